/* Frames of a test vector through the library: a line for each with the instructions, the status, and the log changes.
 *
 * The timer runs at 25 MHz of virtual time and counts down; with -icount shift=0 a tick is 40 instructions. */
#include <stdio.h>
#include <string.h>

#include "panel_constants.h"
#include "test_vector.h"

#define TIMER ((volatile unsigned long *)0x40000000)
#define TICK 40ul

static lampest_panel panel = {.constants = &panel_constants};
static float memory[PANEL_MEMORY];
static float change[PANEL_ROWS * PANEL_COLUMNS];

int main(void) {
    TIMER[2] = TIMER[1] = 0xFFFFFFFFul;
    TIMER[0] = 1;
    printf("begin %d\n", (int)lampest_begin(&panel, memory));
    for (unsigned frame = 0; frame < VECTOR_FRAMES; frame++) {
        const unsigned long start = TIMER[1];
        const lampest_status s = lampest_frame(&panel, vector_sums[frame], change);
        const unsigned long spent = (start - TIMER[1]) * TICK;
        printf("%lu %d %d %d", spent, (int)s.outcome, s.steps, s.products);
        for (unsigned cell = 0; cell < PANEL_ROWS * PANEL_COLUMNS; cell++) {
            unsigned long bits;
            memcpy(&bits, change + cell, sizeof bits);
            printf(" %08lx", bits);
        }
        printf("\n");
    }
    return 0;
}
