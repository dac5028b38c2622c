/* Everything that depends on how the board is wired: pins, channels, divider, start values. Edit this file only.
 *
 * LAMPEST_TWO_POINT, two multiplexers:     supply - row multiplexer - cell - column multiplexer - A0 - reference resistor
 *                                          - ground; all other lines float.
 * LAMPEST_LOADED_COLUMNS, one multiplexer: supply - row multiplexer - row line; every column line leads to an analog input
 *                                          of its own and through a load resistor to ground; all other rows float.
 */
#ifndef LAMPEST_PINS_H
#define LAMPEST_PINS_H

#include "protocol.h"

/* Change it here, or build with -DLAMPEST_WIRING=...; in this folder `make` builds both. */
#ifndef LAMPEST_WIRING
#define LAMPEST_WIRING LAMPEST_TWO_POINT
#endif

/* Both multiplexers hang on one port, so that one write switches row and column at once.
 * PORTA is D22 (bit 0) to D29 (bit 7): S0..S3 of the row multiplexer on D22..D25, of the column multiplexer on D26..D29.
 * With loaded columns D26..D29 stay low and free. */
#define LAMPEST_SELECT_PORT PORTA
#define LAMPEST_SELECT_DIRECTION DDRA
#define LAMPEST_SELECT_PORT_LETTER 'A'
#define LAMPEST_ROW_SHIFT 0
#define LAMPEST_COLUMN_SHIFT 4

/* The same for boards without PORTA, whose sketches scan by portable_scan.h: S0..S3 of each multiplexer, and its input. */
#define LAMPEST_ROW_PINS {22, 23, 24, 25}
#define LAMPEST_COLUMN_PINS {26, 27, 28, 29}
#define LAMPEST_ADC_PIN A0

/* Multiplexer channel of every line, in the order of the panel; with loaded columns the column's analog input. */
#define LAMPEST_ROW_CHANNELS {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}
#define LAMPEST_COLUMN_CHANNELS {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}

/* The converter reads against the supply; with two multiplexers always this input. */
#define LAMPEST_ADC_CHANNEL 0
#define LAMPEST_ADC_BITS 10

/* The divider. Measure your own supply and resistors and write them here: they go out with every HELLO. */
#define LAMPEST_SUPPLY_MILLIVOLT 5000
/* Two multiplexers: the one reference resistor, and what the voltage is taken across. */
#define LAMPEST_REFERENCE_MILLIOHM 1000000UL
#define LAMPEST_MEASURED_ACROSS LAMPEST_ACROSS_REFERENCE
/* Loaded columns: each load, and what stands between supply and row line (CD74HC4067: 70 ohm typical at 5 V). */
#define LAMPEST_LOAD_MILLIOHM 10000000UL
#define LAMPEST_DRIVE_MILLIOHM 70000UL

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
