"""Recognition of a single frame.

Candidates are fitted from several starts, and compared by their evidence. The cost has many minima,
because readings do not depend on rims between patches. Fits begin where templates match, with
coarse errors about the field of cells. The errors about the best explanation then refine them.
Where no candidate explains the frame, several loads are fitted together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from lampest.apps.recognition.bent_suction import BentSuction
from lampest.apps.recognition.candidates import (
    FIELD,
    FULL_KPA,
    LOADS,
    UNIFORM,
    DiscSearch,
    Several,
    under,
)
from lampest.apps.recognition.fit import (
    MAX_LOG_RATIO,
    SEARCH,
    CellLikelihood,
    Fit,
    Fitting,
    field_fit,
    inverse_beside_prior,
    states,
)
from lampest.apps.recognition.observation import Observation, Whitening, alone, outliers
from lampest.apps.recognition.profile import along_diameter
from lampest.apps.recognition.suction import Suction, groups_of, may_suck, suctions
from lampest.apps.recognition.verdict import (
    EVIDENCE_SHARE,
    MAX_MISFIT,
    Verdict,
    prior_cost,
)
from lampest.files.levels import MAX_MEAN_SQUARE, SIGNIFICANT
from lampest.panel.panel import Array, Panel
from lampest.panel.response import PublishedResponse
from lampest.posterior.gaussian import Conditioned
from lampest.recording.shapes.disc import Disc
from lampest.recording.shapes.shape import Candidate

# χ² of a reading in a fit with coarse errors, beyond which it is not refined: rods, rings and pairs
# of rods have up to 0.5, hands and rocks up to 3.
MAX_COARSE = 0.7
SHARPENED = 2  # rounds of fits and outlier detection
START_SIZES = (0.8, 1.1)  # diameters of the starts, over that of the area of the risen cells


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
        Factors on the response's standard deviation, from a film as published to a bent, uneven
        one.
    exponents : tuple of float
        Alternative exponents of the published curve under suction, beside 1: ln f is known at one
        point only, through which a straight line or a threshold pass, too (docs/studies/mouths.md).
    """

    patch_mm: float
    loads: tuple[Candidate, ...] = LOADS
    any_form: bool = False
    most_loads: int = 3
    response_levels: tuple[float, ...] = (0.5, 1.2, 2.5)
    exponents: tuple[float, ...] = (1 / 3, 2.0)

    def search(self, panel: Panel) -> DiscSearch:
        """Return the matched filter with the templates of all loads."""
        templates = tuple(
            dict.fromkeys(template for load in self.loads for template in load.templates)
        )
        return DiscSearch.over(panel, self.patch_mm, templates)

    def verdict(self, frame: Observation, former: Sequence[Fit] = ()) -> Verdict:
        """Return the verdict on a frame.

        Fits of the same candidates to an earlier frame, `former`, are starts where they still
        explain the readings. Cells that have risen decide whether something sucks, and where. Every
        place under suction is then fitted with a load that sucks, and its neighbours are free.
        Where nothing sucks, the loads that press are compared.
        """
        undisturbed = self.calm(frame)
        if undisturbed is not None:
            return self._judged(undisturbed, ())
        field, without = field_fit(frame)
        if self.any_form:
            return self._judged(without, (field,))
        kinds = tuple(load for load in self.loads if load.sucks)
        places = suctions(without)[: self.most_loads]
        if places and kinds:
            # cells rise, too, where other readings saturate under a heavy load: no disc fits then
            verdict = self._sucking(frame, kinds, places, field, without, former)
            refuted = verdict.goodness > MAX_MISFIT
            found = self._judged(without, (field,)) if refuted else verdict
            return replace(found, cells=without)
        # Where fallen cells hide others, the shape decides whether these have risen.
        hidden = may_suck(without)
        kinds = tuple(load for load in self.loads if hidden or not load.sucks)
        if not kinds:
            return self._judged(without, (field,))
        # A coarse fit that leaves changed cells to other loads is not worth a refinement.
        coarse = [
            fit
            for fit in self._coarse(kinds, field, without, former)
            if not self._incomplete(without, fit, field)
        ]
        lowest = min((fit.chi2 for fit in coarse), default=np.inf)
        shaped = lowest < MAX_COARSE * frame.measured.size
        single = self._settled(frame, coarse if shaped else (), field, without)
        groups = groups_of(frame.panel, states(frame.panel, field.change) > 1)
        verdict = single
        poor = single.best.candidate is FIELD or single.goodness > MAX_MEAN_SQUARE
        poor = poor or self._incomplete(frame, single.best, field)
        if poor and 2 <= len(groups) <= self.most_loads:
            discs = [self._under(frame.panel, group) for group in groups]
            several = self._together(kinds, without, field, discs, former)
            fits = several.chi2 <= MAX_COARSE * frame.measured.size
            if fits and not self._incomplete(without, several, field):
                together = self._settled(frame, (several, *single.loads[:1]), field, without)
                verdict = max(single, together, key=lambda verdict: verdict.best.evidence)
        if self._incomplete(frame, verdict.best, field):
            verdict = self._judged(without, (field,))
        return replace(self._spread(frame, verdict), cells=without)

    def _sucking(
        self,
        frame: Observation,
        kinds: Sequence[Candidate],
        places: Sequence[Suction],
        field: Fit,
        without: Observation,
        former: Sequence[Fit],
    ) -> Verdict:
        """Return the verdict with one load at each place under suction, of the most probable kind.

        The area of the risen cells gives the starts. The standard deviation of other cells is their
        change, so that a body next to a mouth does not pull at its rim.
        """
        loose = np.abs(field.change)
        panel = frame.panel
        frame = replace(frame, loose=loose)
        without = replace(without, loose=loose)
        fits = list[Fit]()
        known = list[Fit]()
        for kind in kinds:
            candidate = kind if len(places) == 1 else Several.of((kind,) * len(places))
            fitting = self.fitting(candidate, without)
            for larger in START_SIZES:
                discs = [place.disc(panel, larger) for place in places]
                covered = np.any([under(panel, disc) for disc in discs], axis=0)
                spread = np.where(covered, frame.baseline.model_errors.coarse, loose).ravel()
                whitening = Whitening.about(without, field.change, np.diag(spread**2))
                likelihood = CellLikelihood.about(without, whitening, field.change)
                start = fitting.effect(np.concatenate([kind.start(disc) for disc in discs]))
                point = fitting.descended(start, likelihood, SEARCH.evaluations // 2)
                fits.append(fitting.fit_at(point.effect, likelihood))
            known += [fit for fit in former if fit.candidate is candidate]
        scatter = self.response_levels[-1] * self._response(frame)
        best = max(fits, key=attrgetter("evidence"))
        best = self._less_lost(without, best, known, scatter)
        calm, best = self._sharpened(frame, best, best, without, scatter)
        best, _ = self._own(calm, best)
        verdict = self._judged(calm, (best,), places)
        return self._spread(frame, verdict)

    def _less_lost(
        self, frame: Observation, coarse: Fit, former: Sequence[Fit], scatter: float
    ) -> Fit:
        """Return the start of a refinement: a coarse fit, or a former one that misfits far less.

        Both are compared with the errors about the coarse fit. A coarse fit may lie where the
        circuit, linearised about the field, has little in common with the exact one.
        """
        if not former:
            return coarse
        whitening = self.fitting(coarse.candidate, frame).errors(coarse, scatter)
        exact = list[Fit]()
        for fit in (coarse, *former):
            fitting = self.fitting(fit.candidate, frame)
            effect = fitting.effect(fit.parameters)
            exact.append(fitting.fit_at(effect, fitting.about(effect, whitening)))
        best = min(exact, key=attrgetter("cost"))
        return best if exact[0].cost > best.cost + MAX_LOG_RATIO else coarse

    def calm(self, frame: Observation) -> Observation | None:
        """Return the frame without outliers if it shows no load; else None.

        To show no load, it must show one neither by χ² nor by a template. In a circuit without
        crosstalk a pressed cell changes its own reading alone, as an outlier does; but a contact
        has neighbouring cells, so that only readings without an outlying neighbour are left out.
        """
        whitening = Whitening.about(frame)
        residual = frame.residual()
        undisturbed = frame.without(alone(frame.panel, outliers(whitening, residual)))
        errors = Whitening.about(undisturbed) @ residual
        if errors @ errors >= MAX_MEAN_SQUARE * errors.size:
            return None
        response = whitening @ frame.slope()
        # scores (B t)ᵀ e of the templates, N(0, 1) without a load
        stands_out = self.search(frame.panel).matched(response).T @ (response.T @ errors)
        return undisturbed if stands_out.max() < SIGNIFICANT else None

    def with_errors(self, frame: Observation, fit: Fit) -> tuple[Observation, Whitening]:
        """Return the frame without readings that contradict a fit.

        Returns
        -------
        calm : Observation
            The frame without these readings.
        whitening : Whitening
            Errors about the fit's change of cells.
        """
        contradicting, whitening = self._contradicting(frame, fit)
        if not contradicting.size:
            return frame, whitening
        calm = frame.without(contradicting)
        return calm, self.fitting(fit.candidate, calm).errors(fit, fit.scatter)

    def departure(self, frame: Observation, fit: Fit) -> tuple[Array, Array]:
        """Return the posterior departure of the cells from a fit, and its covariance.

        The departure is d = ln r − ln r0 − x. With A = (∂f/∂ln r, E), the prior covariance P of d
        and the offsets, and C = A P Aᵀ + σ², the mean of d and of the offsets is P Aᵀ C⁻¹ (R −
        f(r0·e^x) − E δ0).

        Returns
        -------
        array, shape (rows, columns)
        array, shape (cells, cells)
        """
        baseline = frame.baseline
        cells = fit.change.size
        calm, whitening = self.with_errors(frame, fit)
        resting = baseline.model_errors.resting_covariance(frame.seconds, cells)
        spread = resting + self.fitting(fit.candidate, frame).film(fit, fit.scatter)
        network = baseline.network(fit.change)
        both = np.hstack([calm.sensitivity(network), calm.offsets(network)])
        # P Aᵀ: the baseline's covariance times Aᵀ, and that of drift and film times (∂f/∂ln r)ᵀ; C
        # = root rootᵀ
        before = baseline.covariance[:cells] @ both.T + spread @ both[:, :cells].T
        prior = baseline.covariance[:cells, :cells] + spread
        conditioned = Conditioned(prior, before, whitening.root)
        return conditioned.mean(fit.residual).reshape(fit.change.shape), conditioned.covariance

    def fitting(self, candidate: Candidate, frame: Observation) -> Fitting:
        """Return the problem of fitting a candidate to a frame."""
        return Fitting(candidate, frame, self.patch_mm)

    def _sharpened(
        self, frame: Observation, fit: Fit, explains: Fit, calm: Observation, scatter: float
    ) -> tuple[Observation, Fit]:
        """Return the frame without outliers, and the fit to it.

        Fits and outlier detection alternate. Outliers are detected among all readings in each
        round, so that a reading returns if a better fit explains it.

        Parameters
        ----------
        frame : Observation
            All readings.
        fit : Fit
            Start of the fit.
        explains : Fit
            Fit about which the errors of the first round are taken; later rounds take the fit
            itself.
        calm : Observation
            The frame without the outliers that are known at the start.
        scatter : float
            Relative deviation of the film.
        """
        whitening = self.fitting(explains.candidate, calm).errors(explains, scatter)
        dropped: list[int] | None = None
        for _ in range(SHARPENED):
            fitting = self.fitting(fit.candidate, calm)
            fit = fitting.best(fitting.effect(fit.parameters), whitening)
            contradicting, whitening = self._contradicting(frame, fit)
            if contradicting.tolist() == dropped:
                break
            calm = frame
            dropped = contradicting.tolist()
            if dropped:
                calm = frame.without(contradicting)
                whitening = self.fitting(fit.candidate, calm).errors(fit, scatter)
        return calm, fit

    def _contradicting(self, frame: Observation, fit: Fit) -> tuple[NDArray[np.intp], Whitening]:
        """Return the numbers of outliers if the fit is poor, and the errors about its change."""
        whitening = self.fitting(fit.candidate, frame).errors(fit, fit.scatter)
        errors = whitening @ fit.residual
        suspicious = errors @ errors > MAX_MEAN_SQUARE * len(errors)
        none = np.zeros(0, dtype=np.intp)
        return outliers(whitening, fit.residual) if suspicious else none, whitening

    @staticmethod
    def _still_explains(
        fitting: Fitting, former: Sequence[Fit], likelihood: CellLikelihood
    ) -> Fit | None:
        """Return the former fit of a candidate with the evidence of a frame with coarse errors.

        The result is None where there is none, or where it does not explain the frame.
        """
        for fit in former:
            if fit.candidate is fitting.candidate:
                known = fitting.fit_at(fitting.effect(fit.parameters), likelihood)
                explains = 2 * known.cost < MAX_COARSE * fitting.frame.measured.size
                return known if explains else None
        return None

    def _coarse(
        self,
        kinds: Sequence[Candidate],
        field: Fit,
        calm: Observation,
        former: Sequence[Fit],
    ) -> list[Fit]:
        """Return the best fit of every kind, from its former fit or the matches of its templates.

        The errors are coarse ones about the field.
        """
        likelihood = coarse_errors(calm, field.change)
        fits = list[Fit]()
        starts = self.search(calm.panel).starts(likelihood.slope, likelihood.error)
        for load in kinds:
            fitting = self.fitting(load, calm)
            known = self._still_explains(fitting, former, likelihood)
            if known is not None:
                fits.append(known)
                continue
            begins = [fitting.effect(load.start(starts[template])) for template in load.templates]
            points = [
                fitting.descended(begin, likelihood, SEARCH.evaluations // 2) for begin in begins
            ]
            lowest = min(points, key=attrgetter("cost"))
            fits.append(fitting.fit_at(lowest.effect, likelihood))
        return fits

    def _settled(
        self, frame: Observation, fits: Sequence[Fit], field: Fit, calm: Observation
    ) -> Verdict:
        """Return the verdict on all candidates, refined from coarse fits.

        The best candidate is refined first. All others are fitted with its errors, and with their
        own errors if they come close. The refinement is repeated until the best one stays the best.

        Parameters
        ----------
        frame : Observation
        fits : sequence of Fit
            Coarse fits.
        field, calm : Fit, Observation
            Results of `field_fit`.
        """
        explains = field
        without = calm
        scatter = self.response_levels[-1] * frame.baseline.model_errors.response
        for _ in range(len(fits)):
            best = min(fits, key=attrgetter("score"))
            alternatives = [fit for fit in fits if fit is not best]
            calm, best = self._sharpened(frame, best, explains, calm, scatter)
            best, whitening = self._own(calm, best)
            # equal errors for all candidates: otherwise a poor candidate would excuse its misfit by
            # its own errors
            most = best.cost + MAX_LOG_RATIO
            besides = []
            for fit in alternatives:
                fitting = self.fitting(fit.candidate, calm)
                besides.append(fitting.best(fitting.effect(fit.parameters), whitening, most))
            fits = [best, *(self._own(calm, fit)[0] if fit.cost < most else fit for fit in besides)]
            explains = best
            if min(fits, key=attrgetter("score")) is best:
                break
        verdict = self._judged(calm, (*fits, field))
        # outliers about a shape may be other contacts
        return replace(verdict, frame=without) if verdict.best is field else verdict

    def _own(self, calm: Observation, fit: Fit) -> tuple[Fit, Whitening]:
        """Return a fit with the errors about its own explained change, and these errors.

        The film's deviation is the one of `response_levels` whose own fit has the largest evidence.
        """
        fitting = self.fitting(fit.candidate, calm)
        response = calm.baseline.model_errors.response
        scatters = [level * response for level in self.response_levels]
        errors = fitting.errors_by_scatter(fit, scatters)
        # type-II maximum likelihood of the film's deviation on a grid, the most promising one first
        begin = fitting.effect(fit.parameters)
        likelihoods = [fitting.about(begin, whitening) for whitening in errors]
        within_reach = [fitting.reachable(begin, likelihood) for likelihood in likelihoods]
        best = fit
        chosen = errors[0]
        highest = -np.inf
        for number in np.argsort(within_reach)[::-1]:
            if within_reach[number] < highest:
                break
            own = fitting.best(begin, errors[number])
            if own.evidence > highest:
                highest = own.evidence
                best = own
                chosen = errors[number]
        return best, chosen

    def _together(
        self,
        kinds: Sequence[Candidate],
        calm: Observation,
        field: Fit,
        discs: Sequence[Disc],
        former: Sequence[Fit],
    ) -> Fit:
        """Return the coarse fit of several loads at once.

        Every load is of the kind with which the fit is most probable, or of its former kind. Kinds
        are exchanged greedily, load by load.

        Parameters
        ----------
        kinds : sequence of Candidate
        calm : Observation
        field : Fit
        discs : sequence of Disc
            Places of the loads.
        former : sequence of Fit
            See `verdict`.
        """
        likelihood = coarse_errors(calm, field.change)
        for fit in former:
            if len(fit.loads) == len(discs) and {part for part, _ in fit.loads} <= set(kinds):
                fitting = self.fitting(fit.candidate, calm)
                known = self._still_explains(fitting, former, likelihood)
                if known is not None:
                    return known

        def fitted(loads: Sequence[tuple[Candidate, Array]]) -> Fit:
            parts, starts = zip(*loads, strict=True)
            fitting = self.fitting(Several.of(parts), calm)
            start = fitting.effect(np.concatenate(starts))
            point = fitting.descended(start, likelihood, SEARCH.evaluations // 2)
            return fitting.fit_at(point.effect, likelihood)

        best = fitted([(kinds[0], kinds[0].start(disc)) for disc in discs])
        for place, disc in enumerate(discs):
            for kind in kinds[1:]:
                loads = best.loads
                loads[place] = kind, kind.start(disc)
                best = max(best, fitted(loads), key=lambda fit: fit.evidence - prior_cost(fit))
        return best

    @staticmethod
    def _under(panel: Panel, group: NDArray[np.bool_]) -> Disc:
        """Return the full disc of the same place and area as a group of cells, (rows, columns)."""
        x, y = panel.places_mm[:, group].mean(axis=1)
        diameter = 2 * (float(group.sum()) / np.pi) ** 0.5 * panel.pitch_mm
        return Disc(float(x), float(y), diameter, 0.0, *FULL_KPA, 0.0, 0.0)

    @staticmethod
    def _response(frame: Observation) -> float:
        return frame.baseline.model_errors.response

    def _judged(
        self, frame: Observation, fits: Sequence[Fit], places: Sequence[Suction] = ()
    ) -> Verdict:
        """Return the verdict on these fits, on no load, and on an equal pressure on all cells."""
        whitening = Whitening.about(frame)
        uniform = []
        for kind in UNIFORM:
            fitting = self.fitting(kind, frame)
            uniform.append(fitting.best(fitting.effect(kind.mean(frame.panel)), whitening))
        return Verdict.of((*uniform, *fits), frame, places)

    @staticmethod
    def _incomplete(frame: Observation, fit: Fit, field: Fit) -> bool:
        """Return whether cells outside the loads of a fit have clearly changed."""
        if fit.candidate in (*UNIFORM, FIELD):
            return False
        explained = [
            fit.change != 0,
            *(under(frame.panel, disc) for disc in fit.discs),
            # the field spreads errors of the readings and changes of a load over other cells
            np.abs(frame.free_map) <= SIGNIFICANT * frame.free_sd,
        ]
        # states 2 and 3 of the field outside the loads: changes of a few kPa and more
        unexplained = np.where(np.any(explained, axis=0), 0.0, field.change)
        return bool(states(frame.panel, unexplained).max() > 1)

    def _spread(self, frame: Observation, verdict: Verdict) -> Verdict:
        """Return the verdict with a single best load's full uncertainty of diameter and suction."""
        best = verdict.best
        if best.candidate not in self.loads:
            return verdict
        calm, whitening = self.with_errors(frame, best)
        fitting = self.fitting(best.candidate, calm)
        likelihood = CellLikelihood.about(calm, whitening, best.change)
        wide = along_diameter(fitting, best, likelihood)
        # a load whose shape explains the frame poorly is as much less sure
        wide = replace(wide, covariance=wide.covariance * max(1.0, verdict.goodness))
        wide = self._along_curves(calm, wide, whitening)
        return replace(verdict, fits=tuple(wide if fit is best else fit for fit in verdict.fits))

    def _along_curves(self, calm: Observation, fit: Fit, whitening: Whitening) -> Fit:
        """Return the fit of a load that sucks, including alternative curves of the film.

        Its covariance includes the alternative curves. C = C_1 + Σ q_a (φ_a − φ_1)(φ_a − φ_1)ᵀ over
        the exponents a, with q_a ∝ evidence^EVIDENCE_SHARE. The circuit is linearised at φ_1.
        """
        baseline = calm.baseline
        film = calm.baseline.response
        if not fit.candidate.sucks or not isinstance(film, PublishedResponse):
            return fit
        likelihood = CellLikelihood.about(calm, whitening, fit.change)
        offsets = []
        evidence = []
        for exponent in (1.0, *self.exponents):
            bent = BentSuction(exponent=exponent, gain=film.gain, gain_sd=film.gain_sd)
            frame = replace(calm, baseline=replace(baseline, response=bent))
            fitting = self.fitting(fit.candidate, frame)
            point = fitting.descended(fitting.effect(fit.parameters), likelihood)
            offsets.append(point.effect.parameters - fit.parameters)
            evidence.append(
                -point.cost - inverse_beside_prior(point.normal, fit.candidate.sd(frame.panel))[1]
            )
        shares = softmax(EVIDENCE_SHARE * np.array(evidence))
        # law of total covariance: the covariance within a curve, and that between the curves
        between = (shares[:, None] * np.array(offsets)).T @ np.array(offsets)
        return replace(fit, covariance=fit.covariance + between, of_curves=between)


def coarse_errors(frame: Observation, change: Array) -> CellLikelihood:
    """Return the likelihood about ln r/r0 (rows, columns).

    The deviations of all cells are independent.
    """
    whitening = Whitening.about(
        frame, change, frame.baseline.model_errors.coarse**2 * np.eye(change.size)
    )
    return CellLikelihood.about(frame, whitening, change)
