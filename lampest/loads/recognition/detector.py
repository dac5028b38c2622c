"""Recognition of a single frame: candidates are fitted from several starts, and compared by their evidence.

The cost has many minima, because readings do not depend on rims between patches. Fits begin where templates match, with
coarse errors about the field of cells. They are then refined with the errors about the best explanation. Where no
candidate explains the frame, several loads are fitted together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.special import softmax

from lampest.files.levels import MAX_MEAN_SQUARE, SIGNIFICANT
from lampest.loads.recognition.candidates import FIELD, LOADS, UNIFORM, DiscSearch, Several, under
from lampest.loads.recognition.fit import (
    EVIDENCE_SHARE,
    MAX_LOG_RATIO,
    MAX_ROUNDS,
    SEARCH,
    CellLikelihood,
    Fit,
    Fitting,
    Verdict,
    along_diameter,
    field_fit,
    prior_cost,
    rises,
    states,
)
from lampest.loads.recognition.observation import Observation, Whitening, outliers
from lampest.loads.shapes.disc import EVEN, Disc
from lampest.loads.shapes.kinds import RoundCandidate
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel
from lampest.panel.response import BentSuction, PublishedResponse


@dataclass(frozen=True, eq=False)
class Detector:
    """Recognition of loads in single frames.

    Attributes
    ----------
    patch_mm : float
        Edge of a cell's film.
    loads : tuple of Candidate
        Kinds of load that are fitted.
    any_form : bool
        Whether contacts of any form are expected, so that no shape is fitted.
    most_loads : int
        Largest number of loads that are fitted together.
    response_levels : tuple of float
        Factors on the response's standard deviation, from a film as published to a bent, uneven one.
    exponents : tuple of float
        Alternative exponents of the published curve under suction, beside 1: ln f is known at one point only, through
        which a straight line or a threshold pass, too (docs/studies/mouths.md).
    """

    patch_mm: float
    loads: tuple[Candidate, ...] = LOADS
    any_form: bool = False
    most_loads: int = 3
    response_levels: tuple[float, ...] = (0.5, 1.2, 2.5)
    exponents: tuple[float, ...] = (1 / 3, 2.0)

    def search(self, panel: Panel) -> DiscSearch:
        """Return the matched filter with the templates of all loads."""
        templates = tuple(dict.fromkeys(template for load in self.loads for template in load.templates))
        return DiscSearch.over(panel, self.patch_mm, templates)

    def verdict(self, frame: Observation, before: Verdict | None = None) -> Verdict:
        """Return the verdict on a frame.

        Parameters
        ----------
        frame : Observation
        before : Verdict, optional
            Verdict on an earlier frame, whose loads are the first starts.
        """
        if (undisturbed := self.calm(frame)) is not None:
            return self._judged(undisturbed, ())
        (field, without), verdicts = field_fit(frame), list[Verdict]()
        if self.any_form:
            return self._judged(without, (field,))
        kinds = tuple(load for load in self.loads if not load.sucks or rises(without)) or self.loads
        # Single loads: from the earlier verdict, and by a new search if that is doubtful.
        if before is not None and before.loads:
            verdicts.append(self._settled(frame, before.loads, field, without))
        if not verdicts or self._doubtful(frame, verdicts[0], field):
            verdicts.append(self._settled(frame, self._coarse(kinds, field, without), field, without))
        # Several loads: one more disc at a time, where cells beside the explained ones have changed.
        single, discs, search = verdicts[-1], list[Disc](), self.search(frame.panel)
        for _ in range(self.most_loads):
            neighbour = search.beside(field.change, discs) if self._doubtful(frame, verdicts[-1], field) else None
            if neighbour is None:
                break
            discs.append(neighbour)
            if len(discs) > 1:
                fits = self._together(kinds, without, field, discs)
                verdicts.append(self._settled(frame, (*fits, *single.loads[:1]), field, without))
                discs = fits[0].discs
        return self._spread(frame, max(verdicts, key=lambda verdict: verdict.evidence))

    def calm(self, frame: Observation) -> Observation | None:
        """Return the frame without outliers if it shows no load, neither by χ² nor by a template; else None."""
        whitening, residual = Whitening.about(frame), frame.residual()
        undisturbed = frame.without(outliers(whitening, residual))
        errors = Whitening.about(undisturbed) @ residual
        if errors @ errors >= MAX_MEAN_SQUARE * errors.size:
            return None
        response = whitening @ frame.slope()
        # scores (B t)ᵀ e of the templates, N(0, 1) without a load
        stands_out = self.search(frame.panel).matched(response).T @ (response.T @ errors)
        return undisturbed if stands_out.max() < SIGNIFICANT else None

    def with_errors(self, frame: Observation, fit: Fit) -> tuple[Observation, Whitening]:
        """Return the frame without readings that contradict a fit, and the errors about the fit's change of cells."""
        calm = frame.without(self._contradicting(frame, fit))
        return calm, self.fitting(fit.candidate, calm).errors(fit, fit.scatter)

    def departure(self, frame: Observation, fit: Fit) -> tuple[Array, Array]:
        """Return the posterior departure d = ln r − ln r0 − x of the cells from a fit, and its covariance.

        With A = (∂f/∂ln r, E), the prior covariance P of d and the offsets, and C = A P Aᵀ + σ², the mean of d and of
        the offsets is P Aᵀ C⁻¹ (R − f(r0·e^x) − E δ0).

        Returns
        -------
        array, shape (rows, columns)
        array, shape (cells, cells)
        """
        baseline, cells = frame.baseline, fit.change.size
        calm, whitening = self.with_errors(frame, fit)
        resting = baseline.model_errors.resting_covariance(frame.seconds, cells)
        spread = resting + baseline.film(self.fitting(fit.candidate, frame).explained(fit), fit.scatter)
        both = np.hstack([calm.slope(fit.change), calm.offsets])
        # P Aᵀ: the baseline's covariance times Aᵀ, and that of drift and film times (∂f/∂ln r)ᵀ; C = root rootᵀ
        before = baseline.covariance[:cells] @ both.T + spread @ both[:, :cells].T
        mean = (before @ cho_solve((whitening.root, True), fit.residual)).reshape(fit.change.shape)
        prior = baseline.covariance[:cells, :cells] + spread
        return mean, prior - before @ cho_solve((whitening.root, True), before.T)

    def fitting(self, candidate: Candidate, frame: Observation) -> Fitting:
        """Return the problem of fitting a candidate to a frame."""
        return Fitting(candidate, frame, self.patch_mm)

    def _sharpened(
        self, frame: Observation, fit: Fit, explains: Fit, calm: Observation, scatter: float
    ) -> tuple[Observation, Fit]:
        """Return the frame without outliers, and the fit to it, by alternating fits and outlier detection.

        Outliers are detected among all readings in each round, so that a reading returns if a better fit explains it.

        Parameters
        ----------
        frame : Observation
            All readings.
        fit : Fit
            Start of the fit.
        explains : Fit
            Fit about which the errors of the first round are taken; later rounds take the fit itself.
        calm : Observation
            The frame without the outliers that are known at the start.
        scatter : float
            Relative deviation of the film.
        """
        dropped: list[int] | None = None
        for _ in range(MAX_ROUNDS):
            whitening = self.fitting(explains.candidate, calm).errors(explains, scatter)
            fit = explains = self.fitting(fit.candidate, calm).best(fit.parameters, whitening)
            far = self._contradicting(frame, fit)
            if far.tolist() == dropped:
                break
            calm, dropped = frame.without(far), far.tolist()
        return calm, fit

    def _contradicting(self, frame: Observation, fit: Fit) -> NDArray[np.intp]:
        whitening = self.fitting(fit.candidate, frame).errors(fit, fit.scatter)
        errors = whitening @ fit.residual
        suspicious = errors @ errors > MAX_MEAN_SQUARE * len(errors)
        return outliers(whitening, fit.residual) if suspicious else np.zeros(0, dtype=np.intp)

    def _coarse(self, kinds: Sequence[Candidate], field: Fit, calm: Observation) -> list[Fit]:
        """Return the best fit of every kind from the matches of its templates, with coarse errors about the field."""
        likelihood, fits = coarse_errors(calm, field.change), list[Fit]()
        starts = self.search(calm.panel).starts(likelihood.slope, likelihood.error)
        for load in kinds:
            fitting, begins = self.fitting(load, calm), [load.start(starts[template]) for template in load.templates]
            descents = [fitting.descended(begin, likelihood, SEARCH.evaluations // 2) for begin in begins]
            fits.append(fitting.fit_at(min(descents, key=lambda descent: descent[1].cost)[0], likelihood))
        return fits

    def _settled(self, frame: Observation, fits: Sequence[Fit], field: Fit, calm: Observation) -> Verdict:
        """Return the verdict on all candidates, refined from coarse fits.

        The best candidate is refined first. All others are fitted with its errors, and with their own errors if they
        come close. This is repeated until the best one stays the best.

        Parameters
        ----------
        frame : Observation
        fits : sequence of Fit
            Coarse fits.
        field, calm : Fit, Observation
            Results of `field_fit`.
        """
        explains, scatter = field, self.response_levels[-1] * frame.baseline.model_errors.response
        for _ in range(len(fits)):
            best = min(fits, key=attrgetter("score"))
            rivals = [fit for fit in fits if fit is not best]
            calm, best = self._sharpened(frame, best, explains, calm, scatter)
            best, whitening = self._own(calm, best)
            # equal errors for all candidates: otherwise a poor candidate would excuse its misfit by its own errors
            most = best.cost + MAX_LOG_RATIO
            besides = [self.fitting(fit.candidate, calm).best(fit.parameters, whitening, most) for fit in rivals]
            fits = [best, *(self._own(calm, fit)[0] if fit.cost < most else fit for fit in besides)]
            explains = best
            if min(fits, key=attrgetter("score")) is best:
                break
        return self._judged(calm, (*fits, field))

    def _own(self, calm: Observation, fit: Fit) -> tuple[Fit, Whitening]:
        """Return a fit with the errors about its own explained change, and these errors.

        The film's deviation is the one of `response_levels` with the largest evidence.
        """
        fitting, response = self.fitting(fit.candidate, calm), calm.baseline.model_errors.response
        errors = [fitting.errors(fit, level * response) for level in self.response_levels]
        # type-II maximum likelihood of the film's deviation on a grid
        likelihoods = (fitting.about(fit.parameters, whitening) for whitening in errors)
        levels = [fitting.fit_at(fit.parameters, likelihood).evidence for likelihood in likelihoods]
        whitening = errors[int(np.argmax(levels))]
        return fitting.best(fit.parameters, whitening), whitening

    def _together(self, kinds: Sequence[Candidate], calm: Observation, field: Fit, discs: Sequence[Disc]) -> list[Fit]:
        """Return coarse fits of several loads at once: one with the most probable kinds, and one in which all suck.

        Kinds are exchanged greedily, load by load, beginning with loads that all suck.

        Parameters
        ----------
        kinds : sequence of Candidate
        calm : Observation
        field : Fit
        discs : sequence of Disc
            Places of the loads.
        """
        likelihood = coarse_errors(calm, field.change)

        def fitted(loads: Sequence[tuple[Candidate, Array]]) -> Fit:
            parts, starts = zip(*sorted(loads, key=lambda load: not load[0].sucks), strict=True)
            fitting = self.fitting(Several.of(parts), calm)
            position, _ = fitting.descended(np.concatenate(starts), likelihood, SEARCH.evaluations // 2)
            return fitting.fit_at(position, likelihood)

        def likely(fit: Fit) -> float:
            return fit.evidence - prior_cost(fit, calm)

        first = next((load for load in kinds if load.sucks), kinds[0])
        sucking = best = fitted([(first, first.start(disc)) for disc in discs])
        for place in range(len(best.loads)):
            for kind in kinds:
                loads = best.loads
                part, starts = loads[place]
                if kind is not part and (disc := part.disc(starts)) is not None:
                    begin = kind.start(disc)
                    if isinstance(kind, RoundCandidate) and isinstance(part, RoundCandidate):
                        begin[-len(EVEN) :] = starts[-len(EVEN) :]  # both are equally uneven
                    loads[place] = kind, begin
                    best = max(best, fitted(loads), key=likely)
        return [best] if best is sucking else [best, sucking]

    def _judged(self, frame: Observation, fits: Sequence[Fit]) -> Verdict:
        """Return the verdict on these fits, on no load, and on an equal pressure on all cells."""
        whitening = Whitening.about(frame)
        uniform = [self.fitting(kind, frame).best(kind.mean(frame.panel), whitening) for kind in UNIFORM]
        return Verdict.of((*uniform, *fits), frame)

    def _doubtful(self, frame: Observation, verdict: Verdict, field: Fit) -> bool:
        """Return whether the best fit is poor, or leaves clearly changed cells beside its loads unexplained."""
        if verdict.best.candidate is FIELD or verdict.goodness > MAX_MEAN_SQUARE:
            return True
        explained = [verdict.best.change != 0, *(under(frame.panel, disc) for disc in verdict.best.discs)]
        # states 2 and 3 of the field outside the loads: changes of a few kPa and more
        left = np.where(np.any(explained, axis=0), 0.0, field.change)
        return bool(states(frame.panel, left).max() > 1)

    def _spread(self, frame: Observation, verdict: Verdict) -> Verdict:
        """Return the verdict in which a single best load has the full uncertainty of its diameter and suction."""
        best = verdict.best
        if best.candidate not in self.loads:
            return verdict
        calm, whitening = self.with_errors(frame, best)
        wide = self._along_curves(calm, along_diameter(self.fitting(best.candidate, calm), best, whitening), whitening)
        return replace(verdict, fits=tuple(wide if fit is best else fit for fit in verdict.fits))

    def _along_curves(self, calm: Observation, fit: Fit, whitening: Whitening) -> Fit:
        """Return the fit of a load that sucks with a covariance that includes alternative curves of the film.

        C = Σ q_a (C_a + (φ_a − φ_1)(φ_a − φ_1)ᵀ) over the exponents a, with q_a ∝ evidence^EVIDENCE_SHARE.
        """
        fits, baseline, film = [fit], calm.baseline, calm.baseline.response
        if not fit.candidate.sucks or not isinstance(film, PublishedResponse):
            return fit
        for exponent in self.exponents:
            bent = BentSuction(exponent=exponent, gain=film.gain, gain_sd=film.gain_sd)
            frame = replace(calm, baseline=replace(baseline, scene=replace(baseline.scene, response=bent)))
            fits.append(self.fitting(fit.candidate, frame).best(fit.parameters, whitening))
        shares = softmax(EVIDENCE_SHARE * np.array([alternative.evidence for alternative in fits]))
        # law of total covariance: mean of the covariances within the curves, and covariance between them
        offsets = np.array([alternative.parameters for alternative in fits]) - fit.parameters
        within = np.tensordot(shares, [alternative.covariance for alternative in fits], 1)
        return replace(fit, covariance=within + (shares[:, None] * offsets).T @ offsets)


def coarse_errors(frame: Observation, change: Array) -> CellLikelihood:
    """Return the likelihood about ln r/r0 (rows, columns), with independent deviations of all cells."""
    whitening = Whitening.about(frame, change, frame.baseline.model_errors.coarse**2 * np.eye(change.size))
    return CellLikelihood.about(frame, whitening, change)
