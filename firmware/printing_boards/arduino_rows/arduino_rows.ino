/* Arduino Mega: rows through one multiplexer, a pull-down resistor on every column; prints numbers.
 *
 * 5V - common pin of a CD74HC4067 - channels C0, C1 ... - row lines; S0..S3 on D22..D25, EN to GND.
 * Column lines - A0, A1 ... - each through 10 kohm to GND. Rows that are not selected float.
 *
 * A frame a line: milliseconds, then all codes, row by row. scene.yaml beside this file fits.
 *   lampest live --port /dev/ttyACM0 --scene scene.yaml
 */
#ifndef ROWS
#define ROWS 8
#endif
#ifndef COLUMNS
#define COLUMNS 8
#endif

static const uint8_t ADDRESS_PINS[] = {22, 23, 24, 25};
/* A line of 100 pF behind 10 kohm settles within 1/1024 after 7 time constants, 7 us; wires and film have more. */
static const unsigned SETTLE_US = 40;

static void select_row(uint8_t row) {
    for (uint8_t bit = 0; bit < sizeof ADDRESS_PINS; ++bit) {
        digitalWrite(ADDRESS_PINS[bit], row >> bit & 1);
    }
    delayMicroseconds(SETTLE_US);
}

static int read_column(uint8_t column) {
    /* The converter's own capacitor holds the voltage of the column before; the second conversion has lost it. */
    analogRead(A0 + column);
    return analogRead(A0 + column);
}

void setup() {
    Serial.begin(115200);
    for (uint8_t bit = 0; bit < sizeof ADDRESS_PINS; ++bit) pinMode(ADDRESS_PINS[bit], OUTPUT);
}

void loop() {
    Serial.print(millis());
    for (uint8_t row = 0; row < ROWS; ++row) {
        select_row(row);
        for (uint8_t column = 0; column < COLUMNS; ++column) {
            Serial.print(',');
            Serial.print(read_column(column));
        }
    }
    Serial.println();
}
