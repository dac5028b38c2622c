/* What hangs on the board: a panel whose cells change with time, two multiplexers, a divider, a noisy converter. */
#ifndef LAMPEST_PANEL_H
#define LAMPEST_PANEL_H

#include <stdint.h>

#include "network.h"

typedef struct {
    int frames, rows, columns, loop;
    double *time, *cells; /* frames; frames x rows x columns, ohm */
    double row_ohm[16], column_ohm[16];
    double settle_s, noise_lsb;
    uint64_t random_state;
    int known_frame; /* the frame whose two-point resistances stand in `resistance` */
    double resistance[16 * 16];
    double volt, volt_before, switched_s;
    int row, column;
} panel_t;

/* Read "frames rows columns" and then for every frame its time in s and its cells in ohm. Exits with a sentence on error. */
void panel_read(panel_t *panel, const char *path);

/* The multiplexers now join this row and this column; time in s. */
void panel_select(panel_t *panel, int row, int column, double time_s);

/* The converter's code at that time. */
int panel_code(panel_t *panel, double time_s);

/* Uniform in [0, 1), and normal with sigma 1. */
double random_uniform(uint64_t *state);
double random_normal(uint64_t *state);

#endif
