"""What stands on a panel in one frame: every candidate fitted from wherever the change looks like something.

Between patches lie many minima: fits begin wherever a template matches, with coarse errors, then those about the cells
that the readings show. In the end all are weighed by the errors about what the best explains; where none fits, more
loads at once are tried.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve

from lampest.loads.recognition.candidates import FIELD, LOADS, UNIFORM, DiscSearch, Several
from lampest.loads.recognition.evidence import Verdict, prior_cost
from lampest.loads.recognition.fit import COARSE_STEPS, UNLIKELY, Fit, Fitting, along_diameter, field_fit
from lampest.loads.recognition.observation import (
    COARSE_SD,
    FARTHEST,
    SUSPICIOUS,
    Explained,
    Observation,
    Whitening,
    outliers,
    unit,
)
from lampest.loads.shapes import OralDisc
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel

LEVELS = (0.5, 1.2, 2.5)  # times the response's standard deviation: from a film as published to a bent, uneven one
ROUNDS, MOST_AT_ONCE = 4, 3  # of fits with the errors about the one before, at most; loads


@dataclass(frozen=True, eq=False)
class Detector:
    """A panel whose cells have films of an edge of `patch_mm`, and the loads that may stand on it."""

    panel: Panel
    patch_mm: float
    loads: tuple[Candidate, ...] = LOADS

    @cached_property
    def search(self) -> DiscSearch:
        """The templates of all loads, all over the panel."""
        templates = tuple(dict.fromkeys(template for load in self.loads for template in load.templates))
        return DiscSearch.over(self.panel, self.patch_mm, templates)

    def verdict(self, frame: Observation, before: Verdict | None = None) -> Verdict:
        """What a frame shows. before : the verdict on an earlier one, whose loads are tried, too."""
        rest, residual = Whitening.at_rest(frame), frame.residual()
        calm = frame.without(outliers(rest, residual))
        errors = Whitening.at_rest(calm) @ residual
        stands_out = unit(rest @ self.search.readings(frame)).T @ errors
        if errors @ errors < SUSPICIOUS * errors.size and stands_out.max() < FARTHEST:
            return self._judged(calm, ())
        (field, without), found = field_fit(frame), list[Verdict]()
        if before is not None and before.loads:
            found.append(self._settled(frame, before.loads, field, without))
        if not found or _doubtful(found[0]):
            starts = self.search.starts(frame, rest)
            coarse = [self._coarse(load, frame, starts) for load in self.loads]
            found.append(self._settled(frame, coarse, field, without))
        single, discs = found[-1], list[Disc]()
        while _doubtful(found[-1]) and len(discs) < MOST_AT_ONCE:
            beside = self.search.beside(field.change, discs)
            if beside is None:
                break
            discs.append(beside)
            if len(discs) > 1:
                fits = self._together(frame, discs)
                found.append(self._settled(frame, (*fits, *single.loads[:1]), field, without))
                discs = discs_of(fits[0])
        return self._spread(frame, max(found, key=lambda one: one.evidence))

    def fitted(self, candidate: Candidate, frame: Observation, start: Fit | None) -> Fit:
        """One candidate whether or not anything else would do; from everywhere, unless the start of before fits."""
        fit = None if start is None else self._whole(frame, start, start.explained, frame)
        if fit is None or fit.chi2 > SUSPICIOUS * frame.measured.size:
            discs = self.search.starts(frame, Whitening.at_rest(frame))
            field, calm = field_fit(frame)
            other = self._whole(frame, self._coarse(candidate, frame, discs), field.explained, calm)
            fit = other if fit is None or other.chi2 < fit.chi2 else fit
        return fit

    def _fitting(self, candidate: Candidate, frame: Observation, whitening: Whitening) -> Fitting:
        return Fitting(self.panel, self.patch_mm, candidate, frame, whitening)

    def _whole(self, frame: Observation, fit: Fit, explained: Explained, calm: Observation) -> Fit:
        """A single fit, sharpened, with the whole width of its posterior."""
        scatter = frame.baseline.model_errors.response
        calm, (fit,) = self._sharpened(frame, [fit], explained, calm, scatter)
        return self._fitting(fit.candidate, calm, Whitening.of(calm, fit.explained, scatter)).best(fit.parameters)

    def _sharpened(
        self, frame: Observation, fits: Sequence[Fit], explained: Explained, calm: Observation, scatter: float
    ) -> tuple[Observation, Sequence[Fit]]:
        """(the frame without outliers, all fits to it) with the errors about what is explained, then the best explains.

        Errors that all fits share follow none of them. calm : the frame to begin with. From the second round on
        outliers are sought every time among all readings, so that none stays out which a better fit explains.
        """
        dropped: list[int] | None = None
        for number in range(ROUNDS):
            whitening = Whitening.of(calm, explained, scatter)
            fits = [self._fitting(fit.candidate, calm, whitening).best(fit.parameters, quick=True) for fit in fits]
            best = best_of(fits)
            explained = best.explained
            if number:
                far = best.outliers(frame)
                if far.tolist() == dropped:
                    break
                calm, dropped = frame.without(far), far.tolist()
        return calm, fits

    def _coarse(self, load: Candidate, frame: Observation, discs: Sequence[Disc]) -> Fit:
        """The best fit of a load from any disc, with the errors of a panel at rest."""
        fitting = self._fitting(load, frame, Whitening.at_rest(frame, COARSE_SD))
        fits: list[Fit] = []
        for disc in discs:
            most = min((fit.cost for fit in fits), default=np.inf) + UNLIKELY
            fits.append(fitting.best(load.start(disc), COARSE_STEPS, most, quick=True))
        return best_of(fits)

    def _settled(self, frame: Observation, fits: Sequence[Fit], field: Fit, calm: Observation) -> Verdict:
        """The verdict on all candidates from coarse fits; field, calm : of `field_fit`.

        All are weighed by what the best of them explains, from where they are or where that is. The film's relative
        deviation is that of LEVELS under which the frame is most probable.
        """
        response = frame.baseline.model_errors.response
        calm, fits = self._sharpened(frame, fits, field.explained, calm, LEVELS[-1] * response)
        best = best_of(fits)
        errors = [Whitening.of(calm, best.explained, level * response) for level in LEVELS]
        levels = [self._fitting(best.candidate, calm, one).best(best.parameters, quick=True) for one in errors]
        suits, whitening = max(zip(levels, errors, strict=True), key=lambda pair: pair[0].evidence)
        weighed = []
        for fit in fits:
            like = fit.candidate.like(suits.candidate, suits.parameters)
            starts = [fit.parameters] if like is None else [fit.parameters, like]
            weighed.append(best_of(self._fitting(fit.candidate, calm, whitening).best(start) for start in starts))
        return self._judged(calm, (*weighed, field))

    def _together(self, frame: Observation, discs: Sequence[Disc]) -> list[Fit]:
        """Coarse fits of loads about some discs at once: each of the likeliest kind, and all that suck."""
        whitening = Whitening.at_rest(frame, COARSE_SD)

        def fitted(loads: Sequence[tuple[Candidate, Array]]) -> Fit:
            parts, own = zip(*sorted(loads, key=lambda load: not load[0].sucks), strict=True)
            return self._fitting(Several.of(parts), frame, whitening).best(
                np.concatenate(own), COARSE_STEPS, quick=True
            )

        def likely(fit: Fit) -> float:
            return fit.evidence - prior_cost(self.panel, fit)

        first = next((load for load in self.loads if load.sucks), self.loads[0])
        sucking = best = fitted([(first, first.start(disc)) for disc in discs])
        for place in range(len(best.loads)):
            for kind in self.loads:
                loads = best.loads
                alike = kind.like(*loads[place])
                if kind is not loads[place][0] and alike is not None:
                    loads[place] = kind, alike
                    best = max(best, fitted(loads), key=likely)
        return [best] if best is sucking else [best, sucking]

    def _judged(self, frame: Observation, fits: Sequence[Fit]) -> Verdict:
        """The verdict on these, on nothing, and on the same pressure everywhere."""
        rest = Whitening.at_rest(frame)
        uniform = [self._fitting(kind, frame, rest).best(kind.mean(self.panel)) for kind in UNIFORM]
        return Verdict.of(self.panel, (*uniform, *fits), frame.measured.size, frame.baseline.response)

    def _spread(self, frame: Observation, verdict: Verdict) -> Verdict:
        """The verdict with a single load as large as it may be."""
        best = verdict.best
        if best.candidate not in self.loads:
            return verdict
        wide = along_diameter(self._fitting(best.candidate, *best.with_errors(frame)), best)
        return replace(verdict, fits=tuple(wide if fit is best else fit for fit in verdict.fits))


def best_of(fits: Iterable[Fit]) -> Fit:
    """The one with the least score, the first of equal ones."""
    return min(fits, key=lambda fit: fit.score)


def discs_of(fit: Fit) -> list[Disc]:
    """The discs of all its loads that are like one."""
    discs = [part.disc(own) for part, own in fit.loads]
    return [disc for disc in discs if disc is not None]


def _doubtful(verdict: Verdict) -> bool:
    """Whether another number of loads might explain more."""
    return verdict.best.candidate is FIELD or verdict.goodness > SUSPICIOUS


@dataclass(frozen=True, eq=False)
class OralDiscFit:
    """An oral disc fitted to the readings without an estimate between, and what follows from it.

    disc, disc_errors : its numbers and their standard deviations. disc_covariance : (8, 8) in the order of the numbers.
    cell_resistance : (rows, columns) ohm. fit : where the next frame's fit may start.
    """

    disc: Disc
    disc_errors: Disc
    disc_covariance: Array
    cell_resistance: Array
    fit: Fit


def fit_oral_disc(detector: Detector, frame: Observation, start: Fit | None = None) -> OralDiscFit:
    """argmin ‖R − f(r0·f(p(θ)))‖² over centre, diameters, suction, rim pressure and tilt, with their priors.

    Weighed by what films and panels depart by. The cells are those of the disc with the departures d that this leaves:
    ln r = ln r0 + x + d. With A = (∂f/∂ln r, E), C = A P Aᵀ + σ² the mean of d and of the offsets δ is
    (d, δ) = P Aᵀ C⁻¹ (R − f(r0·e^x) − E δ0). start : the frame before, or None: all of the panel is searched.
    """
    fit, baseline = detector.fitted(OralDisc.candidate, frame, start), frame.baseline
    disc, slopes = OralDisc.candidate.disc_with_slopes(fit.parameters)
    covariance, cells = slopes @ fit.covariance @ slopes.T, fit.change.size
    calm, whitening = fit.with_errors(frame)
    resting = baseline.model_errors.resting_covariance(frame.seconds, cells)
    spread = resting + baseline.film(fit.explained, fit.scatter)
    both = np.hstack([calm.slope(fit.change), calm.offsets])
    before = baseline.covariance[:cells] @ both.T + spread @ both[:, :cells].T
    departure = (before @ cho_solve((whitening.root, True), fit.residual)).reshape(fit.change.shape)
    resistance = np.exp(baseline.logarithm + fit.change + departure)
    return OralDiscFit(disc, Disc(*np.sqrt(np.diag(covariance))), covariance, resistance, fit)
