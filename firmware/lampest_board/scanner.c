/* The scan on an ATmega2560: see scanner.h. Timer 1 gives the period, timer 3 the settle time. */
#ifdef __AVR_ATmega2560__ /* other boards scan by portable_scan.h */

#include "scanner.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/power.h>
#include <avr/sleep.h>
#include <util/atomic.h>

#include "pins.h"

#define NO_FRAME 255
#define TIMER1_CLOCK (_BV(WGM12) | _BV(CS11) | _BV(CS10)) /* 16 MHz / 64: 4 us */
#define TIMER3_CLOCK (_BV(WGM32) | _BV(CS31))             /* 16 MHz / 8: 0.5 us */
#define CONVERTER (_BV(ADEN) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0))

static const uint8_t row_channels[] = LAMPEST_ROW_CHANNELS;
static const uint8_t column_channels[] = LAMPEST_COLUMN_CHANNELS;

static lampest_settings_t scan;
static uint8_t frames[2][LAMPEST_MOST_BODY_BYTES];
static uint64_t started_us[2];
/* One frame is filled, one waits, one is being sent; two buffers for the three, so at most two of them at a time. */
static volatile uint8_t filling = NO_FRAME, waiting = NO_FRAME, finished = NO_FRAME;
static volatile uint16_t missed;
static uint32_t sequence;

static volatile uint64_t elapsed_us;
static uint32_t slice_us;
static uint16_t slices, slice;

static uint8_t row, column, readings_left;
static uint16_t sum;
static uint8_t *sums;

static void select_cell(void) {
    uint8_t driven = (uint8_t)(row_channels[row] << LAMPEST_ROW_SHIFT), column_channel = column_channels[column];
    if (LAMPEST_WIRING == LAMPEST_TWO_POINT) {
        LAMPEST_SELECT_PORT = (uint8_t)(driven | column_channel << LAMPEST_COLUMN_SHIFT);
        return;
    }
    LAMPEST_SELECT_PORT = driven;
    ADMUX = _BV(REFS0) | (column_channel & 7);
    ADCSRB = column_channel & 8 ? _BV(MUX5) : 0; /* A8 to A15 */
}

static void convert_when_settled(void) {
    select_cell();
    sum = 0;
    readings_left = scan.readings;
    if (scan.settle_us == 0) {
        ADCSRA = CONVERTER | _BV(ADSC);
        return;
    }
    TCNT3 = 0;
    TIFR3 = _BV(OCF3A);
    TCCR3B = TIMER3_CLOCK;
}

ISR(TIMER3_COMPA_vect) {
    TCCR3B = 0;
    if (filling != NO_FRAME) ADCSRA = CONVERTER | _BV(ADSC);
}

static void begin_scan(void) {
    uint8_t next = finished == 0 ? 1 : 0;
    started_us[next] = elapsed_us;
    lampest_frame_header(&scan, sequence++, 0, missed, frames[next]);
    missed = 0;
    sums = frames[next] + LAMPEST_FRAME_HEADER_BYTES;
    row = column = 0;
    filling = next;
    convert_when_settled();
}

ISR(ADC_vect) {
    uint16_t code = ADC;
    if (filling == NO_FRAME) return; /* stopped just now */
    if (--readings_left) ADCSRA = CONVERTER | _BV(ADSC);
    sum += code;
    if (readings_left) return;
    lampest_put_u16(sums + 2 * (uint16_t)(row * scan.columns + column), sum);
    LAMPEST_SCAN_NEXT(row, column, scan.rows, scan.columns);
    if (row < scan.rows) {
        convert_when_settled();
        return;
    }
    if (finished == NO_FRAME)
        finished = filling;
    else
        waiting = filling;
    filling = NO_FRAME;
}

ISR(TIMER1_COMPA_vect) {
    elapsed_us += slice_us;
    if (++slice < slices) return;
    slice = 0;
    if (!scan.running) return;
    if (filling == NO_FRAME && waiting == NO_FRAME)
        begin_scan();
    else
        ++missed;
}

void scanner_begin(void) {
    /* The Arduino core starts all timers; those that are not used here stop, and with them the clock behind millis(). */
    TIMSK0 = 0;
    TCCR0B = TCCR1B = TCCR2B = TCCR3B = TCCR4B = TCCR5B = 0;
    power_all_disable();
    power_adc_enable();
    power_timer1_enable();
    power_timer3_enable();
    power_usart0_enable();
    LAMPEST_SELECT_PORT = 0;
    LAMPEST_SELECT_DIRECTION = 0xFF;
    /* No digital inputs where analog ones are read. */
    DIDR0 = LAMPEST_WIRING == LAMPEST_TWO_POINT ? _BV(LAMPEST_ADC_CHANNEL) : 0xFF;
    DIDR2 = LAMPEST_WIRING == LAMPEST_TWO_POINT ? 0 : 0xFF;
    ADCSRB = 0;
    ADMUX = _BV(REFS0) | LAMPEST_ADC_CHANNEL;
    ADCSRA = CONVERTER;
    TCCR1A = TCCR3A = 0;
    TIFR1 = TIFR3 = 0xFF;
    TIMSK1 = _BV(OCIE1A);
    TIMSK3 = _BV(OCIE3A);
    /* Deeper sleep would also stop the serial line and the timers. */
    set_sleep_mode(SLEEP_MODE_IDLE);
}

void scanner_apply(const lampest_settings_t *settings) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        TCCR1B = TCCR3B = 0;
        ADCSRA = _BV(ADIF); /* off: a conversion under way ends without its interrupt */
        elapsed_us += (uint32_t)TCNT1 * LAMPEST_TICK_US;
        scan = *settings;
        filling = waiting = finished = NO_FRAME;
        missed = 0;
        sequence = 0;
        slice = 0;
        slices = lampest_slices(scan.period_us);
        uint32_t ticks = lampest_slice_ticks(scan.period_us);
        slice_us = ticks * LAMPEST_TICK_US;
        OCR1A = (uint16_t)(ticks - 1);
        OCR3A = (uint16_t)(2 * scan.settle_us - 1);
        TCNT1 = 0;
        TIFR1 = TIFR3 = 0xFF;
        ADCSRA = CONVERTER;
        TCCR1B = TIMER1_CLOCK;
        if (scan.running) begin_scan();
    }
}

uint8_t *scanner_finished(void) {
    uint8_t which = finished;
    if (which == NO_FRAME) return 0;
    lampest_put_u32(frames[which] + 9, (uint32_t)(started_us[which] / 1000));
    return frames[which];
}

uint8_t scanner_has_finished(void) { return finished != NO_FRAME; }

void scanner_release(void) {
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        finished = waiting;
        waiting = NO_FRAME;
    }
}

uint16_t scanner_identity(void) {
    uint16_t drawn = lampest_crc16(0xFFFF, (uint8_t)TCNT1);
    for (uint8_t conversion = 0; conversion < LAMPEST_IDENTITY_READINGS; ++conversion) {
        ADCSRA = (CONVERTER & ~_BV(ADIE)) | _BV(ADIF) | _BV(ADSC);
        while (ADCSRA & _BV(ADSC)) continue;
        drawn = lampest_crc16(drawn, (uint8_t)ADC);
    }
    ADCSRA = CONVERTER | _BV(ADIF);
    return drawn;
}

uint8_t scanner_second_passed(void) {
    static uint64_t last;
    uint64_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) now = elapsed_us;
    if (now - last < 1000000) return 0;
    last = now;
    return 1;
}

void scanner_sleep(void) {
    sleep_enable();
    sei();
    sleep_cpu();
    sleep_disable();
}

#endif
