/* Keys of a matrix keyboard without diodes: which are pressed, how strongly, and no ghosts.
 *
 * The fourth corner of a rectangle of three pressed keys reads as if it were pressed. Its cell does not: the estimate
 * tells how far it fell, and its standard deviation how well that is known. A key is pressed where its cell has fallen by
 * more than DEVIATIONS of its standard deviation, and by FALL at least.
 */
#ifndef KEYS_H
#define KEYS_H

#include "lampest_estimate.h"

#define KEYS_FALL 0.4f       /* of ln r: a third of the resistance at rest; set it by the lightest touch that counts */
#define KEYS_DEVIATIONS 5.0f /* standard deviations: one ghost in three million keys */
#define KEYS_RELEASE 0.5f    /* share of the fall that is still a press: keys do not flutter */
#define KEYS_PRODUCTS 30     /* of a standard deviation */

/* Called for each key that changes: `strength` is -ln(r / r at rest), 0 at a release. */
typedef void (*keys_event)(uint8_t row, uint8_t column, float strength);

/* Look at a frame's log changes; `pressed` holds a byte for each key, 0 at first. Returns the number of pressed keys. */
static inline uint16_t keys_update(lampest_panel *panel, const float *change, uint8_t *pressed, keys_event event) {
    const lampest_constants *c = panel->constants;
    uint16_t count = 0;
    for (uint8_t row = 0; row < c->rows; row++) {
        for (uint8_t column = 0; column < c->columns; column++) {
            const uint16_t key = row * c->columns + column;
            const float fall = -change[key];
            bool down = fall > (pressed[key] ? KEYS_RELEASE * KEYS_FALL : KEYS_FALL);
            if (down && !pressed[key]) {
                const float deviation = lampest_deviation(panel, row, column, KEYS_PRODUCTS);
                down = deviation > 0 && fall > KEYS_DEVIATIONS * deviation;
            }
            if (down != (bool)pressed[key] && event) event(row, column, down ? fall : 0);
            pressed[key] = down;
            count += down;
        }
    }
    return count;
}

#endif
