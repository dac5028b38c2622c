"""Motion within a scan: loads that move while the readings of a frame are taken.

The readings are taken one after the other. A reading is taken at its own delay from the middle of
the frame, and the load has moved by then. The load displaces all readings of a frame along one
known direction: the steps between frames, times each reading's delay, times the share of the time
between frames that a scan takes. The readings are interpolated to the middle of the scan. Cells
that no load touches determine the share: a wrong one makes them move.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import CellsFit, fitted
from lampest.estimate.changed_cells import mostly_still, usual_starts
from lampest.estimate.deciding import MAX_NEIGHBOURS
from lampest.estimate.fitted_pair import FittedPair
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import in_panel_order
from lampest.panel.scene import Scene
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings

SHARES = np.linspace(0, 1, 6)  # of the time between frames that a scan takes
UNKNOWN_SHARE = 1.0  # of a scan of which nothing is known: it may take the whole time


class Share(NamedTuple):
    """Share of the time between frames that a scan takes.

    Attributes
    ----------
    mean, deviation : float
        Mean and standard deviation of its posterior.
    gain : float
        Decrease of −2 ln evidence from no share to the best one.
    """

    mean: float
    deviation: float
    gain: float


def steps_within_scan(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Return the steps of each reading from the previous and to the next measured frame.

    They are given times τ, shape (2, frames, …). τ is the delay of a reading from the middle of its
    frame, in periods, if a scan takes the whole period. The first and the last frame have one
    neighbour; frames that are not measured have 0. The mean of both steps is the change between the
    middle of a frame and a reading's own time. It is zero for a load that is present in a single
    frame, and the larger step is not.
    """
    steps = np.zeros((2, *readings.value.shape))
    if len(measured) > 1:
        step = np.diff(readings.value[measured], axis=0)
        steps[:, measured] = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    return steps * _delays(scene, readings)


def _delays(scene: Scene, readings: Readings) -> Array:
    """Return τ of each reading, shape (1, …)."""
    channels = readings.value[0].size
    # τ of channel k of n: (k + ½)/n − ½
    late = (np.arange(channels) + 0.5) / channels - 0.5
    return in_panel_order(scene.circuit, late[None], (1, *readings.value.shape[1:]))


def displacement(
    scene: Scene, readings: Readings, measured: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Return the displacement of each reading by motion, and its doubt, if a scan takes the period.

    Each has the shape of the readings. A reading that was taken late is displaced by τ times the
    step from the previous frame, an early one by τ times the step to the next frame: a reading less
    its displacement is between two measured ones. The doubt is |τ| times half the difference of
    both steps, and √2 times that of the nearest frame where a frame has one neighbour. Readings
    that are no values, or whose neighbours in time are none, are not displaced; their doubt is the
    larger step.
    """
    previous, following = steps_within_scan(scene, readings, measured)
    late = _delays(scene, readings) > 0
    displaced = np.where(late, previous, following)
    doubt = np.abs(following - previous) / 2
    if len(measured) > 2:
        doubt[measured[[0, -1]]] = np.sqrt(2) * doubt[measured[[1, -2]]]
    plain = readings.plain[measured]
    around = np.concatenate([plain[:1], plain, plain[-1:]])
    values = np.zeros(displaced.shape, dtype=bool)
    values[measured] = around[:-2] & plain & around[2:]
    larger = np.maximum(np.abs(previous), np.abs(following))
    known = values & (len(measured) > 2)
    return np.where(known, displaced, 0.0), np.where(known, doubt, larger)


def share_of_motion(
    scene: Scene, resting: Readings, readings: Readings, measured: NDArray[np.intp]
) -> Share | None:
    """Return the share of the time between frames that a scan takes.

    None where it is unknown. A load that moves displaces all readings of a frame along one known
    direction, by share · displacement. Cells that no load touches seem to move by K times as much,
    K the inverse of the Jacobian. The evidence of the changes since rest is compared over SHARES,
    all equally probable before, for the frames with the largest motion.
    """
    inner = measured[1:-1]
    if not len(inner) or readings.sigma is None or resting.sigma is None:
        return None
    if scene.panel.crossings > MAX_CELLS:
        return None
    displaced, doubt = displacement(scene, readings, measured)
    size = np.sqrt(np.mean((displaced / readings.known_sigma) ** 2, axis=(1, 2)))
    base = fitted(scene, resting, patient=True)
    costs = np.zeros(len(SHARES))
    counted = 0
    near = None
    for frame in inner[np.argsort(-size[inner])][: 1 + MAX_NEIGHBOURS]:
        fit = fitted(scene, readings[frame], near, patient=True)
        if base is None or fit is None:
            return None
        near = fit.cells
        cost, still = _costs((base, fit), displaced[frame], doubt[frame])
        if still:
            costs += cost
            counted += 1
    if not counted:
        return None
    odds = np.exp(-(costs - costs.min()) / 2)
    odds /= odds.sum()
    mean = float(odds @ SHARES)
    deviation = float(np.sqrt(max(float(odds @ SHARES**2) - mean**2, 0.0)))
    return Share(mean, deviation, float(costs[0] - costs.min()))


def _costs(fits: tuple[CellsFit, CellsFit], displaced: Array, doubt: Array) -> tuple[Array, bool]:
    """Return −2 ln evidence over SHARES, (shares,), and whether most cells are still.

    Cells count as still without the doubt of the interpolation: with it, everything may be still.

    Parameters
    ----------
    fits : tuple of two CellsFit
        The unloaded panel and a frame.
    displaced, doubt : array, shape (rows, columns)
        See `displacement`.
    """
    frame = fits[1]
    changes = FittedPair.of(*fits).with_columns(np.zeros((displaced.size, 0)))
    moved = frame.response(displaced[None])[:, 0]
    spread = frame.gain * doubt.ravel()
    exact = [replace(changes, change=changes.change - share * moved) for share in SHARES]
    doubted = [
        replace(each, noise=each.noise + share**2 * spread @ spread.T)
        for share, each in zip(SHARES, exact, strict=True)
    ]
    costs = [each.selected(usual_starts(each.change))[0] for each in doubted]
    best = exact[int(np.argmin(costs))]
    return np.array(costs), mostly_still(best.selected(usual_starts(best.change))[1])
