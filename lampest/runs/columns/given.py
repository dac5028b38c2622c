"""What every estimate of a recording was given: its frames, the readings with their noise, and the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lampest.panel.panel import Array
from lampest.recording.recording import UNLOADED
from lampest.runs.columns.checks import finite, positive, positive_or_infinite, positive_or_missing
from lampest.runs.columns.column import CELLS, FRAMES, MAPS, Column

if TYPE_CHECKING:
    from lampest.estimate.estimates import Estimates


def _truth(estimates: Estimates) -> Array | None:
    truth = estimates.recording.truth_cell_resistance
    return None if truth is None else truth[estimates.frame]


def _truth_baseline(estimates: Estimates) -> Array | None:
    truth = estimates.recording.truth_cell_resistance
    unloaded = estimates.recording.role == UNLOADED
    return truth[unloaded].mean(axis=0) if truth is not None and np.any(unloaded) else None


TIME = Column(
    "time",
    FRAMES,
    "s",
    "time of the frame",
    lambda done: done.time,
    (finite,),
    shared=True,
)
FRAME = Column(
    "frame",
    FRAMES,
    "1",
    "index of the frame in the recording",
    lambda done: done.frame if done.recording.number is None else done.recording.number[done.frame],
    dtype=np.int64,
    shared=True,
)
MEASURED = Column(
    "measured",
    MAPS,
    "ohm",
    "measured two-point resistance, series taken off; NaN where a reading says nothing",
    lambda done: done.measured,
    (positive_or_missing,),
    dataset="resistance",
    shared=True,
    as_volt=("volt", "measured voltage, as the network is read"),
)
GIVEN = (
    TIME,
    FRAME,
    MEASURED,
    Column(
        "measured_baseline",
        CELLS,
        "ohm",
        "mean of the unloaded frames, series taken off",
        lambda done: done.measured_baseline,
        (positive_or_missing,),
        dataset="baseline",
        shared=True,
        as_volt=("baseline", "mean of the unloaded frames"),
    ),
    Column(
        "sigma",
        MAPS,
        "ohm",
        "standard deviation of the measured two-point resistance",
        lambda done: done.sigma,
        (positive_or_infinite,),
        shared=True,
        as_volt=("sigma", "standard deviation of the measured voltage"),
    ),
    Column(
        "sigma_baseline",
        CELLS,
        "ohm",
        "standard deviation of the baseline",
        lambda done: done.sigma_baseline,
        (positive_or_infinite,),
        shared=True,
        as_volt=("sigma_baseline", "standard deviation of the baseline"),
    ),
    Column(
        "reading_side",
        MAPS,
        "1",
        "0: a value; a bound: 1 the truth is at least this, -1 at most",
        lambda done: done.readings.side,
        dtype=np.int8,
        shared=True,
        flags=((-1, "truth_is_at_most_this"), (0, "value"), (1, "truth_is_at_least_this")),
    ),
    Column(
        "missing_readings",
        FRAMES,
        "1",
        "readings that say nothing",
        lambda done: done.missing_readings,
        dtype=np.int64,
        shared=True,
    ),
    Column(
        "bound_readings",
        FRAMES,
        "1",
        "readings at a rail, zero, or below the series resistance",
        lambda done: done.bound_readings,
        dtype=np.int64,
        shared=True,
    ),
    Column("truth", MAPS, "ohm", "true cell resistance", _truth, (positive,), shared=True),
    Column(
        "truth_baseline", CELLS, "ohm", "mean true unloaded cell resistance", _truth_baseline, (positive,), shared=True
    ),
)
