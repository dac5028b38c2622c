/* The serial line: a pseudo-terminal that bytes may not survive, and that can be unplugged. */
#ifndef LAMPEST_LINE_H
#define LAMPEST_LINE_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

typedef struct {
    int master, slave, watch, real_time;
    char name[64];
    const char *link; /* a fixed name for the terminal, or 0 */
    double flip, drop, duplicate;
    uint64_t random_state;
    FILE *log; /* two bytes for each byte sent: the byte and its fate */
    uint8_t out[1 << 14];
    size_t out_length;
    uint8_t in[256];
    size_t in_length;
    unsigned long sent, flipped, dropped, duplicated, overrun;
} line_t;

enum { FATE_WHOLE, FATE_FLIPPED, FATE_DROPPED, FATE_DUPLICATED };

/* Make the terminal and its link. Exits with a sentence on error. */
void line_plug(line_t *line);
/* Take it away: who has it open reads an end of file or an error. */
void line_unplug(line_t *line);

/* A byte from the board, through the faults, towards the host. */
void line_send(line_t *line, uint8_t byte);
/* Pass bytes on in both directions. In real time what the host does not take is lost, as on a cable; else this waits
 * for the host, and the board's time stands still, until `quit` is set. Returns 1 where the host has opened the line. */
int line_pump(line_t *line, volatile int *quit);

#endif
