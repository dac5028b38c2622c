"""What is known of an estimate beyond its value; absent where the noise of the readings is unknown or nobody asked."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.runs.columns.checks import not_negative, told_if_solved
from lampest.runs.columns.column import CELLS, FRAMES, MAPS, Column, of_steps

if TYPE_CHECKING:
    from lampest.estimate.sequence import Reconstruction
    from lampest.estimate.step import Step
    from lampest.posterior.certainty import Certainty
    from lampest.posterior.track import Change


def barred(value: Callable[[Reconstruction], NDArray[Any]]) -> Callable[[Reconstruction], NDArray[Any] | None]:
    """`value` where there are error bars, the baseline's included; else nothing."""

    def if_barred(done: Reconstruction) -> NDArray[Any] | None:
        return value(done) if done.baseline_bars is not None and any(step.bars for step in done.steps) else None

    return if_barred


def ratio(done: Reconstruction) -> Array:
    """r/r0, (frames, rows, columns)."""
    return done.cell_resistance / done.baseline_resistance


def ratio_lower(done: Reconstruction) -> Array:
    """The lower end of its 95 % interval, same shape."""
    return ratio(done) * np.exp(-_of_changes(done, lambda change: change.below))


def ratio_upper(done: Reconstruction) -> Array:
    """The upper end of its 95 % interval, same shape."""
    return ratio(done) * np.exp(_of_changes(done, lambda change: change.above))


def _of_changes(done: Reconstruction, part: Callable[[Change], Array]) -> Array:
    """A part of what is known of log r/r0, (frames, rows, columns); infinite where an estimate has no error bars."""

    def values(step: Step) -> Array | None:
        return None if step.bars is None or step.bars.change is None else part(step.bars.change)

    return _stacked(done, values, np.inf)


def _of_frames(done: Reconstruction, part: Callable[[Certainty], Array], unbarred: float = np.inf) -> Array:
    """A part of what is known of log r, (frames, rows, columns); `unbarred` where an estimate has no error bars."""
    return _stacked(done, lambda step: None if step.bars is None else part(step.bars.frame), unbarred)


def _stacked(done: Reconstruction, values: Callable[[Step], Array | None], unbarred: float) -> Array:
    """NaN where a frame failed."""
    cells = done.cell_resistance
    maps = [values(step) for step in done.steps]
    stacked = np.stack([np.full(cells.shape[1:], unbarred) if one is None else one for one in maps])
    stacked[np.isnan(cells)] = np.nan
    return stacked


def _baseline_errors(done: Reconstruction) -> Array:
    assert done.baseline_bars is not None
    return done.baseline_resistance * done.baseline_bars.deviation


CERTAINTY = (
    Column(
        "cell_resistance_errors",
        MAPS,
        "ohm",
        "posterior standard deviation of the cell resistance",
        barred(lambda done: done.cell_resistance * _of_frames(done, lambda bars: bars.deviation)),
        (not_negative, told_if_solved),
    ),
    Column(
        "cell_resistance_lower",
        MAPS,
        "ohm",
        "95 % interval, lower end",
        barred(lambda done: done.cell_resistance * np.exp(-_of_frames(done, lambda bars: bars.below))),
        (told_if_solved,),
    ),
    Column(
        "cell_resistance_upper",
        MAPS,
        "ohm",
        "95 % interval, upper end",
        barred(lambda done: done.cell_resistance * np.exp(_of_frames(done, lambda bars: bars.above))),
        (told_if_solved,),
    ),
    Column(
        "relative_change_errors",
        MAPS,
        "percent",
        "posterior standard deviation of the relative change",
        barred(lambda done: 100 * ratio(done) * _of_changes(done, lambda change: change.deviation)),
        (not_negative, told_if_solved),
    ),
    Column(
        "relative_change_lower",
        MAPS,
        "percent",
        "95 % interval, lower end",
        barred(lambda done: 100 * (ratio_lower(done) - 1)),
        (told_if_solved,),
    ),
    Column(
        "relative_change_upper",
        MAPS,
        "percent",
        "95 % interval, upper end",
        barred(lambda done: 100 * (ratio_upper(done) - 1)),
        (told_if_solved,),
    ),
    Column(
        "resolution",
        MAPS,
        "1",
        "diagonal of the averaging kernel",
        barred(lambda done: _of_frames(done, lambda bars: bars.resolution, 0.0)),
        (told_if_solved,),
    ),
    Column(
        "data_share",
        MAPS,
        "1",
        "share of the estimate that comes from the data",
        barred(lambda done: _of_frames(done, lambda bars: bars.data_share, 0.0)),
        (told_if_solved,),
    ),
    Column(
        "error_bar_time",
        FRAMES,
        "s",
        "wall time of the error bars",
        barred(of_steps(lambda step: step.bars_seconds)),
    ),
    Column(
        "baseline_resistance_errors",
        CELLS,
        "ohm",
        "posterior standard deviation of the unloaded cell resistance",
        barred(_baseline_errors),
        (not_negative,),
    ),
)
