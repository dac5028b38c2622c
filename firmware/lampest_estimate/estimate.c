#include "lampest_estimate.h"

#include <float.h>

#include "arithmetic.h"
#include "network.h"
#include "terms.h"

#define LARGEST_STEP 2.0f   /* of ln r in one step: a factor of seven, beyond which the linear model says nothing */
#define HALVINGS 3          /* of a step that does not lower the cost */
#define TAIL 3              /* iterations whose decreases tell how much the next ones would gain */
#define REACH 3.0f          /* standard deviations: a two-point reading that is so small is a bound */
#define FAR 25.0f           /* misfit of a cell: readings that are five standard deviations off */
#define ROUNDED 1e-5f       /* of a reading: smaller noise is lost in the rounding of the model's readings */
#define LEAST_OWN 1e-3f     /* of what lines share: with less of its own a cell leaves no digit to the preconditioner */
#define RESOLVED 1e-3f      /* of the cost: single precision tells whether a step lowers it by that share */
#define BISECTIONS 16       /* of the range of changes, on the way to their median */
#define LARGEST_OHM 1e9f
#define SMALLEST_OHM 1e-3f
#define SMALLEST 1e-30f     /* what lines share where no reading tells */

typedef enum { AT_MOST, VALUE, AT_LEAST, ABSENT } side_of_reading;

/* The vectors of a panel in its working memory, over cells along the longer side unless they say otherwise. */
typedef struct {
    const lampest_constants *constants;
    uint16_t cells;
    float *baseline, *u;   /* ln of the cells at rest, and of the estimate */
    float *measured, *precision, *reading; /* measured readings, 1/sigma (0: missing), and what the model predicts */
    float *gradient;       /* half the gradient */
    float *diagonal;       /* 1 / diagonal of the Hessian without what lines share; 0 where a cell is held */
    float *lines;          /* over the lines, and */
    float *coarse;         /* over the shorter side squared: parts of T, see `linearise` */
    float *sums;           /* over the lines */
    float *x, *r, *p, *q;                  /* conjugate gradients */
    uint8_t *side, *absent;                /* side_of_reading; 1 without a cell */
    network net;
    cells_view view;
} workspace;

/* Divide the panel's memory among the vectors. */
static workspace arrange(const lampest_panel *panel) {
    const lampest_constants *c = panel->constants;
    const uint8_t m = c->rows >= c->columns ? c->rows : c->columns, n = c->rows >= c->columns ? c->columns : c->rows;
    const uint16_t cells = m * n;
    bool relative = false;
    for (uint8_t number = 0; number < c->term_count; number++) {
        const lampest_quantity quantity = c->terms[number].quantity;
        relative = relative || quantity == LAMPEST_CHANGE || quantity == LAMPEST_LOG_OF_PREVIOUS;
    }
    float *free = panel->memory;
#define TAKE(count) (free += (count), free - (count))
    workspace w = {.constants = c, .cells = cells};
    w.baseline = TAKE(cells);
    w.u = TAKE(cells);
    w.measured = TAKE(cells);
    w.precision = TAKE(cells);
    w.reading = TAKE(cells);
    w.gradient = TAKE(cells);
    w.diagonal = TAKE(cells);
    w.x = TAKE(cells);
    w.r = TAKE(cells);
    w.p = TAKE(cells);
    w.q = TAKE(cells);
    network *net = &w.net;
    net->m = m;
    net->n = n;
    net->constants = c;
    net->floats = !c->driven;
    net->long_driven = c->rows_driven == (c->rows >= c->columns);
    net->conductance = TAKE(cells);
    net->share = TAKE(cells);
    net->mutual = TAKE(cells);
    net->middle = TAKE(cells);
    net->inverse = TAKE(n * n);
    net->small = TAKE(n * n);
    net->small2 = TAKE(n * n);
    net->total = TAKE(m);
    net->own_long = TAKE(m);
    net->x_long = TAKE(m);
    net->x_short = TAKE(n);
    net->tie = TAKE(m + n);
    w.lines = TAKE(m + n);
    w.sums = TAKE(m + n);
    w.coarse = TAKE(n * n);
    if (c->driven) {
        net->slope_long = TAKE(cells);
        net->slope_short = TAKE(cells);
        net->slope_mutual = TAKE(cells);
    }
    w.view = (cells_view){.constants = c, .m = m, .n = n, .u = w.u, .baseline = w.baseline,
                          .conductance = net->conductance, .slope = net->middle};
    if (relative) w.view.previous = TAKE(cells);
    w.side = (uint8_t *)TAKE((cells + 3) / 4);
    w.absent = (uint8_t *)TAKE((cells + 3) / 4);
#undef TAKE
    w.view.absent = c->present ? w.absent : NULL;
    return w;
}

/* Readings: codes of the converter as readings of the network. */

static float volt_of(const lampest_constants *c, uint32_t sum) {
    return c->volt_at_zero + c->volt_per_sum * (float)sum;
}

/* The network's reading of a voltage at the converter, and |d reading/d volt|. */
static float reading_of(const lampest_constants *c, float volt, uint8_t row, uint8_t column, float *slope) {
    if (c->driven) {
        *slope = 1;
        return c->mirrored ? c->supply_volt - volt : volt;
    }
    const float rest = c->supply_volt - volt;
    float ohm = c->reference_ohm * (c->across_reference ? rest / volt : volt / rest);
    const float base = c->across_reference ? volt : rest;
    *slope = c->reference_ohm * c->supply_volt / (base * base) * c->ohm_scale;
    ohm *= c->ohm_scale;
    if (c->shunt_siemens > 0) {
        const float without = larger(1 / ohm - c->shunt_siemens, 1e-6f * c->shunt_siemens);
        *slope /= (ohm * without) * (ohm * without);
        ohm = 1 / without;
    }
    if (c->series) ohm -= c->series[row] + c->series[c->rows + column];
    return ohm;
}

/* Read the sums of a frame; false if there are too few values. */
static bool read_sums(workspace *w, const uint32_t *sums, lampest_status *status) {
    const lampest_constants *c = w->constants;
    uint16_t values = 0, cells = 0;
    bool row_has[LAMPEST_MAX_LINES] = {false}, column_has[LAMPEST_MAX_LINES] = {false};
    bool row_is[LAMPEST_MAX_LINES] = {false}, column_is[LAMPEST_MAX_LINES] = {false};
    for (uint8_t row = 0; row < c->rows; row++) {
        for (uint8_t column = 0; column < c->columns; column++) {
            const uint16_t outside = row * c->columns + column;
            const uint16_t cell = cell_number(c, row, column);
            uint32_t sum = sums[outside];
            w->side[cell] = ABSENT;
            w->precision[cell] = 0;
            w->measured[cell] = 1;
            /* A crossing without a cell has a reading, too, which depends on the cells around it. */
            const bool counts = !(w->view.absent && w->absent[cell]);
            if (counts) {
                cells++;
                column_is[column] = true;
                row_is[row] = true;
            }
            if (sum > c->top_sum) {
                status->missing += counts;
                continue;
            }
            /* The network's reading rises with the sum unless it is mirrored, or a divider that is read across its reference. */
            const bool rises = c->driven ? !c->mirrored : !c->across_reference;
            side_of_reading side = VALUE;
            if (sum < c->low_sum) {
                sum = c->low_sum;
                side = rises ? AT_MOST : AT_LEAST;
            } else if (sum > c->high_sum) {
                sum = c->high_sum;
                side = rises ? AT_LEAST : AT_MOST;
            }
            float slope;
            float reading = reading_of(c, volt_of(c, sum), row, column, &slope);
            const float sigma = slope * c->sigma_volt[c->sigma_count > 1 ? outside : 0];
            const float least = c->driven ? 0 : REACH * sigma;
            if (reading <= least && side != AT_LEAST) {
                side = AT_MOST;
                reading = larger(reading, 0) + REACH * sigma;
            }
            if (side != VALUE) {
                status->saturated += counts;
            } else if (counts) {
                values++;
                column_has[column] = true;
                row_has[row] = true;
            }
            w->side[cell] = side;
            w->measured[cell] = reading;
            w->precision[cell] = 1 / larger(c->plain_sigma > 0 ? c->plain_sigma : sigma, ROUNDED * fabsf(reading));
        }
    }
    uint16_t lines = 0;
    for (uint8_t line = c->columns; line-- > 0;) {
        lines += column_is[line];
        if (column_is[line] && !column_has[line]) status->dead_line = c->rows + line + 1;
    }
    for (uint8_t line = c->rows; line-- > 0;) {
        lines += row_is[line];
        if (row_is[line] && !row_has[line]) status->dead_line = line + 1;
    }
    /* One value less than lines describes a panel with one factor for each line; bounds tell the rest. */
    const uint16_t half = (cells + 1) / 2, least = half < lines - 1 ? half : lines - 1;
    if (values >= least && 2 * status->missing <= cells) return true;
    status->outcome = LAMPEST_TOO_FEW;
    return false;
}

/* The cost: residuals of the readings in standard deviations, and the penalties. */

static inline float deviation_of(const workspace *w, uint16_t cell) {
    const float x = (w->reading[cell] - w->measured[cell]) * w->precision[cell];
    switch (w->side[cell]) {
        case AT_LEAST: return smaller(x, 0);
        case AT_MOST: return larger(x, 0);
        default: return x;
    }
}

/* omega / sigma^2 of a reading at its present residual x. */
static inline float curvature_of(const workspace *w, uint16_t cell, float x) {
    const float precision = w->precision[cell];
    if (w->side[cell] != VALUE && x == 0) return 0;
    return precision * precision * stiffness_of(w->constants->data_loss, w->constants->data_corner, x);
}

static float cost_of(const workspace *w) {
    float cost = penalty_cost(&w->view);
    for (uint16_t cell = 0; cell < w->cells; cell++) {
        cost += loss_of(w->constants->data_loss, w->constants->data_corner, deviation_of(w, cell));
    }
    return cost;
}

/* Bounds of a cell in ohm. */
static void bounds_of(const workspace *w, uint16_t cell, float *least, float *largest) {
    const lampest_constants *c = w->constants;
    *least = c->least_ohm;
    *largest = c->largest_ohm;
    if (!c->native_bounds || w->side[cell] != VALUE) return;
    /* r >= R, as parallel paths lower a reading. An open cell in place of R^2/sigma changes the reading by sigma. */
    const float measured = w->measured[cell], alone = 2 * measured * w->cells / (float)(w->net.m + w->net.n - 1);
    *least = larger(*least, measured);
    *largest = larger(smaller(*largest, larger(measured * measured * w->precision[cell], alone)), *least);
}

static bool evaluate(workspace *w, float *cost) {
    if (!network_solve(&w->net)) return false;
    network_readings(&w->net, w->reading);
    *cost = cost_of(w);
    return isfinite(*cost);
}

/* u = from + scale x within the bounds. */
static void move(workspace *w, const float *from, float scale) {
    for (uint16_t cell = 0; cell < w->cells; cell++) {
        if (w->view.absent && w->absent[cell]) continue;
        float least, largest;
        bounds_of(w, cell, &least, &largest);
        const float step = larger(smaller(scale * w->x[cell], LARGEST_STEP), -LARGEST_STEP);
        w->u[cell] = from[cell] + step;
        float ohm = exponential(w->u[cell]);
        if (ohm < least || ohm > largest) {
            ohm = ohm < least ? least : largest;
            w->u[cell] = logarithm(ohm);
        }
        w->net.conductance[cell] = 1 / ohm;
    }
}

static float dot(const float *a, const float *b, uint16_t count) {
    float sum = 0;
    for (uint16_t cell = 0; cell < count; cell++) sum = FUSED(a[cell], b[cell], sum);
    return sum;
}

/* Half the gradient, and the preconditioner at this point.
 *
 * M = D + G U S U' G approximates J' W J + penalties: D has each reading's response to its own cell and the diagonal of
 * the penalties, S what readings share along their lines (`network_line_responses`). By Woodbury's formula
 * M^-1 = D^-1 - V T V', V = D^-1 G U, T = (S^-1 + U' G D^-1 G U)^-1. Held cells have no place in it: D^-1 is 0. A cell
 * without a reading has only its penalties in D, which may be 10^14 times smaller than S; it gets a small part of S.
 * T^-1 = [E, C; C', F] with E and F diagonal: the longer side is eliminated, as in the network. `lines` has 1/E, and
 * `coarse` (F - C' C / E)^-1, whose rows have the sums S_k^-1 + sum_i C_ik S_i^-1 / E_i. */
static bool linearise(workspace *w) {
    float *gradient = w->gradient, *diagonal = w->diagonal, *weight = w->x;
    const float *g = w->net.conductance;
    const uint8_t m = w->net.m, n = w->net.n;
    network_own_response(&w->net, diagonal);
    for (uint16_t cell = 0; cell < w->cells; cell++) {
        const float x = deviation_of(w, cell);
        weight[cell] = curvature_of(w, cell, x);
        diagonal[cell] *= diagonal[cell] * weight[cell];
        gradient[cell] = w->precision[cell] > 0 ? weight[cell] * x / w->precision[cell] : 0;
    }
    network_adjoint(&w->net, gradient, gradient);
    network_line_responses(&w->net, weight, w->lines);
    penalty_gradient(&w->view, gradient, diagonal);
    for (uint16_t cell = 0; cell < w->cells; cell++) {
        float least, largest;
        bounds_of(w, cell, &least, &largest);
        const float ohm = 1 / g[cell];
        const bool held = (ohm <= least && gradient[cell] > 0) || (ohm >= largest && gradient[cell] < 0);
        const bool none = (w->view.absent && w->absent[cell]) || held || !(diagonal[cell] > 0);
        const float shared = g[cell] * g[cell] * (w->lines[cell / n] + w->lines[m + cell % n]);
        diagonal[cell] = none ? 0 : 1 / larger(diagonal[cell], LEAST_OWN * shared);
    }
    float *const lines = w->lines, *const coarse = w->coarse, *const excess = w->net.x_short;
    for (uint8_t line = 0; line < m + n; line++) lines[line] = lines[line] > SMALLEST ? 1 / lines[line] : 1 / SMALLEST;
    for (uint16_t cell = 0; cell < w->cells; cell++) w->x[cell] = g[cell] * g[cell] * diagonal[cell]; /* C */
    memset(coarse, 0, n * n * sizeof(float));
    memcpy(excess, lines + m, n * sizeof(float));
    for (uint8_t i = 0; i < m; i++) {
        const float *c = w->x + i * n, tie = lines[i];
        for (uint8_t k = 0; k < n; k++) lines[i] += c[k];
        lines[i] = 1 / lines[i];
        for (uint8_t k = 0; k < n; k++) {
            const float factor = -c[k] * lines[i];
            excess[k] = FUSED(-factor, tie, excess[k]);
            for (uint8_t l = 0; l < n; l++) coarse[k * n + l] = FUSED(factor, c[l], coarse[k * n + l]);
        }
    }
    return invert(coarse, excess, n);
}

/* p = M^-1 r + turn p, the turn being the present r' M^-1 r, which is returned, times `turn_by_slope`. */
static float precondition(workspace *w, float turn_by_slope) {
    const uint8_t m = w->net.m, n = w->net.n;
    const float *g = w->net.conductance;
    float *const of_long = w->sums, *const of_short = w->sums + m;
    float *const shared = w->net.x_short; /* C' E^-1 times the sums of the longer side */
    float slope = 0;
    memset(of_short, 0, n * sizeof(float));
    memset(shared, 0, n * sizeof(float));
    for (uint8_t i = 0; i < m; i++) {
        float sum = 0;
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            const float z = w->diagonal[cell] * w->r[cell], drawn = g[cell] * z;
            slope = FUSED(z, w->r[cell], slope);
            sum += drawn;
            of_short[k] += drawn;
            w->q[cell] = z;
        }
        of_long[i] = sum;
        const float part = sum * w->lines[i];
        slope = FUSED(-part, sum, slope);
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            shared[k] = FUSED(part, g[cell] * g[cell] * w->diagonal[cell], shared[k]);
        }
    }
    for (uint8_t k = 0; k < n; k++) shared[k] = of_short[k] - shared[k];
    for (uint8_t k = 0; k < n; k++) {
        of_short[k] = dot(w->coarse + k * n, shared, n);
        slope = FUSED(-of_short[k], shared[k], slope);
    }
    const float turn = slope * turn_by_slope;
    for (uint8_t i = 0; i < m; i++) {
        float answer = of_long[i];
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            answer = FUSED(-of_short[k], g[cell] * g[cell] * w->diagonal[cell], answer);
        }
        answer *= w->lines[i];
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            const float drawn = w->diagonal[cell] * g[cell] * (answer + of_short[k]);
            w->p[cell] = FUSED(turn, w->p[cell], w->q[cell] - drawn);
        }
    }
    return slope;
}

/* q = (J' W J + penalties) p. */
static void product(workspace *w) {
    network_forward(&w->net, w->p, w->q);
    for (uint16_t cell = 0; cell < w->cells; cell++) w->q[cell] *= curvature_of(w, cell, deviation_of(w, cell));
    network_adjoint(&w->net, w->q, w->q);
    penalty_product(&w->view, w->p, w->q);
}

/* Solve the linear system for x, the right-hand side in r, by preconditioned conjugate gradients.
 *
 * `tail` gets the decrease that the last iterations brought, an estimate of what is left; iterations stop where it is
 * below `enough`. Returns the decrease of the quadratic model. */
static float conjugate_gradients(workspace *w, uint16_t most, float enough, float share, float *tail,
                                 uint16_t *products) {
    const uint16_t cells = w->cells;
    float decreases[TAIL] = {0}, total = 0, before = 0;
    memset(w->x, 0, cells * sizeof(float));
    memset(w->p, 0, cells * sizeof(float));
    *tail = FLT_MAX;
    for (uint16_t iteration = 0; iteration < most; iteration++) {
        const float slope = precondition(w, before);
        if (slope == 0) *tail = 0; /* nothing is left */
        if (!(slope > 0)) break;
        product(w);
        ++*products;
        const float curvature = dot(w->p, w->q, cells);
        if (!(curvature > 0)) break;
        const float length = slope / curvature;
        for (uint16_t cell = 0; cell < cells; cell++) {
            w->x[cell] = FUSED(length, w->p[cell], w->x[cell]);
            w->r[cell] = FUSED(-length, w->q[cell], w->r[cell]);
        }
        before = 1 / slope;
        decreases[iteration % TAIL] = length * slope;
        total += length * slope;
        float sum = 0;
        for (uint8_t last = 0; last < TAIL; last++) sum += decreases[last];
        *tail = sum;
        if (iteration + 1 >= TAIL && sum < larger(enough, share * total)) break;
    }
    return total;
}

/* Let the estimate be these cells; false if their network cannot be solved. */
static bool set_cells(workspace *w, const float *u) {
    for (uint16_t cell = 0; cell < w->cells; cell++) {
        w->u[cell] = u[cell];
        w->net.conductance[cell] = w->view.absent && w->absent[cell] ? 0 : exponential(-u[cell]);
    }
    if (!network_solve(&w->net)) return false;
    network_readings(&w->net, w->reading);
    return true;
}

/* Sum of the squared residuals of the readings, in standard deviations. A robust loss hardly tells far from farther. */
static float misfit_of(const workspace *w) {
    float sum = 0;
    for (uint16_t cell = 0; cell < w->cells; cell++) sum += deviation_of(w, cell) * deviation_of(w, cell);
    return sum;
}

/* Start from cells; false if their network cannot be solved. */
static bool start_from(workspace *w, lampest_status *status, const float *u, float *misfit) {
    status->products++;
    if (!set_cells(w, u)) return false;
    *misfit = misfit_of(w);
    return isfinite(*misfit);
}

/* Start from the estimate of the frame before, unless it is far from this frame's readings and the baseline is nearer. False
 * if neither is a start; `at_baseline` is true at first where the frame before is none. */
static bool choose_start(workspace *w, lampest_status *status, bool *at_baseline) {
    float *const before = w->p;
    float misfit, of_baseline;
    if (*at_baseline) return start_from(w, status, w->baseline, &of_baseline);
    network_readings(&w->net, w->reading);
    misfit = misfit_of(w);
    if (misfit <= FAR * w->cells) return true;
    memcpy(before, w->u, w->cells * sizeof(float));
    *at_baseline = start_from(w, status, w->baseline, &of_baseline) && !(misfit <= of_baseline);
    return *at_baseline || start_from(w, status, before, &misfit);
}

/* Gauss and Newton: linearise, solve, and move within the bounds, as long as the budget lasts.
 *
 * After garbled readings or a metal object the estimate of the frame before is so far away that no step from it lowers the
 * cost, although much is left to gain. The baseline then takes its place: in the next step, or in the next frame, for which
 * the function returns true. Halvings of the steps make up for the work of such starts. */
static bool minimise(workspace *w, lampest_status *status, bool at_baseline) {
    const lampest_constants *c = w->constants;
    const float enough = c->within * c->within * w->cells;
    bool astray = false;
    if (!choose_start(w, status, &at_baseline)) status->outcome = LAMPEST_FAILED;
    float cost = cost_of(w), misfit;
    status->left = cost;
    while (status->outcome == LAMPEST_FINE && status->steps < c->steps && !status->settled) {
        const uint32_t most = (status->steps + 1ul) * (c->products + HALVINGS + 1ul);
        if (!linearise(w)) {
            status->outcome = LAMPEST_FAILED;
            break;
        }
        for (uint16_t cell = 0; cell < w->cells; cell++) w->r[cell] = -w->gradient[cell];
        float tail;
        const float predicted = conjugate_gradients(w, c->products, 0.5f * enough, 0.01f, &tail, &status->products);
        memcpy(w->q, w->u, w->cells * sizeof(float));
        float scale = 1, next = cost;
        bool lower = false;
        for (uint8_t half = 0; half <= HALVINGS && !lower && status->products < most; half++, scale *= 0.5f) {
            move(w, w->q, scale);
            status->products++;
            lower = evaluate(w, &next) && next <= cost * (1 + 1e-6f);
        }
        status->steps++;
        const bool solved = tail < FLT_MAX;
        if (lower && solved) {
            /* What the linear model missed, and what conjugate gradients left. */
            status->left = tail + fabsf(cost - next - predicted);
            cost = next;
            status->settled = status->left <= enough || predicted <= enough;
            continue;
        }
        status->left = predicted;
        astray = !solved || predicted > larger(enough, RESOLVED * cost);
        if (astray && !at_baseline && status->steps < c->steps) {
            at_baseline = true;
            astray = false;
            if (!start_from(w, status, w->baseline, &misfit)) status->outcome = LAMPEST_FAILED;
            cost = cost_of(w);
            continue;
        }
        memset(w->x, 0, w->cells * sizeof(float));
        move(w, w->q, 1);
        if (!evaluate(w, &cost) && !set_cells(w, w->baseline)) status->outcome = LAMPEST_FAILED;
        break;
    }
    if (!(status->left <= FLT_MAX)) status->left = FLT_MAX;
    return astray || status->outcome != LAMPEST_FINE;
}

static bool sound(float value, float least, float largest) {
    return isfinite(value) && value >= least && value <= largest;
}

static bool all_sound(const float *values, uint16_t count, float least, float largest) {
    for (uint16_t number = 0; number < count; number++) {
        if (!sound(values[number], least, largest)) return false;
    }
    return true;
}

static bool constants_are_sound(const lampest_constants *c) {
    if (c->rows < 1 || c->columns < 1 || c->rows > LAMPEST_MAX_LINES || c->columns > LAMPEST_MAX_LINES) return false;
    const uint16_t cells = c->rows * c->columns;
    const uint8_t driven = c->rows_driven ? c->rows : c->columns, sensed = c->rows + c->columns - driven;
    bool fine = all_sound(c->baseline, cells, SMALLEST_OHM, LARGEST_OHM) && sound(c->supply_volt, 1e-3f, 1e3f) &&
                sound(c->volt_per_sum, 1e-12f, 1e3f) && sound(c->volt_at_zero, -1e3f, 1e3f) &&
                all_sound(c->sigma_volt, c->sigma_count > 1 ? cells : 1, 1e-12f, 1e6f) &&
                c->top_sum < LAMPEST_MISSING && sound(c->follow, 1, 1e6f) && sound(c->plain_sigma, 0, 1e12f) && sound(c->within, 0, 1e6f) && c->low_sum <= c->high_sum &&
                c->high_sum <= c->top_sum && sound(c->least_ohm, 0, LARGEST_OHM) &&
                sound(c->largest_ohm, c->least_ohm, 1e15f);
    fine = fine && (c->data_loss == LAMPEST_SQUARED || sound(c->data_corner, 1e-12f, 1e12f));
    for (uint8_t number = 0; fine && number < c->term_count; number++) {
        const lampest_term *term = c->terms + number;
        fine = sound(term->weight, 0, 1e30f) && (term->loss == LAMPEST_SQUARED || sound(term->corner, 1e-12f, 1e12f));
    }
    for (uint16_t pair = 0; fine && pair < c->pair_count; pair++) {
        const lampest_pair *p = c->pairs + pair;
        fine = p->first < cells && p->second < cells && p->first != p->second && sound(p->distance, 1e-6f, 1e6f);
    }
    if (!fine) return false;
    if (!c->driven) {
        return sound(c->reference_ohm, 1e-6f, LARGEST_OHM) && sound(c->ohm_scale, 1e-6f, 1e6f) &&
               sound(c->shunt_siemens, 0, 1e6f) &&
               (!c->series || all_sound(c->series, c->rows + c->columns, 0, LARGEST_OHM));
    }
    return all_sound(c->tie, c->rows + c->columns, 0, 1e9f) && all_sound(c->drive, driven, 0, LARGEST_OHM) &&
           all_sound(c->release, driven, -1e9f, 1) && all_sound(c->load, sensed, -1e9f, 1e9f) &&
           all_sound(c->gain, sensed, 1e-12f, 1e12f);
}

lampest_outcome lampest_begin(lampest_panel *panel, float *memory) {
    const lampest_constants *c = panel->constants;
    panel->ready = false;
    if (c && c->version != LAMPEST_ESTIMATE_VERSION) return LAMPEST_OTHER_VERSION;
    if (!c || !memory || !constants_are_sound(c)) return LAMPEST_BAD_CONSTANTS;
    panel->memory = memory;
    panel->baselines = 0;
    panel->solved = panel->settled = false;
    panel->at_baseline = true;
    workspace w = arrange(panel);
    for (uint8_t row = 0; row < c->rows; row++) {
        for (uint8_t column = 0; column < c->columns; column++) {
            const uint16_t outside = row * c->columns + column, cell = cell_number(c, row, column);
            w.absent[cell] = c->present && !c->present[outside];
            w.baseline[cell] = logarithm(c->baseline[outside]);
        }
    }
    if (c->driven) {
        const bool rows_long = c->rows >= c->columns;
        memcpy(w.net.tie + (rows_long ? 0 : w.net.m), c->tie, c->rows * sizeof(float));
        memcpy(w.net.tie + (rows_long ? w.net.m : 0), c->tie + c->rows, c->columns * sizeof(float));
    }
    panel->ready = set_cells(&w, w.baseline);
    return panel->ready ? LAMPEST_FINE : LAMPEST_BAD_CONSTANTS;
}

lampest_status lampest_frame(lampest_panel *panel, const uint32_t *sums, float *log_change) {
    lampest_status status = {.outcome = LAMPEST_FINE};
    if (!panel->ready) {
        status.outcome = LAMPEST_BAD_CONSTANTS;
        return status;
    }
    const lampest_constants *c = panel->constants;
    workspace w = arrange(panel);
    if (read_sums(&w, sums, &status)) {
        if (w.view.previous) {
            float *previous = (float *)w.view.previous;
            for (uint16_t cell = 0; cell < w.cells; cell++) {
                previous[cell] = w.net.conductance[cell] > 0 ? 1 / w.net.conductance[cell] : 1;
            }
        }
        panel->at_baseline = minimise(&w, &status, panel->at_baseline);
        panel->solved = status.outcome == LAMPEST_FINE;
    }
    panel->settled = status.outcome == LAMPEST_FINE && status.settled;
    for (uint8_t row = 0; row < c->rows; row++) {
        for (uint8_t column = 0; column < c->columns; column++) {
            const uint16_t cell = cell_number(c, row, column);
            const bool none = w.view.absent && w.absent[cell];
            log_change[row * c->columns + column] = none ? 0 : w.u[cell] - w.baseline[cell];
        }
    }
    return status;
}

float lampest_cell(const lampest_panel *panel, uint8_t row, uint8_t column) {
    const workspace w = arrange(panel);
    return 1 / w.net.conductance[cell_number(panel->constants, row, column)];
}

/* Whether a cell lies further below the others, relative to the baseline, than cells at rest do. A change of all cells, as of
 * a film that warms up, is none. */
static bool under_load(const workspace *w) {
    float low = INFINITY, high = -INFINITY;
    uint16_t count = 0;
    for (uint16_t cell = 0; cell < w->cells; cell++) {
        if (w->view.absent && w->absent[cell]) continue;
        const float change = w->u[cell] - w->baseline[cell];
        low = smaller(low, change);
        high = larger(high, change);
        count++;
    }
    const float least = low;
    for (uint8_t part = 0; part < BISECTIONS; part++) { /* the median lies between `low` and `high` */
        const float middle = low + 0.5f * (high - low);
        uint16_t below = 0;
        for (uint16_t cell = 0; cell < w->cells; cell++) {
            below += !(w->view.absent && w->absent[cell]) && w->u[cell] - w->baseline[cell] <= middle;
        }
        if (2 * below < count) low = middle;
        else high = middle;
    }
    return !(least >= high - w->constants->loaded_limit);
}

/* Move the baseline by a share of the way to the estimate; false if a load is on the panel. */
static bool take_up(workspace *w, float share) {
    if (under_load(w)) return false;
    share = larger(share, 1 / larger(w->constants->follow, 1));
    for (uint16_t cell = 0; cell < w->cells; cell++) {
        w->baseline[cell] = FUSED(share, w->u[cell] - w->baseline[cell], w->baseline[cell]);
    }
    return true;
}

lampest_status lampest_baseline(lampest_panel *panel, const uint32_t *sums) {
    lampest_status status = {.outcome = LAMPEST_FINE};
    if (!panel->ready) {
        status.outcome = LAMPEST_BAD_CONSTANTS;
        return status;
    }
    workspace w = arrange(panel);
    if (!read_sums(&w, sums, &status)) return status;
    w.view.at_rest = true;
    minimise(&w, &status, true);
    if (status.outcome == LAMPEST_FINE && !take_up(&w, 1.0f / (1 + panel->baselines))) status.outcome = LAMPEST_UNDER_LOAD;
    if (!set_cells(&w, w.baseline)) status.outcome = LAMPEST_FAILED;
    panel->at_baseline = true;
    panel->settled = false;
    if (status.outcome != LAMPEST_FINE) return status;
    if (panel->baselines < UINT8_MAX) panel->baselines++;
    panel->solved = true;
    return status;
}

bool lampest_follow(lampest_panel *panel) {
    if (!panel->ready || !panel->settled) return false;
    workspace w = arrange(panel);
    return take_up(&w, 0);
}

float lampest_deviation(lampest_panel *panel, uint8_t row, uint8_t column, uint16_t products) {
    if (!panel->ready || !panel->solved || row >= panel->constants->rows || column >= panel->constants->columns) return -1;
    workspace w = arrange(panel);
    const uint16_t cell = cell_number(panel->constants, row, column);
    if (!linearise(&w) || !(w.diagonal[cell] > 0)) return -1;
    /* The decrease of e'x - x'Ax/2 on its way to e'A^-1 e / 2 is the variance of the cell. */
    memset(w.r, 0, w.cells * sizeof(float));
    w.r[cell] = 1;
    uint16_t spent = 0;
    float tail;
    const float variance = conjugate_gradients(&w, products, 0, 1e-3f, &tail, &spent);
    return isfinite(variance) && variance > 0 ? sqrtf(variance) : -1;
}
