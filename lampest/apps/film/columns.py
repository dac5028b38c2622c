"""Columns of results with the pressures of loads.

Cases without error bars have none of them: the uncertainty of pressures requires error bars.
"""

import numpy as np

from lampest.runs.columns import FRAMES, MAPS, Column, known_if_solved, not_negative

DEVIATION = (not_negative, known_if_solved)
PRESSURE = Column(
    "pressure", MAPS, "kPa", "pressure of the load on the cell", checks=(known_if_solved,)
)
ERRORS = Column(
    "pressure_errors", MAPS, "kPa", "standard deviation of the pressure", checks=DEVIATION
)
OWN = Column(
    "pressure_own",
    MAPS,
    "kPa",
    "standard deviation of the pressure: each cell's own error",
    checks=DEVIATION,
)
COMMON = Column(
    "pressure_common",
    MAPS,
    "kPa",
    "standard deviation of the pressure: common error of all cells",
    checks=DEVIATION,
)
LOWER = Column("pressure_lower", MAPS, "kPa", "95 % interval, lower end", checks=(known_if_solved,))
UPPER = Column("pressure_upper", MAPS, "kPa", "95 % interval, upper end", checks=(known_if_solved,))
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
