"""What is known of estimates beyond their values: the intervals of log r and of log r/r0, in ohm and percent."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lampest.estimate.step import Step
from lampest.panel.panel import Array
from lampest.posterior.track import Bars


@dataclass(frozen=True, eq=False)
class ErrorBars:
    """Standard deviations and 95 % intervals; NaN where a frame failed, infinite where an estimate has none.

    Parameters
    ----------
    cell_resistance_errors, cell_resistance_lower, cell_resistance_upper : (frames, rows, columns) ohm.
    relative_change_errors : (frames, rows, columns) percent. ratio_lower, ratio_upper : of r/r0, the same shape.
    resolution, data_share : (frames, rows, columns) diagonal and row sums of the averaging kernel; 0 without bars.
    """

    cell_resistance_errors: Array
    cell_resistance_lower: Array
    cell_resistance_upper: Array
    relative_change_errors: Array
    ratio_lower: Array
    ratio_upper: Array
    resolution: Array
    data_share: Array

    @classmethod
    def of(cls, cells: Array, baseline: Array, steps: tuple[Step, ...]) -> "ErrorBars":
        """σ_r = r·σ(log r), and r·exp(−below) to r·exp(above).

        cells : (frames, rows, columns) ohm. baseline : (rows, columns) ohm. steps : how the frames were solved.
        """
        ratio = cells / baseline

        def frames(part: Callable[[Bars], Array | None], unbarred: float = np.inf) -> Array:
            maps = [None if step.bars is None else part(step.bars) for step in steps]
            stacked = np.stack([np.full(baseline.shape, unbarred) if one is None else one for one in maps])
            stacked[np.isnan(cells)] = np.nan
            return stacked

        with np.errstate(over="ignore"):  # a cell of which nothing is known reaches to infinity
            return cls(
                cells * frames(lambda bars: bars.frame.deviation),
                cells * np.exp(-frames(lambda bars: bars.frame.below)),
                cells * np.exp(frames(lambda bars: bars.frame.above)),
                100 * ratio * frames(lambda bars: None if bars.change is None else bars.change.deviation),
                ratio * np.exp(-frames(lambda bars: None if bars.change is None else bars.change.below)),
                ratio * np.exp(frames(lambda bars: None if bars.change is None else bars.change.above)),
                frames(lambda bars: bars.frame.resolution, 0.0),
                frames(lambda bars: bars.frame.data_share, 0.0),
            )
