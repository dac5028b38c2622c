"""Comparison of a board's own estimate with lampest's."""

from collections.abc import Iterator

import numpy as np

from lampest.files.errors import InputError, counted
from lampest.panel.panel import Array, Mask, Numbers
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.stored import joined
from lampest.report.words import digits
from lampest.runs.case import CaseResult

MAX_COMPARED = 12  # frames, evenly over the recording: some seconds


def board_rows(recording: Recording) -> Iterator[tuple[str, str]]:
    """Yield the row of `lampest info` about a board's own estimate.

    The row has its difference from lampest's default estimate. There is none without an estimate of
    the board.
    """
    if recording.board_log_change is None:
        return
    measured = recording.role == MEASURED
    estimated = measured & np.isfinite(recording.board_log_change).any(axis=(1, 2))
    count = f"the board estimated {np.sum(estimated)} of {np.sum(measured)} measured frames"
    unloaded = recording.role == UNLOADED
    if np.any(estimated):
        compared = "they are compared where unloaded frames precede them"
        if np.any(unloaded):
            try:
                compared = _difference(recording, unloaded, np.flatnonzero(estimated))
            except InputError as error:
                compared = f"not compared: {error}"
        count = f"{count}; {compared}"
    yield "board", count


def _difference(recording: Recording, unloaded: Mask, estimated: Numbers) -> str:
    """Return the difference in words. Raises InputError where lampest has no estimate."""
    # With all of the estimate, which results do without.
    from lampest.estimate.estimator import Estimator
    from lampest.estimate.sequence import default_terms
    from lampest.report.reconstruction import Reconstruction

    places = np.unique(np.linspace(0, len(estimated) - 1, MAX_COMPARED).round().astype(int))
    chosen = estimated[places]
    part = joined((recording,), np.union1d(np.flatnonzero(unloaded), chosen))
    assert recording.board_log_change is not None
    estimate = Reconstruction.of(part, Estimator(default_terms(part), "reduced"))
    return difference_sentence(estimate.result(), recording.board_log_change[chosen], chosen)


def difference_sentence(case: CaseResult, board_log_change: Array, frames: Numbers) -> str:
    """Return the difference of a board's cells from those of a case in words.

    Parameters
    ----------
    case : CaseResult
    board_log_change : array, shape (frames of the case, rows, columns)
        ln(r / r unloaded).
    frames : array, shape (frames of the case,)
        Their numbers in the recording.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = np.abs(
            board_log_change - np.log(case.cell_resistance / case.baseline_resistance)
        )
    difference[(case.open_cell | case.at_lower_bound) > 0] = np.nan
    size = difference
    unit = ""
    if case.sigma_own is not None:
        size = difference / np.where(case.sigma_own > 0, case.sigma_own, np.nan)
        unit = "; σ is a cell's own error"
    compared = np.isfinite(size)
    if not np.any(compared):
        return "no cell has both estimates"
    worst = np.unravel_index(np.nanargmax(np.where(compared, size, np.nan)), size.shape)

    def amount(share: float, log_difference: float) -> str:
        percent = f"{digits(100 * np.expm1(log_difference), 2)} %"
        return f"{digits(share, 2)} σ ({percent})" if unit else percent

    median = amount(*(float(np.median(part[compared])) for part in (size, difference)))
    largest = amount(size[worst], difference[worst])
    count = counted(len(case.frame), "frame")
    return (
        f"its cells differ from lampest's ({' + '.join(case.costs)}, {count}) "
        f"by {median} in the median, {largest} at most, in frame {frames[worst[0]]}{unit}"
    )
