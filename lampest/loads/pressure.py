"""Pressure of a load on every cell, from the cell's resistance over its unloaded one; and the water's pressure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.loads.response import RESPONSE_SD, TOLD_KPA, VACUUM_KPA, pressure_from_logarithm, ratio_from_pressure
from lampest.panel.hidden import usual
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene, Water

GRAVITY = 9.81
KPA_PER_MM_OF_WATER = 1e-6 * 1000 * GRAVITY
NORMAL_95 = 1.959964  # half the 95 % interval of a normal distribution, in standard deviations


@dataclass(frozen=True, eq=False)
class Pressure:
    """What presses on the cells or sucks at them, against the surroundings: without the pressure of the water.

    Parameters
    ----------
    pressure : (frames, rows, columns) kPa; NaN where the estimate is.
    lower, upper : ends of the 95 % interval, kPa. `lower` is never below an empty space; `upper` may be infinite.
    errors : half the 68 % interval, kPa: one standard deviation where the response is straight.
    saturated : 1 where the response does not tell the pressure: the interval reaches beyond 40 kPa, where the curve is
        flat, or below −10 kPa, where there is none (on the film, water included). The value is still the best one, but
        not to be trusted, and an end beyond even less. Without any error of the estimate this begins at 31 kPa; the
        paper calls the response "largely saturated" above 28.
    """

    pressure: Array
    lower: Array
    upper: Array
    errors: Array
    saturated: NDArray[np.uint8]


def pressure_of(ratio: Array, lower: Array, upper: Array, scene: Scene) -> Pressure:
    """p = f⁻¹(f(p_w)·e^x) − p_w with x = ln(r/r_baseline) − α (T − T_b), (frames, rows, columns) kPa.

    The interval's ends are those of x, mapped like x itself: f is monotone. Three errors are added in quadrature:
    that of the estimate (each side its own), |T − T_b|·σ_α, and for the scatter of the cells' response
    `response_sd`·|x| of the scene's systematic errors, RESPONSE_SD·|x| where it names none.
    A cell at its baseline has none of the last: f(0) = 1 by definition.

    Parameters
    ----------
    ratio : (frames, rows, columns) r/r_baseline; NaN where a frame failed.
    lower, upper : ends of its 95 % interval; 0 and infinity where that is open, `ratio` itself at a bound.
    scene : panel, and water and temperature where it names them; the water stood there in the unloaded frames too.

    Raises ValueError where shapes disagree, a ratio is not positive and finite, or lies outside its interval.
    """
    _check(ratio, lower, upper, scene.panel)
    water = water_pressure(scene.panel, scene.water)
    warming, warming_sd = 0.0, 0.0
    if scene.temperature is not None:
        warming = scene.temperature.logarithm
        warming_sd = abs(scene.temperature.difference_kelvin) * scene.temperature.coefficient_sd_per_kelvin
    change = np.log(ratio) - warming
    errors_named = usual(scene)
    scatter = RESPONSE_SD if errors_named is None or errors_named.response_sd is None else errors_named.response_sd
    shared = NORMAL_95 * np.hypot(scatter * change, warming_sd)
    with np.errstate(divide="ignore"):
        below = np.hypot(np.log(ratio) - np.log(lower), shared)
        above = np.hypot(np.log(upper) - np.log(ratio), shared)

    def on_film(logarithm: Array) -> Array:
        return np.maximum(pressure_from_logarithm(np.log(ratio_from_pressure(water)) + logarithm), VACUUM_KPA)

    least, most = on_film(change + above), on_film(change - below)
    errors = (on_film(change - below / NORMAL_95) - on_film(change + above / NORMAL_95)) / 2
    saturated = (least < TOLD_KPA[0]) | (most > TOLD_KPA[1])
    return Pressure(on_film(change) - water, least - water, most - water, errors, saturated.astype(np.uint8))


def water_pressure(panel: Panel, water: Water | None) -> Array:
    """p_w = ρ g (depth + j·pitch) of row j, (rows, columns) kPa; zero without water."""
    if water is None:
        return np.zeros(panel.shape)
    depth = water.top_row_depth_mm + panel.centres_mm()[1]
    return np.repeat(KPA_PER_MM_OF_WATER * depth[:, None], panel.columns, axis=1)


def _check(ratio: Array, lower: Array, upper: Array, panel: Panel) -> None:
    if ratio.shape[1:] != panel.shape or not ratio.shape == lower.shape == upper.shape:
        raise ValueError("ratio, lower and upper must all be frames × rows × columns of the scene's panel")
    number = np.isfinite(ratio) & (ratio > 0) & (lower >= 0) & (lower <= ratio) & (upper >= ratio)
    if not np.all(number | (np.isnan(ratio) & np.isnan(lower) & np.isnan(upper))):
        raise ValueError("a resistance over its unloaded value must be positive, finite and within its interval")
