/* Prints presses and releases of a matrix keyboard without diodes, with their strengths.
 *
 * panel_constants.h comes from `lampest export RESULTS --to c`; a term that suits keys, few of which are pressed, is
 * log_ratio with a squared loss and the weight 1e-4: a press changes ln r by about 1. Put your own scan into read_sums.
 */
#include "keys.h"
#include "panel_constants.h"

static lampest_panel panel = {&panel_constants};
static float memory[PANEL_MEMORY];
static float change[PANEL_ROWS * PANEL_COLUMNS];
static uint16_t sums[PANEL_ROWS * PANEL_COLUMNS];
static uint8_t pressed[PANEL_ROWS * PANEL_COLUMNS];

static void read_sums() {
    for (uint16_t cell = 0; cell < PANEL_ROWS * PANEL_COLUMNS; ++cell) sums[cell] = LAMPEST_MISSING;
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
    if (lampest_begin(&panel, memory) != LAMPEST_FINE) Serial.println("the constants are not sound");
    for (uint8_t frame = 0; frame < 8; ++frame) {
        read_sums();
        if (lampest_baseline(&panel, sums).outcome == LAMPEST_UNDER_LOAD) Serial.println("release all keys");
    }
}

void loop() {
    read_sums();
    const lampest_status status = lampest_frame(&panel, sums, change);
    if (status.outcome == LAMPEST_FINE) keys_update(&panel, change, pressed, print_event);
}
