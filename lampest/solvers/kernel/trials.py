"""Whether a step or a share of it leads to a better point, in machine code."""

from typing import Any

import numpy as np

from lampest.panel.machine import machine_code
from lampest.solvers.kernel.points import priced, projected_residual, put_within
from lampest.solvers.kernel.stops import SHARES, spread_over, stop_at_bounds, straightened


@machine_code
def step_trial(
    addresses: Any, where: Any, arena: Any, ties: Any, bounds: Any, limits: Any, here: Any, there: Any, step: Any,
    shares: int, costs: Any,
) -> bool:  # fmt: skip
    """Whether a step, or the best of so many shares of it, leads to a better point, which `there` is then.

    costs : φ, its scale and what the step promised, first of `here`, then of `there`.
    """
    vectors, target = here[0], np.empty(len(step))
    for number in range(shares):
        length, promise = SHARES[number], 0.0
        for cell in range(len(step)):
            moved = vectors[0, cell] + max(length * step[cell], -limits[5])
            target[cell] = min(max(moved, bounds[0, cell]), bounds[1, cell])
            promise -= (vectors[2, cell] + vectors[3, cell]) * (target[cell] - vectors[0, cell])
        put_within(there[0], target, bounds)
        costs[3], costs[4] = priced(addresses, where, arena, ties, there)
        costs[5], gain = promise, costs[0] - costs[3]
        if promise > 0 and gain >= limits[2] * promise:
            return True
        if abs(gain) <= limits[3] * abs(costs[0]):
            residual = projected_residual(vectors, bounds, costs[1])
            if projected_residual(there[0], bounds, costs[4]) < limits[4] * residual:
                return True
    return False


@machine_code
def straight_trial(
    addresses: Any, where: Any, arena: Any, ties: Any, bounds: Any, limits: Any, here: Any, there: Any, other: Any,
    matrix: Any, free: Any, along: Any, better: bool, costs: Any,
) -> bool:  # fmt: skip
    """Whether a step that is straight elsewhere, see `straightened`, leads to a point that is better, and lower than
    `there` where that is `better`: `other` is it then, and costs are its.

    along : over the free cells, the step that is straight in u. It and the matrix are overwritten.
    """
    straight, step, told = np.zeros(len(free), dtype=np.int64), np.zeros(len(here[0][0])), np.zeros(4)
    if not straightened(addresses, matrix, here[0], free, along, straight):
        return False
    stop_at_bounds(addresses, matrix, here[0], bounds, free, straight, along)
    spread_over(here[0], bounds, free, straight, along, step, told)
    found = costs.copy()
    reached = step_trial(addresses, where, arena, ties, bounds, limits, here, other, step, 1, found)
    if reached and (not better or found[3] < costs[3]):
        costs[:] = found
        return True
    priced(addresses, where, arena, ties, there)
    return False
