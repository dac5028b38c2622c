#include "terms.h"

#include <math.h>

float loss_of(lampest_loss loss, float corner, float x) {
    if (loss == LAMPEST_SQUARED) return x * x;
    if (loss == LAMPEST_STUDENT) return corner * corner * logf(1 + (x / corner) * (x / corner));
    const float size = fabsf(x);
    return size <= corner ? x * x : corner * (2 * size - corner);
}

float stiffness_of(lampest_loss loss, float corner, float x) {
    if (loss == LAMPEST_SQUARED) return 1;
    if (loss == LAMPEST_STUDENT) return 1 / (1 + (x / corner) * (x / corner));
    const float size = fabsf(x);
    return size <= corner ? 1 : corner / size;
}

/* What is asked of the rows of a term: its cost, half its gradient with the diagonal of its Hessian, or a product. */
typedef enum { COST, GRADIENT, PRODUCT } task;

typedef struct {
    const cells_view *view;
    const lampest_term *term;
    const float *p; /* PRODUCT: the vector */
    float *out;     /* GRADIENT, PRODUCT: added to */
    float *diagonal;/* GRADIENT: added to */
    float cost;
} work;

static inline float value_of(const work *w, uint16_t cell) {
    const cells_view *view = w->view;
    switch (w->term->quantity) {
        case LAMPEST_LOG: return view->u[cell];
        case LAMPEST_OHM: return 1 / view->conductance[cell];
        case LAMPEST_CHANGE: return 100 / (view->conductance[cell] * view->previous[cell]) - 100;
        case LAMPEST_LOG_OF_BASELINE: return 100 * (view->u[cell] - view->baseline[cell]);
        default: return 100 * (view->u[cell] - logf(view->previous[cell]));
    }
}

/* dv/du. */
static inline float slope_of(const work *w, uint16_t cell) {
    const cells_view *view = w->view;
    switch (w->term->quantity) {
        case LAMPEST_LOG: return 1;
        case LAMPEST_OHM: return 1 / view->conductance[cell];
        case LAMPEST_CHANGE: return 100 / (view->conductance[cell] * view->previous[cell]);
        default: return 100;
    }
}

/* One residual, x = factor (v_second - v_first), or x = v_first where second is first. */
static inline void residual(work *w, task what, uint16_t first, uint16_t second, float factor) {
    const cells_view *view = w->view;
    if (view->absent && (view->absent[first] || view->absent[second])) return;
    const bool alone = first == second;
    const bool bare = what == PRODUCT && w->term->loss == LAMPEST_SQUARED;
    float x = 0, stiffness = w->term->weight;
    if (!bare) {
        x = alone ? value_of(w, first) : factor * (value_of(w, second) - value_of(w, first));
        if (what == COST) {
            w->cost += w->term->weight * loss_of(w->term->loss, w->term->corner, x);
            return;
        }
        stiffness *= stiffness_of(w->term->loss, w->term->corner, x);
    }
    const float d_first = alone ? slope_of(w, first) : -factor * slope_of(w, first);
    const float d_second = alone ? 0 : factor * slope_of(w, second);
    if (what == PRODUCT) x = alone ? d_first * w->p[first] : d_first * w->p[first] + d_second * w->p[second];
    const float pull = stiffness * x;
    w->out[first] += d_first * pull;
    if (!alone) w->out[second] += d_second * pull;
    if (what == GRADIENT) {
        w->diagonal[first] += stiffness * d_first * d_first;
        if (!alone) w->diagonal[second] += stiffness * d_second * d_second;
    }
}

/* All residuals along one direction of the rectangle: `lines` lines of `count` cells that are `step` apart. */
static inline void along(work *w, task what, uint8_t lines, uint8_t line_step, uint8_t count, uint8_t step) {
    const bool central = w->term->difference == LAMPEST_CENTRAL;
    for (uint8_t line = 0; line < lines; line++) {
        const uint16_t start = line * line_step;
        for (uint8_t at = 0; at < count; at++) {
            const uint16_t here = start + at * step;
            if (!central) {
                if (at + 1 < count) residual(w, what, here, here + step, 1);
            } else if (count > 1) {
                const bool low = at == 0, high = at + 1 == count;
                residual(w, what, low ? here : here - step, high ? here : here + step, low || high ? 1 : 0.5f);
            }
        }
    }
}

static inline void all_residuals(work *w, task what) {
    const lampest_constants *c = w->view->constants;
    const uint8_t m = w->view->m, n = w->view->n;
    if (w->term->difference == LAMPEST_VALUES) {
        for (uint16_t cell = 0; cell < m * n; cell++) residual(w, what, cell, cell, 1);
    } else if (c->pairs) {
        for (uint16_t pair = 0; pair < c->pair_count; pair++) {
            residual(w, what, c->pairs[pair].first, c->pairs[pair].second, 1 / c->pairs[pair].distance);
        }
    } else {
        along(w, what, m, n, n, 1);
        along(w, what, n, 1, m, n);
    }
}

float penalty_cost(const cells_view *view) {
    work w = {.view = view};
    for (uint8_t number = 0; number < view->constants->term_count; number++) {
        w.term = view->constants->terms + number;
        all_residuals(&w, COST);
    }
    return w.cost;
}

void penalty_gradient(const cells_view *view, float *gradient, float *diagonal) {
    work w = {.view = view, .out = gradient, .diagonal = diagonal};
    for (uint8_t number = 0; number < view->constants->term_count; number++) {
        w.term = view->constants->terms + number;
        all_residuals(&w, GRADIENT);
    }
}

void penalty_product(const cells_view *view, const float *p, float *out) {
    work w = {.view = view, .p = p, .out = out};
    for (uint8_t number = 0; number < view->constants->term_count; number++) {
        w.term = view->constants->terms + number;
        all_residuals(&w, PRODUCT);
    }
}
