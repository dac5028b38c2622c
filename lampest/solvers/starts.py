"""Where solves start."""

from collections.abc import Iterable
from contextlib import suppress

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.panel import Array
from lampest.solvers.newton.curvature import DENSE_JOINT_UNKNOWNS

SEARCHED_UNKNOWNS = 2048  # of frames that are solved jointly, from all starts
FAR_FACTORS, FAR_CELLS = (1.2, 20.0), 400
SCATTERED = 6  # starts
# On larger panels starts that cost so many times the cheapest: under a mouth the convex one ended 2 to 13 % higher than
# the uniform one in 9 of 10 frames at 64 × 64 and 48 × 72.
DEAR = 30.0
BROKEN = (ArithmeticError, ValueError, RuntimeError)  # what numpy, LAPACK, SuperLU and CasADi raise for numbers


def first_starts(data: Data) -> list[Array]:
    """Where a cold start is begun."""
    return _unchanged(data) if lengthy(data) else [data.uniform_start, convex(data, None)]


def elsewhere(data: Data, previous: Array | None) -> list[Array]:
    """Where a hard solve is begun beside what it went on from."""
    near = [] if previous is None and not lengthy(data) else [data.uniform_start, convex(data, None)]
    near += [] if lengthy(data) else _unchanged(data)
    if data.measured[0].size > FAR_CELLS:
        return near
    between = [np.sqrt(data.lower * data.upper)] if len(data.measured) == 1 else []
    return near + [data.apparent_resistance * factor for factor in FAR_FACTORS] + between


def scattered(data: Data) -> Iterable[Array]:
    """Where a search goes on that met different minima: cells of 1 to 20 times what readings make of them.

    The exponents are fractions of √2·n², which lie evenly, without correlation (Rudnick, Sarnak & Zaharescu, Invent.
    Math. 145, 2001): the same for everybody, and no draw.
    """
    numbers = np.arange(1, SCATTERED * data.measured.size + 1, dtype=float).reshape(SCATTERED, *data.measured.shape)
    for share in np.sqrt(2.0) * numbers**2 % 1.0:
        yield data.apparent_resistance * FAR_FACTORS[1] ** share


def _unchanged(data: Data) -> list[Array]:
    """Where frames are solved jointly, and not by factors: the first one's start in all.

    Where penalties outweigh readings no cell changes. LSR-∇ΔCR under a mouth ended 9 % lower from there at 16 × 16, and
    13 % higher at 32 × 32.
    """
    joint = len(data.measured) > 1 and data.measured.size > DENSE_JOINT_UNKNOWNS
    return [np.repeat(convex(data, None, 1), len(data.measured), axis=0)] if joint else []


def lengthy(data: Data) -> bool:
    """Whether frames are solved jointly that take seconds a start: one has to do, where no cell changes.

    Under rods and a small mouth at 64 × 64 all starts ended in one minimum, from there in a third to a half of the
    iterations.
    """
    return len(data.measured) > 1 and data.measured.size > SEARCHED_UNKNOWNS


def convex(data: Data, near: Array | None, frames: int | None = None) -> Array:
    """The readout's start of every frame, begun near an earlier estimate (frames, rows, columns) ohm if there is one.

    frames : of so many of the first ones alone. Of two-point readings it is the convex one.
    """
    measured, upper = data.measured[:frames], data.upper[:frames]
    places = [None] * len(measured) if near is None else list(near[:frames])
    with suppress(*BROKEN):
        return np.stack([data.readout.start(*three) for three in zip(measured, upper, places, strict=True)])
    return data.uniform_start[:frames]


def evaluated(cost: Cost, data: Data, start: Array) -> Evaluation:
    """The cost at a start that is put within the bounds."""
    return Evaluation.at(cost, data, np.clip(start, data.lower, data.upper))


def evaluable(cost: Cost, data: Data, starts: Iterable[Array]) -> Iterable[Evaluation]:
    """The cost at those starts where it is a number."""
    for start in starts:
        with suppress(*BROKEN):
            point = evaluated(cost, data, start)
            if np.isfinite(point.objective):
                yield point


def affordable(points: Iterable[Evaluation]) -> list[Evaluation]:
    """The cheapest first; of a large frame without those that cost many times as much."""
    found = sorted(points, key=lambda point: point.objective)
    if not found or not large(found[0].cell_resistance):
        return found
    return [point for point in found if point.objective <= DEAR * found[0].objective]


def large(cell_resistance: Array) -> bool:
    """Whether it is one frame (1, rows, columns) of a panel on which starts far from all others are not tried."""
    return len(cell_resistance) == 1 and cell_resistance.size > FAR_CELLS
