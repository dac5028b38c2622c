/* The cost's summands: losses, penalties, and what they add to the gradient and to products with the Hessian.
 *
 * A loss rho enters by its stiffness omega(x) = rho'(x) / 2x (iteratively reweighted least squares): half the gradient
 * of rho is omega x, and omega x^2 is a quadratic that touches rho from above. */
#ifndef LAMPEST_TERMS_H
#define LAMPEST_TERMS_H

#include "network.h"

typedef struct {
    const lampest_constants *constants;
    uint8_t m, n;
    const float *u, *baseline; /* ln of the cells */
    const float *conductance;  /* siemens */
    const float *previous;     /* cells of the previous frame in ohm; NULL where no term needs them */
    const uint8_t *absent;     /* 1 for crossings without a cell, along the longer side; NULL: all have one */
    float *slope;              /* work: dv/du of the cells */
    bool at_rest;              /* the baseline is estimated: terms that compare with it or with a frame before have no part */
} cells_view;

float loss_of(lampest_loss loss, float corner, float x);
float stiffness_of(lampest_loss loss, float corner, float x);

/* The penalties' cost. */
float penalty_cost(const cells_view *view);

/* Add half the penalties' gradient, and the diagonal of their Hessian. */
void penalty_gradient(const cells_view *view, float *gradient, float *diagonal);

/* Add to `out` the product of the penalties' Hessian with p. */
void penalty_product(const cells_view *view, const float *p, float *out);

#endif
