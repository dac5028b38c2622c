"""What is said of one case: errors, residuals, intervals, weights, times, and cells and frames not to be trusted."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.report.compare import data_error, relative_error
from lampest.report.page.interval import Interval
from lampest.report.page.statistics import block_length, mean_interval, median_interval, picks
from lampest.runs.case import CaseResult

MAD = 1.4826  # of a normal distribution, from median absolute deviation to standard deviation
SMALLEST = 1e-300  # ohm


@dataclass(frozen=True)
class Measures:
    """One case over its solved frames; None where the results do not say.

    Parameters
    ----------
    frames, solved, cells : number of frames, of solved ones, and of the cells in these.
    failures : (sentence, frame numbers) of the frames that failed.
    cell_error : median of |r − r_true|/r_true, percent. log_error : median of |ln(r/r_true)|, percent.
    data_error : mean of |model − measured|/measured over readings that are values, percent.
    misfit : mean square of (model − measured)/σ. spread : robust standard deviation of the same.
    width : mean of (upper − lower)/r of the 95 % intervals that have an end, percent. endless : how many have none.
    coverage : share of true values within their intervals, percent. free_coverage : of cells away from bounds.
    share : median share of an estimate that the data decide, percent.
    time : median time per frame, ms. open, low, saturated : so many cells.
    optima : how many frames end at a local optimum, and from how few and how many starts. missing, bounds : so many
    readings. pressure : smallest and largest, kPa.
    """

    frames: int
    solved: int
    cells: int
    failures: tuple[tuple[str, tuple[int, ...]], ...]
    cell_error: Interval | None
    data_error: float | None
    misfit: float | None
    spread: float | None
    width: float | None
    endless: int | None
    coverage: Interval | None
    free_coverage: Interval | None
    share: float | None
    weights: dict[str, Array]
    time: float | None
    open: int
    low: int
    saturated: int | None
    missing: int | None
    bounds: int | None
    pressure: tuple[float, float] | None
    optima: tuple[int, int, int] | None = None


@np.errstate(over="ignore")
def measures(case: CaseResult, generator: np.random.Generator) -> Measures:
    """Everything of one case; intervals from frames drawn in blocks."""
    good = case.solved
    failed = Counter(text for text, solved in zip(case.status, good, strict=True) if not solved)
    none = int(np.sum(good)) == 0
    error = None if none or case.truth is None else relative_error(case.cell_resistance, case.truth)[good]
    residual = None if none else weighted_residual(case)
    widths = None if none else _width(case)
    ended = None if widths is None else widths[good][np.isfinite(widths[good])]
    within = None if none else _within(case)
    free = (case.open_cell == 0) & (case.at_lower_bound == 0)
    return Measures(
        frames=len(good),
        solved=int(np.sum(good)),
        cells=int(case.measured[good].size),
        failures=tuple(
            (
                text,
                tuple(int(case.frame[at]) for at, status in enumerate(case.status) if status == text and not good[at]),
            )
            for text in failed
        ),
        cell_error=None if error is None else median_interval(_flat(error), _drawn(error, generator)),
        data_error=None if none else _mean(data_error(case)[good]),
        misfit=None if residual is None else _mean(residual[good] ** 2),
        spread=None if residual is None else MAD * float(np.nanmedian(np.abs(residual[good]))),
        width=None if ended is None or ended.size == 0 else float(np.mean(ended)),
        endless=None if ended is None else int(case.measured[good].size - ended.size),
        coverage=None if within is None else _share(within[good], np.ones(within[good].shape, bool), generator),
        free_coverage=None if within is None else _share(within[good], free[good], generator),
        share=None if none or case.data_share is None else 100 * float(np.median(case.data_share[good])),
        weights=case.weights,
        time=None if none else 1e3 * float(np.median(case.solve_time[good])),
        open=int(np.sum(case.open_cell[good] != 0)),
        low=int(np.sum(case.at_lower_bound[good] != 0)),
        saturated=None if case.saturated is None else int(np.sum(case.saturated[good] != 0)),
        missing=None if case.missing_readings is None else int(np.sum(case.missing_readings)),
        bounds=None if case.bound_readings is None else int(np.sum(case.bound_readings)),
        pressure=None
        if none or case.pressure is None
        else (float(np.min(case.pressure[good])), float(np.max(case.pressure[good]))),
        optima=case.local_optima,
    )


def log_error(case: CaseResult) -> Array:
    """100·|ln(r/r_true)|, (frames, rows, columns) percent; NaN where a frame failed. The case must know its truth."""
    assert case.truth is not None
    error: Array = 100 * np.abs(np.log(np.maximum(case.cell_resistance, SMALLEST) / case.truth))
    return error


def weighted_residual(case: CaseResult) -> Array | None:
    """(model − measured)/σ, (frames, rows, columns), NaN where a reading is no value; None where σ is unknown."""
    if case.sigma is None:
        return None
    residual: Array = (case.reading_model - case.measured) / case.sigma
    return np.asarray(np.where(case.valued, residual, np.nan))


def _width(case: CaseResult) -> Array | None:
    """100·(upper − lower)/r of the 95 % intervals, (frames, rows, columns) percent; infinite without an upper end."""
    if case.cell_resistance_lower is None or case.cell_resistance_upper is None:
        return None
    width: Array = 100 * (case.cell_resistance_upper - case.cell_resistance_lower) / case.cell_resistance
    return width


def _within(case: CaseResult) -> NDArray[np.bool_] | None:
    """Whether the truth lies in the interval, (frames, rows, columns)."""
    if case.truth is None or case.cell_resistance_lower is None or case.cell_resistance_upper is None:
        return None
    return (case.cell_resistance_lower <= case.truth) & (case.truth <= case.cell_resistance_upper)


def _share(within: NDArray[np.bool_], counted: NDArray[np.bool_], generator: np.random.Generator) -> Interval | None:
    """Mean over the frames of the share of the counted cells that are within, in percent."""
    cells = counted.sum(axis=(1, 2))
    if not np.all(cells):
        return None
    shares = 100 * (within & counted).sum(axis=(1, 2)) / cells
    return mean_interval(shares, picks(len(shares), block_length(shares[:, None]), generator))


def _mean(values: Array) -> float | None:
    """Of the numbers; None where there is none."""
    numbers = values[np.isfinite(values)]
    return float(numbers.mean()) if numbers.size else None


def _flat(values: Array) -> Array:
    return values.reshape(len(values), -1)


def _drawn(values: Array, generator: np.random.Generator) -> NDArray[np.intp]:
    """Draws of frames; their memory is that of their medians."""
    medians = np.median(_flat(values), axis=1)
    return picks(len(values), block_length(medians[:, None]), generator)
