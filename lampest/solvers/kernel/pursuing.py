"""A frame of a panel between small and large in one call of machine code: steps by conjugate gradients, no matrix."""

from typing import TYPE_CHECKING

import numpy as np

from lampest.panel.panel import Array
from lampest.solvers.certificate import Bend, Certificate
from lampest.solvers.newton.newton import Newton
from lampest.solvers.solution import Outcome, Status

if TYPE_CHECKING:
    from lampest.solvers.kernel.following import Workbench

NOTHING = np.zeros(0)
LARGER_UNKNOWNS = 2048  # beyond, products are nearly all of the time, and Newton's classes cost little beside them
WIDEST = 160  # how far apart cells may stand that a term ties: a solve with that band takes as long as two products


def pursued(solver: Newton, bench: "Workbench", start: Array, limits: Array) -> Outcome | None:
    """What the machine code makes of a frame from u (1, rows, columns) on; None where it fell short.

    Where nothing but readings is asked for, steps are straight in 1/r: they are nearly linear in that, and cells that
    come off arrive in one. There, what nobody knows the noise of is left to a certificate with more digits.
    """
    from lampest.panel.machine import result_of
    from lampest.solvers.kernel.arithmetic import SETTLED, pursue

    data, arena = bench.data, bench.arena
    plain = all(term.reads_measurement for term in solver.cost.terms)
    if arena.band > WIDEST or (plain and not data.noise_known):
        return None
    ending, position, step, decrement, share, solves = result_of(
        pursue,
        arena.addresses,
        arena.where,
        arena.memory,
        bench.told,
        arena.entries,
        data.ties,
        np.concatenate(data.log_bounds).reshape(2, -1),
        start.ravel(),
        -1 if plain else 0,
        arena.band,
        limits,
        data.sigma.flatten() if data.noise_known else NOTHING,
    )
    if ending != SETTLED:
        return None
    found = np.exp(position).reshape(start.shape)
    return Outcome(found, NOTHING, Status.OPTIMUM, solves, Certificate(Bend.UP, step, decrement, share))
