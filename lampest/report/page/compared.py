"""Estimators against each other: by which criterion, how far apart with bootstrap intervals, and which to take."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lampest.panel.panel import Array
from lampest.report.compare import weighted_residual
from lampest.report.page import measures
from lampest.report.page.batch import Batch, Matched, first_of, matched
from lampest.report.page.measures import between, weights_text
from lampest.report.words import counted, digits, listed
from lampest.runs.case import CaseResult


@dataclass(frozen=True)
class Standing:
    """An estimator's mean over the units, and how it differs from the smallest of all, in pairs.

    wins : units in which none is smaller.
    """

    estimator: str
    mean: measures.Interval
    difference: measures.Interval
    wins: int

    @property
    def told_apart(self) -> bool:
        """Whether the interval of the difference excludes zero."""
        return not self.difference.lower <= 0 <= self.difference.upper


@dataclass(frozen=True)
class Criterion:
    """What estimators are ranked by; smaller is better.

    name : fits 'the smallest …'. unit : of the figure. meaning : how it is defined. per_cell : (frames, rows, columns)
    of a case. average : over cells and frames.
    """

    name: str
    unit: str
    meaning: str
    per_cell: Callable[[CaseResult], Array]
    average: Callable[..., Any]

    @property
    def difference_unit(self) -> str:
        return "percentage points" if self.unit == "%" else self.unit


@dataclass(frozen=True, eq=False)
class Comparison:
    """Estimators in pairs.

    units : names of recordings, or of the frames of a single one. values : (units, estimators of the match), smaller is
    better. block : so many neighbouring units are drawn together, 1 for recordings. standings : best first.
    milliseconds : median time per frame, geometric mean over the units.
    """

    criterion: Criterion
    match: Matched
    units: tuple[str, ...]
    values: Array
    block: int
    standings: tuple[Standing, ...]
    milliseconds: Mapping[str, float]

    @property
    def over_frames(self) -> bool:
        return len(self.match.recordings) == 1


def predicted(case: CaseResult) -> Array:
    """Mallows' C: min(z², 25) + 2·resolution with z = (model − measured)/σ, (frames, rows, columns), unit 1.

    Its mean is what fresh readings are expected to deviate from the model by, squared, in units of σ²: 1 for a model
    that is right, 2 for one that follows every reading. The trace of the averaging kernel is that of the readings'
    influence on their own prediction. Outliers count as five σ, lest a few of them decide. Source: Mallows,
    Technometrics 15, 1973.
    """
    residual = weighted_residual(case)
    assert residual is not None and case.resolution is not None
    return np.asarray(np.minimum(residual**2, 25.0) + 2 * case.resolution)


CELL_ERROR = Criterion(
    "error of the cells",
    "%",
    "100·|ln(r/r_true)|, its median over cells and frames; the truth is known",
    measures.log_error,
    np.median,
)
PREDICTION = Criterion(
    "prediction error",
    "σ²",
    "expected squared deviation of new readings from those of the estimated cells, in units of their variance "
    "(Mallows' C); the truth is unknown",
    predicted,
    np.nanmean,
)


def compared(batch: Batch, generator: np.random.Generator) -> Comparison | None:
    """The comparison by the best criterion that the results allow.

    Truth first: the recordings that know theirs. Else the prediction of fresh readings, which needs their noise and
    the resolution. None where neither is known, for a data error grows with every penalty, good or bad; or where no two
    estimators share a frame.
    """
    known = {name: cases for name, cases in batch.recordings.items() if first_of(cases).truth is not None}
    match = matched(known or batch.recordings)
    cases = [case for name in match.estimators for case in match.cases(name)]
    predictable = all(case.sigma is not None and case.resolution is not None for case in cases)
    if len(match.estimators) < 2 or not match.recordings or not (known or predictable):
        return None
    criterion = CELL_ERROR if known else PREDICTION
    single, units = len(match.recordings) == 1, tuple(match.recordings)
    if single:
        units = tuple(f"frame {number}" for number in cases[0].frame[match.chosen[0]])
    values = _values(match, criterion.per_cell, criterion.average)
    block = measures.block_length(values) if single else 1
    standings = _standings(match.estimators, values, measures.picks(len(values), block, generator.spawn(1)[0]))
    times = np.exp(_values(match, lambda case: np.log(np.fmax(1e3 * case.solve_time, 1e-3)), np.median).mean(axis=0))
    milliseconds = dict(zip(match.estimators, times.tolist(), strict=True))
    return Comparison(criterion, match, units, values, block, standings, milliseconds)


def _values(match: Matched, per_cell: Callable[[CaseResult], Array], average: Callable[..., Any]) -> Array:
    """(units, estimators) averages over the cells of the matched frames: of recordings, or frames of a single one."""
    columns = []
    for name in match.estimators:
        pairs_of = zip(match.cases(name), match.chosen, strict=True)
        chosen = [per_cell(case)[frames].reshape(int(np.sum(frames)), -1) for case, frames in pairs_of]
        single = average(chosen[0], axis=1)
        columns.append(single if len(chosen) == 1 else np.array([average(part) for part in chosen]))
    return np.stack(columns, axis=1)


def _standings(estimators: Sequence[str], values: Array, drawn: measures.Picks) -> tuple[Standing, ...]:
    """Every estimator against the one with the smallest mean, that one first; all are drawn together, so in pairs."""
    order = np.argsort(values.mean(axis=0), kind="stable")
    wins, rows = np.sum(values == values.min(axis=1, keepdims=True), axis=0), []
    for one in order:
        own, best = values[:, one], values[:, order[0]]
        intervals = measures.mean_interval(own, drawn), measures.mean_interval(own - best, drawn)
        rows.append(Standing(estimators[one], *intervals, int(wins[one])))
    return tuple(rows)


@dataclass(frozen=True)
class Advice:
    """headline : what to take, or that nothing decides. reasons, warnings : sentences. estimator : None if open."""

    estimator: str | None
    headline: str
    reasons: tuple[str, ...]
    warnings: tuple[str, ...]


def advise(batch: Batch, comparison: Comparison | None) -> Advice:
    """Error first, then time: of those with practically the smallest criterion the fastest.

    Practically the same is what lies within a twentieth of the smallest one, however sure that difference is; one that
    is larger is not made up for by speed.
    """
    match = comparison.match if comparison else matched(batch.recordings)
    left_out = tuple(f"Not compared: {sentence}." for sentence in match.left_out)
    if comparison is None:
        headline = "These results cannot rank the estimators."
        alone = "No two estimators solved the same frames."
        if len(match.estimators) > 1 and match.recordings:
            alone = "A ranking needs the true cells, or the noise of the readings and the resolution. Neither is known."
        return Advice(None, headline, (alone,), left_out)
    warnings = (*_few(comparison), *left_out)
    best = comparison.standings[0]
    # Nobody sees less in a map or a force.
    alike = [row for row in comparison.standings if row.mean.value <= (1 + 0.05) * best.mean.value]
    taken = min(alike, key=lambda row: comparison.milliseconds[row.estimator])
    if comparison.milliseconds[best.estimator] < 1.1 * comparison.milliseconds[taken.estimator]:  # nobody notices less
        taken = best
    weights = weights_text([case.weights for case in comparison.match.cases(taken.estimator)])
    named = f"{taken.estimator}{f' ({weights})' if weights else ''}"
    headline = f"On these data take {named}."
    if len(alike) > 1:
        why = "has the smallest error" if taken is best else "is the fastest"
        names = listed([row.estimator for row in alike])
        headline = f"No practical difference between {names}; {named} {why} of them."
    return Advice(taken.estimator, headline, tuple(_reasons(comparison, taken, alike)), warnings)


def _reasons(comparison: Comparison, taken: Standing, alike: Sequence[Standing]) -> Iterator[str]:
    best, criterion, units = comparison.standings[0], comparison.criterion, len(comparison.units)
    points = criterion.difference_unit
    basis = f"mean over {counted(units, 'recording')} with {counted(comparison.match.frames, 'frame')}"
    if comparison.over_frames:
        basis = f"mean over {counted(units, 'frame')} of one recording, drawn in blocks of {comparison.block}"
    yield f"{best.estimator} has the smallest {criterion.name}: {between(best.mean, criterion.unit)}, {basis}."
    others = [f"{row.estimator} ({between(row.difference, points, '+')})" for row in alike if row is not best]
    if others:
        yield f"Within 5 % of it: {listed(others)}."
    if taken is not best:
        slow, fast = (digits(comparison.milliseconds[row.estimator], 2) for row in (best, taken))
        yield f"{taken.estimator} takes {fast} ms a frame, {best.estimator} {slow} ms."
    worse = [row for row in comparison.standings if row not in alike]
    if worse:
        texts = [f"{row.estimator} by {between(row.difference, sign='+')}" for row in worse]
        yield f"The error is larger, in {points}, with {listed(texts)}."
    for row in worse:
        if not row.told_apart:
            ends = f"95 % interval {digits(row.difference.lower)} to {digits(row.difference.upper)} {points}"
            yield f"The difference between {row.estimator} and {best.estimator} is not significant ({ends})."
    if criterion is PREDICTION:
        yield (
            "The truth is unknown. The ranking uses the error with which new readings would be predicted, which "
            "depends on the noise that the results state."
        )


def _few(comparison: Comparison) -> Iterator[str]:
    if comparison.over_frames:
        yield "One recording only: the intervals describe its frames, not other subjects or days."
    if len(comparison.units) < 5:
        noun = counted(len(comparison.units), "frame" if comparison.over_frames else "recording")
        yield f"{noun} only: intervals from fewer than 5 are unreliable, usually too short."


def doubts(estimator: str, found: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """What is wrong with the recommended estimator: residuals beyond the noise, error bars that are wrong.

    found : its `figures` of each recording.
    """
    lines = measures.SPREAD, measures.COVERED
    spreads, coverages = ([own[line] for own in found if own.get(line) is not None] for line in lines)
    spread, coverage = float(np.median(spreads or [1.0])), float(np.mean(coverages or [100.0]))
    sentences = []
    if spread > 1.5:
        sentences.append(
            f"The residuals of {estimator} are {digits(spread, 2)} times the noise of the readings: the noise is "
            "larger than the scene states, an effect is missing in the model, or the penalty is too strong."
        )
    if coverage < 90:
        sentences.append(
            f"The 95 % intervals of {estimator} contain the truth for {digits(coverage, 2)} % of the cells: an effect "
            "is missing in the scene, or the penalty does not suit these loads."
        )
    return tuple(sentences)
