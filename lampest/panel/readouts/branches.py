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
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from lampest.files.levels import SIGNIFICANCE
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.readouts.matching import matching_cells

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
MIN_FACTOR = 1.3  # of the cells of a line beyond its fold


def uniform_panels(log_medians: Array, measured: Array) -> list[Array]:
    """Return the uniform panels whose median reading is the measured one.

    The panels are (rows, columns) ohm each. If there is none, the nearest one is returned.
    """
    excess = log_medians - np.log(np.median(measured))
    crossings = np.flatnonzero(excess[:-1] * excess[1:] <= 0)
    if not crossings.size:
        return [np.full(measured.shape, LEVELS[np.argmin(np.abs(excess))])]
    # linear in the logarithms between two levels
    share = excess[crossings] / (excess[crossings] - excess[crossings + 1])
    levels = LEVELS[crossings] * (LEVELS[1] / LEVELS[0]) ** share
    return [np.full(measured.shape, level) for level in levels]


def misfit(solved: Network, measured: Array) -> float:
    """Return the root mean square of the differences to the readings, over the median reading."""
    return float(np.sqrt(np.mean((solved.reading() - measured) ** 2)) / np.median(measured))


def panels_alike(
    network: Callable[[Array], Network], measured: Array, firsts: Sequence[Array], upper: Array
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
    upper : array, shape (rows, columns)
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
    evidence = {number: _log_evidence(networks[number], panels[number]) for number in alike}
    prior = {number: LOG_PRIOR * bool(networks[number].branch < 0) for number in alike}
    order = sorted(alike, key=lambda number: -(evidence[number] + prior[number]))
    return [(evidence[number], panels[number]) for number in order]


def every_panel(
    network: Callable[[Array], Network],
    measured: Array,
    firsts: Sequence[Array],
    tolerance: float,
    driven_axis: int,
) -> list[Array]:
    """Return the panels that give the readings, in the order in which they are found.

    From each of them, searches begin beyond the folds of single driven lines.

    Parameters
    ----------
    network, measured, firsts
        As those of `panels_alike`.
    tolerance : float
        Largest `misfit` of a panel.
    driven_axis : int
        Axis of a panel that counts the driven lines.
    """
    panels: list[Array] = []
    waiting = list(firsts)
    searches = 0
    while waiting and searches < MAX_SEARCHES:
        first = waiting.pop(0)
        searches = searches + 1
        cells = matching_cells(network, measured, first, first / RANGE, first * RANGE)
        if not misfit(network(cells), measured) <= tolerance:
            continue
        if len(_distinct([*panels, cells])) > len(panels):
            panels.append(cells)
            waiting.extend(_beyond_folds(network, measured, cells, driven_axis))
    return panels


def _beyond_folds(
    network: Callable[[Array], Network], measured: Array, cells: Array, driven_axis: int
) -> list[Array]:
    """Return panels with one driven line beyond its fold.

    The line has cells larger or smaller by one factor, with which it has its median reading again.
    """
    panels = []
    for line in range(cells.shape[driven_axis]):
        of_line = np.moveaxis(np.zeros(cells.shape, dtype=bool), driven_axis, 0)
        of_line[line] = True
        chosen = np.moveaxis(of_line, 0, driven_axis)
        excess = np.empty(len(LINE_FACTORS))
        for number, factor in enumerate(LINE_FACTORS):
            reading = network(np.where(chosen, factor * cells, cells)).reading()
            excess[number] = np.log(np.median(reading[chosen] / measured[chosen]))
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


def _log_evidence(solved: Network, cells: Array) -> float:
    """Return ln p = −n ln s − ln|det J|; 0 for a large panel."""
    if cells.size > MAX_CELLS:
        return 0.0
    scatter = max(float(np.log(cells).std()), MIN_SCATTER)
    volume = float(np.linalg.slogdet(solved.sensitivity() / solved.reading().reshape(-1, 1))[1])
    return -cells.size * math.log(scatter) - volume
