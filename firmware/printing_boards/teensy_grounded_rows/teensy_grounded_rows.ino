/* Teensy 4.1: rows on pins, idle rows LOW, a resistor to GND on every column; prints numbers.
 *
 * Pins 0 to 7 - row lines. Column lines - A0 to A7 - each through 1 kohm to GND. No multiplexer.
 * Idle rows are grounded, so that little current takes other ways.
 *
 * An object of JSON a frame: {"t": microseconds, "data": [[...], ...]}. scene.yaml beside this file fits.
 *   lampest live --port /dev/ttyACM0 --scene scene.yaml
 */
static const int ROWS = 8;
static const int COLUMNS = 8;
static const int FIRST_ROW_PIN = 0;
static const int COLUMN_PINS[COLUMNS] = {A0, A1, A2, A3, A4, A5, A6, A7};
static const int SETTLE_US = 5; /* idle rows and 1 kohm discharge a column fast */

void setup() {
    Serial.begin(115200); /* USB ignores the rate */
    analogReadResolution(12);
    analogReadAveraging(4);
    for (int row = 0; row < ROWS; ++row) {
        pinMode(FIRST_ROW_PIN + row, OUTPUT);
        digitalWrite(FIRST_ROW_PIN + row, LOW);
    }
}

void loop() {
    Serial.printf("{\"t\": %lu, \"data\": [", (unsigned long)micros());
    for (int row = 0; row < ROWS; ++row) {
        digitalWrite(FIRST_ROW_PIN + row, HIGH);
        delayMicroseconds(SETTLE_US);
        Serial.print(row ? ", [" : "[");
        for (int column = 0; column < COLUMNS; ++column) {
            analogRead(COLUMN_PINS[column]); /* takes the charge of the column before */
            Serial.printf(column ? ", %d" : "%d", analogRead(COLUMN_PINS[column]));
        }
        Serial.print("]");
        digitalWrite(FIRST_ROW_PIN + row, LOW);
    }
    Serial.println("]}");
    delay(10);
}
