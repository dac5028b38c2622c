"""What presses on the cells, where there are error bars: without them nobody can say what the response tells."""

import numpy as np

from lampest.runs.columns.checks import not_negative, told_if_solved
from lampest.runs.columns.column import FRAMES, MAPS, Column

PRESSURE = (
    Column(
        "pressure",
        MAPS,
        "kPa",
        "pressure of the load on the cell",
        lambda done: done.pressure,
        (told_if_solved,),
    ),
    Column(
        "pressure_errors",
        MAPS,
        "kPa",
        "standard deviation of the pressure",
        lambda done: done.pressure_errors,
        (not_negative, told_if_solved),
    ),
    Column(
        "pressure_lower",
        MAPS,
        "kPa",
        "95 % interval, lower end",
        lambda done: done.pressure_lower,
        (told_if_solved,),
    ),
    Column(
        "pressure_upper",
        MAPS,
        "kPa",
        "95 % interval, upper end",
        lambda done: done.pressure_upper,
        (told_if_solved,),
    ),
    Column(
        "saturated",
        MAPS,
        "1",
        "1: the response does not tell the pressure",
        lambda done: done.saturated,
        dtype=np.uint8,
        flags=((0, "response_tells_pressure"), (1, "response_does_not_tell_pressure")),
    ),
    Column(
        "tared",
        FRAMES,
        "1",
        "why the zero of pressures was taken anew after the frame; empty: it was not",
        lambda done: done.tared,
        dtype=str,
    ),
)
