"""Starts for costs whose losses are not convex.

Readings that are far off at a start have hardly any pull under such a loss, so that steps from
there end where they are outliers. The relaxed cost has Huber's loss instead, with a corner where
the loss still is a square: it is convex, and single wrong readings hardly move its minimum. The
solver that minimises the cost minimises the relaxed one first, and begins at its minimum and around
it. Losses that shrink from squares end higher (docs/studies/minima.md).
Source: Yohai, Ann. Statist. 15, 1987 (a robust convex start for a redescending loss).
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import count

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.losses import Huber, Loss
from lampest.cost.problem import Evaluation
from lampest.files.errors import BROKEN
from lampest.panel.panel import Array
from lampest.solvers.solution import Solver

CORNER = 0.1  # of the residual at which the loss ceases to be convex
SPREAD = 0.5  # of log r: largest change of a cell in a start around another one
# Residuals among which the end of convexity is searched for, in any unit.
RESIDUALS = np.geomspace(1e-12, 1e12, 4801)


def relaxed(cost: Cost) -> Cost:
    """Return the cost with Huber's loss in place of losses that are not convex."""
    terms = []
    for term in cost.terms:
        if not term.loss.convex:
            corner, curvature = huber_of(term.loss)
            term = replace(term, loss=Huber(corner=corner), weight=curvature * float(term.weight))
        terms.append(term)
    return replace(cost, terms=tuple(terms))


@lru_cache(maxsize=64)
def huber_of(loss: Loss) -> tuple[float, float]:
    """Return the corner and the factor of the Huber loss that replaces a loss.

    Returns
    -------
    corner : float
        CORNER of the range of residuals in which the loss is convex.
    factor : float
        Curvature ½ρ''(0) of the loss.
    """
    convex = loss.curvature(RESIDUALS) > 0
    end = RESIDUALS[-1] if convex.all() else RESIDUALS[int(np.argmin(convex))]
    return CORNER * float(end), float(loss.curvature(np.zeros(1))[0])


def relaxed_starts(solver: Solver, start: Evaluation) -> Iterator[Array]:
    """Yield starts of a cost with losses that are not convex, (frames, rows, columns) ohm.

    The minimum of the relaxed cost from `start`, then an endless sequence around it and `start`.
    Nothing is yielded where the relaxed cost breaks down.
    """
    cost = relaxed(solver.cost)
    try:
        begin = Evaluation.at(cost, start.data, start.cell_resistance)
        cells = replace(solver, cost=cost).solve(start.data, begin).cell_resistance
    except BROKEN:
        return
    yield cells
    for number in count():
        # fractional parts of √3·n², in place of random numbers (Rudnick, Sarnak & Zaharescu 2001)
        places = np.arange(1, cells.size + 1, dtype=float) + cells.size * number
        share = (np.sqrt(3.0) * places**2 % 1.0).reshape(cells.shape)
        centre = cells if number % 2 == 0 else start.cell_resistance
        yield centre * np.exp(SPREAD * (2 * share - 1))
