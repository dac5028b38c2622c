/* Lampest board that also estimates: sends the sums of its readings, and the log changes of the cells beside them.
 *
 * For boards with a floating-point unit, two multiplexers wired as pins.h says, and the library lampest_estimate. Put
 * panel_constants.h of `lampest export RESULTS --to c` into this folder. `lampest record` stores both, `lampest live`
 * shows both maps, `lampest info` compares them.
 *
 * It estimates while rows, columns and readings are those of the constants; else it scans alone.
 */
#include <lampest_estimate.h>
#include <pins.h>
#include <portable_scan.h>
#include <protocol.h>

#include "panel_constants.h"

static lampest_settings_t settings;
static lampest_inbox_t inbox;
static lampest_panel panel = {&panel_constants};
static float memory[PANEL_MEMORY], change[PANEL_ROWS * PANEL_COLUMNS];
static uint32_t sums[LAMPEST_MOST_ROWS * LAMPEST_MOST_COLUMNS];
static uint8_t frame[LAMPEST_MOST_BODY_BYTES];
static uint8_t estimate[LAMPEST_ESTIMATE_HEADER_BYTES + 4 * PANEL_ROWS * PANEL_COLUMNS + LAMPEST_CRC_BYTES];
static uint32_t sequence, due_us, greeted_ms;
static uint16_t missed;
static uint8_t unloaded; /* frames that are still to come */

static void emit(uint8_t byte) {
    Serial.write(byte);
}

static void sayHello() {
    uint8_t body[LAMPEST_HELLO_BYTES + LAMPEST_HELLO_WIRING_BYTES + LAMPEST_CRC_BYTES];
    lampest_send(body, lampest_hello(&settings, body), emit);
    greeted_ms = millis();
}

static void start() {
    sequence = missed = 0;
    due_us = micros();
    unloaded = settings.baseline;
    if (unloaded) lampest_begin(&panel, memory);
}

static void obey(uint8_t length) {
    uint8_t answer[LAMPEST_HELLO_BYTES + LAMPEST_HELLO_WIRING_BYTES + LAMPEST_CRC_BYTES];
    const bool ran = settings.running;
    if (!ran && length > 1 && inbox.bytes[1] == LAMPEST_START) settings.identity = portable_identity();
    settings.estimates = settings.rows == PANEL_ROWS && settings.columns == PANEL_COLUMNS &&
                         settings.readings == PANEL_READINGS;
    const uint8_t bytes = lampest_command(&settings, inbox.bytes, length, answer);
    lampest_send(answer, bytes, emit);
    if (settings.running && !ran) start();
}

static void sendEstimate(lampest_outcome outcome) {
    lampest_estimate_header(&settings, sequence, outcome, estimate);
    uint8_t *place = estimate + LAMPEST_ESTIMATE_HEADER_BYTES;
    for (uint16_t cell = 0; cell < PANEL_ROWS * PANEL_COLUMNS; ++cell) lampest_put_f32(place + 4 * cell, change[cell]);
    lampest_send(estimate, LAMPEST_ESTIMATE_HEADER_BYTES + 4 * PANEL_ROWS * PANEL_COLUMNS, emit);
}

static void estimateCells() {
    if (!unloaded) {
        sendEstimate(lampest_frame(&panel, sums, change).outcome);
        return;
    }
    --unloaded;
    const lampest_outcome outcome = lampest_baseline(&panel, sums).outcome;
    if (outcome != LAMPEST_FINE) sendEstimate(outcome);
}

static void sendFrame(uint32_t started_ms) {
    const uint16_t cells = (uint16_t)settings.rows * settings.columns;
    lampest_frame_header(&settings, sequence, started_ms, missed, frame);
    for (uint16_t cell = 0; cell < cells; ++cell) {
        lampest_put_u16(frame + LAMPEST_FRAME_HEADER_BYTES + 2 * cell, (uint16_t)sums[cell]);
    }
    lampest_send(frame, LAMPEST_FRAME_HEADER_BYTES + 2 * cells, emit);
    ++sequence;
    missed = 0;
}

static bool due() {
    return (int32_t)(micros() - due_us) >= 0;
}

void setup() {
    settings = lampest_start_settings();
    settings.rows = PANEL_ROWS;
    settings.columns = PANEL_COLUMNS;
    settings.readings = PANEL_READINGS;
    Serial.begin(LAMPEST_BAUD);
    portable_scan_begin();
    lampest_begin(&panel, memory);
    sayHello();
}

void loop() {
    while (Serial.available()) {
        const uint8_t length = lampest_receive(&inbox, (uint8_t)Serial.read());
        if (length) obey(length);
    }
    if (!settings.running) {
        if (millis() - greeted_ms >= 1000) sayHello();
        return;
    }
    if (!due()) return;
    const uint32_t started_ms = millis();
    portable_scan(settings.rows, settings.columns, settings.readings, settings.settle_us, sums);
    if (settings.estimates) estimateCells();
    sendFrame(started_ms);
    for (due_us += settings.period_us; due(); due_us += settings.period_us) ++missed;
}
