"""Preconditioned conjugate gradients that stop where the matrix turns out not to be positive definite."""

from collections.abc import Callable

import numpy as np

from lampest.panel.panel import Array

# Below so many unknowns a factorisation is faster: it costs as much as 20 products at 16 × 16, 500 at 32 × 32.
DENSE_UNKNOWNS = 256
MOST_PRODUCTS = 400
Linear = Callable[[Array], Array]


def conjugate_gradients(
    product: Linear, precondition: Linear, right: Array, accuracy: float
) -> tuple[Array, Array | None]:
    """(x, None) with A x ≈ b to a relative accuracy in the preconditioned norm, or (x so far, d) where dᵀA d ≤ 0.

    Source: Steihaug, SIAM J. Numer. Anal. 20, 1983.
    """
    solution, residual = np.zeros_like(right), right
    search = scaled = precondition(residual)
    strength = float(residual @ scaled)
    goal = accuracy**2 * strength
    for _ in range(MOST_PRODUCTS):
        image = product(search)
        bend = float(search @ image)
        if bend <= 0:
            return solution, search
        length = strength / bend
        solution, residual = solution + length * search, residual - length * image
        scaled = precondition(residual)
        before, strength = strength, float(residual @ scaled)
        if strength <= goal:
            break
        search = scaled + strength / before * search
    return solution, None
