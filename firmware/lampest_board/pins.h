/* Everything that depends on how the board is wired: pins, channels, divider, start values. Edit this file only.
 *
 * Divider: supply - row multiplexer - cell - column multiplexer - A0 - reference resistor - ground.
 */
#ifndef LAMPEST_PINS_H
#define LAMPEST_PINS_H

/* Both multiplexers hang on one port, so that one write switches row and column at once.
 * PORTA is D22 (bit 0) to D29 (bit 7): S0..S3 of the row multiplexer on D22..D25, of the column multiplexer on D26..D29. */
#define LAMPEST_SELECT_PORT PORTA
#define LAMPEST_SELECT_DIRECTION DDRA
#define LAMPEST_SELECT_PORT_LETTER 'A'
#define LAMPEST_ROW_SHIFT 0
#define LAMPEST_COLUMN_SHIFT 4

/* Multiplexer channel of every line, in the order of the panel. */
#define LAMPEST_ROW_CHANNELS {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}
#define LAMPEST_COLUMN_CHANNELS {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}

/* The converter reads A0 against the supply. */
#define LAMPEST_ADC_CHANNEL 0
#define LAMPEST_ADC_BITS 10

/* The divider. Measure your own supply and reference resistor and write them here: they go out with every HELLO. */
#define LAMPEST_SUPPLY_MILLIVOLT 5000
#define LAMPEST_REFERENCE_MILLIOHM 1000000UL
#define LAMPEST_MEASURED_ACROSS LAMPEST_ACROSS_REFERENCE

/* What the board does until the host asks for something else. */
#define LAMPEST_START_ROWS 10
#define LAMPEST_START_COLUMNS 10
#define LAMPEST_START_READINGS 20
#define LAMPEST_START_PERIOD_US 1000000UL
#define LAMPEST_START_SETTLE_US 40

/* Scan order: along a row, then the next row. Sums always go out row by row, whatever the order here. */
#define LAMPEST_SCAN_NEXT(row, column, rows, columns) \
    do {                                              \
        if (++(column) == (columns)) {                \
            (column) = 0;                             \
            ++(row);                                  \
        }                                             \
    } while (0)

#endif
