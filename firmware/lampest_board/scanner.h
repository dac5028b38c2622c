/* The scan: a timer starts it, every conversion ends in an interrupt, and the core sleeps in between. */
#ifndef LAMPEST_SCANNER_H
#define LAMPEST_SCANNER_H

#include "protocol.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Set up pins, converter and timers; switch off what is not used. */
void scanner_begin(void);

/* Take over period, settle time and size; begins with a scan at once where settings->running is set. */
void scanner_apply(const lampest_settings_t *settings);

/* A finished frame's body, header filled in, or 0. It stays untouched until scanner_release. */
uint8_t scanner_has_finished(void);
uint8_t *scanner_finished(void);
void scanner_release(void);

/* A number that another board hardly draws: of the noise of the converter, and of the time. For idle boards. */
uint16_t scanner_identity(void);

/* 1 once for every second since the last call that saw one. */
uint8_t scanner_second_passed(void);

/* Sleep until the next interrupt. */
void scanner_sleep(void);

#ifdef __cplusplus
}
#endif

#endif
