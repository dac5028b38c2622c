/* Framing, CRC, commands and scan order: see protocol.h. No registers, no Arduino. */
#include "protocol.h"

#include <string.h>

#include "pins.h"

void lampest_put_u16(uint8_t *place, uint16_t value) {
    place[0] = (uint8_t)value;
    place[1] = (uint8_t)(value >> 8);
}

void lampest_put_u32(uint8_t *place, uint32_t value) {
    lampest_put_u16(place, (uint16_t)value);
    lampest_put_u16(place + 2, (uint16_t)(value >> 16));
}

void lampest_put_f32(uint8_t *place, float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    lampest_put_u32(place, bits);
}

uint32_t lampest_get_u32(const uint8_t *place) {
    return (uint32_t)place[0] | (uint32_t)place[1] << 8 | (uint32_t)place[2] << 16 | (uint32_t)place[3] << 24;
}

uint16_t lampest_crc16(uint16_t crc, uint8_t byte) {
    crc = (uint16_t)(crc >> 8 | crc << 8);
    crc ^= byte;
    crc ^= (uint16_t)((crc & 0xFF) >> 4);
    crc ^= (uint16_t)(crc << 12);
    crc ^= (uint16_t)((crc & 0xFF) << 5);
    return crc;
}

static void emit_stuffed(const uint8_t *body, uint16_t length, void (*emit)(uint8_t)) {
    uint16_t start = 0;
    for (;;) {
        uint8_t run = 0;
        while (run < 254 && start + run < length && body[start + run] != 0) ++run;
        emit((uint8_t)(run + 1));
        for (uint8_t index = 0; index < run; ++index) emit(body[start + index]);
        start = (uint16_t)(start + run);
        if (start == length) return;
        if (run < 254) ++start; /* the zero that the next code stands for */
    }
}

void lampest_send(uint8_t *body, uint16_t length, void (*emit)(uint8_t)) {
    uint16_t crc = 0xFFFF;
    for (uint16_t index = 0; index < length; ++index) crc = lampest_crc16(crc, body[index]);
    /* The high byte first, so that the CRC of body and CRC together is zero. */
    body[length] = (uint8_t)(crc >> 8);
    body[length + 1] = (uint8_t)crc;
    emit(0);
    emit_stuffed(body, (uint16_t)(length + LAMPEST_CRC_BYTES), emit);
    emit(0);
}

/* Unstuff in place; returns the length, 0 where the codes do not end with the bytes. */
static uint8_t unstuff(uint8_t *bytes, uint8_t length) {
    uint8_t from = 0, to = 0;
    while (from < length) {
        uint8_t code = bytes[from++];
        if (code == 0 || code - 1 > length - from) return 0;
        for (uint8_t index = 1; index < code; ++index) bytes[to++] = bytes[from++];
        if (from < length && code < 255) bytes[to++] = 0;
    }
    return to;
}

uint8_t lampest_receive(lampest_inbox_t *inbox, uint8_t byte) {
    if (byte != 0) {
        if (inbox->length < sizeof inbox->bytes)
            inbox->bytes[inbox->length++] = byte;
        else
            inbox->overflow = 1;
        return 0;
    }
    uint8_t length = inbox->overflow ? 0 : unstuff(inbox->bytes, inbox->length);
    inbox->length = inbox->overflow = 0;
    if (length <= LAMPEST_CRC_BYTES) return 0;
    uint16_t crc = 0xFFFF;
    for (uint8_t index = 0; index < length; ++index) crc = lampest_crc16(crc, inbox->bytes[index]);
    return crc == 0 ? (uint8_t)(length - LAMPEST_CRC_BYTES) : 0;
}

lampest_settings_t lampest_start_settings(void) {
    lampest_settings_t settings;
    settings.rows = LAMPEST_START_ROWS;
    settings.columns = LAMPEST_START_COLUMNS;
    settings.readings = LAMPEST_START_READINGS;
    settings.running = 0;
    settings.settle_us = LAMPEST_START_SETTLE_US;
    settings.period_us = LAMPEST_START_PERIOD_US;
    settings.estimates = 0;
    settings.baseline = 0;
    settings.identity = 0;
    return settings;
}

uint16_t lampest_frame_bytes(const lampest_settings_t *settings) {
    uint16_t body = (uint16_t)(LAMPEST_FRAME_HEADER_BYTES + 2 * settings->rows * settings->columns + LAMPEST_CRC_BYTES);
    return (uint16_t)(body + body / 254 + 3);
}

uint32_t lampest_shortest_period_us(const lampest_settings_t *settings) {
    uint32_t cell = (uint32_t)settings->readings * LAMPEST_CONVERSION_US + settings->settle_us + LAMPEST_CELL_US;
    uint32_t scan = (uint32_t)settings->rows * settings->columns * cell + LAMPEST_SCAN_US;
    uint32_t send = (uint32_t)lampest_frame_bytes(settings) * LAMPEST_BYTE_US + LAMPEST_SCAN_US;
    /* Boards that estimate send after the scan, not beside it: four bytes more for each cell. */
    if (settings->estimates) return scan + send + 4 * LAMPEST_BYTE_US * (uint32_t)settings->rows * settings->columns;
    return scan > send ? scan : send;
}

uint16_t lampest_slices(uint32_t period_us) {
    uint32_t ticks = (period_us + LAMPEST_TICK_US / 2) / LAMPEST_TICK_US;
    return (uint16_t)((ticks + LAMPEST_MOST_SLICE_TICKS - 1) / LAMPEST_MOST_SLICE_TICKS);
}

uint32_t lampest_slice_ticks(uint32_t period_us) {
    uint32_t ticks = (period_us + LAMPEST_TICK_US / 2) / LAMPEST_TICK_US;
    uint16_t slices = lampest_slices(period_us);
    return (ticks + slices / 2) / slices;
}

static uint8_t set_byte(uint8_t *place, uint32_t value, uint32_t most) {
    if (value < 1 || value > most) return LAMPEST_REFUSED_RANGE;
    *place = (uint8_t)value;
    return LAMPEST_DONE;
}

static uint8_t set_period(lampest_settings_t *settings, uint32_t value) {
    if (value > LAMPEST_MOST_PERIOD_US) return LAMPEST_REFUSED_RANGE;
    if (value < lampest_shortest_period_us(settings)) return LAMPEST_REFUSED_TOO_FAST;
    settings->period_us = LAMPEST_TICK_US * lampest_slice_ticks(value) * lampest_slices(value);
    return LAMPEST_DONE;
}

static uint8_t set_settle(lampest_settings_t *settings, uint32_t value) {
    if (value > LAMPEST_MOST_SETTLE_US) return LAMPEST_REFUSED_RANGE;
    settings->settle_us = (uint16_t)value;
    return LAMPEST_DONE;
}

static uint8_t set_baseline(lampest_settings_t *settings, uint32_t value) {
    if (!settings->estimates) return LAMPEST_REFUSED_UNKNOWN;
    if (value > LAMPEST_MOST_BASELINE) return LAMPEST_REFUSED_RANGE;
    settings->baseline = (uint8_t)value;
    return LAMPEST_DONE;
}

static uint8_t start(lampest_settings_t *settings) {
    if (settings->period_us < lampest_shortest_period_us(settings)) return LAMPEST_REFUSED_TOO_FAST;
    settings->running = 1;
    return LAMPEST_DONE;
}

static uint8_t change(lampest_settings_t *settings, uint8_t command, uint32_t value) {
    switch (command) {
        case LAMPEST_SET_ROWS: return set_byte(&settings->rows, value, LAMPEST_MOST_ROWS);
        case LAMPEST_SET_COLUMNS: return set_byte(&settings->columns, value, LAMPEST_MOST_COLUMNS);
        case LAMPEST_SET_READINGS: return set_byte(&settings->readings, value, LAMPEST_MOST_READINGS);
        case LAMPEST_SET_PERIOD: return set_period(settings, value);
        case LAMPEST_SET_SETTLE: return set_settle(settings, value);
        case LAMPEST_SET_BASELINE: return set_baseline(settings, value);
        case LAMPEST_START: return start(settings);
        default: return LAMPEST_REFUSED_UNKNOWN;
    }
}

static uint32_t present_value(const lampest_settings_t *settings, uint8_t command) {
    switch (command) {
        case LAMPEST_SET_ROWS: return settings->rows;
        case LAMPEST_SET_COLUMNS: return settings->columns;
        case LAMPEST_SET_READINGS: return settings->readings;
        case LAMPEST_SET_PERIOD: return settings->period_us;
        case LAMPEST_SET_SETTLE: return settings->settle_us;
        case LAMPEST_SET_BASELINE: return settings->baseline;
        case LAMPEST_START: return settings->identity;
        default: return settings->running;
    }
}

uint8_t lampest_command(lampest_settings_t *settings, const uint8_t *body, uint8_t length, uint8_t *answer) {
    uint8_t command = length > 1 ? body[1] : 0;
    uint8_t result;
    if (body[0] != LAMPEST_PROTOCOL_VERSION) {
        result = LAMPEST_REFUSED_VERSION;
    } else if (length != LAMPEST_COMMAND_BYTES) {
        result = LAMPEST_REFUSED_UNKNOWN;
    } else if (command == LAMPEST_IDENTIFY) {
        return lampest_hello(settings, answer);
    } else if (command == LAMPEST_STOP) {
        settings->running = 0;
        result = LAMPEST_DONE;
    } else if (settings->running) {
        result = LAMPEST_REFUSED_RUNNING;
    } else {
        result = change(settings, command, lampest_get_u32(body + 3));
    }
    answer[0] = LAMPEST_PROTOCOL_VERSION;
    answer[1] = LAMPEST_ANSWER;
    answer[2] = command;
    answer[3] = length > 2 ? body[2] : 0;
    answer[4] = result;
    lampest_put_u32(answer + 5, present_value(settings, command));
    return LAMPEST_ANSWER_BYTES;
}

uint8_t lampest_hello(const lampest_settings_t *settings, uint8_t *body) {
    body[0] = LAMPEST_PROTOCOL_VERSION;
    body[1] = LAMPEST_HELLO;
    body[2] = settings->rows;
    body[3] = settings->columns;
    body[4] = settings->readings;
    body[5] = LAMPEST_MOST_ROWS;
    body[6] = LAMPEST_MOST_COLUMNS;
    body[7] = LAMPEST_MOST_READINGS;
    lampest_put_u16(body + 8, LAMPEST_FIRMWARE_MAJOR << 8 | LAMPEST_FIRMWARE_MINOR);
    lampest_put_u32(body + 10, settings->period_us);
    lampest_put_u32(body + 14, lampest_shortest_period_us(settings));
    lampest_put_u16(body + 18, settings->settle_us);
    lampest_put_u16(body + 20, LAMPEST_SUPPLY_MILLIVOLT);
    body[26] = LAMPEST_ADC_BITS;
    body[28] = settings->running;
    if (LAMPEST_WIRING == LAMPEST_TWO_POINT) {
        lampest_put_u32(body + 22, LAMPEST_REFERENCE_MILLIOHM);
        body[27] = LAMPEST_MEASURED_ACROSS;
        return LAMPEST_HELLO_BYTES;
    }
    lampest_put_u32(body + 22, LAMPEST_LOAD_MILLIOHM);
    body[27] = LAMPEST_ACROSS_REFERENCE;
    body[29] = LAMPEST_WIRING;
    lampest_put_u32(body + 30, LAMPEST_DRIVE_MILLIOHM);
    return LAMPEST_HELLO_BYTES + LAMPEST_HELLO_WIRING_BYTES;
}

void lampest_frame_header(const lampest_settings_t *settings, uint32_t sequence, uint32_t device_ms, uint16_t missed,
                          uint8_t *body) {
    body[0] = LAMPEST_PROTOCOL_VERSION;
    body[1] = LAMPEST_FRAME;
    body[2] = settings->rows;
    body[3] = settings->columns;
    body[4] = settings->readings;
    lampest_put_u32(body + 5, sequence);
    lampest_put_u32(body + 9, device_ms);
    lampest_put_u16(body + 13, missed);
    lampest_put_u16(body + 15, settings->identity);
}

void lampest_estimate_header(const lampest_settings_t *settings, uint32_t sequence, uint8_t outcome, uint8_t *body) {
    body[0] = LAMPEST_PROTOCOL_VERSION;
    body[1] = LAMPEST_ESTIMATE;
    body[2] = settings->rows;
    body[3] = settings->columns;
    body[4] = outcome;
    lampest_put_u32(body + 5, sequence);
    lampest_put_u16(body + 9, settings->identity);
}

void lampest_scan_next(uint8_t *row, uint8_t *column, uint8_t rows, uint8_t columns) {
    (void)rows;
    LAMPEST_SCAN_NEXT(*row, *column, rows, columns);
}
