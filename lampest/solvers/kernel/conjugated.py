"""Conjugate gradients with second derivatives of the cost, in machine code."""

from typing import Any

import numpy as np

from lampest.panel.machine import machine_code
from lampest.solvers.kernel.algebra import dot_of
from lampest.solvers.kernel.applied import precondition_into
from lampest.solvers.kernel.products import bent_along


@machine_code
def conjugated_step(
    addresses: Any, rows: int, model: Any, links: Any, point: Any, whole: bool, found: Any, moving: Any,
    accuracy: float, begun: bool, told: Any, step: Any,
) -> bool:  # fmt: skip
    """step (cells) ← nearer to −(∇²φ)⁻¹ ∇φ over the moving cells, the others as they are; whether nothing bent down.

    begun : whether it is not zero. told[0] : the products left; told[1] : ∇φ's strength where a step of zero began,
    against which `accuracy` is. Source: Steihaug, SIAM J. Numer. Anal. 20, 1983.
    """
    cells = len(step)
    residual, scaled, image = np.empty(cells), np.empty(cells), np.empty(cells)
    if begun:
        bent_along(addresses, rows, model, links, point, whole, step, image)
        told[0] -= 1
    for cell in range(cells):
        residual[cell] = -(point[0][2, cell] + point[0][3, cell]) - (image[cell] if begun else 0.0)
        residual[cell] = residual[cell] if moving[cell] else 0.0
    precondition_into(addresses, rows, found, moving, residual, scaled)
    search, strength = scaled.copy(), dot_of(residual, scaled)
    if not begun:
        told[1] = strength
    while strength > accuracy**2 * told[1] and told[0] > 0:
        bent_along(addresses, rows, model, links, point, whole, search, image)
        told[0] -= 1
        bend = 0.0
        for cell in range(cells):
            image[cell] = image[cell] if moving[cell] else 0.0
            bend += search[cell] * image[cell]
        if not bend > 0:
            return False
        for cell in range(cells):
            step[cell] += strength / bend * search[cell]
            residual[cell] -= strength / bend * image[cell]
        precondition_into(addresses, rows, found, moving, residual, scaled)
        before, strength = strength, dot_of(residual, scaled)
        for cell in range(cells):
            search[cell] = scaled[cell] + strength / before * search[cell]
    return bool(told[0] > 0)
