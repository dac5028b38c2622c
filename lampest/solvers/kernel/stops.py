"""Steps in machine code: in what they are straight, where they stop, whether they are short enough to certify."""

from typing import Any

import numpy as np

from lampest.panel.machine import call, machine_code
from lampest.solvers.kernel.algebra import cholesky_divided, cholesky_factored
from lampest.solvers.kernel.points import reading_stiffness

MOST_STEPS = 60
MOST_STOPS = 6
STRAIGHT = 0.2  # of log r
SHARES = (1.0, 0.5, 0.25, 0.1, 0.02)


@machine_code
def pull_into(vectors: Any, free: Any, step: Any) -> None:
    """step ← −∇φ at the free cells."""
    for number in range(len(free)):
        step[number] = -(vectors[2, free[number]] + vectors[3, free[number]])


@machine_code
def stop_at_bounds(addresses: Any, matrix: Any, vectors: Any, bounds: Any, free: Any, straight: Any, step: Any) -> bool:
    """Let cells that a step over the free ones takes beyond their bounds stop there, and ask the others again; whether
    there were any. Step and bounds in what is `straight`, see `straightened`.
    """
    count = len(free)
    known, moving, left = np.zeros(count), np.ones(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    for stops in range(MOST_STOPS):
        remaining, before = 0, len(left)
        for number in range(count):
            place, kind = vectors[0, free[number]], straight[number]
            low, high = (
                bent_change(bounds[0, free[number]] - place, kind),
                bent_change(bounds[1, free[number]] - place, kind),
            )
            held = min(max(step[number], low), high)
            if moving[number] and held != step[number]:
                known[number], moving[number] = held, 0
            if moving[number]:
                left[remaining] = number
                remaining += 1
        if remaining == before:
            return stops > 0
        left = left[:remaining]
        part, right, found = np.empty((remaining, remaining)), np.empty(count), np.empty(remaining)
        pull_into(vectors, free, right)
        for one in range(remaining):
            found[one] = right[left[one]]
            for number in range(count):
                if not moving[number]:
                    found[one] -= matrix[min(left[one], number), max(left[one], number)] * known[number]
            for other in range(one, remaining):
                part[one, other] = matrix[left[one], left[other]]
        if not cholesky_factored(addresses, part):
            return True
        cholesky_divided(addresses, part, found)
        for number in range(count):
            step[number] = known[number]
        for one in range(remaining):
            step[left[one]] = found[one]
    return True


@machine_code
def bent_change(change: float, kind: int) -> float:
    """A change of u as one of what is straight: of u, or relative of r (1) or of the conductance, downwards (-1)."""
    if kind == 0:
        return change
    return float(np.expm1(change)) if kind > 0 else float(-np.expm1(-change))


@machine_code
def unbent_change(change: float, kind: int) -> float:
    """The change of u, infinite beyond what is positive."""
    if kind == 0:
        return change
    if kind > 0:
        return float(np.log1p(change)) if change > -1 else -np.inf
    return float(-np.log1p(-change)) if change < 1 else np.inf


@machine_code
def straightened(addresses: Any, matrix: Any, vectors: Any, free: Any, step: Any, straight: Any) -> bool:
    """step over the free cells ← Newton's in r of those that it would make far smaller, in 1/r of those that it would
    make far larger, in u of all others; matrix ← its second derivatives. Whether there are such cells, and a step.

    With H and g the second and first derivatives in u, those in r are H − diag g, and in 1/r they are H + diag g, both
    for relative changes. In u a cell that is nearly open or shorted moves by about 1 a step, and hardly arrives.
    """
    many, kept = False, matrix.copy()
    for number in range(len(free)):
        slope = vectors[2, free[number]] + vectors[3, free[number]]
        if (step[number] > STRAIGHT and slope < 0) or (step[number] < -STRAIGHT and slope > 0):
            straight[number], many = -1 if slope < 0 else 1, True
            kept[number, number] -= abs(slope)
            matrix[number, number] -= abs(slope)
    if not many or not cholesky_factored(addresses, kept):
        return False
    pull_into(vectors, free, step)
    cholesky_divided(addresses, kept, step)
    return True


@machine_code
def short_enough(
    addresses: Any, where: Any, arena: Any, entries: Any, limits: Any, sigma: Any, step: Any, told: Any
) -> bool:
    """Whether a step is as short as a certificate asks for; told : its promise, decrement, share and length."""
    told[1], told[2] = np.sqrt(max(told[0], 0.0)), np.inf
    told[3] = 0.0
    for cell in range(len(step)):
        told[3] = max(told[3], abs(step[cell]))
    if told[3] > limits[8] and len(sigma) > 0:
        told[2] = told[1] / _deviation(reading_stiffness(addresses, where, arena, entries, len(step)), sigma)
    return bool(told[3] <= limits[8] or told[2] <= limits[9])


@machine_code
def spread_over(vectors: Any, bounds: Any, free: Any, straight: Any, along: Any, step: Any, told: Any) -> bool:
    """step (cells) ← a step over the free cells, within bounds; told[0] : −∇φ·s; whether no bound was in its way."""
    inside, told[0] = True, 0.0
    for cell in range(len(step)):
        step[cell] = 0.0
    for number in range(len(free)):
        cell = free[number]
        target = vectors[0, cell] + unbent_change(along[number], straight[number])
        held = min(max(target, bounds[0, cell]), bounds[1, cell])
        inside = inside and held == target
        step[cell] = held - vectors[0, cell]
        told[0] -= (vectors[2, cell] + vectors[3, cell]) * along[number]
    return inside


@machine_code
def past_end(addresses: Any, limits: Any) -> bool:
    """Whether the clock is past limits[15]; limits[14] : its number, which goes where others take a pointer."""
    if limits[15] == np.inf or addresses[8] == 0:
        return False
    now = np.zeros(2, dtype=np.int64)
    call(addresses[8], (int(limits[14]), now.ctypes.data))
    return bool(now[0] + 1e-9 * now[1] > limits[15])


@machine_code
def _deviation(stiffness: Any, sigma: Any) -> float:
    """√(mean ∂²φ/∂y² σ²) over the readings that count."""
    total, count = 0.0, 0
    for number in range(len(stiffness)):
        if stiffness[number] > 0:
            total += stiffness[number] * sigma[number] ** 2
            count += 1
    return np.sqrt(total / count) if count else 0.0
