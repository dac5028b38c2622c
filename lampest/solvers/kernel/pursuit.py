"""A warm frame of a larger panel, in one call of machine code: steps by conjugate gradients.

The easy case of `lampest.solvers.newton`.
"""

from typing import Any

import numpy as np

from lampest.panel.machine import machine_code
from lampest.solvers.kernel.conjugated import conjugated_step
from lampest.solvers.kernel.lined import made_preconditioner
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
from lampest.solvers.kernel.products import modelled
from lampest.solvers.kernel.stops import (
    MOST_STEPS,
    MOST_STOPS,
    SHARES,
    bent_change,
    past_end,
    short_enough,
    unbent_change,
)

FREELY, STOPPED, DOWN = 0, 1, 2
ROUGH, FINE = 0.1, 0.01  # of a step by conjugate gradients, and of the last one, which is taken unseen
MOST_PRODUCTS = 1500  # of a frame; beyond, it is not an easy one


@machine_code
def _approached(
    addresses: Any, rows: int, model: Any, links: Any, point: Any, whole: bool, found: Any, bounds: Any, straight: int,
    moving: Any, accuracy: float, told: Any, step: Any,
) -> int:  # fmt: skip
    """step ← Newton's over the moving cells, of which those stop at their bounds that it would take beyond.

    DOWN where the cost bends down, STOPPED where cells stopped, else FREELY. Step and bounds as in `bent_change`.
    """
    cells, rough, ending = len(step), max(accuracy, ROUGH), FREELY
    step[:] = 0.0
    for stops in range(MOST_STOPS + 2):
        if not conjugated_step(
            addresses, rows, model, links, point, whole, found, moving, rough, stops > 0, told, step
        ):
            return DOWN
        beyond = 0
        for cell in range(cells):
            low = bent_change(bounds[0, cell] - point[0][0, cell], straight)
            high = bent_change(bounds[1, cell] - point[0][0, cell], straight)
            held = min(max(step[cell], low), high)
            if moving[cell] and held != step[cell]:
                step[cell], moving[cell] = held, 0
                beyond += 1
        if beyond > 0:
            ending = STOPPED
        elif rough == accuracy:
            break
        else:
            rough = accuracy
    return ending


@machine_code
def _ventured(
    addresses: Any, where: Any, arena: Any, ties: Any, bounds: Any, limits: Any, here: Any, there: Any, along: Any,
    straight: int, costs: Any,
) -> bool:  # fmt: skip
    """Whether a step or a share of it leads to a better point, which `there` is then; as `step_trial`, straight in 1/r
    where `straight` is −1.
    """
    vectors, target = here[0], np.empty(len(along))
    for number in range(len(SHARES)):
        promise = 0.0
        for cell in range(len(along)):
            moved = unbent_change(SHARES[number] * along[cell], straight)
            moved = min(max(vectors[0, cell] + max(moved, -limits[5]), bounds[0, cell]), bounds[1, cell])
            target[cell] = moved
            promise -= (vectors[2, cell] + vectors[3, cell]) * bent_change(moved - vectors[0, cell], straight)
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
def pursue(
    addresses: Any, where: Any, arena: Any, given: Any, entries: Any, ties: Any, bounds: Any, start: Any, base: Any,
    seen: Any, inner: Any, found_at: Any, straight: int, band: int, limits: Any, sigma: Any,
) -> Any:  # fmt: skip
    """(ending, u, the last step, its decrement and share, steps before it, the last preconditioner's parts and place,
    how many were made) of one larger frame.

    As `descend`, without matrices of cells × cells. base, seen, inner : of a preconditioner that was made at `found_at`
    u, or nothing. straight : −1 where steps are straight in 1/r, 0 in u. band : how far apart cells stand that a term
    ties.
    """
    rows, cells = where[9], len(start)
    lines = rows + cells // rows
    for number in range(len(given)):
        arena[where[6] + number] = given[number]
    here, there = blank_point(lines, cells), blank_point(lines, cells)
    step, along, moving = np.zeros(cells), np.zeros(cells), np.zeros(cells, dtype=np.int64)
    told, costs, spent = np.zeros(4), np.zeros(6), np.zeros(2)
    put_within(here[0], start, bounds)
    costs[0], costs[1] = priced(addresses, where, arena, ties, here)
    ending, solves, made, spent[0] = FELL_SHORT, 0, 0, MOST_PRODUCTS
    found = (base, seen, inner, len(found_at) > 0)
    for turn in range(MOST_STEPS):
        residual = projected_residual(here[0], bounds, costs[1])
        if not (abs(costs[0]) < np.inf and residual < np.inf) or past_end(addresses, limits) or solves >= limits[13]:
            break
        near, better = residual <= limits[0], False
        accuracy = FINE if near else min(ROUGH, np.sqrt(residual))
        for attempt in range(2):
            whole = attempt == 0 and (turn > 0 or straight == 0 or near)
            if attempt == 0 and not whole:
                continue
            moving[:] = 0
            moving[free_numbers(here[0], bounds)] = 1
            model, links = modelled(addresses, where, arena, entries, here, straight, whole)
            if not found[3] or farthest(here[0][0], found_at) > limits[6]:
                found = made_preconditioner(addresses, rows, model, links, here, band, ties[0])
                found_at, made = here[0][0].copy(), made + 1
            if not found[3]:
                break
            way = _approached(
                addresses, rows, model, links, here, whole, found, bounds, straight, moving, accuracy, spent, along
            )
            if way == DOWN:
                continue
            told[0] = 0.0
            for cell in range(cells):
                step[cell] = unbent_change(along[cell], straight)
                told[0] -= (here[0][2, cell] + here[0][3, cell]) * along[cell]
            sure = near and way == FREELY and whole
            if sure and short_enough(addresses, where, arena, entries, limits, sigma, step, told):
                ending = SETTLED
                break
            better = _ventured(addresses, where, arena, ties, bounds, limits, here, there, along, straight, costs)
            if better:
                break
            priced(addresses, where, arena, ties, here)
        if not better:
            break
        here, there, solves = there, here, solves + 1
        costs[0], costs[1] = costs[3], costs[4]
    if ending == SETTLED and told[3] <= limits[7]:
        for cell in range(cells):
            here[0][0, cell] += step[cell]
    return ending, here[0][0].copy(), step, told[1], told[2], solves, found[0], found[1], found[2], found_at, made
