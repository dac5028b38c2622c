"""Total force of what presses on a panel: F = Σ p·pitch² over the pressed cells; suction is in no force."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.loads.pressure import water_pressure
from lampest.panel.panel import Array
from lampest.panel.scene import Scene

CLEAR = 3.0  # standard deviations: less than one cell of a panel of 700 seems to be pressed by noise alone
KPA_MM2 = 1e-3  # of one kPa on a square millimetre, newton


class Force(NamedTuple):
    """F and its standard deviation, newton, NaN where unknown; with saturated cells, so many, F is a lower bound."""

    newton: float
    deviation: float
    saturated: int = 0


def pressing_cells(scene: Scene, ratio: Array, deviation: Array | None, pressure: Array) -> NDArray[np.bool_]:
    """(…, rows, columns) unbroken cells with a pressure whose r/r0 fell by CLEAR deviations; None: they are unknown."""
    fallen = 1 - np.nan_to_num(ratio, nan=1.0)
    least = np.zeros(1) if deviation is None else CLEAR * np.nan_to_num(deviation, nan=np.inf, posinf=np.inf)
    return np.asarray((fallen > least) & (np.nan_to_num(pressure) > 0) & ~scene.broken)


def determined(scene: Scene, pressure: Array, errors: Array) -> tuple[Array, Array]:
    """p and its error, (…, rows, columns) kPa; p is at most what the response determines, without error there."""
    if scene.response is None:
        return pressure, errors
    most = scene.response.told_kpa[1] - water_pressure(scene.panel, scene.water)
    return np.minimum(pressure, most), np.where(pressure < most, errors, 0.0)


def total_force(
    scene: Scene, pressure: Array, pressed: NDArray[np.bool_], saturated: NDArray[np.bool_], errors: Array | None
) -> Force:
    """F of one frame, all (rows, columns). pressed : as `pressing_cells`. errors : kPa, independent, or None."""
    area = scene.panel.pitch_mm**2 * KPA_MM2
    kpa, sd = determined(scene, pressure, np.full(pressure.shape, np.nan) if errors is None else errors)
    deviation = np.nan if errors is None else float(area * np.sqrt(np.sum(sd[pressed] ** 2)))
    return Force(float(area * np.sum(kpa[pressed])), deviation, int(np.sum(saturated & pressed)))
