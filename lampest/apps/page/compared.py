"""Comparison of estimators by a criterion with intervals of its mean, and a recommendation."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError, counted
from lampest.panel.panel import Array
from lampest.report.compare import weighted_residual
from lampest.report.words import digits, listed, median_text
from lampest.runs.case import CaseResult, Cases
from lampest.runs.results import Reader, read_results

# Successive parts of a recording whose means are taken as independent. Intervals of 20, 60 and 200
# frames of an autoregression with 0.8 hold the mean in 77, 91 and 94 %, with parts as long as the
# correlation in 71, 80 and 81 %.
MAX_PARTS = 5
# Below three, an interval of a mean is 12.7 standard errors to each side.
MIN_RECORDINGS = 3
MIN_SOLVED = 0.95  # share of its frames that an estimator has to solve to be compared
# Relative differences of the mean error up to this are invisible in maps and forces.
SIMILAR = 0.05
NONE = "–"
HARD = "\N{NO-BREAK SPACE}"
Texts = tuple[str, ...]
Recordings = Mapping[str, Mapping[str, CaseResult]]  # name → estimator → case


@dataclass(frozen=True, eq=False)
class Batch:
    """Cases of one or several results files; `sources` are their names."""

    sources: Texts
    recordings: Recordings

    @classmethod
    def of(cls, sources: Sequence[str], cases: Cases) -> "Batch":
        """Group cases by recording; no two have the same names."""
        recordings: dict[str, dict[str, CaseResult]] = {}
        for case in cases:
            recordings.setdefault(case.recording, {})[case.estimator] = case
        return cls(tuple(sources), recordings)

    @property
    def estimators(self) -> Texts:
        """Names in order, each once."""
        return tuple(dict.fromkeys(name for cases in self.recordings.values() for name in cases))

    @property
    def frames(self) -> int:
        """Number of frames."""
        return sum(len(first_of(cases).time) for cases in self.recordings.values())


@dataclass(frozen=True, eq=False)
class Matched:
    """Estimators that can be compared on the same frames of the same recordings.

    Attributes
    ----------
    estimators : tuple of str
    recordings : mapping
        Name → estimator → case.
    chosen : tuple of boolean array, shape (frames,)
        Frames of each recording that all estimators solved.
    left_out : tuple of str
        Sentences on estimators and recordings that are not compared.
    """

    estimators: Texts
    recordings: Recordings
    chosen: tuple[NDArray[np.bool_], ...]
    left_out: Texts

    @property
    def frames(self) -> int:
        """Number of compared frames."""
        return int(sum(np.sum(frames) for frames in self.chosen))

    def cases(self, estimator: str) -> list[CaseResult]:
        """Return the cases of an estimator, one for each recording."""
        return [cases[estimator] for cases in self.recordings.values()]


def first_of(cases: Mapping[str, CaseResult]) -> CaseResult:
    """Return a case of a recording, for the measurement that all of them share."""
    return next(iter(cases.values()))


def read_batch(paths: Sequence[Path], read: Reader = read_results) -> Batch:
    """Return the cases of all files, each read by a function of its path, grouped by recording.

    If two files use a name for different cases, the number of the file is added: 'LSM [2]'. Raises
    InputError for unreadable, repeated and empty files.
    """
    if len({path.resolve() for path in paths}) < len(paths):
        raise InputError("a results file is named twice")
    cases = list[CaseResult]()
    for number, path in enumerate(paths, 1):
        cases += [_renamed(case, cases, number) for case in read(path).cases]
    if not cases:
        raise InputError(f"{', '.join(map(str, paths))}: no results to report")
    return Batch.of(list(map(str, paths)), cases)


def _renamed(case: CaseResult, before: Cases, number: int) -> CaseResult:
    """Return the case under names that no earlier case has."""
    same_name = [earlier for earlier in before if earlier.recording == case.recording]
    names = ("frame", "time", "measured", "measured_baseline", "truth", "truth_baseline")
    for earlier, name in product(same_name[:1], names):
        ours = getattr(case, name)
        theirs = getattr(earlier, name)
        equal_nan = ours is not None and theirs is not None
        if not np.array_equal(ours, theirs, equal_nan=equal_nan):  # another measurement
            return replace(case, recording=f"{case.recording} [{number}]")
    if any(earlier.estimator == case.estimator for earlier in same_name):
        return replace(case, estimator=f"{case.estimator} [{number}]")
    return case


def without_copies(recordings: Recordings) -> tuple[Recordings, list[str]]:
    """Return the recordings without copies, whose frames would count twice.

    In a copy, more than half of the frames have the readings of an earlier recording in single
    precision.

    Returns
    -------
    recordings : dict
        Recordings that are no copies.
    sentences : list of str
        One sentence on each copy.
    """
    frames_of: dict[str, set[bytes]] = {}
    copies = list[str]()
    for name, cases in recordings.items():
        frames = [
            np.float32(frame).tobytes()
            for frame in first_of(cases).measured
            if np.isfinite(frame).any()
        ]
        for original, known in frames_of.items():
            if sum(frame in known for frame in frames) > len(frames) / 2:
                copies.append(
                    f"{name}, whose readings are those of {original}: a copy does not count again"
                )
                break
        else:
            frames_of[name] = {*frames}
    return {name: recordings[name] for name in frames_of}, copies


def matched(recordings: Recordings) -> Matched:
    """Match estimators with recordings so that the number of paired differences is largest.

    An estimator that failed in more than 5 % of the frames is left out, since it would profit from
    skipping hard ones. Of the remaining ones, frames count that all solved.
    """
    originals, left_out = without_copies(recordings)
    recordings_of = Counter(chain.from_iterable(originals.values()))
    # Sets of estimators with at least `least` recordings each; the number of paired differences is
    # (estimators − 1) · recordings.
    options = []
    for least in sorted(set(recordings_of.values()), reverse=True):
        estimators = [name for name, count in recordings_of.items() if count >= least]
        complete = {
            name: cases for name, cases in originals.items() if {*estimators} <= cases.keys()
        }
        options.append((estimators, complete))
    names, common = max(options, key=lambda option: (len(option[0]) - 1) * len(option[1]))
    fewer = [name for name in recordings_of if name not in names]
    if fewer:
        left_out.append(f"{listed(fewer)}, without results of the same recordings")
    if len(common) < len(originals):
        left_out.append(
            f"{len(originals) - len(common)} "
            f"of {len(originals)} recordings lack some of the estimators"
        )
    for name in tuple(names) if common else ():
        solved = np.concatenate([cases[name].solved for cases in common.values()])
        if np.mean(solved) < MIN_SOLVED:
            names.remove(name)
            left_out.append(f"{name} failed in {int(np.sum(~solved))} of {len(solved)} frames")
    chosen = {}
    for recording, cases in common.items() if names else ():
        solved = np.all([cases[name].solved for name in names], axis=0)
        if np.any(solved):
            chosen[recording] = solved
    compared = {recording: common[recording] for recording in chosen}
    return Matched(tuple(names), compared, tuple(chosen.values()), tuple(left_out))


@dataclass(frozen=True)
class Interval:
    """A figure and the ends of its 95 % interval."""

    value: float
    lower: float
    upper: float


def mean_interval(values: Array, parts: int) -> Interval:
    """Return the mean of values, shape (units,), with its interval x̄ ± t·s/√n.

    The interval is that of the means of n successive parts. Infinite for a single part. Source:
    Schmeiser, Oper. Res. 30, 1982 (batch means).
    """
    mean = float(np.mean(values))
    reach = np.inf
    if parts > 1:
        from lampest.posterior.interval import student_two_sided  # with scipy.special

        means = [part.mean() for part in np.array_split(values, parts)]
        reach = float(student_two_sided(parts - 1) * np.std(means, ddof=1) / np.sqrt(parts))
    return Interval(mean, mean - reach, mean + reach)


def positive_mean_interval(values: Array, parts: int) -> Interval:
    """Return the mean of positive values with its interval x̄·e^(±t·s/(x̄·√n)), as `mean_interval`.

    It is the ratio to one: the standard deviation of ln x̄ is that of x̄ over x̄, so that both ends
    are positive.
    """
    if not np.any(values):
        return mean_interval(values, parts)
    return ratio_interval(values, np.ones_like(values), parts)


def ratio_interval(values: Array, others: Array, parts: int) -> Interval:
    """Return the ratio of two means of positive values, x̄/ȳ·e^(±t·s/√n), as `mean_interval`.

    ln(x̄/ȳ) has the standard deviation of the paired differences x/x̄ − y/ȳ. The interval is one of
    factors, so that no end is negative. NaN where ȳ is zero.

    Parameters
    ----------
    values, others : array, shape (units,)
        x and y of the same units.
    parts : int
        Number n of successive parts.
    """
    mean = np.float64(np.mean(values))
    other = np.float64(np.mean(others))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = float(mean / other)
        reach = mean_interval(values / mean - others / other, parts).upper
        factor = float(np.exp(reach))
    return Interval(ratio, ratio / factor, ratio * factor)


def between(interval: Interval, unit: str = "") -> str:
    """Format an interval, such as '2.13 (1.95 to 2.36) %', with two digits of its length."""
    length = interval.upper - interval.lower
    like = max(length, abs(interval.value) / 10) if np.isfinite(length) else None
    ends = (interval.value, interval.lower, interval.upper)
    value, lower, upper = (digits(end, 2, like) for end in ends)
    return f"{value} ({lower}{HARD}to{HARD}{upper}){unit and HARD + unit}"


@dataclass(frozen=True)
class Standing:
    """Mean of an estimator over the units, and its paired ratio to the smallest mean.

    Attributes
    ----------
    estimator : str
    mean, ratio : Interval
    wins : int
        Number of units in which no estimator is better.
    milliseconds : float
        Median time per frame, geometric mean over the units.
    """

    estimator: str
    mean: Interval
    ratio: Interval
    wins: int
    milliseconds: float

    @property
    def is_significant(self) -> bool:
        """Whether the interval of the ratio excludes one."""
        return self.ratio.lower > 1


@dataclass(frozen=True)
class Criterion:
    """Criterion by which estimators are ranked; smaller is better.

    Attributes
    ----------
    name, unit, meaning : str
        Name (as in 'the smallest …'), unit and definition.
    per_cell : callable
        Case → values, shape (frames, rows, columns).
    average : callable
        Average over cells and frames.
    """

    name: str
    unit: str
    meaning: str
    per_cell: Callable[[CaseResult], Array]
    average: Callable[..., Any]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Paired comparison of estimators.

    Attributes
    ----------
    criterion : Criterion
    match : Matched
    units : tuple of str
        Recordings, or the frames of a single one.
    values : array, shape (units, estimators)
        Criterion of each unit.
    standings : tuple of Standing
        Best first.
    """

    criterion: Criterion
    match: Matched
    units: Texts
    values: Array
    standings: tuple[Standing, ...]

    @property
    def over_frames(self) -> bool:
        """Whether the units are frames of one recording."""
        return len(self.match.recordings) == 1


def log_error(case: CaseResult) -> Array:
    """Return 100·|ln(r/r_true)|, (frames, rows, columns) percent; NaN for failed frames.

    Requires the truth.
    """
    assert case.truth is not None
    return np.asarray(100 * np.abs(np.log(case.cell_resistance / case.truth)))


def predicted(case: CaseResult) -> Array:
    """Return Mallows' C, min(z², 25) + 2·resolution with z = (model − measured)/σ.

    Shape (frames, rows, columns). Its mean is the expected squared deviation of new readings from
    the model in units of σ²: 1 for the right model, 2 for one that follows every reading. The trace
    of the averaging kernel equals that of the readings' influence on their own prediction. |z| is
    limited to 5, so that few outliers do not decide. Source: Mallows, Technometrics 15, 1973.
    """
    assert case.resolution is not None
    return np.asarray(np.minimum(weighted_residual(case) ** 2, 25.0) + 2 * case.resolution)


CELL_ERROR = Criterion(
    "error of the cells",
    "%",
    "100·|ln(r/r_true)|, its median over cells and frames; the truth is known",
    log_error,
    np.nanmedian,
)
PREDICTION = Criterion(
    "prediction error",
    "σ²",
    "expected squared deviation of new readings from those of the estimated cells, "
    "in units of their variance (Mallows' C); the truth is unknown",
    predicted,
    np.nanmean,
)


def comparison_of(batch: Batch) -> Comparison | None:
    """Compare estimators by the best criterion that the results allow.

    The best criterion is the error against the truth. The second one is the predicted error of new
    readings, which requires their noise and the resolution. The result is None if neither is known,
    since the data error grows with every penalty, good or bad; or if no two estimators share a
    frame.
    """
    known = {
        name: cases
        for name, cases in batch.recordings.items()
        if all(case.truth is not None for case in cases.values())
    }
    match = matched(known or batch.recordings)
    cases = [case for name in match.estimators for case in match.cases(name)]
    predictable = all(case.sigma is not None and case.resolution is not None for case in cases)
    if len(match.estimators) < 2 or not match.recordings or not (known or predictable):
        return None
    criterion = CELL_ERROR if known else PREDICTION
    single = len(match.recordings) == 1
    units = tuple(match.recordings)
    if single:
        units = tuple(f"frame {number}" for number in cases[0].frame[match.chosen[0]])
    values = _values(match, criterion.per_cell, criterion.average)
    parts = min(len(values), MAX_PARTS) if single else len(values)
    # geometric mean over the units of the median time per frame
    logs = _values(match, lambda case: np.log(np.fmax(1e3 * case.solve_time, 1e-3)), np.median)
    times = np.exp(logs.mean(axis=0))
    order = np.argsort(values.mean(axis=0), kind="stable")
    wins = np.sum(values == values.min(axis=1, keepdims=True), axis=0)
    standings = tuple(
        Standing(
            match.estimators[number],
            positive_mean_interval(values[:, number], parts),
            ratio_interval(values[:, number], values[:, order[0]], parts),  # to the smallest mean
            int(wins[number]),
            float(times[number]),
        )
        for number in order
    )
    return Comparison(criterion, match, units, values, standings)


def _values(
    match: Matched, per_cell: Callable[[CaseResult], Array], average: Callable[..., Any]
) -> Array:
    """Return averages over the cells of the matched frames, shape (units, estimators)."""
    columns = []
    for name in match.estimators:
        pairs_of = zip(match.cases(name), match.chosen, strict=True)
        chosen = [per_cell(case)[frames] for case, frames in pairs_of]
        if len(chosen) == 1:
            columns.append(average(chosen[0].reshape(len(chosen[0]), -1), axis=1))
        else:
            columns.append(np.array(list(map(average, chosen))))
    return np.stack(columns, axis=1)


def weights_text(cases: Sequence[Mapping[str, Array]]) -> str:
    """Return the weights of the penalties, such as 'gradient λ = 0.001'.

    If they differ, they are given as median and range.
    """
    by_term: dict[str, list[Array]] = {}
    for weights in cases:
        for term, values in weights.items():
            by_term.setdefault(term.replace("_", " "), []).append(values)
    texts = {
        term: median_text(np.concatenate(arrays), "{:.3g}".format)
        for term, arrays in by_term.items()
    }
    parts = [f"{term} λ = {text or NONE}" for term, text in texts.items() if term != "misfit"]
    return ", ".join(parts) or ("no penalty" if by_term else "")


@dataclass(frozen=True)
class Advice:
    """Recommendation of an estimator, or None; headline, reasons and warnings are sentences."""

    estimator: str | None
    headline: str
    reasons: Texts
    warnings: Texts


def advise(batch: Batch, comparison: Comparison | None) -> Advice:
    """Recommend the fastest of the estimators that equal the one with the smallest criterion.

    Estimators are equal where their criterion is within 5 % of the smallest one, or where no
    difference from it is significant. A larger error is not outweighed by speed.
    """
    match = comparison.match if comparison else matched(batch.recordings)
    left_out = tuple(f"Not compared: {sentence}." for sentence in match.left_out)
    if comparison is None:
        gap = "No two estimators solved the same frames."
        if len(match.estimators) > 1 and match.recordings:
            gap = (
                "A ranking needs the true cells, "
                "or the noise of the readings and the resolution. Neither is known."
            )
        return Advice(None, "These results cannot rank the estimators.", (gap,), left_out)
    warning = ""
    if comparison.over_frames:
        warning = (
            "One recording only: the intervals describe its frames, not other subjects or days."
        )
    elif len(comparison.units) < MIN_RECORDINGS:
        few = counted(len(comparison.units), "recording")
        warning = f"{few} are few: the next one may change the ranking."
    best = comparison.standings[0]
    largest = (1 + SIMILAR) * best.mean.value
    similar = [
        row for row in comparison.standings if row.mean.value <= largest or not row.is_significant
    ]
    advised = min(similar, key=lambda row: row.milliseconds)
    weights = weights_text([case.weights for case in match.cases(advised.estimator)])
    named = f"{advised.estimator} ({weights})" if weights else advised.estimator
    headline = f"On these data take {named}."
    if len(similar) > 1:
        names = listed([row.estimator for row in similar])
        headline = f"No difference is shown between {names}; {named} is the fastest of them."
    reasons = tuple(_reasons(comparison, advised, similar))
    warnings = tuple(filter(None, (warning, *left_out)))
    return Advice(advised.estimator, headline, reasons, warnings)


def _reasons(
    comparison: Comparison, advised: Standing, similar: Sequence[Standing]
) -> Iterator[str]:
    """Yield the reasons for the advised estimator, one sentence each."""
    best = comparison.standings[0]
    criterion = comparison.criterion
    units = len(comparison.units)
    basis = (
        f"mean over {counted(units, 'recording')} with {counted(comparison.match.frames, 'frame')}"
    )
    if comparison.over_frames:
        basis = f"mean over {counted(units, 'frame')} of one recording"
    yield (
        f"{best.estimator} has the smallest {criterion.name}: "
        f"{between(best.mean, criterion.unit)}, {basis}."
    )
    ratios = [f"{row.estimator} ({between(row.ratio)} times)" for row in similar if row is not best]
    if ratios:
        yield f"Within 5 % of it, or not significantly different: {listed(ratios)}."
    if advised is not best:
        slow, fast = (digits(row.milliseconds, 2) for row in (best, advised))
        yield f"{advised.estimator} takes {fast} ms a frame, {best.estimator} {slow} ms."
    worse = [row for row in comparison.standings if row not in similar]
    if worse:
        texts = [f"{row.estimator} ({between(row.ratio)} times)" for row in worse]
        yield f"The error is larger with {listed(texts)}."
    if criterion is PREDICTION:
        yield (
            "The truth is unknown. The ranking uses the error with which "
            "new readings would be predicted, which depends on the noise that the results state."
        )
