"""A frame of a panel between small and large in one call of machine code: steps by conjugate gradients, no matrix."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lampest.panel.conjugate import DENSE_UNKNOWNS
from lampest.panel.panel import Array
from lampest.solvers.certificate import Bend, Certificate
from lampest.solvers.newton.directions import Factor
from lampest.solvers.newton.newton import Newton
from lampest.solvers.newton.softest import SOFT
from lampest.solvers.solution import Outcome, Status

if TYPE_CHECKING:
    from lampest.solvers.kernel.following import Workbench

NOTHING = np.zeros(0)
NO_PRECONDITIONER = (np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), NOTHING)
LARGER_UNKNOWNS = 2048  # beyond, products are nearly all of the time, and Newton's classes cost little beside them
WIDEST = 160  # how far apart cells may stand that a term ties: a solve with that band takes as long as two products


@dataclass(frozen=True, eq=False, kw_only=True)
class KeptPreconditioner(Factor):
    """What machine code preconditions with, over all cells: its parts, and where it was made, u (cells).

    bench, position : the frame that it was made for, and that frame's optimum u (cells).
    """

    parts: tuple[Array, Array, Array, Array]
    bench: "Workbench"
    position: Array

    @cached_property
    def softest(self) -> Array | None:
        """The softest direction at the optimum; larger panels are not asked for it."""
        from lampest.panel.machine import result_of
        from lampest.solvers.kernel.softness import softest_vector

        if len(self.cells) > DENSE_UNKNOWNS:
            return None
        found, along = result_of(softest_vector, *self.bench.given, self.position, *self.parts[:3], SOFT)
        return along if found else None


def pursued(solver: Newton, bench: "Workbench", start: Array, limits: Array) -> Outcome | None:
    """What the machine code makes of a frame from u (1, rows, columns) on; None where it fell short.

    Where nothing but readings is asked for, steps are straight in 1/r: they are nearly linear in that, and cells that
    come off arrive in one. There, what nobody knows the noise of is left to a certificate with more digits.
    """
    from lampest.panel.machine import result_of
    from lampest.solvers.kernel.points import SETTLED
    from lampest.solvers.kernel.pursuit import pursue

    data, band = bench.data, bench.arena.band
    plain = all(term.reads_measurement for term in solver.cost.terms)
    if band > WIDEST or (plain and not data.noise_known):
        return None
    kept = solver.factor if isinstance(solver.factor, KeptPreconditioner) else None
    ending, position, step, decrement, share, solves, *parts, made = result_of(
        pursue,
        *bench.given,
        start.ravel(),
        *(NO_PRECONDITIONER if kept is None else kept.parts),
        -1 if plain else 0,
        band,
        limits,
        bench.sigma,
    )
    if ending != SETTLED:
        return None
    cell_resistance = np.exp(position).reshape(start.shape)
    left = kept if kept is not None and not made else _made(bench, parts, position, start.shape)
    return Outcome(cell_resistance, NOTHING, Status.OPTIMUM, solves, Certificate(Bend.UP, step, decrement, share), left)


def _made(bench: "Workbench", parts: list[Array], position: Array, shape: tuple[int, ...]) -> KeptPreconditioner:
    """A preconditioner as the machine code leaves it."""
    base, seen, inner, found_at = parts

    def solve(right: Array) -> Array:
        from lampest.solvers.kernel.applied import preconditioned

        solution: Array = preconditioned(bench.arena.addresses, shape[1], base, seen, inner, right)
        return solution

    return KeptPreconditioner(
        np.arange(position.size),
        np.exp(found_at).reshape(shape),
        solve,
        parts=(base, seen, inner, found_at),
        bench=bench,
        position=position,
    )
