/* What travels between board and host, in plain C: compiled for the board, for the host's tests and for the simulated board.
 *
 * A message on the wire is 0x00 - COBS(body, CRC-16/CCITT-FALSE of body) - 0x00, numbers little-endian. The leading 0x00
 * keeps whatever stood on the line before (a boot banner, half a message) out of it. Bodies, by type:
 *
 *   HELLO    version, type, rows, columns, readings, most rows, most columns, most readings: u8
 *            firmware u16 (major, minor), period us u32, shortest period us u32, settle us u16,
 *            supply mV u16, reference mOhm u32, adc bits u8, measured across u8, running u8
 *            and only where the wiring is not LAMPEST_TWO_POINT: wiring u8, drive mOhm u32. Boards without these two are
 *            wired with two multiplexers. With loaded columns the reference is the load of every column, and the voltage
 *            is taken across it.
 *   FRAME    version, type, rows, columns, readings: u8, sequence u32, device ms u32, missed ticks u16, identity u16,
 *            sums u16[rows * columns], row by row
 *   ESTIMATE version, type, rows, columns, outcome: u8, sequence u32, identity u16,
 *            ln(r / r unloaded) f32[rows * columns], row by row.
 *            Sent before the FRAME of the same sequence, by boards that estimate. The outcome is that of lampest_frame;
 *            the numbers are meant only where it is 0. Unloaded frames have none, unless the baseline fails.
 *   ANSWER   version, type, command, tag, result: u8, value u32 (the value that now holds; of START the identity)
 *   commands version, type, tag: u8, value u32
 *
 * The identity is a number that the board draws at each START. Frames of another board on the same line have another one.
 */
#ifndef LAMPEST_PROTOCOL_H
#define LAMPEST_PROTOCOL_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define LAMPEST_PROTOCOL_VERSION 2
#define LAMPEST_FIRMWARE_MAJOR 2
#define LAMPEST_FIRMWARE_MINOR 0
#define LAMPEST_BAUD 500000UL

#define LAMPEST_HELLO 1
#define LAMPEST_FRAME 2
#define LAMPEST_ANSWER 3
#define LAMPEST_ESTIMATE 4
#define LAMPEST_IDENTIFY 16
#define LAMPEST_START 17
#define LAMPEST_STOP 18
#define LAMPEST_SET_ROWS 19
#define LAMPEST_SET_COLUMNS 20
#define LAMPEST_SET_READINGS 21
#define LAMPEST_SET_PERIOD 22
#define LAMPEST_SET_SETTLE 23
/* Of boards that estimate: so many frames after START are unloaded, the baseline of the estimate; 0: that of its constants.
 * Other boards do not know this command, by which a host tells them apart. */
#define LAMPEST_SET_BASELINE 24

#define LAMPEST_DONE 0
#define LAMPEST_REFUSED_UNKNOWN 1
#define LAMPEST_REFUSED_RANGE 2
#define LAMPEST_REFUSED_TOO_FAST 3
#define LAMPEST_REFUSED_RUNNING 4
#define LAMPEST_REFUSED_VERSION 5

#define LAMPEST_ACROSS_REFERENCE 0
#define LAMPEST_ACROSS_SENSOR 1

#define LAMPEST_TWO_POINT 0
#define LAMPEST_LOADED_COLUMNS 1

/* 64 readings of 1023 are the most that a u16 holds. */
#define LAMPEST_MOST_ROWS 16
#define LAMPEST_MOST_COLUMNS 16
#define LAMPEST_MOST_READINGS 64
#define LAMPEST_MOST_BASELINE 255
#define LAMPEST_MOST_PERIOD_US 60000000UL
#define LAMPEST_MOST_SETTLE_US 30000

#define LAMPEST_HELLO_BYTES 29
#define LAMPEST_HELLO_WIRING_BYTES 5
#define LAMPEST_FRAME_HEADER_BYTES 17
#define LAMPEST_ESTIMATE_HEADER_BYTES 11
#define LAMPEST_ANSWER_BYTES 9
#define LAMPEST_COMMAND_BYTES 7
#define LAMPEST_CRC_BYTES 2
#define LAMPEST_MOST_BODY_BYTES \
    (LAMPEST_FRAME_HEADER_BYTES + 2 * LAMPEST_MOST_ROWS * LAMPEST_MOST_COLUMNS + LAMPEST_CRC_BYTES)

/* Codes of which a board draws its identity: noise of half a step turns each last bit as often as not. */
#define LAMPEST_IDENTITY_READINGS 32

/* The timer that sets the period counts in 4 us and to 65536 at most; longer periods are made of equal slices. */
#define LAMPEST_TICK_US 4
#define LAMPEST_MOST_SLICE_TICKS 65536UL
/* 14 cycles of a 125 kHz converter clock, as on the chip: 13 for the conversion, up to one to begin it. */
#define LAMPEST_CONVERSION_US 112
/* Interrupts, switching and storing for one cell, and sending and starting for one scan; measured, with reserve. */
#define LAMPEST_CELL_US 16
#define LAMPEST_SCAN_US 500
#define LAMPEST_BYTE_US 24

typedef struct {
    uint8_t rows, columns, readings, running;
    uint16_t settle_us;
    uint32_t period_us;
    uint8_t estimates; /* 1 where the sketch estimates; set by it */
    uint8_t baseline;  /* unloaded frames after START */
    uint16_t identity; /* set by the sketch before it carries out a START */
} lampest_settings_t;

typedef struct {
    uint8_t bytes[24];
    uint8_t length, overflow;
} lampest_inbox_t;

void lampest_put_u16(uint8_t *place, uint16_t value);
void lampest_put_u32(uint8_t *place, uint32_t value);
uint32_t lampest_get_u32(const uint8_t *place);

/* crc' of one more byte; polynomial x^16 + x^12 + x^5 + 1, start at 0xFFFF. */
uint16_t lampest_crc16(uint16_t crc, uint8_t byte);

/* Write the CRC behind the body (two bytes must be free there) and emit the whole message. */
void lampest_send(uint8_t *body, uint16_t length, void (*emit)(uint8_t));

/* Take one byte from the line; returns the length of a complete, undamaged body in inbox->bytes, else 0. */
uint8_t lampest_receive(lampest_inbox_t *inbox, uint8_t byte);

/* Start values of pins.h. */
lampest_settings_t lampest_start_settings(void);

/* Carry out a command on the settings; writes the answer's body and returns its length. IDENTIFY is answered by HELLO.
 * The longest is a HELLO with its wiring. */
uint8_t lampest_command(lampest_settings_t *settings, const uint8_t *body, uint8_t length, uint8_t *answer);

uint8_t lampest_hello(const lampest_settings_t *settings, uint8_t *body);
void lampest_frame_header(const lampest_settings_t *settings, uint32_t sequence, uint32_t device_ms, uint16_t missed,
                          uint8_t *body);

/* Writes the header of an ESTIMATE; lampest_put_f32 writes its numbers behind. */
void lampest_estimate_header(const lampest_settings_t *settings, uint32_t sequence, uint8_t outcome, uint8_t *body);
void lampest_put_f32(uint8_t *place, float value);

/* Bytes on the wire of one frame at most, and the shortest period that scanning and sending allow. */
uint16_t lampest_frame_bytes(const lampest_settings_t *settings);
uint32_t lampest_shortest_period_us(const lampest_settings_t *settings);

/* Number of equal timer slices in a period, and ticks of one slice. */
uint16_t lampest_slices(uint32_t period_us);
uint32_t lampest_slice_ticks(uint32_t period_us);

/* The cell after (row, column) in the order of pins.h. */
void lampest_scan_next(uint8_t *row, uint8_t *column, uint8_t rows, uint8_t columns);

#ifdef __cplusplus
}
#endif

#endif
