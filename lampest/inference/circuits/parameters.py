"""Most probable parameters of an alternative: a resistance in series, of idle lines, a memory.

A coarse grid is tried first. A search about its best value follows. Where linear theory allows no
gain, neither is made: each value that is tried costs fits of both frames.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from lampest.files.errors import BROKEN, InputError
from lampest.files.levels import DOUBTFUL_GAIN, MIN_EVIDENCE_GAIN
from lampest.inference.cells_fit import CellsFit
from lampest.inference.circuits.alternatives import Alternative
from lampest.inference.circuits.explanation import (
    FAR,
    ComparedFrames,
    Explanation,
    alternative_fits,
    broken_law,
)
from lampest.inference.evidence import PARAMETER_COST
from lampest.inference.pair import FittedPair
from lampest.inference.readings.free_tests import largest_series_ohm
from lampest.panel.effects import usual_size
from lampest.panel.panel import Array
from lampest.panel.sizes import SIZED
from lampest.panel.trust_region import golden_section

# Of the largest resistance in series that readings allow: all of it would short the panel.
MAX_SERIES_SHARE = 0.98
SERIES_POINTS = 5  # resistances in series that are tried, before a search about the best one
# Fractions of the channel before that a converter may keep.
MEMORIES = (0.01, 0.02, 0.04, 0.08, 0.16)
LINEAR_MEMORY = usual_size("converter_memory")
# Fractions nearer to the ends of the searched range, half the smallest and twice the largest of
# MEMORIES, are no finding.
MIN_MEMORY = MEMORIES[0] / 2 * 1.1
MAX_MEMORY = MEMORIES[-1] * 1.9
MIN_LINEAR_SHARE = 0.5  # of the gain by a memory that linear theory gives at least
MEMORY_ACCURACY = 0.03  # of the search about the best one, as a share of it
NUMBER_RANGE = float(np.log(3))  # of ln of an open number, from one tried value to the next
NUMBER_ACCURACY = 0.1
SERIES_ACCURACY = 0.05  # of that search, as a share of their distance


def some_in_series(
    alternative: Alternative,
    frames: ComparedFrames,
    to_beat: float = np.inf,
    *,
    fits: tuple[CellsFit, ...] = (),
    specified: Explanation | None = None,
) -> Explanation | None:
    """Return a circuit's explanation with the best of SERIES_POINTS other resistances in series.

    Each fit begins at the cells of the one before, also where only the unloaded panel was
    explained. The result is None without any explanation.

    Parameters
    ----------
    alternative : Alternative
        A circuit that does not explain the frames with its given resistance.
    frames : ComparedFrames
    to_beat : float
        Evidence above which an explanation does not count. The search ends where linear theory
        gives no resistance one that exceeds it by less than FAR.
    fits : tuple of CellsFit
        Fits with the given resistance where they explain only the unloaded panel.
    specified : Explanation or None
        See `Explanation.by`.
    """
    most = most_in_series(alternative, frames)
    best = near = None
    begin = fits
    for ohm in np.linspace(0.0, most, SERIES_POINTS) if most else ():
        if ohm == alternative.ohm:
            continue
        tried = replace(alternative.with_series(ohm), at_limit=ohm in (0.0, most))
        if broken_law(tried, frames):  # and with every larger one
            break
        fits = alternative_fits(tried, frames, begin, specified)
        begin = fits or begin
        explanation = Explanation.by(fits, tried, frames, near, specified)
        if explanation is None:
            continue
        near = explanation
        if best is None or explanation.linear_evidence < best.linear_evidence:
            best = explanation
        beyond = explanation.linear_evidence - to_beat - FAR
        if beyond > 0 and beyond > _gain_by_series(explanation, most):
            break
    return best


def with_series(explanation: Explanation, frames: ComparedFrames) -> Explanation:
    """Return a circuit's explanation with the most probable or the given resistance in series.

    The search is made about the best of SERIES_POINTS, and about the given resistance only where a
    change of it may gain by linear theory.
    """
    alternative = explanation.alternative
    most = most_in_series(alternative, frames)
    if not most:
        return explanation
    spacing = most / (SERIES_POINTS - 1)
    best = explanation
    if alternative.in_series is None:
        best = _best_beside(explanation, frames, most)
        if best is explanation and _gain_by_series(best, spacing) <= PARAMETER_COST:
            return explanation
    search = _ParameterSearch(
        lambda ohm: replace(alternative.with_series(ohm), at_limit=False), frames, best
    )
    accuracy = SERIES_ACCURACY * spacing
    middle = best.alternative.ohm
    golden_section(search.score, max(middle - spacing, 0.0), middle + spacing, 2 * accuracy)
    best = search.best.final
    if best.alternative.in_series is None:
        return best
    at_limit = not 2 * accuracy < best.alternative.ohm < most - 2 * accuracy
    return replace(best, alternative=replace(best.alternative, at_limit=at_limit))


def _best_beside(explanation: Explanation, frames: ComparedFrames, most: float) -> Explanation:
    """Return the best explanation with one of SERIES_POINTS resistances, or with the given one.

    The resistances next to the given one come first. Smaller and larger ones follow while they are
    no worse than the best by more than DOUBTFUL_GAIN: the evidence has one maximum.

    Parameters
    ----------
    explanation : Explanation
    frames : ComparedFrames
    most : float
        The largest resistance, ohm.
    """
    alternative = explanation.alternative
    ohms = np.linspace(0.0, most, SERIES_POINTS)
    best = explanation
    for outwards in (ohms[ohms < alternative.ohm][::-1], ohms[ohms > alternative.ohm]):
        near = explanation
        for ohm in outwards:
            tried = replace(alternative.with_series(ohm), at_limit=ohm in (0.0, most))
            further = None if broken_law(tried, frames) else Explanation.of(tried, frames, near)
            if further is None or further.linear_evidence > best.linear_evidence + DOUBTFUL_GAIN:
                break
            near = further
            best = min(best, further, key=attrgetter("linear_evidence"))
    return best


def with_converter_memory(explanation: Explanation, frames: ComparedFrames) -> Explanation:
    """Return a circuit's explanation with the most probable or the given converter memory.

    A scene that states a memory keeps it. Other memories are searched for where there is the effect
    and they may gain by linear theory, larger ones while they are no worse than the best by more
    than DOUBTFUL_GAIN.
    """
    alternative = explanation.alternative
    if alternative.scene.converter_memory is not None or alternative.scene.readout is None:
        return explanation
    if "converter_memory" not in SIZED or not may_gain_by_memory(explanation, frames):
        return explanation
    search = _ParameterSearch(alternative.with_memory, frames, explanation)
    scores = {0.0: explanation.linear_evidence}
    for memory in MEMORIES:
        scores[memory] = search.score(memory)
        if scores[memory] > min(scores.values()) + DOUBTFUL_GAIN:
            break
    if search.best is explanation:
        return explanation
    coarse = min(scores, key=lambda memory: scores[memory])
    golden_section(search.score, coarse / 2, 2 * coarse, 2 * MEMORY_ACCURACY * coarse)
    fraction = search.best.alternative.scene.known_memory or 0.0
    return search.best.final if MIN_MEMORY < fraction < MAX_MEMORY else explanation


def with_number(explanation: Explanation, frames: ComparedFrames) -> Explanation:
    """Return a circuit's explanation with the most probable value of its open number, if any."""
    alternative = explanation.alternative
    if not alternative.number:
        return explanation
    middle = float(np.log(getattr(alternative.scene.readout, alternative.number)))
    search = _ParameterSearch(lambda log: alternative.with_number(np.exp(log)), frames, explanation)
    golden_section(search.score, middle - NUMBER_RANGE, middle + NUMBER_RANGE, NUMBER_ACCURACY)
    return search.best.final


@dataclass(eq=False)
class _ParameterSearch:
    """Search for the most probable value of a parameter of a circuit.

    Attributes
    ----------
    alternative_of : callable
        Function (value) → the circuit with that value.
    frames : ComparedFrames
    best : Explanation
        The best explanation so far; the next fits begin at its cells.
    """

    alternative_of: Callable[[float], Alternative]
    frames: ComparedFrames
    best: Explanation

    def score(self, value: float) -> float:
        """Return the score of a value; infinite where no fit is found."""
        explanation = Explanation.of(self.alternative_of(float(value)), self.frames, self.best)
        if explanation is None:
            return np.inf
        self.best = min(self.best, explanation, key=attrgetter("linear_evidence"))
        return explanation.linear_evidence


def may_gain_by_memory(explanation: Explanation, frames: ComparedFrames) -> bool:
    """Return whether linear theory allows a memory of the converter a gain that is significant.

    A smaller gain is no doubt, and no converter keeps a negative share.
    """
    if explanation.pair is None:
        return True
    remembering = frames.readings(explanation.alternative.with_memory(LINEAR_MEMORY))
    resting, loaded = (
        fit.response((readings.value - fit.measured.value)[None])
        for fit, readings in zip(explanation.fits, remembering, strict=True)
    )
    # by a usual memory, and by the largest tried one
    for unit in (1.0, MEMORIES[-1] / LINEAR_MEMORY):
        gain, size = _linear_gain(explanation.pair, unit * (resting - loaded))
        if gain > MIN_LINEAR_SHARE * MIN_EVIDENCE_GAIN and not size < 0:
            return True
    return False


def _linear_gain(pair: FittedPair, response: Array) -> tuple[float, float]:
    """Return the gain of a parameter in score by linear theory, and its posterior mean.

    The mean is NaN where no cell stands still.

    Parameters
    ----------
    pair : FittedPair
    response : array, shape (cells, 1)
        Change of d by one standard deviation of the parameter.
    """
    evidence = pair.explained(response)
    return pair.evidence.score - evidence.score, float(evidence.size[1])


def _gain_by_series(explanation: Explanation, ohm: float) -> float:
    """Return the gain by a resistance in series by linear theory; infinite without a pair."""
    if explanation.pair is None:
        return np.inf
    # in series with every driven line, or with either side of lines that are alike
    rows = explanation.pair.shape[0]
    driven = getattr(explanation.alternative.scene.circuit, "driven", "rows")
    lines = slice(0, rows) if driven == "rows" else slice(rows, None)
    response = explanation.pair.channels[:, lines].sum(axis=1, keepdims=True)
    return _linear_gain(explanation.pair, ohm * response)[0]


def most_in_series(alternative: Alternative, frames: ComparedFrames) -> float:
    """Return the largest resistance in series that the readings allow, ohm.

    The result is 0 where no such resistance is possible or known.
    """
    if not alternative.scene.series_name or len(frames.standing) == 0:
        return 0.0
    without = without_series(alternative)
    try:
        read = frames.readings(without)
    except (InputError, *BROKEN):
        return 0.0
    limits = []
    for frame in read:
        sigma = frame.sigma_of_values
        if sigma is not None:
            limits.append(largest_series_ohm(without.scene.circuit, frame.value[None], sigma[None]))
    most = min(limits)
    return MAX_SERIES_SHARE * most if np.isfinite(most) and most > 0 else 0.0


def without_series(alternative: Alternative) -> Alternative:
    """Return the alternative without resistance in series; the same where it has none."""
    return (
        alternative.with_series(0.0)
        if alternative.scene.series_name and alternative.ohm
        else alternative
    )
