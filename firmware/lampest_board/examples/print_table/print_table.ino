/* Prints every scan as a line of numbers: mean codes of the converter, row by row, commas between them.
 *
 * For a first look in the serial monitor (500000 baud), and for programs that know no other format:
 *   lampest import monitor.log --scene scene.yaml --unit code --out mine.h5
 * A damaged line cannot be told from a good one; for recordings upload lampest_board.ino and use lampest record.
 */
#include <pins.h>
#include <protocol.h>
#include <scanner.h>

static lampest_settings_t settings;

void setup() {
    settings = lampest_start_settings();
    settings.running = 1;
    Serial.begin(LAMPEST_BAUD);
    scanner_begin();
    scanner_apply(&settings);
}

void loop() {
    const uint8_t *frame = scanner_finished();
    if (!frame) return;
    const uint8_t *sums = frame + LAMPEST_FRAME_HEADER_BYTES;
    uint16_t cells = (uint16_t)settings.rows * settings.columns;
    for (uint16_t cell = 0; cell < cells; ++cell) {
        if (cell) Serial.print(',');
        uint16_t sum = sums[2 * cell] | (uint16_t)sums[2 * cell + 1] << 8;
        Serial.print((float)sum / settings.readings, 2);
    }
    Serial.println();
    scanner_release();
}
