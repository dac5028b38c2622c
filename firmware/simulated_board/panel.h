/* What hangs on the board, wired as pins.h says: a panel whose cells change with time, multiplexers, resistors, a noisy
 * converter. */
#ifndef LAMPEST_PANEL_H
#define LAMPEST_PANEL_H

#include <stdint.h>

#include "network.h"

typedef struct {
    int frames, rows, columns, loop;
    double *time, *cells; /* frames; frames x rows x columns, ohm */
    double row_ohm[16], column_ohm[16], load_ohm[16];
    double settle_s, noise_lsb;
    double memory, converted; /* share of the voltage converted before that the converter keeps, and that voltage */
    uint64_t random_state;
    int known_frame; /* the frame whose voltages stand in `resting` */
    double resting[16 * 16];
    double volt_before, switched_s;
    int row, column, row_before;
} panel_t;

/* Read "frames rows columns" and then for every frame its time in s and its cells in ohm. Exits with a sentence on error. */
void panel_read(panel_t *panel, const char *path);

/* The multiplexers now join this row and this column; time in s. */
void panel_select(panel_t *panel, int row, int column, double time_s);

/* The converter now reads this column's input, of those that are loaded; the row stays. */
void panel_sense(panel_t *panel, int column);

/* The converter's code at that time. */
int panel_code(panel_t *panel, double time_s);

/* Uniform in [0, 1), and normal with sigma 1. */
double random_uniform(uint64_t *state);
double random_normal(uint64_t *state);

#endif
