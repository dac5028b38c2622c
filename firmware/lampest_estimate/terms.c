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

/* What is asked of the rows of a term: its cost, half its gradient with the diagonal of its Hessian, or a product,
 * of which that with squares alone is the shorter one. */
typedef enum { COST, GRADIENT, PRODUCT, ROBUST_PRODUCT } task;

typedef struct {
    cells_view view;
    lampest_term term;
    const float *p; /* PRODUCT: the vector */
    float *out;     /* GRADIENT, PRODUCT: added to */
    float *diagonal; /* GRADIENT: added to */
} work;

/* What the term compares. */
static float value_of(const work *w, uint16_t cell) {
    switch (w->term.quantity) {
        case LAMPEST_LOG: return w->view.u[cell];
        case LAMPEST_OHM: return 1 / w->view.conductance[cell];
        case LAMPEST_CHANGE: return 100 / (w->view.conductance[cell] * w->view.previous[cell]) - 100;
        case LAMPEST_LOG_OF_BASELINE: return 100 * (w->view.u[cell] - w->view.baseline[cell]);
        default: return 100 * (w->view.u[cell] - logarithm(w->view.previous[cell]));
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

/* The residual x = factor (v_second - v_first), or x = v_first where second is first. */
static float residual(const work *w, uint16_t first, uint16_t second, float factor) {
    return first == second ? value_of(w, first) : factor * (value_of(w, second) - value_of(w, first));
}

static float stiffness_at(const work *w, uint16_t first, uint16_t second, float factor) {
    return w->term.weight * stiffness_of(w->term.loss, w->term.corner, residual(w, first, second, factor));
}

/* Add a residual's part of half the gradient, and of the Hessian's diagonal. */
static void add_gradient(const work *w, uint16_t first, uint16_t second, float factor) {
    const float stiffness = stiffness_at(w, first, second, factor);
    const float pull = stiffness * residual(w, first, second, factor);
    const float to_second = factor * w->view.slope[second], to_first = factor * w->view.slope[first];
    w->out[second] = FUSED(to_second, pull, w->out[second]);
    w->diagonal[second] += stiffness * to_second * to_second;
    if (first == second) return;
    w->out[first] = FUSED(-to_first, pull, w->out[first]);
    w->diagonal[first] += stiffness * to_first * to_first;
}

/* Do with a residual what is asked for; returns its cost. Only the product, which is asked for most often, is inline. */
INLINE float visit(const work w, task what, uint16_t first, uint16_t second, float factor) {
    if (w.view.absent && (w.view.absent[first] || w.view.absent[second])) return 0;
    if (what == COST) return w.term.weight * loss_of(w.term.loss, w.term.corner, residual(&w, first, second, factor));
    if (what == GRADIENT) {
        add_gradient(&w, first, second, factor);
        return 0;
    }
    const float stiffness = what == ROBUST_PRODUCT ? stiffness_at(&w, first, second, factor) : w.term.weight;
    const float to_second = factor * w.view.slope[second], to_first = factor * w.view.slope[first];
    float x = to_second * w.p[second];
    if (first != second) x = FUSED(-to_first, w.p[first], x);
    const float pull = stiffness * x;
    w.out[second] = FUSED(to_second, pull, w.out[second]);
    if (first != second) w.out[first] = FUSED(-to_first, pull, w.out[first]);
    return 0;
}

/* All residuals along one direction of the rectangle: `lines` lines of `count` cells that are `step` apart. */
INLINE float along(const work w, task what, uint8_t lines, uint8_t line_step, uint8_t count, uint8_t step) {
    float cost = 0;
    for (uint8_t line = 0; line < lines; line++) {
        uint16_t here = line * line_step;
        if (w.term.difference == LAMPEST_STEPS) {
            for (uint8_t at = 1; at < count; at++, here += step) cost += visit(w, what, here, here + step, 1);
            continue;
        }
        for (uint8_t at = 0; count > 1 && at < count; at++, here += step) {
            const bool low = at == 0, high = at + 1 == count;
            cost += visit(w, what, low ? here : here - step, high ? here : here + step, low || high ? 1 : 0.5f);
        }
    }
    return cost;
}

INLINE float all_residuals(const work w, task what) {
    const lampest_constants *c = w.view.constants;
    const uint8_t m = w.view.m, n = w.view.n;
    float cost = 0;
    if (w.term.difference == LAMPEST_VALUES) {
        for (uint16_t cell = 0; cell < m * n; cell++) cost += visit(w, what, cell, cell, 1);
        return cost;
    }
    if (!c->pairs) return along(w, what, m, n, n, 1) + along(w, what, n, 1, m, n);
    for (uint16_t pair = 0; pair < c->pair_count; pair++) {
        cost += visit(w, what, c->pairs[pair].first, c->pairs[pair].second, 1 / c->pairs[pair].distance);
    }
    return cost;
}

static void add_product(const work w) {
    all_residuals(w, PRODUCT);
}

static void add_robust_product(const work w) {
    all_residuals(w, ROBUST_PRODUCT);
}

static bool takes_part(const cells_view *view, const lampest_term *term) {
    return !view->at_rest || term->quantity == LAMPEST_LOG || term->quantity == LAMPEST_OHM;
}

float penalty_cost(const cells_view *view) {
    float cost = 0;
    for (uint8_t number = 0; number < view->constants->term_count; number++) {
        if (!takes_part(view, view->constants->terms + number)) continue;
        cost += all_residuals((work){.view = *view, .term = view->constants->terms[number]}, COST);
    }
    return cost;
}

void penalty_gradient(const cells_view *view, float *gradient, float *diagonal) {
    for (uint8_t number = 0; number < view->constants->term_count; number++) {
        const lampest_term term = view->constants->terms[number];
        if (!takes_part(view, &term)) continue;
        find_slopes(view, term.quantity);
        all_residuals((work){.view = *view, .term = term, .out = gradient, .diagonal = diagonal}, GRADIENT);
    }
}

void penalty_product(const cells_view *view, const float *p, float *out) {
    for (uint8_t number = 0; number < view->constants->term_count; number++) {
        const lampest_term term = view->constants->terms[number];
        if (!takes_part(view, &term)) continue;
        find_slopes(view, term.quantity);
        const work w = {.view = *view, .term = term, .p = p, .out = out};
        if (term.loss == LAMPEST_SQUARED) add_product(w);
        else add_robust_product(w);
    }
}
