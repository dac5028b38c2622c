/* A scan by Arduino's own functions, for any board: two multiplexers, wired as pins.h says (LAMPEST_TWO_POINT).
 *
 * The core waits while it converts; on a Mega scanner.h scans in interrupts. */
#ifndef LAMPEST_PORTABLE_SCAN_H
#define LAMPEST_PORTABLE_SCAN_H

#include <Arduino.h>

#include "pins.h"
#include "protocol.h"

static const uint8_t portable_row_pins[] = LAMPEST_ROW_PINS, portable_column_pins[] = LAMPEST_COLUMN_PINS;

static inline void portable_scan_begin() {
    for (uint8_t bit = 0; bit < 4; ++bit) {
        pinMode(portable_row_pins[bit], OUTPUT);
        pinMode(portable_column_pins[bit], OUTPUT);
    }
#ifndef __AVR__
    analogReadResolution(LAMPEST_ADC_BITS);
#endif
}

static inline void portable_select(const uint8_t *pins, uint8_t channel) {
    for (uint8_t bit = 0; bit < 4; ++bit) digitalWrite(pins[bit], channel >> bit & 1 ? HIGH : LOW);
}

/* A number that another board hardly draws: of the noise of the converter, and of the time. */
static inline uint16_t portable_identity() {
    uint16_t drawn = lampest_crc16(0xFFFF, (uint8_t)micros());
    for (uint8_t reading = 0; reading < LAMPEST_IDENTITY_READINGS; ++reading) {
        drawn = lampest_crc16(drawn, (uint8_t)analogRead(LAMPEST_ADC_PIN));
    }
    return drawn;
}

/* Sums of `readings` codes of each cell, row by row. */
static inline void portable_scan(uint8_t rows, uint8_t columns, uint8_t readings, uint16_t settle_us, uint32_t *sums) {
    static const uint8_t row_channels[] = LAMPEST_ROW_CHANNELS, column_channels[] = LAMPEST_COLUMN_CHANNELS;
    for (uint8_t row = 0; row < rows; ++row) {
        portable_select(portable_row_pins, row_channels[row]);
        for (uint8_t column = 0; column < columns; ++column) {
            portable_select(portable_column_pins, column_channels[column]);
            delayMicroseconds(settle_us);
            uint32_t sum = 0;
            for (uint8_t reading = 0; reading < readings; ++reading) sum += analogRead(LAMPEST_ADC_PIN);
            sums[row * columns + column] = sum;
        }
    }
}

#endif
