"""Cells that explain frames under a circuit, and the rival circuit that explains them better.

Explanations of a pair of frames are compared by evidence, which decreases with the number of cells
that must have moved between the unloaded panel and the loaded frame. A rival counts if its evidence
is larger by MIN_EVIDENCE_GAIN. A resistance in series and the memory of the converter are
parameters of a circuit: their most probable values are searched for.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np
import scipy

from lampest.files.errors import BROKEN, InputError
from lampest.files.levels import MIN_EVIDENCE_GAIN
from lampest.inference.cells_fit import SMALL_CHI_SQUARE, CellsFit, fitted, well_determined
from lampest.inference.changed_cells import PARAMETER_COST, mostly_still
from lampest.inference.compared_frames import ComparedFrames, broken_law
from lampest.inference.fitted_pair import FittedPair
from lampest.inference.nuisances import MAX_CANDIDATES, BetterExplanation
from lampest.inference.rivals import (
    Rival,
    changes_beyond_noise,
    in_other_scan_order,
    other_converters,
    rivals_of,
    rounded_down,
)
from lampest.panel.panel import Array
from lampest.panel.readouts.presets import VirtualGroundReadout

# −2 ln evidence by which another circuit may beat the scene's without a doubt: of 430 recordings
# with the right circuit nearly all gain less (docs/theory/model_check.md).
DOUBTFUL_GAIN = 15.0
# Of the largest resistance in series that readings allow: all of it would short the panel.
MAX_SERIES_SHARE = 0.98
SERIES_POINTS = 5  # resistances in series that are tried, before a search about the best one
# Fractions of the channel before that a converter may keep.
MEMORIES = (0.01, 0.02, 0.04, 0.08, 0.16)
USUAL_MEMORY = MEMORIES[2]
# Fractions nearer to the ends of the searched range, half the smallest and twice the largest of
# MEMORIES, are no finding.
MIN_MEMORY = MEMORIES[0] / 2 * 1.1
MAX_MEMORY = MEMORIES[-1] * 1.9
MIN_LINEAR_SHARE = 0.5  # of the gain by a memory that linear theory gives at least
MEMORY_ACCURACY = 0.03  # of the search about the best one, as a share of it
SERIES_ACCURACY = 0.05  # of that search, as a share of their distance
SAME_SCORE = 1e-3  # scores that differ by less are rounding's
# Fits end within some hundredths of their smallest χ², rivals within SMALL_CHI_SQUARE.
SAME_COST = SMALL_CHI_SQUARE
# Of a circuit under which a load lowers no resistance, in -2 ln evidence, beside one of falling
# codes: a press lowers some, and so does a cup's rim.
RISING_COST = 24.0
MAX_COUPLED = 0.3  # of the largest rise: falls that channels couple to it
MIN_RISEN = 3  # cells: fewer may be a cup's alone
# Shares beyond which moved cells show couplings that a circuit lacks: of a line's cells, and of the
# moved cells in such lines.
MIN_FILLED = 0.5
MIN_IN_FILLED = 0.5
FAR = 100.0  # in scores, beyond what channels and the selection of moved cells change


@dataclass(frozen=True, eq=False)
class Explanation:
    """Cells that explain the readings under a circuit.

    Attributes
    ----------
    rival : Rival
        The circuit.
    fits : tuple of CellsFit
        Fits of the unloaded panel and, if there is one, of the loaded frame.
    pair : FittedPair or None
        The pair of both; None without a loaded frame, or on a panel of more than MAX_CELLS.
    """

    rival: Rival
    fits: tuple[CellsFit, ...]
    pair: FittedPair | None

    @classmethod
    def of(
        cls,
        rival: Rival,
        frames: ComparedFrames,
        near: "Explanation | None" = None,
        *,
        patient: bool = False,
    ) -> "Explanation | None":
        """Return a circuit's explanation of the frames; None where no fit is found.

        Parameters
        ----------
        rival : Rival
        frames : ComparedFrames
        near : Explanation or None
            Explanation by a similar circuit: the fits begin at its cells, and `like` applies.
        patient : bool
            See `fits_of`.
        """
        fits = fits_of(rival, frames, near.fits if near else (), patient=patient)
        return cls.by(fits, rival, frames, near)

    @classmethod
    def by(
        cls,
        fits: tuple[CellsFit, ...],
        rival: Rival,
        frames: ComparedFrames,
        near: "Explanation | None" = None,
        specified: "Explanation | None" = None,
    ) -> "Explanation | None":
        """Return a circuit's explanation by fits; None where they lack a frame.

        Parameters
        ----------
        fits : tuple of CellsFit
            Those of `fits_of`.
        rival : Rival
        frames : ComparedFrames
        near : Explanation or None
            Explanation by a similar circuit, to which `like` applies.
        specified : Explanation or None
            Explanation by the scene's circuit, for a rival of it. A rival whose score is larger by
            FAR with the channels and moved cells of that explanation keeps them.
        """
        if len(fits) < (2 if len(frames.standing) else 1):
            return None
        with suppress(InputError, *BROKEN):
            pair = None
            if len(fits) == 2 and fits[0].jacobian.size:
                pair = FittedPair(fits)
            explanation = cls(rival, fits, pair)
            if near is not None:
                explanation = explanation.like(near)
            elif specified is not None and rival.order is None:
                coarse = explanation.like(specified)
                explanation = coarse if coarse.score > specified.score + FAR else explanation
            return explanation if np.isfinite(explanation.score) else None
        return None

    def like(self, near: "Explanation") -> "Explanation":
        """Return the explanation with the channels and about the moved cells of a similar one.

        Its score costs less; see `final`.
        """
        if self.pair is None or near.pair is None:
            return self
        pair = replace(self.pair, known_channels=near.pair.channels, start=near.pair.evidence.moved)
        return replace(self, pair=pair)

    @cached_property
    def final(self) -> "Explanation":
        """The explanation with nothing taken over from a similar one."""
        if self.pair is None or self.pair.known_channels is None:
            return self
        return replace(self, pair=FittedPair(self.pair.frames))

    @cached_property
    def score(self) -> float:
        """−2 ln density of the loaded frame, and the costs of parameters."""
        return 0.0 if self.pair is None else self.pair.density + _costs(self.fits)

    @cached_property
    def beyond_noise(self) -> float:
        """−2 ln evidence of the changes beyond that of noise alone, and the costs of parameters."""
        return 0.0 if self.pair is None else self.pair.beyond_noise + _costs(self.fits)


def _costs(fits: Sequence[CellsFit]) -> float:
    """Return the misfit χ² of each frame, and PARAMETER_COST of each bound.

    Thus no circuit gains by bounds.
    """
    return sum(fit.chi_square + PARAMETER_COST * int(fit.readings.bounds.sum()) for fit in fits)


def fits_of(
    rival: Rival,
    frames: ComparedFrames,
    near: Sequence[CellsFit] = (),
    *,
    patient: bool = False,
) -> tuple[CellsFit, ...]:
    """Return the fits of the frames under a circuit, up to the first frame without a fit.

    Parameters
    ----------
    rival : Rival
    frames : ComparedFrames
    near : sequence of CellsFit
        Fits of the first frames under a similar circuit, at whose cells the fits begin.
    patient : bool
        Whether a fit is searched for from every start and accepted with any misfit. Otherwise the
        fit of the loaded frame begins at the cells of the unloaded panel, and a frame has a fit
        only if the circuit explains it.
    """
    fits: list[CellsFit] = []
    with suppress(InputError, *BROKEN):
        chosen = frames.panels if rival is frames.specified else None
        for number, frame in enumerate(frames.readings(rival)):
            start = near[number].cells if number < len(near) else None
            if start is None and chosen is not None:
                start = (chosen.resting, chosen.loaded)[number]
            if start is None and fits and not patient:
                start = fits[0].cells
            fit = fitted(rival.scene, frame, start, patient=patient)
            # of two panels that read alike the one that continues the unloaded panel is meant
            elsewhere = chosen is None and fit is not None and bool(fits)
            if elsewhere and fit and fit.network.branch != fits[0].network.branch:
                fit = fitted(rival.scene, frame, fits[0].cells, patient=patient)
            if fit is None or not (patient or fit.within_noise):
                break
            fits.append(fit)
    return tuple(fits)


def _rival_fits(
    rival: Rival,
    frames: ComparedFrames,
    near: tuple[CellsFit, ...] = (),
    specified: Explanation | None = None,
) -> tuple[CellsFit, ...]:
    """Return the fits under a rival, from the cells of the scene's circuit where these suffice.

    Where several panels read alike, the readout's start determines which one is meant.

    Parameters
    ----------
    rival : Rival
    frames : ComparedFrames
    near : tuple of CellsFit
        Fits under a circuit that is nearer; () without any.
    specified : Explanation or None
        Explanation by the scene's circuit.
    """
    if near or specified is None or rival.order is not None:
        return fits_of(rival, frames, near)
    if rival.scene.circuit.several_panels:
        return fits_of(rival, frames)
    return fits_of(rival, frames, specified.fits[:1]) or fits_of(rival, frames)


def better_rival(frames: ComparedFrames, specified: Explanation | None) -> BetterExplanation:
    """Return the rival that explains the readings better than the scene's circuit.

    A better rival explains them where the scene's circuit does not, or gains more than
    MIN_EVIDENCE_GAIN. Rivals under which most cells have moved do not count, because the still
    cells cannot be identified then.

    Parameters
    ----------
    frames : ComparedFrames
    specified : Explanation or None
        The explanation by the scene's circuit; None where it does not explain the readings.
    """
    if specified is not None and not _needs_rivals(specified):
        return BetterExplanation()
    candidates = _without_twins(_likely_rivals(frames, specified))
    assumed = [] if specified is None else [specified]
    candidates += [with_series(explanation, frames) for explanation in (*candidates, *assumed)]
    candidates += [with_converter_memory(explanation, frames) for explanation in assumed]
    for explanation in assumed:
        for rival in in_other_scan_order(explanation.rival):
            remembering = with_converter_memory(replace(explanation, rival=rival), frames)
            candidates += [remembering] if remembering.rival is not rival else []
    best = _best_candidate(candidates, frames, at_fault=specified is None)
    return BetterExplanation() if best is None else _compared(specified, best, frames)


def _needs_rivals(specified: Explanation) -> bool:
    """Return whether a rival can gain enough evidence over the scene's circuit.

    Where cells are determined badly, linear theory does not hold, and none is tried.
    """
    pair = specified.pair
    if pair is None or pair.beyond_noise < MIN_EVIDENCE_GAIN:
        return False
    return well_determined(specified.fits)


def _likely_rivals(frames: ComparedFrames, specified: Explanation | None) -> list[Explanation]:
    """Return the MAX_CANDIDATES best explanations by rivals, better ones than the scene's.

    Rivals whose inequalities the readings break are not fitted. A resistance in series only makes
    these inequalities narrower, so that they are tested without one.
    """
    change = changes_beyond_noise(frames.specified.scene, frames.specified.readings, frames.role)
    mostly_increases = bool(change.max(initial=0.0) > -change.min(initial=0.0))
    # circuits that only exchange the names of lines have the scene's score within rounding
    limit = np.inf if specified is None else specified.score - SAME_SCORE
    rivals = [
        rival
        for rival in (
            *rivals_of(frames.specified, reversed_too=mostly_increases),
            *other_converters(frames.specified, reversed_too=mostly_increases),
        )
        if not broken_law(_without_series(rival), frames)
    ]
    explanations: list[Explanation | None] = []
    failed: list[tuple[Rival, tuple[CellsFit, ...]]] = []
    for rival in rivals:
        lawful = rival.ohm == 0 or not broken_law(rival, frames)
        fits = _rival_fits(rival, frames, specified=specified) if lawful else ()
        explanation = Explanation.by(fits, rival, frames, specified=specified)
        if explanation is None:
            failed.append((rival, fits))
        explanations.append(explanation)
    # A search for a resistance in series costs several fits: last, so that it ends where it cannot
    # reach the best ones.
    for rival, fits in failed:
        to_beat = min(limit, _score_to_beat(explanations))
        explanations.append(some_in_series(rival, frames, to_beat, fits=fits, specified=specified))
    if specified is None:
        explanations.append(some_in_series(frames.specified, frames))
        down = rounded_down(frames.specified)
        explanations.append(None if down is None else Explanation.of(down, frames))
    better = [
        explanation
        for explanation in explanations
        if explanation is not None and explanation.score < limit
    ]
    best = sorted(better, key=attrgetter("score"))[:MAX_CANDIDATES]
    return [explanation.final for explanation in best]


def _score_to_beat(explanations: Sequence[Explanation | None]) -> float:
    """Return the score of the last of MAX_CANDIDATES explanations; infinite with fewer."""
    scores = sorted(explanation.score for explanation in explanations if explanation is not None)
    return scores[MAX_CANDIDATES - 1] if len(scores) >= MAX_CANDIDATES else np.inf


def _without_twins(candidates: Sequence[Explanation]) -> list[Explanation]:
    """Return the explanations without those that are another one with other names of lines.

    Readings in another order are so to circuits in which rows and columns change places. Of the
    two, `_best_candidate` prefers the one that keeps the file's order.
    """
    kept = [candidate.score for candidate in candidates if candidate.rival.order is None]
    return [
        candidate
        for candidate in candidates
        if candidate.rival.order is None
        or not np.isclose(candidate.score, kept, rtol=0.0, atol=SAME_COST).any()
    ]


def _best_candidate(
    candidates: Sequence[Explanation], frames: ComparedFrames, *, at_fault: bool
) -> Explanation | None:
    """Return the candidate with the largest evidence, less the costs of its parameters.

    Candidates do not count under which most cells have moved, whose inequalities the readings
    break, or that do not differ from the scene's circuit. Where the scene's circuit is at fault,
    the best one has to say more than that each reading has its cell (`_says_no_more`), and loads
    have to lower some resistance.

    Parameters
    ----------
    candidates : sequence of Explanation
    frames : ComparedFrames
    at_fault : bool
        Whether the scene's circuit does not explain the readings.
    """
    specified_memory = frames.specified.scene.converter_memory
    valid = []
    for candidate in candidates:
        still = candidate.pair is None or mostly_still(candidate.pair.moved)
        if still and not broken_law(candidate.rival, frames) and candidate.rival.name:
            valid.append(candidate)

    reversible = any(
        getattr(candidate.rival.scene.readout, "code_sign", 1.0) < 0 for candidate in valid
    )

    def cost(candidate: Explanation) -> float:
        # Among rivals a resistance in series is one more parameter, and so is a memory.
        has_series = candidate.rival.in_series is not None
        has_memory = candidate.rival.scene.converter_memory != specified_memory
        rises = RISING_COST * (reversible and _only_rises(candidate))
        return candidate.beyond_noise + PARAMETER_COST * (has_series + has_memory) + rises

    # of circuits that differ in the names of lines alone, the one that keeps the file's order
    least = min(map(cost, valid), default=0.0)
    tied = [candidate for candidate in valid if cost(candidate) <= least + SAME_COST]
    best = min(tied, key=lambda tie: (tie.rival.order is not None, cost(tie)), default=None)
    if best is None or not at_fault:
        return best
    apart = [cost(candidate) for candidate in valid if _reads_cells_apart(candidate)]
    gain = min(apart, default=np.inf) - cost(best)
    if _only_rises(best) or (gain < MIN_EVIDENCE_GAIN and _says_no_more(best)):
        return None
    return best


def _reads_cells_apart(candidate: Explanation) -> bool:
    """Return whether each line has an amplifier, so that any readings have cells."""
    return isinstance(candidate.rival.scene.readout, VirtualGroundReadout)


def _says_no_more(candidate: Explanation) -> bool:
    """Return whether moved cells fill whole lines, as those of a wrong circuit do.

    A press moves all readings of its lines, and a circuit without these couplings takes each for a
    cell that moved. Without a loaded frame nothing is known of the couplings.
    """
    if candidate.pair is None:
        return _reads_cells_apart(candidate)
    moved = candidate.pair.moved
    columns = moved.mean(axis=0) > MIN_FILLED
    rows = moved.mean(axis=1) > MIN_FILLED
    in_filled = moved & (columns | rows[:, None])
    return bool(in_filled.sum() > MIN_IN_FILLED * moved.sum())


def _only_rises(candidate: Explanation) -> bool:
    """Return whether moved cells have larger resistances under load, but for small couplings."""
    if candidate.pair is None or candidate.pair.moved.sum() < MIN_RISEN:
        return False
    return rises_only(candidate.pair.change[candidate.pair.moved.ravel()])


def rises_only(change: Array) -> bool:
    """Return whether log resistances only rise: the largest fall is a share of the largest rise."""
    return bool(-change.min(initial=0.0) < MAX_COUPLED * change.max(initial=0.0))


def _compared(
    specified: Explanation | None, best: Explanation, frames: ComparedFrames
) -> BetterExplanation:
    """Return the best candidate as better, as nearly as good, or as neither."""
    if specified is None or best.pair is None:
        return BetterExplanation(best.rival.name, addition=best.rival.addition)
    gain = (specified.beyond_noise - best.beyond_noise) / best.pair.excess
    if specified.pair is None or gain <= DOUBTFUL_GAIN or not best.pair.moved.any():
        return BetterExplanation()
    insignificant = gain <= MIN_EVIDENCE_GAIN
    if insignificant or specified.pair.gain_apart(best.pair) <= DOUBTFUL_GAIN:
        # A resistance in series follows hidden errors of the circuit, a memory the edge of a load:
        # alone, neither is a doubt.
        as_specified = best.rival.scene.converter_memory == frames.specified.scene.converter_memory
        doubtful = insignificant and best.rival.kind and as_specified
        return BetterExplanation(nearly=best.rival.name if doubtful else "")
    moved = int(best.pair.moved.sum())
    moved_as_specified = int(specified.pair.moved.sum())
    return BetterExplanation(
        best.rival.name,
        frames.loaded,
        moved,
        moved_as_specified,
        addition=best.rival.addition,
    )


def some_in_series(
    rival: Rival,
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
    rival : Rival
        A circuit that does not explain the frames with its given resistance.
    frames : ComparedFrames
    to_beat : float
        Score above which an explanation does not count. The search ends where linear theory gives
        no resistance a score that exceeds it by less than FAR.
    fits : tuple of CellsFit
        Fits with the given resistance where they explain only the unloaded panel.
    specified : Explanation or None
        See `Explanation.by`.
    """
    most = most_in_series(rival, frames)
    best = near = None
    begin = fits
    for ohm in np.linspace(0.0, most, SERIES_POINTS) if most else ():
        if ohm == rival.ohm:
            continue
        tried = replace(rival.with_series(ohm), at_limit=ohm in (0.0, most))
        if broken_law(tried, frames):  # and with every larger one
            break
        fits = _rival_fits(tried, frames, begin, specified)
        begin = fits or begin
        explanation = Explanation.by(fits, tried, frames, near, specified)
        if explanation is None:
            continue
        near = explanation
        if best is None or explanation.score < best.score:
            best = explanation
        if explanation.score > to_beat + FAR:
            gain = _linear_gain(explanation, _response_to_series(explanation, most))
            if explanation.score - gain > to_beat + FAR:
                break
    return best


def _best_beside(explanation: Explanation, frames: ComparedFrames, most: float) -> Explanation:
    """Return the best explanation with one of SERIES_POINTS resistances, or with the given one.

    The resistances next to the given one come first. Smaller and larger ones follow while they are
    no worse than the best by more than DOUBTFUL_GAIN: the score has one minimum.

    Parameters
    ----------
    explanation : Explanation
    frames : ComparedFrames
    most : float
        The largest resistance, ohm.
    """
    rival = explanation.rival
    ohms = np.linspace(0.0, most, SERIES_POINTS)
    best = explanation
    for outwards in (ohms[ohms < rival.ohm][::-1], ohms[ohms > rival.ohm]):
        near = explanation
        for ohm in outwards:
            tried = replace(rival.with_series(ohm), at_limit=ohm in (0.0, most))
            further = None if broken_law(tried, frames) else Explanation.of(tried, frames, near)
            if further is None or further.score > best.score + DOUBTFUL_GAIN:
                break
            near = further
            best = min(best, further, key=attrgetter("score"))
    return best


@dataclass(eq=False)
class _ParameterSearch:
    """Search for the most probable value of a parameter of a circuit.

    Attributes
    ----------
    rival_of : callable
        Function (value) → the circuit with that value.
    frames : ComparedFrames
    best : Explanation
        The best explanation so far; the next fits begin at its cells.
    """

    rival_of: Callable[[float], Rival]
    frames: ComparedFrames
    best: Explanation

    def score(self, value: float) -> float:
        """Return the score of a value; infinite where no fit is found."""
        explanation = Explanation.of(self.rival_of(float(value)), self.frames, self.best)
        if explanation is None:
            return np.inf
        self.best = min(self.best, explanation, key=attrgetter("score"))
        return explanation.score

    def between(self, lower: float, upper: float, accuracy: float) -> None:
        """Search between two values."""
        scipy.optimize.minimize_scalar(
            self.score, bounds=(lower, upper), method="bounded", options={"xatol": accuracy}
        )


def with_series(explanation: Explanation, frames: ComparedFrames) -> Explanation:
    """Return a circuit's explanation with the most probable or the given resistance in series.

    The search is made about the best of SERIES_POINTS, and about the given resistance only where a
    change of it may gain by linear theory.
    """
    rival = explanation.rival
    most = most_in_series(rival, frames)
    if not most:
        return explanation
    spacing = most / (SERIES_POINTS - 1)
    best = explanation
    if rival.in_series is None:
        best = _best_beside(explanation, frames, most)
        if best is explanation:
            gain = _linear_gain(best, _response_to_series(best, spacing))
            if gain <= PARAMETER_COST:
                return explanation
    search = _ParameterSearch(
        lambda ohm: replace(rival.with_series(ohm), at_limit=False), frames, best
    )
    accuracy = SERIES_ACCURACY * spacing
    search.between(max(best.rival.ohm - spacing, 0.0), best.rival.ohm + spacing, accuracy)
    best = search.best.final
    if best.rival.in_series is None:
        return best
    at_limit = not 2 * accuracy < best.rival.ohm < most - 2 * accuracy
    return replace(best, rival=replace(best.rival, at_limit=at_limit))


def with_converter_memory(explanation: Explanation, frames: ComparedFrames) -> Explanation:
    """Return a circuit's explanation with the most probable or the given converter memory.

    A scene that states a memory keeps it. Other memories are searched for where they may gain by
    linear theory.
    """
    rival = explanation.rival
    if rival.scene.converter_memory is not None or rival.scene.readout is None:
        return explanation
    if not may_gain_by_memory(explanation, frames):
        return explanation
    search = _ParameterSearch(rival.with_memory, frames, explanation)
    coarse = min(MEMORIES, key=search.score)
    if search.best is explanation:
        return explanation
    search.between(coarse / 2, 2 * coarse, MEMORY_ACCURACY * coarse)
    fraction = search.best.rival.scene.known_memory or 0.0
    return search.best.final if MIN_MEMORY < fraction < MAX_MEMORY else explanation


def may_gain_by_memory(explanation: Explanation, frames: ComparedFrames) -> bool:
    """Return whether linear theory allows a memory of the converter a gain that is significant.

    A smaller gain is no doubt.
    """
    gain = _linear_gain(explanation, _response_to_memory(explanation, frames))
    return gain > MIN_LINEAR_SHARE * MIN_EVIDENCE_GAIN


def _linear_gain(explanation: Explanation, response: Array | None) -> float:
    """Return the gain of a parameter in score by linear theory; infinite where it is unknown.

    Parameters
    ----------
    explanation : Explanation
    response : array, shape (cells,), or None
        Change of d by one standard deviation of the parameter.
    """
    if explanation.pair is None or response is None:
        return np.inf
    pair = explanation.pair
    return pair.evidence.score - pair.explained(response[:, None]).score


def _response_to_series(explanation: Explanation, ohm: float) -> Array | None:
    """Return the change of d by a resistance in series, (cells,); None without a pair."""
    if explanation.pair is None:
        return None
    # in series with every driven line, or with either side of lines that are alike
    rows = explanation.pair.shape[0]
    driven = getattr(explanation.rival.scene.circuit, "driven", "rows")
    lines = slice(0, rows) if driven == "rows" else slice(rows, None)
    return np.asarray(ohm * explanation.pair.channels[:, lines].sum(axis=1))


def _response_to_memory(explanation: Explanation, frames: ComparedFrames) -> Array | None:
    """Return the change of d by a usual memory of the converter, (cells,); None without a pair."""
    if explanation.pair is None:
        return None
    remembering = frames.readings(explanation.rival.with_memory(USUAL_MEMORY))
    resting, loaded = (
        fit.response((readings.value - fit.measured.value)[None])[:, 0]
        for fit, readings in zip(explanation.fits, remembering, strict=True)
    )
    return np.asarray(loaded - resting)


def _without_series(rival: Rival) -> Rival:
    """Return the rival without resistance in series; the same where it has none."""
    return rival.with_series(0.0) if rival.scene.circuit.series_name and rival.ohm else rival


def most_in_series(rival: Rival, frames: ComparedFrames) -> float:
    """Return the largest resistance in series that the readings allow, ohm.

    The result is 0 where no such resistance is possible or known.
    """
    if not rival.scene.circuit.series_name or len(frames.standing) == 0:
        return 0.0
    without = _without_series(rival)
    try:
        read = frames.readings(without)
    except (InputError, *BROKEN):
        return 0.0
    limits = []
    for frame in read:
        sigma = frame.sigma_of_values
        if sigma is not None:
            limits.append(without.scene.circuit.most_in_series(frame.value[None], sigma[None]))
    most = min(limits)
    return MAX_SERIES_SHARE * most if np.isfinite(most) and most > 0 else 0.0
