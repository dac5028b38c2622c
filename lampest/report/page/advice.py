"""Which estimator to take on these data, and why, in sentences."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lampest.report.page.batch import Batch, Matched, matched
from lampest.report.page.compared import PREDICTION, Comparison, Standing
from lampest.report.page.measures import Measures
from lampest.report.page.template import between, signed, weights_text
from lampest.report.words import counted, digits, listed

FEW = 5  # units: intervals over fewer are uncertain themselves
MOST_NAMED = 4  # estimators that a sentence names
FASTER = 1.1  # times of two estimators are the same below this ratio
PRACTICAL = 0.05  # of the smallest criterion: nobody sees a difference below a twentieth in a map or in a force


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
        alone = "There are no frames that two estimators both solved in the recordings that can be compared."
        if len(batch.estimators) == 1:
            alone = f"{batch.estimators[0]} is the only estimator."
        return Advice(None, "There is nothing to choose from.", (alone,), _left_out(matched(batch.subjects)))
    warnings = (*_few(comparison), *_left_out(comparison.match))
    if not comparison.criterion.decides:
        headline = "These results do not tell which estimator is nearest to the cells."
        return Advice(None, headline, _undecided(comparison), warnings)
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
        names = _some([row.estimator for row in alike], "more")
        headline = f"No practical difference between {names}; {named} is {why} of them."
    return Advice(taken.estimator, headline, tuple(_reasons(comparison, taken, alike)), warnings)


def _some(texts: list[str], more: str) -> str:
    """The first few in a list, and how many more there are."""
    left = len(texts) - MOST_NAMED
    return listed(texts[:MOST_NAMED] + ([f"{left} {more}"] if left > 0 else []))


def doubts(estimator: str, found: Sequence[Measures]) -> tuple[str, ...]:
    """What is wrong with the recommended estimator: residuals beyond the noise, error bars that are wrong."""
    sentences = []
    spread = float(np.median([value for own in found for value in own.values("spread")] or [0.0]))
    if spread > 1.5:
        sentences.append(
            f"The residuals of {estimator} are {digits(spread, 2)} times the noise of the readings: the noise is "
            "larger than the scene says, the model lacks an effect, or the penalty is too strong."
        )
    coverage = float(np.mean([value for own in found for value in own.values("coverage")] or [100.0]))
    if coverage < 90:
        sentences.append(
            f"The 95 % intervals of {estimator} cover the truth for {digits(coverage, 2)} % of the cells: the readings "
            "contain more than the noise, the scene and the penalty account for."
        )
    return tuple(sentences)


def _reasons(comparison: Comparison, taken: Standing, alike: Sequence[Standing]) -> Iterator[str]:
    best, criterion = comparison.standings[0], comparison.criterion
    points = criterion.difference_unit
    smallest = between(best.mean, criterion.unit)
    yield f"{best.estimator} has the smallest {criterion.name}: {smallest}, {_basis(comparison)}."
    others = [f"{row.estimator} ({signed(row.against_best.difference, points)})" for row in alike if row is not best]
    if others:
        yield f"Within a twentieth of it: {listed(others)}."
    if taken is not best:
        slow, fast = (digits(comparison.milliseconds(row.estimator), 2) for row in (best, taken))
        yield f"{taken.estimator} takes {fast} ms a frame, {best.estimator} {slow} ms."
    worse = [row for row in comparison.standings if row not in alike]
    if worse:
        texts = [f"{row.estimator} by {signed(row.against_best.difference)}" for row in worse]
        yield f"Larger than that of {best.estimator}, in {points}: {_some(texts, 'more by more than that')}."
    unsure = [row.estimator for row in worse if not row.against_best.told_apart]
    if unsure:
        yield f"These data do not make sure that {listed(unsure)} {'is' if len(unsure) == 1 else 'are'} larger."
    if criterion is PREDICTION:
        yield (
            "The truth is unknown, so this rests on how well fresh readings would be predicted: the misfit, charged "
            "for every cell that follows its reading's noise. It is as right as the noise that the results name."
        )


def _basis(comparison: Comparison) -> str:
    units, block = len(comparison.scores.values), comparison.scores.block
    if comparison.scores.over_frames:
        blocks = f"in blocks of {block}" if block > 1 else "one by one"
        return f"mean over {counted(units, 'frame')} of one recording (95 % interval from frames drawn {blocks})"
    frames = counted(comparison.match.frames, "frame")
    return f"mean over {counted(units, 'recording')} with {frames} (95 % interval)"


def _few(comparison: Comparison) -> Iterator[str]:
    units, over_frames = len(comparison.scores.values), comparison.scores.over_frames
    if over_frames:
        yield "One recording only: intervals are over its frames and say nothing of another animal or day."
    if units < FEW:
        noun = counted(units, "frame" if over_frames else "recording")
        yield f"{noun} only: intervals over fewer than {FEW} are rough, mostly too short."


def _left_out(match: Matched) -> tuple[str, ...]:
    return tuple(f"Not compared: {sentence}." for sentence in match.left_out)


def _undecided(comparison: Comparison) -> tuple[str, ...]:
    first, quickest = comparison.standings[0], comparison.times[0]
    return (
        "The truth is unknown, and so is what would stand in for it: the noise of the readings with the resolution.",
        f"{first.estimator} has the smallest data error, {between(first.mean, comparison.criterion.unit)}; but a data "
        "error grows with every penalty, good or bad.",
        f"The fastest is {quickest.estimator}, {digits(comparison.milliseconds(quickest.estimator), 2)} ms a frame.",
    )
