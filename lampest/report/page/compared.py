"""All estimators of a batch against each other: by which criterion, how far apart, how fast."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lampest.panel.panel import Array
from lampest.report.compare import data_error
from lampest.report.page.batch import Batch, Matched, matched
from lampest.report.page.measures import log_error, weighted_residual
from lampest.report.page.statistics import Pair, Scores, Standing, pairs, score, standings
from lampest.runs.case import CaseResult

OUTLIER = 5.0
SHORTEST_MS = 1e-3


@dataclass(frozen=True)
class Criterion:
    """What estimators are ranked by; smaller is better.

    name : fits 'the smallest …'. unit, difference_unit : of the figure and of a difference. meaning : how it is
    defined. decides : whether a smaller figure is evidence of a better estimate. per_cell : (frames, rows, columns) of
    a case. average : over cells and frames.
    """

    name: str
    unit: str
    difference_unit: str
    meaning: str
    decides: bool
    per_cell: Callable[[CaseResult], Array]
    average: Callable[..., Any]


@dataclass(frozen=True, eq=False)
class Comparison:
    """standings : by the criterion, best first. times : by time per frame, fastest first, in ln(ms)."""

    criterion: Criterion
    match: Matched
    scores: Scores
    standings: tuple[Standing, ...]
    pairs: tuple[Pair, ...]
    speed: Scores
    times: tuple[Standing, ...]

    def milliseconds(self, estimator: str) -> float:
        """Geometric mean over the units of the median time per frame."""
        return float(np.exp(self.speed.values[:, self.speed.estimators.index(estimator)].mean()))


def predicted(case: CaseResult) -> Array:
    """Mallows' C: min(z², 25) + 2·resolution with z = (model − measured)/σ, (frames, rows, columns), unit 1.

    Its mean is what fresh readings are expected to deviate from the model by, squared, in units of σ²: 1 for a model
    that is right, 2 for one that follows every reading. The trace of the averaging kernel is that of the readings'
    influence on their own prediction. Outliers count as five σ, lest a few of them decide. Source: Mallows,
    Technometrics 15, 1973.
    """
    residual, resolution = weighted_residual(case), case.resolution
    assert residual is not None and resolution is not None
    deviation: Array = np.minimum(residual**2, OUTLIER**2) + 2 * resolution
    return deviation


def _absolute_residual(case: CaseResult) -> Array:
    residual = weighted_residual(case)
    assert residual is not None
    return np.abs(residual)


CELL_ERROR = Criterion(
    "error of the cells",
    "%",
    "percentage points",
    "100·|ln(r/r_true)|, its median over cells and frames; the truth is known",
    True,
    log_error,
    np.median,
)
PREDICTION = Criterion(
    "prediction error",
    "σ²",
    "σ²",
    "what fresh readings are expected to deviate by from those of the estimated cells, squared and in units of their "
    "noise (Mallows' C); the truth is unknown",
    True,
    predicted,
    np.nanmean,
)
WEIGHTED = Criterion(
    "data error",
    "σ",
    "σ",
    "|model − measured|/σ, its median over readings and frames",
    False,
    _absolute_residual,
    np.nanmedian,
)
DATA_ERROR = Criterion(
    "data error",
    "%",
    "percentage points",
    "100·|model − measured|/measured, its median over readings and frames",
    False,
    data_error,
    np.nanmedian,
)


def compared(batch: Batch, generator: np.random.Generator) -> Comparison | None:
    """The comparison by the best criterion that the results allow; None where no two estimators share a frame.

    Truth first: the recordings that know theirs. Else the prediction of fresh readings, which needs their noise and
    the resolution. Else the data error, which does not decide.
    """
    known = [subject for subject in batch.subjects if subject.cases[0].truth is not None]
    match = matched(known or batch.subjects)
    if len(match.estimators) < 2 or not match.subjects:
        return None
    criterion = CELL_ERROR if known else _without_truth(match)
    scores = score(match, criterion.per_cell, criterion.average)
    speed = score(match, _log_milliseconds, np.median)
    drawn = generator.spawn(3)
    return Comparison(
        criterion,
        match,
        scores,
        standings(scores, drawn[0]),
        pairs(scores, drawn[1]),
        speed,
        standings(speed, drawn[2]),
    )


def _without_truth(match: Matched) -> Criterion:
    cases = [case for name in match.estimators for case in match.cases(name)]
    if any(case.sigma is None for case in cases):
        return DATA_ERROR
    return WEIGHTED if any(case.resolution is None for case in cases) else PREDICTION


def _log_milliseconds(case: CaseResult) -> Array:
    milliseconds: Array = np.log(np.fmax(1e3 * case.solve_time, SHORTEST_MS))
    return milliseconds
