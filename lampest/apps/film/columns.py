"""Columns of results with the pressures of loads.

Cases without error bars have none of them: the uncertainty of pressures requires error bars.
"""

import numpy as np

from lampest.runs.columns import FRAMES, MAPS, Check, Column, known_if_solved, not_negative


def _kpa(name: str, words: str, *checks: Check) -> Column:
    """Return a column of pressures, which are known where a frame is solved."""
    return Column(name, MAPS, "kPa", words, checks=(*checks, known_if_solved))


PRESSURE = _kpa("pressure", "pressure of the load on the cell")
ERRORS = _kpa("pressure_errors", "standard deviation of the pressure", not_negative)
OWN = _kpa(
    "pressure_own", "standard deviation of the pressure: each cell's own error", not_negative
)
COMMON = _kpa(
    "pressure_common",
    "standard deviation of the pressure: common error of all cells",
    not_negative,
)
LOWER = _kpa("pressure_lower", "95 % interval, lower end")
UPPER = _kpa("pressure_upper", "95 % interval, upper end")
SATURATED = Column(
    "saturated",
    MAPS,
    "1",
    "1: the response leaves the pressure open",
    dtype=np.uint8,
    flags=((0, "response_tells_pressure"), (1, "response_does_not_tell_pressure")),
)
PRESSING = Column(
    "pressing",
    MAPS,
    "1",
    "1: a load presses on the cell, beyond errors and what the film keeps of earlier loads",
    dtype=np.uint8,
    flags=((0, "no_load_presses"), (1, "load_presses")),
)
TARED = Column(
    "tared",
    FRAMES,
    "1",
    "why the zero of pressures was taken anew after the frame; empty: it was not",
    dtype=str,
)
