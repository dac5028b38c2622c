/* ESP32: a multiplexer for the rows, one for the columns, one reference resistor; prints numbers.
 *
 * 3V3 - common pin of the row multiplexer (CD74HC4067) - row lines; S0..S3 on GPIO 13, 14, 27, 26.
 * Column lines - column multiplexer - its common pin - GPIO 34, and through 1 kohm to GND; S0..S3 on 25, 33, 32, 23.
 * EN of both to GND. All other lines float. GPIO 34 is an input of ADC1, which works beside Wi-Fi.
 *
 * A row a line, an empty line behind each frame. scene.yaml beside this file fits.
 *   lampest live --port /dev/ttyUSB0 --scene scene.yaml
 */
static const int ROWS = 16;
static const int COLUMNS = 16;
static const int ROW_PINS[] = {13, 14, 27, 26};
static const int COLUMN_PINS[] = {25, 33, 32, 23};
static const int INPUT_PIN = 34;
static const int READINGS = 4;      /* their mean is printed: the converter scatters by some 3 LSB */
static const int SETTLE_US = 20;    /* 1 kohm and two channels charge the line at once */

static void select_line(const int pins[4], int line) {
    for (int bit = 0; bit < 4; ++bit) digitalWrite(pins[bit], line >> bit & 1);
}

static float read_cell() {
    delayMicroseconds(SETTLE_US);
    analogRead(INPUT_PIN); /* takes the charge of the cell before */
    int sum = 0;
    for (int reading = 0; reading < READINGS; ++reading) sum += analogRead(INPUT_PIN);
    return sum / (float)READINGS;
}

void setup() {
    Serial.begin(921600);
    analogReadResolution(12);
    analogSetPinAttenuation(INPUT_PIN, ADC_11db); /* up to some 3.1 V */
    for (int bit = 0; bit < 4; ++bit) {
        pinMode(ROW_PINS[bit], OUTPUT);
        pinMode(COLUMN_PINS[bit], OUTPUT);
    }
}

void loop() {
    for (int row = 0; row < ROWS; ++row) {
        select_line(ROW_PINS, row);
        for (int column = 0; column < COLUMNS; ++column) {
            select_line(COLUMN_PINS, column);
            Serial.printf(column ? ",%.2f" : "%.2f", read_cell());
        }
        Serial.println();
    }
    Serial.println();
}
