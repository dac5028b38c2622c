/* Lampest board: scans a resistive matrix sensor and sends the sums of its readings.
 *
 * Wiring and start values are in pins.h, the messages in protocol.h, the scan in scanner.c.
 * Until the host sends START, the board says HELLO once a second.
 */
#include "pins.h"
#include "protocol.h"
#include "scanner.h"

#include <avr/interrupt.h>

static lampest_settings_t settings;
static lampest_inbox_t inbox;

static void emit(uint8_t byte) {
    /* The transmitter's next interrupt wakes the core; Serial.write alone would wait awake. */
    while (Serial.availableForWrite() == 0) scanner_sleep();
    Serial.write(byte);
}

static void sayHello() {
    uint8_t body[LAMPEST_HELLO_BYTES + LAMPEST_HELLO_WIRING_BYTES + LAMPEST_CRC_BYTES];
    lampest_send(body, lampest_hello(&settings, body), emit);
}

static void obey(uint8_t length) {
    uint8_t answer[LAMPEST_HELLO_BYTES + LAMPEST_HELLO_WIRING_BYTES + LAMPEST_CRC_BYTES];
    if (!settings.running && length > 1 && inbox.bytes[1] == LAMPEST_START) settings.identity = scanner_identity();
    lampest_settings_t before = settings;
    uint8_t bytes = lampest_command(&settings, inbox.bytes, length, answer);
    bool stopped = before.running && !settings.running;
    if (stopped) scanner_apply(&settings); /* no frame may follow the answer to STOP */
    lampest_send(answer, bytes, emit);
    bool changed = before.running != settings.running || before.rows != settings.rows ||
                   before.columns != settings.columns || before.readings != settings.readings ||
                   before.period_us != settings.period_us || before.settle_us != settings.settle_us;
    if (changed && !stopped) scanner_apply(&settings);
}

void setup() {
    settings = lampest_start_settings();
    scanner_begin();
    Serial.begin(LAMPEST_BAUD);
    scanner_apply(&settings);
    sayHello();
}

void loop() {
    while (Serial.available()) {
        uint8_t length = lampest_receive(&inbox, (uint8_t)Serial.read());
        if (length) obey(length);
    }
    uint8_t *frame = scanner_finished();
    if (frame) {
        uint16_t cells = (uint16_t)frame[2] * frame[3];
        lampest_send(frame, LAMPEST_FRAME_HEADER_BYTES + 2 * cells, emit);
        scanner_release();
    }
    if (!settings.running && scanner_second_passed()) sayHello();
    /* Interrupts stay off between the question and sleeping: what comes in between wakes the core at once. */
    cli();
    if (!Serial.available() && !scanner_has_finished()) scanner_sleep();
    sei();
}
