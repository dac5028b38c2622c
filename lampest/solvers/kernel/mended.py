"""A kept factor in machine code, mended by what steps with it have shown."""

from typing import Any

import numpy as np

from lampest.panel.machine import machine_code
from lampest.solvers.kernel.algebra import cholesky_divided, dot_of


@machine_code
def along_mended(addresses: Any, kept: Any, seen: Any, count: int, along: Any) -> None:
    """along ← H⁻¹·along, H the second derivatives of a kept factor mended by what `count` steps have shown.

    seen : (2, steps, free) steps and what they changed ∇φ by. Source: Nocedal, Math. Comput. 35, 1980.
    """
    shares = np.empty(count)
    for back in range(count):
        number = count - 1 - back
        step, change = seen[0, number], seen[1, number]
        shares[number] = dot_of(step, along) / dot_of(step, change)
        for cell in range(len(along)):
            along[cell] -= shares[number] * change[cell]
    cholesky_divided(addresses, kept, along)
    for number in range(count):
        step, change = seen[0, number], seen[1, number]
        more = shares[number] - dot_of(change, along) / dot_of(step, change)
        for cell in range(len(along)):
            along[cell] += more * step[cell]


@machine_code
def noted_step(before: Any, after: Any, free: Any, seen: Any, count: int) -> bool:
    """A step from one point to another as the next of `seen`; whether ∇φ grew along it."""
    for number in range(len(free)):
        cell = free[number]
        seen[0, count, number] = after[0, cell] - before[0, cell]
        seen[1, count, number] = after[2, cell] + after[3, cell] - before[2, cell] - before[3, cell]
    return bool(dot_of(seen[0, count], seen[1, count]) > 0)
