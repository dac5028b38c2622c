/* Keys of a matrix keyboard without diodes: which are pressed, how strongly, and no ghosts.
 *
 * The fourth corner of a rectangle of three pressed keys reads as if it were pressed. Its cell does not: the estimate
 * tells how far it fell, and its standard deviation how well that is known. A key is pressed where its cell has fallen by
 * more than DEVIATIONS of its standard deviation, and by FALL at least.
 *
 * A key that moves while the panel is scanned is down for some readings and up for others. Such a frame fits no cells, and
 * its estimate has ghosts. Therefore a change counts once two frames in a row show it.
 */
#ifndef KEYS_H
#define KEYS_H

#include "lampest_estimate.h"

#ifndef KEYS_FALL
#define KEYS_FALL 0.4f       /* of ln r: a third of the resistance at rest; set it by the lightest touch that counts */
#endif
#define KEYS_DEVIATIONS 5.0f /* standard deviations: one ghost in three million keys */
#define KEYS_RELEASE 0.5f    /* share of the fall that is still a press: keys do not flutter */
#define KEYS_PRODUCTS 30     /* of a standard deviation */
#define KEYS_CALLS 8         /* of lampest_frame for one scan, until it has settled: many keys may change at once */

/* Called for each key that changes: `strength` is -ln(r / r at rest), 0 at a release. */
typedef void (*keys_event)(uint8_t row, uint8_t column, float strength);

/* What `pressed` holds of a key: whether it is down, and whether the frame before showed a change. */
enum { KEYS_DOWN = 1, KEYS_CHANGING = 2 };

/* Look at a frame's log changes; `pressed` holds a byte for each key, 0 at first. Returns the number of pressed keys. */
static inline uint16_t keys_update(lampest_panel *panel, const float *change, uint8_t *pressed, keys_event event) {
    const lampest_constants *c = panel->constants;
    uint16_t count = 0;
    for (uint8_t row = 0; row < c->rows; row++) {
        for (uint8_t column = 0; column < c->columns; column++) {
            const uint16_t key = row * c->columns + column;
            const float fall = -change[key];
            const bool was_down = pressed[key] & KEYS_DOWN, was_changing = pressed[key] & KEYS_CHANGING;
            bool down = fall > (was_down ? KEYS_RELEASE * KEYS_FALL : KEYS_FALL);
            if (down && !was_down) {
                const float deviation = lampest_deviation(panel, row, column, KEYS_PRODUCTS);
                down = deviation > 0 && fall > KEYS_DEVIATIONS * deviation;
            }
            if (down == was_down) {
                pressed[key] = was_down;
            } else if (!was_changing) {
                pressed[key] = was_down | KEYS_CHANGING;
            } else {
                pressed[key] = down;
                if (event) event(row, column, down ? fall : 0);
            }
            count += pressed[key] & KEYS_DOWN;
        }
    }
    return count;
}

/* Estimate a scan and look at its keys, unless it does not settle. Behind a dead line cells that no reading determines never
 * settle: there the keys' standard deviations decide alone. The baseline follows the film while no key is down. */
static inline lampest_status keys_scan(lampest_panel *panel, const uint32_t *sums, float *change, uint8_t *pressed,
                                       keys_event event) {
    lampest_status status;
    uint8_t calls = KEYS_CALLS;
    do {
        status = lampest_frame(panel, sums, change);
    } while (status.outcome == LAMPEST_FINE && !status.settled && --calls);
    if (status.outcome == LAMPEST_FINE && (status.settled || status.dead_line)) keys_update(panel, change, pressed, event);
    lampest_follow(panel);
    return status;
}

#endif
