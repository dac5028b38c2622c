/* The network of a panel's lines: impedances, readings, and products with the derivatives of the readings.
 *
 * Cells connect `m` lines of the longer side (i) with `n` lines of the shorter one (k); all arrays over cells are
 * m x n, whatever side is longer. As L is bipartite, the longer side is eliminated by hand. With its line sums a_i, the
 * ties included, and H = diag(1/a) G,
 *
 *     S = B - G' H,    Z_kk = S^-1,    Z_ik = H S^-1,    Z_ii = diag(1/a) + H S^-1 H'.
 */
#ifndef LAMPEST_NETWORK_H
#define LAMPEST_NETWORK_H

#include "lampest_estimate.h"

typedef struct {
    uint8_t m, n;
    bool floats;          /* two-point readings */
    bool long_driven;     /* the longer side is driven */
    const lampest_constants *constants;
    float *conductance;   /* m x n */
    float *share;         /* H, m x n */
    float *mutual;        /* Z_ik, m x n */
    float *inverse;       /* S^-1, n x n */
    float *total;         /* a, m */
    float *own_long;      /* Z_ii, m */
    float *tie;           /* m + n */
    float *slope_long, *slope_short, *slope_mutual; /* dy/dZ of driven lines, m x n each */
    float *middle;        /* work: m x n */
    float *small, *small2;/* work: n x n each */
    float *x_long, *x_short; /* work: m, n */
} network;

/* Number of the cell of row and column along the longer side, and of a line. */
static inline uint16_t cell_number(const lampest_constants *c, uint8_t row, uint8_t column) {
    return c->rows >= c->columns ? (uint16_t)(row * c->columns + column) : (uint16_t)(column * c->rows + row);
}

/* Solve for the conductances in `net->conductance`; false if a line is not connected. */
bool network_solve(network *net);

/* The reading of each cell, and the slopes of driven lines. */
void network_readings(network *net, float *reading);

/* dy_c/du_c, the response of each reading to its own cell, u = ln r. */
void network_own_response(const network *net, float *response);

/* J p and J' w, u = ln r. */
void network_forward(network *net, const float *p, float *reading);
void network_adjoint(network *net, const float *w, float *cells);

/* How readings depend on the other cells of their two lines, as S over all lines (m, then n) of
 *
 *     J' W J = own part + G U diag(S) U' G,    U the incidence of cells and lines, G the conductances.
 *
 * The response of the reading of i and k to each other cell of line i is replaced by its mean alpha_ik over these cells,
 * weighted by their conductances, that to the other cells of k by beta_ik: S_i = sum_k w alpha^2, S_k = sum_i w beta^2.
 * (Entries w alpha beta between i and k save no iteration.) */
void network_line_responses(const network *net, const float *weight, float *s);

/* Invert in place a symmetric matrix whose entries off the diagonal are not positive, by sweeps of Gauss and Jordan; false at
 * a pivot that is none.
 *
 * The diagonal is not read: it follows from `excess` >= 0, the sums of the rows, which is lost. Nothing is subtracted, so that
 * each entry keeps its digits however far the matrix's numbers are apart (Grassmann, Taksar and Heyman 1985). */
bool invert(float *s, float *excess, uint8_t n);

#endif
