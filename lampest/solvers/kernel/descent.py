"""A warm frame of a small panel, in one call of machine code: steps with a factor of second derivatives.

The easy case of `lampest.solvers.newton`.
"""

from typing import Any

import numpy as np

from lampest.panel.machine import machine_code
from lampest.solvers.kernel.algebra import cholesky_factored
from lampest.solvers.kernel.matrices import curvature_matrix
from lampest.solvers.kernel.mended import along_mended, noted_step
from lampest.solvers.kernel.points import (
    FELL_SHORT,
    SETTLED,
    blank_point,
    farthest,
    free_numbers,
    priced,
    projected_residual,
    put_within,
)
from lampest.solvers.kernel.stops import (
    MOST_STEPS,
    past_end,
    pull_into,
    short_enough,
    spread_over,
    stop_at_bounds,
)
from lampest.solvers.kernel.trials import step_trial, straight_trial

MOST_SEEN = 8


@machine_code
def _same(one: Any, other: Any) -> bool:
    same = len(one) == len(other)
    for number in range(min(len(one), len(other))):
        same = same and one[number] == other[number]
    return same


@machine_code
def descend(
    addresses: Any, where: Any, arena: Any, given: Any, entries: Any, ties: Any, bounds: Any, start: Any, kept: Any,
    kept_cells: Any, kept_at: Any, limits: Any, sigma: Any,
) -> Any:  # fmt: skip
    """(ending, u, the last step, its decrement and share, factors made, the last one, its cells, where it was taken).

    Of one frame from `start` on. given : all that the terms know, copied to the arena's end. bounds : (2, cells) of u.
    start : u. kept : a factor of second derivatives over `kept_cells`, taken at `kept_at`, or nothing. sigma : of the
    readings, or nothing where it is not known. limits : see `limits` of `lampest.solvers.kernel.following`. SETTLED :
    the projected gradient was below the tolerance before the last step, and that is as short as a certificate asks for.
    FELL_SHORT : anything else; u then says nothing.
    """
    rows, cells = where[9], len(start)
    lines = rows + cells // rows
    for number in range(len(given)):
        arena[where[6] + number] = given[number]
    here, there, other = blank_point(lines, cells), blank_point(lines, cells), blank_point(lines, cells)
    step, told, costs = np.zeros(cells), np.zeros(4), np.zeros(6)
    put_within(here[0], start, bounds)
    costs[0], costs[1] = priced(addresses, where, arena, ties, here)
    costs[2], factors = np.inf, 0
    usable = len(kept_cells) > 0 and farthest(here[0][0], kept_at) <= limits[6]
    ending, exact, begun, steps, seen = FELL_SHORT, True, 0.0, 0, np.empty((2, MOST_SEEN, len(kept_cells)))
    for _ in range(MOST_STEPS):
        vectors = here[0]
        residual = projected_residual(vectors, bounds, costs[1])
        if not (abs(costs[0]) < np.inf and residual < np.inf) or past_end(addresses, limits):
            break
        free, near = free_numbers(vectors, bounds), residual <= limits[0]
        usable = usable and exact and _same(free, kept_cells)
        along, stopped, fresh = np.empty(len(free)), False, not usable
        straight = np.zeros(len(free), dtype=np.int64)
        pull_into(vectors, free, along)
        if fresh:
            if factors >= limits[13]:
                break
            factors += 1
            matrix = curvature_matrix(addresses, where, arena, entries, here, free, True)
            kept = matrix.copy()
            exact = cholesky_factored(addresses, kept)
            if not exact:
                matrix = curvature_matrix(addresses, where, arena, entries, here, free, False)
                kept = matrix.copy()
                if near or not cholesky_factored(addresses, kept):
                    break
            kept_cells, kept_at, usable = free, vectors[0].copy(), True
            along_mended(addresses, kept, seen, 0, along)
            steps, seen = 0, np.empty((2, MOST_SEEN, len(free)))
            tried = along.copy()
            stopped = stop_at_bounds(addresses, matrix, vectors, bounds, free, straight, along)
        else:
            along_mended(addresses, kept, seen, steps, along)
        inside = spread_over(vectors, bounds, free, straight, along, step, told)
        if not abs(told[0]) < np.inf:
            break
        sure = farthest(vectors[0], kept_at) <= limits[7]
        sure = sure or (farthest(vectors[0], kept_at) <= limits[10] and told[0] <= limits[11] ** 2 * begun)
        if near and sure and not stopped and short_enough(addresses, where, arena, entries, limits, sigma, step, told):
            ending = SETTLED
            if told[3] <= limits[12]:
                break
        if fresh or (inside and 0 < told[0] <= limits[1] ** 2 * costs[2]):
            better = step_trial(
                addresses, where, arena, ties, bounds, limits, here, there, step, 5 if fresh else 1, costs
            )
            again = fresh and exact and straight_trial(
                addresses, where, arena, ties, bounds, limits, here, there, other, matrix, free, tried, better, costs
            )  # fmt: skip
            if again:
                there, other, better = other, there, True
            if better:
                here, there, ending = there, here, FELL_SHORT
                begun = costs[5] if costs[2] == np.inf else begun
                costs[0], costs[1], costs[2] = costs[3], costs[4], costs[5]
                if steps < MOST_SEEN:
                    usable = noted_step(there[0], here[0], kept_cells, seen, steps)
                    steps += 1
                continue
            if fresh or ending == SETTLED:
                break
            priced(addresses, where, arena, ties, here)
        if ending == SETTLED:
            break
        usable = False
    if told[3] <= limits[7]:  # one that is short against the noise alone may lead further than derivatives hold
        for cell in range(cells):
            here[0][0, cell] += step[cell]
    return ending, here[0][0].copy(), step, told[1], told[2], factors, kept, kept_cells, kept_at
