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

from lampest.estimate.cells_fit import CellsFit, fitted
from lampest.estimate.changed_cells import PARAMETER_COST, mostly_still
from lampest.estimate.compared_frames import ComparedFrames, broken_law
from lampest.estimate.fitted_pair import FittedPair
from lampest.estimate.nuisances import MAX_CANDIDATES, MIN_EVIDENCE_GAIN, BetterExplanation
from lampest.estimate.rivals import Rival, changes_beyond_noise, rivals_of
from lampest.files.errors import BROKEN, InputError
from lampest.files.levels import SIGNIFICANCE
from lampest.panel.readouts.branches import branch

# −2 ln evidence by which another circuit may beat the scene's without a doubt: of 430 recordings
# with the right circuit nearly all gain less (docs/theory/model_check.md).
DOUBTFUL_GAIN = 15.0
# Of the largest resistance in series that readings allow: all of it would short the panel.
MAX_SERIES_SHARE = 0.98
# Median standard deviation of the log cells beyond which linear theory does not hold: 8 bits and
# one reading on 12 x 8 cells leave 1.4, and distinguishable circuits at most 0.2
# (docs/studies/model_check.py).
MAX_CELL_SD = 0.5
SERIES_POINTS = 5  # resistances in series that are tried, before a search about the best one
# Fractions of the channel before that a converter may keep.
MEMORIES = (0.01, 0.02, 0.04, 0.08, 0.16)
# Fractions nearer to the ends of the searched range, half the smallest and twice the largest of
# MEMORIES, are no finding.
MIN_MEMORY = MEMORIES[0] / 2 * 1.1
MAX_MEMORY = MEMORIES[-1] * 1.9
MEMORY_ACCURACY = 0.03  # of the search about the best one, as a share of it
SERIES_ACCURACY = 0.05  # of that search, as a share of their distance


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
            Explanation by a similar circuit, at whose cells the fits begin.
        patient : bool
            Whether the fit is searched for from every start and accepted with any misfit. Otherwise
            the circuit is given up at the first frame that it does not explain.
        """
        fits: list[CellsFit] = []
        with suppress(InputError, *BROKEN):
            for number, readings in enumerate(frames.readings(rival)):
                start = None if near is None else near.fits[number].cells
                fit = fitted(rival.scene, readings, start, patient=patient)
                # of two panels that read alike the one that continues the unloaded panel is meant
                if fit is not None and fits and branch(fit.network) != branch(fits[0].network):
                    fit = fitted(rival.scene, readings, fits[0].cells, patient=patient)
                if fit is None or (not patient and fit.tail < SIGNIFICANCE):
                    return None
                fits.append(fit)
            pair = FittedPair.of(*fits) if len(fits) == 2 and fits[0].jacobian.size else None
            explanation = cls(rival, tuple(fits), pair)
            return explanation if np.isfinite(explanation.score) else None
        return None

    @cached_property
    def _costs(self) -> float:
        """Misfit χ² of each frame, and PARAMETER_COST of each bound.

        Thus no circuit gains by bounds.
        """
        return sum(
            fit.chi_square + PARAMETER_COST * int(fit.readings.bounds.sum()) for fit in self.fits
        )

    @cached_property
    def score(self) -> float:
        """−2 ln density of the loaded frame, and the costs of parameters."""
        return 0.0 if self.pair is None else self.pair.density + self._costs

    @cached_property
    def beyond_noise(self) -> float:
        """−2 ln evidence of the changes beyond that of noise alone, and the costs of parameters."""
        return 0.0 if self.pair is None else self.pair.beyond_noise + self._costs


def better_rival(frames: ComparedFrames, specified: Explanation | None) -> BetterExplanation:
    """Return the rival that explains the readings better than the scene's circuit.

    It explains them where the scene's circuit does not, or better by MIN_EVIDENCE_GAIN. Rivals
    under which most cells have moved do not count, because the still cells cannot be identified
    then.

    Parameters
    ----------
    frames : ComparedFrames
    specified : Explanation or None
        The explanation by the scene's circuit; None where it does not explain the readings.
    """
    if specified is not None and not _needs_rivals(specified):
        return BetterExplanation()
    candidates = _likely_rivals(frames, specified)
    assumed = [] if specified is None else [specified]
    candidates += [with_series(explanation, frames) for explanation in (*candidates, *assumed)]
    candidates += [with_converter_memory(explanation, frames) for explanation in assumed]
    best = _best_candidate(candidates, frames)
    return BetterExplanation() if best is None else _compared(specified, best, frames)


def _needs_rivals(specified: Explanation) -> bool:
    """Return whether a rival can gain enough evidence over the scene's circuit.

    Where cells are determined badly, linear theory does not hold, and none is tried.
    """
    pair = specified.pair
    if pair is None or pair.beyond_noise < MIN_EVIDENCE_GAIN:
        return False
    deviations = [np.sqrt(np.diag(fit.covariance)) for fit in specified.fits]
    return not np.median(deviations) > MAX_CELL_SD


def _likely_rivals(frames: ComparedFrames, specified: Explanation | None) -> list[Explanation]:
    """Return the MAX_CANDIDATES best explanations by rivals, better ones than the scene's."""
    change = changes_beyond_noise(frames.specified.scene, frames.specified.readings(), frames.role)
    mostly_increases = bool(change.max(initial=0.0) > -change.min(initial=0.0))
    explanations = [
        Explanation.of(rival, frames) or some_in_series(rival, frames)
        for rival in rivals_of(frames.specified, reversed_too=mostly_increases)
    ]
    if specified is None:
        explanations.append(some_in_series(frames.specified, frames))
    threshold = np.inf if specified is None else specified.score
    better = [
        explanation
        for explanation in explanations
        if explanation is not None and explanation.score < threshold
    ]
    return sorted(better, key=attrgetter("score"))[:MAX_CANDIDATES]


def _best_candidate(
    candidates: Sequence[Explanation], frames: ComparedFrames
) -> Explanation | None:
    """Return the candidate with the largest evidence, less the costs of its parameters.

    Candidates do not count under which most cells have moved, whose inequalities the readings
    break, or that do not differ from the scene's circuit.
    """
    specified_memory = frames.specified.scene.converter_memory
    valid = []
    for candidate in candidates:
        still = candidate.pair is None or mostly_still(candidate.pair.moved)
        if still and not broken_law(candidate.rival, frames) and candidate.rival.name:
            valid.append(candidate)

    def cost(candidate: Explanation) -> float:
        # Among rivals a resistance in series is one more parameter, and so is a memory.
        has_series = candidate.rival.in_series is not None
        has_memory = candidate.rival.scene.converter_memory != specified_memory
        return candidate.beyond_noise + PARAMETER_COST * (has_series + has_memory)

    return min(valid, key=cost, default=None)


def _compared(
    specified: Explanation | None, best: Explanation, frames: ComparedFrames
) -> BetterExplanation:
    """Return the best candidate as better, as nearly as good, or as neither."""
    if specified is None or best.pair is None:
        return BetterExplanation(best.rival.name)
    gain = (specified.beyond_noise - best.beyond_noise) / best.pair.excess
    if specified.pair is None or gain <= DOUBTFUL_GAIN or not best.pair.moved.any():
        return BetterExplanation()
    insignificant = gain <= MIN_EVIDENCE_GAIN
    if insignificant or specified.pair.gain_apart(best.pair) <= PARAMETER_COST:
        # A resistance in series follows hidden errors of the circuit, a memory the edge of a load:
        # alone, neither is a doubt.
        as_specified = best.rival.scene.converter_memory == frames.specified.scene.converter_memory
        doubtful = insignificant and best.rival.kind and as_specified
        return BetterExplanation(nearly=best.rival.name if doubtful else "")
    moved = int(best.pair.moved.sum())
    moved_as_specified = int(specified.pair.moved.sum())
    return BetterExplanation(best.rival.name, frames.loaded, moved, moved_as_specified)


def some_in_series(rival: Rival, frames: ComparedFrames) -> Explanation | None:
    """Return a circuit's explanation with the best one of SERIES_POINTS resistances in series.

    None without any.
    """
    most = most_in_series(rival, frames)
    points = np.linspace(0.0, most, SERIES_POINTS) if most else ()
    tried = (replace(rival.with_series(ohm), at_limit=ohm in (0.0, most)) for ohm in points)
    explanations = (Explanation.of(candidate, frames) for candidate in tried)
    return min(filter(None, explanations), key=attrgetter("score"), default=None)


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
    """Return a circuit's explanation with the most probable or the given resistance in series."""
    rival = explanation.rival
    coarse = explanation if rival.in_series is not None else some_in_series(rival, frames)
    best = min(filter(None, (explanation, coarse)), key=attrgetter("score"))
    spacing = most_in_series(rival, frames) / (SERIES_POINTS - 1)
    if not spacing:
        return best
    search = _ParameterSearch(
        lambda ohm: replace(rival.with_series(ohm), at_limit=False), frames, best
    )
    accuracy = SERIES_ACCURACY * spacing
    search.between(max(best.rival.ohm - spacing, 0.0), best.rival.ohm + spacing, accuracy)
    best = search.best
    most = (SERIES_POINTS - 1) * spacing
    at_limit = not 2 * accuracy < best.rival.ohm < most - 2 * accuracy
    if best.rival.in_series is None:
        return best
    return replace(best, rival=replace(best.rival, at_limit=at_limit))


def with_converter_memory(explanation: Explanation, frames: ComparedFrames) -> Explanation:
    """Return a circuit's explanation with the most probable or the given converter memory.

    A scene that states a memory keeps it.
    """
    rival = explanation.rival
    if rival.scene.converter_memory is not None or rival.scene.readout is None:
        return explanation
    search = _ParameterSearch(rival.with_memory, frames, explanation)
    coarse = min(MEMORIES, key=search.score)
    if search.best is explanation:
        return explanation
    search.between(coarse / 2, 2 * coarse, MEMORY_ACCURACY * coarse)
    fraction = search.best.rival.scene.known_memory or 0.0
    return search.best if MIN_MEMORY < fraction < MAX_MEMORY else explanation


def most_in_series(rival: Rival, frames: ComparedFrames) -> float:
    """Return the largest resistance in series that the readings allow, ohm.

    It is 0 where none is possible or known.
    """
    if not rival.scene.circuit.series_name or len(frames.standing) == 0:
        return 0.0
    without = rival.with_series(0.0)
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
