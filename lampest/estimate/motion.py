"""Motion within a scan: whether loads moved on while the lines of a frame were read one after the other.

A reading that is taken τ of a frame period away from the frame's middle differs by Δ·τ, with Δ half the difference of
the frames before and after. If no cells explain the readings, but some do once s·Δ·τ is taken off, a scan takes the
share s of the period. Where no share helps, and most of the frames that move most are unexplained though the unloaded
panel is not, loads move too far from frame to frame for Δ, and s is 1. Error bars then reach as far as |τ| s times the
larger of a reading's steps to the frames beside.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import LEVEL, fitted
from lampest.panel.memory import in_panel_order
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

MOST_FRAMES = 3  # that move most are tried
SHARES = (0.25, 0.5, 0.75, 1.0)  # of the period that are tried: a scan takes no longer than that
THIRD = 3.0  # by which χ² must fall
LEAST_LEFT = 0.1  # of a reading, however fast it changes
LEAST_MOTION = 3.0  # rms of Δ·τ over σ, below which nobody would notice it


def passing(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """Δ·τ (frames, rows, columns) of the measured frames in the unit of readings; 0 for frames before them.

    The first and the last one have one neighbour.
    """
    moved = np.zeros(readings.value.shape)
    if len(measured) > 1:
        moved[measured] = np.gradient(readings.value[measured], axis=0)
    return moved * _late(scene, readings)


def swept(scene: Scene, readings: Readings, measured: NDArray[np.intp]) -> Array:
    """|τ| times the larger of a reading's steps from the frame before and to the one after, as `passing`.

    A load that has come and gone from one frame to the next but one leaves no difference between these.
    """
    step = np.zeros(readings.value.shape)
    if len(measured) > 1:
        steps = np.abs(np.diff(readings.value[measured], axis=0))
        step[measured[1:]] = steps
        step[measured[:-1]] = np.maximum(step[measured[:-1]], steps)
    return step * np.abs(_late(scene, readings))


def _late(scene: Scene, readings: Readings) -> Array:
    """τ (1, rows, columns) of each reading: how late it is taken, from the middle of its frame, in periods."""
    channels = readings.value[0].size
    late = (np.arange(channels) + 0.5) / channels - 0.5
    return in_panel_order(scene.circuit, late[None], (1, *readings.value.shape[1:]))


def scan_share(scene: Scene, resting: Readings, readings: Readings, measured: NDArray[np.intp]) -> float:
    """The share of its period that a frame's scan seems to take; 0 where nothing shows it.

    Frames with most motion that have two neighbours are tried.
    """
    inner = measured[1:-1]
    if not len(inner) or readings.sigma is None or resting.sigma is None:
        return 0.0
    moved = passing(scene, readings, measured)
    size = np.sqrt(np.mean((moved / readings.sigma) ** 2, axis=(1, 2)))
    moving = inner[np.argsort(-size[inner])][:MOST_FRAMES]
    if size[moving[0]] < LEAST_MOTION:
        return 0.0
    base = fitted(scene, resting, patient=True)
    if base is None or base.tail < LEVEL:
        return 0.0

    def left(share: float) -> tuple[list[float], float]:
        """(χ²'s tails, Σ log(1 + χ²)) of what cells leave of the frames once share·Δ·τ is taken off."""
        least = LEAST_LEFT * readings.value
        freed = replace(readings, value=np.maximum(readings.value - share * moved, least))
        fits = [fit for frame in moving if (fit := fitted(scene, freed[frame], patient=True)) is not None]
        tails = [fit.tail for fit in fits] + [1.0] * (len(moving) - len(fits))
        return tails, float(sum(np.log1p(fit.chi_square) for fit in fits))

    tails, cost = left(0.0)
    if min(tails) >= LEVEL:
        return 0.0
    costs = {share: left(share)[1] for share in SHARES}
    best = min(costs, key=lambda share: costs[share])
    if costs[best] < cost - len(moving) * np.log(THIRD):
        return best
    return float(np.median(tails) < LEVEL)  # the whole period, or nothing
