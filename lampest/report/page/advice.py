"""Which estimator to take on these data, and why, in sentences."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lampest.report.page.batch import Batch, Matched, matched
from lampest.report.page.compared import PREDICTION, Comparison, Standing
from lampest.report.page.measures import Measures
from lampest.report.page.template import between, digits, listed, signed, weights_text
from lampest.report.strongest import counted

FEW, MOST_NAMED = 5, 4  # units whose intervals are rough, estimators that a sentence names
FASTER = 1.1  # times of two estimators are the same below this ratio
PRACTICAL = 0.05  # of the smallest criterion: nobody sees a difference below a twentieth in a map or in a force
LARGEST_SPREAD = 1.5  # of residuals in units of the noise, up to which they are taken for noise
LEAST_COVERAGE = 90.0  # percent of true values in 95 % intervals, below which a warning is due


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
    is larger is not made up for by speed. Where nothing but the data error is known nothing is recommended: a smaller
    one only means a weaker penalty.
    """
    if comparison is None:
        return Advice(None, "There is nothing to choose from.", _alone(batch), _left_out(matched(batch.subjects)))
    warnings = (*_few(comparison), *_left_out(comparison.match))
    if not comparison.criterion.decides:
        headline = "These results do not tell which estimator is nearest to the cells."
        return Advice(None, headline, _untold(comparison), warnings)
    best = comparison.standings[0]
    alike = [row for row in comparison.standings if row.mean.value <= (1 + PRACTICAL) * best.mean.value]
    taken = min(alike, key=lambda row: comparison.milliseconds(row.estimator))
    if comparison.milliseconds(best.estimator) < FASTER * comparison.milliseconds(taken.estimator):
        taken = best
    weights = weights_text([case.weights for case in comparison.match.cases(taken.estimator)])
    named = f"{taken.estimator}{f' ({weights})' if weights else ''}"
    headline = f"On these data take {named}."
    if len(alike) > 1:
        why = "the smallest error" if taken is best else "the fastest"
        headline = f"No practical difference between {listed(_named(alike))}; {named} is {why} of them."
    return Advice(taken.estimator, headline, _reasons(comparison, taken, alike), warnings)


def _named(rows: Sequence[Standing]) -> list[str]:
    names = [row.estimator for row in rows[:MOST_NAMED]]
    return names + ([f"{len(rows) - MOST_NAMED} more"] if len(rows) > MOST_NAMED else [])


def doubts(estimator: str, found: Sequence[Measures]) -> tuple[str, ...]:
    """What is wrong with the recommended estimator: residuals beyond the noise, error bars that are wrong."""
    sentences = []
    spreads = [own.spread for own in found if own.spread is not None]
    if spreads and (spread := float(np.median(spreads))) > LARGEST_SPREAD:
        sentences.append(
            f"The residuals of {estimator} are {digits(spread, 2)} times the noise of the readings: the noise is "
            "larger than the scene says, the model lacks an effect, or the penalty is too strong."
        )
    covered = [own.coverage.value for own in found if own.coverage is not None]
    if covered and (coverage := float(np.mean(covered))) < LEAST_COVERAGE:
        sentences.append(
            f"The 95 % intervals of {estimator} cover the truth for {digits(coverage, 2)} % of the cells: the readings "
            "contain more than the noise, the scene and the penalty account for."
        )
    return tuple(sentences)


def _reasons(comparison: Comparison, taken: Standing, alike: Sequence[Standing]) -> tuple[str, ...]:
    best, criterion = comparison.standings[0], comparison.criterion
    unit, points = criterion.unit, criterion.difference_unit
    found = [f"{best.estimator} has the smallest {criterion.name}: {between(best.mean, unit)}, {_basis(comparison)}."]
    others = [f"{row.estimator} ({signed(row.against_best.difference, points)})" for row in alike if row is not best]
    if others:
        found.append(f"Within a twentieth of it: {listed(others)}.")
    if taken is not best:
        slow, fast = (comparison.milliseconds(row.estimator) for row in (best, taken))
        found.append(f"{taken.estimator} takes {digits(fast, 2)} ms a frame, {best.estimator} {digits(slow, 2)} ms.")
    worse = [row for row in comparison.standings if row not in alike]
    unsure = [row.estimator for row in worse if not row.against_best.told_apart]
    if worse:
        texts = [f"{row.estimator} by {signed(row.against_best.difference)}" for row in worse[:MOST_NAMED]]
        texts += [f"{len(worse) - MOST_NAMED} more by more than that"] if len(worse) > MOST_NAMED else []
        found.append(f"Larger than that of {best.estimator}, in {points}: {listed(texts)}.")
    if unsure:
        found.append(f"These data do not make sure that {listed(unsure)} {'is' if len(unsure) == 1 else 'are'} larger.")
    if criterion is PREDICTION:
        found.append(
            "The truth is unknown, so this rests on how well fresh readings would be predicted: the misfit, charged "
            "for every cell that follows its reading's noise. It is as right as the noise that the results name."
        )
    return tuple(found)


def _basis(comparison: Comparison) -> str:
    units, block = len(comparison.scores.values), comparison.scores.block
    if comparison.scores.over_frames:
        blocks = f"in blocks of {block}" if block > 1 else "one by one"
        return f"mean over {counted(units, 'frame')} of one recording (95 % interval from frames drawn {blocks})"
    frames = counted(comparison.match.frames, "frame")
    return f"mean over {counted(units, 'recording')} with {frames} (95 % interval)"


def _few(comparison: Comparison) -> tuple[str, ...]:
    units, sentences = len(comparison.scores.values), []
    if comparison.scores.over_frames:
        sentences.append("One recording only: intervals are over its frames and say nothing of another animal or day.")
    if units < FEW:
        noun = "frame" if comparison.scores.over_frames else "recording"
        sentences.append(f"{counted(units, noun)} only: intervals over fewer than {FEW} are rough, mostly too short.")
    return tuple(sentences)


def _left_out(match: Matched) -> tuple[str, ...]:
    return tuple(f"Not compared: {sentence}." for sentence in match.left_out)


def _untold(comparison: Comparison) -> tuple[str, ...]:
    first, quickest = comparison.standings[0], comparison.times[0]
    return (
        "The truth is unknown, and so is what would stand in for it: the noise of the readings with the resolution.",
        f"{first.estimator} has the smallest data error, {between(first.mean, comparison.criterion.unit)}; but a data "
        "error grows with every penalty, good or bad.",
        f"The fastest is {quickest.estimator}, {digits(comparison.milliseconds(quickest.estimator), 2)} ms a frame.",
    )


def _alone(batch: Batch) -> tuple[str, ...]:
    if len(batch.estimators) == 1:
        return (f"{batch.estimators[0]} is the only estimator.",)
    return ("There are no frames that two estimators both solved in the recordings that can be compared.",)
