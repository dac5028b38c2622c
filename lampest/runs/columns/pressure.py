"""What presses on the cells, where there are error bars: without them nobody can say what the response tells."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lampest.loads.pressure import Pressure, pressure_of
from lampest.runs.columns.certainty import barred, ratio, ratio_lower, ratio_upper
from lampest.runs.columns.checks import not_negative, told_if_solved
from lampest.runs.columns.column import MAPS, Column

if TYPE_CHECKING:
    from lampest.estimate.sequence import Reconstruction


@lru_cache(maxsize=1)  # five columns follow from it
def _pressure(done: Reconstruction) -> Pressure:
    return pressure_of(ratio(done), ratio_lower(done), ratio_upper(done), done.recording.scene)


def _part(part: Callable[[Pressure], NDArray[Any]]) -> Callable[[Reconstruction], NDArray[Any] | None]:
    return barred(lambda done: part(_pressure(done)))


PRESSURE = (
    Column(
        "pressure",
        MAPS,
        "kPa",
        "pressure of the load on the cell",
        _part(lambda load: load.pressure),
        (told_if_solved,),
    ),
    Column(
        "pressure_errors",
        MAPS,
        "kPa",
        "standard deviation of the pressure",
        _part(lambda load: load.errors),
        (not_negative, told_if_solved),
    ),
    Column(
        "pressure_lower",
        MAPS,
        "kPa",
        "95 % interval, lower end",
        _part(lambda load: load.lower),
        (told_if_solved,),
    ),
    Column(
        "pressure_upper",
        MAPS,
        "kPa",
        "95 % interval, upper end",
        _part(lambda load: load.upper),
        (told_if_solved,),
    ),
    Column(
        "saturated",
        MAPS,
        "1",
        "1: the response does not tell the pressure",
        _part(lambda load: load.saturated),
        dtype=np.uint8,
    ),
)
