"""The total force on a panel, and how uncertain it is."""

from typing import NamedTuple

import numpy as np

from lampest.loads.pressure import Pressure, PressureTrack
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.track import Bars

KPA_MM2 = 1e-3  # of one kPa on a square millimetre, newton


class Force(NamedTuple):
    """F and its standard deviation, newton; NaN where it is not known."""

    newton: float
    deviation: float


def total_force(scene: Scene, pressed: Pressure, barred: Pressure | None = None) -> Force:
    """F = Σ p·pitch² and √Σ σ_p²·pitch² over the cells that are neither broken nor saturated; suction is negative.

    Errors of cells are taken to be independent, as `lampest detect` takes them. pressed : (rows, columns), without the
    estimate's own errors: what they leave of a cell's pressure does not decide whether it counts. barred : with them;
    None: the deviation is not known.
    """
    counted = pressed.saturated == 0
    if scene.faults is not None:
        counted &= ~(scene.faults.open_cells(scene.panel) | scene.faults.shorted_cells(scene.panel))
    area = scene.panel.pitch_mm**2 * KPA_MM2
    deviation = np.nan if barred is None else area * np.sqrt(np.sum(barred.errors[counted] ** 2))
    return Force(float(area * np.sum(pressed.pressure[counted])), float(deviation))


def read_load(load: PressureTrack, ratio: Array, bars: Bars | None, time: float) -> tuple[Pressure, Force]:
    """What presses on a frame's cells, and with which force in all.

    ratio : r/r_baseline (rows, columns). bars : of the estimate, or None. time : s.
    """
    pressed, barred = load.pressure(ratio, ratio, ratio, time), None
    if bars is not None and bars.change is not None:
        with np.errstate(over="ignore"):
            ends = ratio * np.exp(-bars.change.below), ratio * np.exp(bars.change.above)
            barred = load.pressure(ratio, *ends, time)
    return pressed, total_force(load.scene, pressed, barred)
