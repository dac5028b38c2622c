"""What was fitted as the response that a scene holds."""

import numpy as np

from lampest.loads.calibration.fit import Fitted
from lampest.loads.response import TOLD_KPA
from lampest.panel.panel import Array
from lampest.panel.response import Response, Table, TableResponse

AN_OCTAVE = 3  # points of the table
LEAST_KPA = 0.25
DIGITS = 6
UNLOADED_OHM = 1000.0  # only what others are over it counts


def response_of(fitted: Fitted, base: Response | None, shape: tuple[int, int], tolerance: float) -> TableResponse:
    """Points from where the base curve begins to where it ends, densest about 0; gains of cells (rows, columns).

    tolerance : by which fraction all loads together may be off, evenly: σ = 1/√3 of it, of the curve.
    """
    low, high = TOLD_KPA if base is None else base.told_kpa
    pressure = np.concatenate([-_rising(-low)[::-1], [0.0], _rising(high)])
    logarithm, sd = np.zeros(len(pressure)), np.zeros(len(pressure))
    loaded = pressure != 0
    logarithm[loaded], sd[loaded] = fitted.curve(pressure[loaded], base)
    sd[~loaded] = np.interp(0.0, pressure[loaded], sd[loaded])
    sd = np.hypot(sd, tolerance / np.sqrt(3))
    gain, gain_sd = fitted.gain()
    return TableResponse(
        pressure_kpa=_significant(pressure),
        resistance_ohm=_significant(UNLOADED_OHM * np.exp(logarithm)),
        sd=_significant(sd, 3),
        gain=_table(gain, shape),
        gain_sd=_table(gain_sd, shape),
    )


def _rising(most: float) -> Array:
    """From LEAST_KPA to the most, in equal steps of the logarithm; none where the most is not above."""
    if most <= LEAST_KPA:
        return np.array([most] if most > 0 else [])
    return np.geomspace(LEAST_KPA, most, 1 + int(np.ceil(AN_OCTAVE * np.log2(most / LEAST_KPA))))


def _significant(values: Array, digits: int = DIGITS) -> tuple[float, ...]:
    """To so many significant digits."""
    return tuple(float(f"{value:.{digits}g}") for value in values)


def _table(values: Array, shape: tuple[int, int]) -> Table:
    return tuple(_significant(row, 4) for row in values.reshape(shape))
