"""Total force of what presses on a panel: F = Σ p·pitch² over the pressed cells; suction is in no force."""

from typing import NamedTuple

import numpy as np

from lampest.loads.pressure import Pressure, water_pressure
from lampest.panel.panel import Array
from lampest.panel.scene import Scene

KPA_MM2 = 1e-3  # of one kPa on a square millimetre, newton


class Force(NamedTuple):
    """F and its standard deviation, newton, NaN where unknown; with saturated cells, so many, F is a lower bound."""

    newton: float
    deviation: float
    saturated: int = 0


def determined(scene: Scene, pressure: Array, *errors: Array) -> tuple[Array, ...]:
    """p and its errors, (…, rows, columns) kPa; p is at most what the response determines, without error there."""
    if scene.response is None:
        return pressure, *errors
    most = scene.response.told_kpa[1] - water_pressure(scene.panel, scene.water)
    return np.minimum(pressure, most), *(np.where(pressure < most, error, 0.0) for error in errors)


def sum_sd(weight: Array | float, own: Array, common: Array) -> float:
    """√(Σ (w·own)² + (Σ w·common)²): standard deviation of Σ w·p over cells (n), whose common errors move together."""
    return float(np.hypot(np.sqrt(np.sum((weight * own) ** 2)), np.sum(weight * common)))


def total_force(scene: Scene, load: Pressure) -> Force:
    """F of one frame."""
    area, pressed = scene.panel.pitch_mm**2 * KPA_MM2, load.pressing != 0
    kpa, own, common = (one[pressed] for one in determined(scene, load.pressure, load.own, load.common))
    return Force(float(area * kpa.sum()), sum_sd(area, own, common), int(np.sum((load.saturated != 0) & pressed)))
