/* Frames of a test vector through the library on an ATmega2560: GPIOR0 counts the frames, and GPIOR1 and GPIOR2 then hold
 * the address of the log changes of the last one. */
#include <avr/io.h>
#include <avr/sleep.h>

#include "panel_constants.h"
#include "test_vector.h"

static lampest_panel panel = {.constants = &panel_constants};
static float memory[PANEL_MEMORY];
static float change[PANEL_ROWS * PANEL_COLUMNS];

int main(void) {
    const lampest_outcome begun = lampest_begin(&panel, memory);
    GPIOR1 = (uint8_t)((uint16_t)change & 0xFF);
    GPIOR2 = (uint8_t)((uint16_t)change >> 8);
    GPIOR0 = begun == LAMPEST_FINE ? 1 : 255;
    for (uint8_t frame = 0; frame < VECTOR_FRAMES; frame++) {
        if (lampest_frame(&panel, vector_sums[frame], change).outcome != LAMPEST_FINE) GPIOR0 = 255;
        GPIOR0++;
    }
    sleep_enable();
    for (;;) sleep_cpu();
}
