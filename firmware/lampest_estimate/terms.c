#include "terms.h"

#include "arithmetic.h"

float loss_of(lampest_loss loss, float corner, float x) {
    if (loss == LAMPEST_SQUARED) return x * x;
    if (loss == LAMPEST_STUDENT) return corner * corner * logarithm(1 + (x / corner) * (x / corner));
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
    cells_view view;
    lampest_term term;
    const float *p; /* PRODUCT: the vector */
    float *out;     /* GRADIENT, PRODUCT: added to */
    float *diagonal;/* GRADIENT: added to */
} work;

/* What the term compares. */
INLINE float value_of(const work w, uint16_t cell) {
    switch (w.term.quantity) {
        case LAMPEST_LOG: return w.view.u[cell];
        case LAMPEST_OHM: return 1 / w.view.conductance[cell];
        case LAMPEST_CHANGE: return 100 / (w.view.conductance[cell] * w.view.previous[cell]) - 100;
        case LAMPEST_LOG_OF_BASELINE: return 100 * (w.view.u[cell] - w.view.baseline[cell]);
        default: return 100 * (w.view.u[cell] - logarithm(w.view.previous[cell]));
    }
}

/* Its derivative by u, for all cells. */
static void find_slopes(const cells_view *view, lampest_quantity quantity) {
    for (uint16_t cell = 0; cell < view->m * view->n; cell++) {
        const bool none = view->absent && view->absent[cell];
        float slope = quantity == LAMPEST_LOG ? 1 : 100;
        if (!none && quantity == LAMPEST_OHM) slope = 1 / view->conductance[cell];
        if (!none && quantity == LAMPEST_CHANGE) slope = 100 / (view->conductance[cell] * view->previous[cell]);
        view->slope[cell] = none ? 0 : slope;
    }
}

/* One residual, x = factor (v_second - v_first), or x = v_first where second is first; returns its cost. */
INLINE float residual(const work w, task what, uint16_t first, uint16_t second, float factor) {
    const bool alone = first == second;
    if (w.view.absent && (w.view.absent[first] || w.view.absent[second])) return 0;
    float x = 0, stiffness = w.term.weight;
    if (what != PRODUCT || w.term.loss != LAMPEST_SQUARED) {
        x = alone ? value_of(w, first) : factor * (value_of(w, second) - value_of(w, first));
        if (what == COST) return w.term.weight * loss_of(w.term.loss, w.term.corner, x);
        stiffness *= stiffness_of(w.term.loss, w.term.corner, x);
    }
    const float to_first = alone ? w.view.slope[first] : -factor * w.view.slope[first];
    const float to_second = alone ? 0 : factor * w.view.slope[second];
    if (what == PRODUCT) x = alone ? to_first * w.p[first] : FUSED(to_second, w.p[second], to_first * w.p[first]);
    const float pull = stiffness * x;
    w.out[first] = FUSED(to_first, pull, w.out[first]);
    if (!alone) w.out[second] = FUSED(to_second, pull, w.out[second]);
    if (what == GRADIENT) {
        w.diagonal[first] += stiffness * to_first * to_first;
        if (!alone) w.diagonal[second] += stiffness * to_second * to_second;
    }
    return 0;
}

/* All residuals along one direction of the rectangle: `lines` lines of `count` cells that are `step` apart. */
INLINE float along(const work w, task what, uint8_t lines, uint8_t line_step, uint8_t count, uint8_t step) {
    float cost = 0;
    for (uint8_t line = 0; line < lines; line++) {
        uint16_t here = line * line_step;
        if (w.term.difference == LAMPEST_STEPS) {
            for (uint8_t at = 1; at < count; at++, here += step) cost += residual(w, what, here, here + step, 1);
            continue;
        }
        for (uint8_t at = 0; count > 1 && at < count; at++, here += step) {
            const bool low = at == 0, high = at + 1 == count;
            cost += residual(w, what, low ? here : here - step, high ? here : here + step, low || high ? 1 : 0.5f);
        }
    }
    return cost;
}

INLINE float all_residuals(const work w, task what) {
    const lampest_constants *c = w.view.constants;
    const uint8_t m = w.view.m, n = w.view.n;
    float cost = 0;
    if (w.term.difference == LAMPEST_VALUES) {
        for (uint16_t cell = 0; cell < m * n; cell++) cost += residual(w, what, cell, cell, 1);
        return cost;
    }
    if (!c->pairs) return along(w, what, m, n, n, 1) + along(w, what, n, 1, m, n);
    for (uint16_t pair = 0; pair < c->pair_count; pair++) {
        cost += residual(w, what, c->pairs[pair].first, c->pairs[pair].second, 1 / c->pairs[pair].distance);
    }
    return cost;
}

float penalty_cost(const cells_view *view) {
    float cost = 0;
    for (uint8_t number = 0; number < view->constants->term_count; number++) {
        cost += all_residuals((work){.view = *view, .term = view->constants->terms[number]}, COST);
    }
    return cost;
}

void penalty_gradient(const cells_view *view, float *gradient, float *diagonal) {
    for (uint8_t number = 0; number < view->constants->term_count; number++) {
        const lampest_term term = view->constants->terms[number];
        find_slopes(view, term.quantity);
        all_residuals((work){.view = *view, .term = term, .out = gradient, .diagonal = diagonal}, GRADIENT);
    }
}

void penalty_product(const cells_view *view, const float *p, float *out) {
    for (uint8_t number = 0; number < view->constants->term_count; number++) {
        const lampest_term term = view->constants->terms[number];
        find_slopes(view, term.quantity);
        all_residuals((work){.view = *view, .term = term, .p = p, .out = out}, PRODUCT);
    }
}
