/* Prints presses and releases of a matrix keyboard without diodes, with their strengths.
 *
 * panel_constants.h comes from `lampest export RESULTS --to c`; a term that suits keys, few of which are pressed, is
 * log_ratio with a squared loss and the weight 1e-4: a press changes ln r by about 1. The scan is that of two multiplexers,
 * of the library lampest_board (pins.h); for another circuit put your own into read_sums.
 */
#include <portable_scan.h>

#include "keys.h"
#include "panel_constants.h"

static lampest_panel panel = {&panel_constants};
static float memory[PANEL_MEMORY];
static float change[PANEL_ROWS * PANEL_COLUMNS];
static uint32_t sums[PANEL_ROWS * PANEL_COLUMNS];
static uint8_t pressed[PANEL_ROWS * PANEL_COLUMNS];

static void read_sums() {
    portable_scan(PANEL_ROWS, PANEL_COLUMNS, PANEL_READINGS, LAMPEST_START_SETTLE_US, sums);
}

static void print_event(uint8_t row, uint8_t column, float strength) {
    Serial.print(strength > 0 ? "press " : "release ");
    Serial.print(row);
    Serial.print(' ');
    Serial.print(column);
    Serial.print(' ');
    Serial.println(strength, 2);
}

void setup() {
    Serial.begin(115200);
    portable_scan_begin();
    if (lampest_begin(&panel, memory) != LAMPEST_FINE) Serial.println("the constants are not sound");
    for (uint8_t frame = 0; frame < 8; ++frame) {
        read_sums();
        if (lampest_baseline(&panel, sums).outcome == LAMPEST_UNDER_LOAD) Serial.println("release all keys");
    }
}

void loop() {
    read_sums();
    keys_scan(&panel, sums, change, pressed, print_event);
}
