"""Panels that read alike: choice among the cells that give the same readings.

Where a driven line has a resistance and other lines are held near ground, readings rise with the
conductance of the cells and then fall, because the driven line is pulled to ground: two panels, one
of small and one of large resistances, give the same readings. Each is searched for from the uniform
panel of its branch. If log cells scatter by an unknown s, the probability of the readings is p(y) =
∫ N(x(y); μ, s²)/|det J| dμ ds/s with J = ∂ ln y/∂x, so that a panel of n cells has, up to a
constant,

    ln p = −n ln s − ln|det J|.

Circuits are designed so that readings rise when cells conduct more. A panel where they fall has to
be more probable by LOG_PRIOR than the regular one; on large panels, whose determinant costs too
much, it is never taken.

Each driven line has a fold of its own, so that there may be more panels. `every_panel` searches
beyond the folds of single lines, too, and frames separate them: cells without a load are
equal in an unloaded and in a loaded frame on the branch that is meant, and on no other
(`lampest.inference.circuits.alike`).

Cells whose exact readings are the measured ones are found on the logarithms of both. The
Levenberg–Marquardt method minimises ½ |log(y(u)/y)|² over u = log r on panels of up to MAX_DENSE
cells. Near a fold of the readings J is nearly singular, where undamped steps lead nowhere. On
larger panels a step of Newton's method solves J·p = log(y/y(u)) by GMRES with products of J, and is
shortened until the misfit falls.
"""

import math
from collections.abc import Callable, Sequence
from itertools import islice

import numpy as np
import scipy

from lampest.files.levels import SIGNIFICANCE
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.trust_region import backtracked

Solved = Callable[[Array], Network]  # cells (rows, columns) ohm → their solved network
# ohm: uniform panels that are tried, each twice the one before
LEVELS = np.geomspace(10.0, 1e8, 24)
RANGE = 1e3  # cells lie within this factor of the uniform panel's
MIN_FOLD = 0.01  # of ln y: readings that fall by more, as cells conduct more, have a fold
MIN_SCATTER = 1e-3  # of log r; cells at their largest resistance are alike
MAX_MISFIT = 0.03  # of the median reading: panels that read alike to less than that are compared
LOG_PRIOR = -math.log(SIGNIFICANCE)  # of a panel whose readings rise with its conductance
MAX_CELLS = 400  # whose determinant is computed
SAME = 1e-2  # of log r: panels that differ by less are one
MAX_SEARCHES = 16  # for all panels that give one frame's readings
LINE_FACTORS = np.geomspace(1e-2, 1e2, 17)  # of the cells of a line, on the way to its fold
WHOLE_FACTORS = (0.5, 2.0)  # of all cells, beyond the fold of the whole panel
MIN_FACTOR = 1.3  # of the cells of a line beyond its fold
MAX_DENSE = 400  # cells whose Jacobian is factored
# Where no cells give the readings, the misfit falls by ever less: below 1 % an iteration it ends.
DAMPED = LevenbergMarquardt(evaluations=100, settled=1e-12, share=0.01, damping=0.1)
MAX_ITERATIONS = 20
MAX_PRODUCTS = 30
CONVERGED = 1e-3  # change of log r
MAX_STEP = 2.0  # of log r
MAX_LENGTHS = 8  # tried lengths of a step
SOLVED = 1e-2  # relative residual of a step's linear system


def uniform_panels(log_medians: Array, measured: Array) -> list[Array]:
    """Return the uniform panels whose median reading is the measured one.

    The panels are (rows, columns) ohm each. If there is none, the nearest one is returned.
    """
    excess = log_medians - np.log(np.nanmedian(measured))
    crossings = np.flatnonzero(excess[:-1] * excess[1:] <= 0)
    if not crossings.size:
        return [np.full(measured.shape, LEVELS[np.argmin(np.abs(excess))])]
    # linear in the logarithms between two levels
    share = excess[crossings] / -np.diff(excess)[crossings]
    levels = LEVELS[crossings] * (LEVELS[1] / LEVELS[0]) ** share
    return [np.full(measured.shape, level) for level in levels]


def misfit(solved: Network, measured: Array) -> float:
    """Return the root mean square of the differences to the readings, over the median reading."""
    square = np.nanmean((solved.reading() - measured) ** 2)
    return float(np.sqrt(square) / np.nanmedian(measured))


def panels_alike(
    network: Solved,
    measured: Array,
    firsts: Sequence[Array],
    upper: Array | float,
) -> list[tuple[float, Array]]:
    """Return the panels that give the readings, the most probable one first.

    The order counts LOG_PRIOR; the probabilities in the result do not.

    Parameters
    ----------
    network : callable
        Solved network of cells (rows, columns) ohm.
    measured : array, shape (rows, columns)
        Positive readings.
    firsts : sequence of array, shape (rows, columns)
        Cells at which the searches begin, ohm.
    upper : float or array, shape (rows, columns)
        Largest resistances, ohm.

    Returns
    -------
    list of (float, array)
        ln p, and cells (rows, columns) ohm, of each panel.
    """
    matched = (
        matching_cells(network, measured, first, first / RANGE, first * RANGE) for first in firsts
    )
    panels = _distinct([np.minimum(cells, upper) for cells in matched])
    networks = [network(cells) for cells in panels]
    misfits = [misfit(solved, measured) for solved in networks]
    largest = max(MAX_MISFIT, min(misfits))
    alike = [number for number, deviation in enumerate(misfits) if deviation <= largest]
    if len(alike) == 1:
        return [(0.0, panels[alike[0]])]
    evidence = {number: _log_evidence(networks[number]) for number in alike}
    alike.sort(
        key=lambda number: evidence[number] + LOG_PRIOR * bool(networks[number].branch < 0),
        reverse=True,
    )
    return [(evidence[number], panels[number]) for number in alike]


def every_panel(
    network: Solved,
    measured: Array,
    firsts: Sequence[Array],
    limits: tuple[Array, Array],
    tolerance: float,
    driven_axis: int,
) -> list[Array]:
    """Return the panels that give the readings, in the order in which they are found.

    From each of them, searches begin beyond the fold of the whole panel, whose cells are scaled,
    and beyond the folds of single driven lines.

    Parameters
    ----------
    network, measured, firsts
        As those of `panels_alike`; a reading that is NaN does not count.
    limits : tuple of two arrays, shape (rows, columns)
        Smallest and largest resistances, ohm; equal where a cell is known.
    tolerance : float
        Largest `misfit` of a panel.
    driven_axis : int
        Axis of a panel that counts the driven lines.
    """
    panels: list[Array] = []
    waiting = list(firsts)
    # The list grows while it is read
    for start in islice(waiting, MAX_SEARCHES):
        first = np.clip(start, *limits)
        least, most = (np.clip(first * factor, *limits) for factor in (1 / RANGE, RANGE))
        cells = matching_cells(network, measured, first, least, most)
        if not misfit(network(cells), measured) <= tolerance:
            continue
        if len(_distinct([*panels, cells])) > len(panels):
            panels.append(cells)
            waiting.extend(factor * cells for factor in WHOLE_FACTORS)
            waiting.extend(_beyond_folds(network, measured, cells, driven_axis))
    return panels


def _beyond_folds(network: Solved, measured: Array, cells: Array, driven_axis: int) -> list[Array]:
    """Return panels with one driven line beyond its fold.

    The line has cells larger or smaller by one factor, with which it has its median reading again.
    """
    panels = []
    for line in range(cells.shape[driven_axis]):
        chosen = np.indices(cells.shape)[driven_axis] == line
        if not np.isfinite(measured[chosen]).any():
            continue
        scaled = [np.where(chosen, factor * cells, cells) for factor in LINE_FACTORS]
        ratios = [network(panel).reading()[chosen] / measured[chosen] for panel in scaled]
        excess = np.log(np.nanmedian(ratios, axis=1))
        for crossing in np.flatnonzero(excess[:-1] * excess[1:] < 0):
            factor = float(np.sqrt(LINE_FACTORS[crossing] * LINE_FACTORS[crossing + 1]))
            if abs(np.log(factor)) > np.log(MIN_FACTOR):
                panels.append(np.where(chosen, factor * cells, cells))
    return panels


def _distinct(panels: Sequence[Array]) -> list[Array]:
    """Return the panels without repetitions."""
    distinct: list[Array] = []
    for cells in panels:
        if not any(np.allclose(np.log(cells), np.log(panel), atol=SAME) for panel in distinct):
            distinct.append(cells)
    return distinct


def _log_evidence(solved: Network) -> float:
    """Return ln p = −n ln s − ln|det J|; 0 for a large panel."""
    cells = solved.cell_resistance
    if cells.size > MAX_CELLS:
        return 0.0
    scatter = max(float(np.log(cells).std()), MIN_SCATTER)
    volume = float(np.linalg.slogdet(solved.sensitivity() / solved.reading().reshape(-1, 1))[1])
    return -cells.size * math.log(scatter) - volume


def matching_cells(
    network: Solved, measured: Array, first: Array, least: Array, most: Array
) -> Array:
    """Return cells between two limits that reproduce the readings as well as possible.

    Shape (rows, columns), in ohm.

    Parameters
    ----------
    network : callable
        Solved network of cells (rows, columns) ohm.
    measured : array, shape (rows, columns)
        Positive readings; on panels of up to MAX_DENSE cells NaN does not count.
    first, least, most : array, shape (rows, columns)
        Cells of the first iteration, and the limits, ohm.
    """
    lower = np.log(least)
    upper = np.log(most)
    start = np.clip(np.log(first), lower, upper)
    solve = _by_matrix if measured.size <= MAX_DENSE else _by_products
    return np.exp(solve(network, measured, start, lower, upper))


def _by_matrix(network: Solved, measured: Array, start: Array, lower: Array, upper: Array) -> Array:
    """Return log cells by the Levenberg–Marquardt method."""
    counted = np.isfinite(measured)

    def model(position: Array) -> SumOfSquares:
        solved = network(np.exp(position.reshape(measured.shape)))
        reading = np.maximum(solved.reading(), np.finfo(float).tiny)
        residual = np.where(counted, np.log(reading / measured), 0.0)
        weight = np.where(counted, 1 / reading, 0.0)
        return SumOfSquares(residual.ravel(), solved.sensitivity() * weight.reshape(-1, 1))

    position, _ = DAMPED.minimum(model, start.ravel(), (lower.ravel(), upper.ravel()))
    return position.reshape(measured.shape)


def _by_products(network: Solved, measured: Array, start: Array, low: Array, high: Array) -> Array:
    """Return log cells by Newton's method with products of J."""

    def at(position: Array) -> tuple[Array, Network, Array, Array]:
        solved = network(np.exp(position))
        reading = solved.reading()
        misfit = np.log(measured / np.maximum(reading, np.finfo(float).tiny))
        return position, solved, reading, misfit

    def lower(length: float) -> tuple[Array, Network, Array, Array] | None:
        trial = at(np.clip(current + length * step, low, high))
        return trial if np.sum(trial[-1] ** 2) < np.sum(misfit**2) else None

    current, solved, reading, misfit = at(start)
    for _ in range(MAX_ITERATIONS):
        response = scipy.sparse.linalg.LinearOperator(
            (measured.size, measured.size),
            matvec=lambda step, solved=solved, reading=reading: (
                solved.forward(step.reshape(measured.shape)) / reading
            ).ravel(),
            dtype=float,
        )
        step, _ = scipy.sparse.linalg.gmres(
            response, misfit.ravel(), rtol=SOLVED, restart=MAX_PRODUCTS, maxiter=1
        )
        step = np.clip(step.reshape(measured.shape), -MAX_STEP, MAX_STEP)
        following = backtracked(lower, MAX_LENGTHS)
        if following is None:
            break
        change = np.abs(following[0] - current).max()
        current, solved, reading, misfit = following
        if change < CONVERGED:
            break
    return current
