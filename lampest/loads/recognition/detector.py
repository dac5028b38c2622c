"""What stands on a panel in one frame: every candidate fitted from wherever the change looks like something.

Between patches lie many minima: fits begin wherever a template matches, with coarse errors, then those about the cells
that the readings show. In the end all are weighed by the errors about what the best explains; where none fits, more
loads at once are tried.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lampest.loads.recognition.candidates import FIELD, LOADS, UNIFORM, Several
from lampest.loads.recognition.evidence import Verdict, judged, prior_cost
from lampest.loads.recognition.field import field_fit
from lampest.loads.recognition.fit import COARSE_STEPS, UNLIKELY, Fit, Fitting, along_diameter
from lampest.loads.recognition.observation import FARTHEST, SUSPICIOUS, Explained, Observation, Whitening, outliers
from lampest.loads.recognition.search import DiscSearch, unit
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel

COARSE = 0.2  # standard deviation of cells at rest in ln r while a load is looked for
ROUNDS = 4  # of fits with the errors about the one before, and without its outliers, at most
LEVELS = (0.5, 1.2, 2.5)  # times the response's standard deviation: from a film as published to a bent, uneven one
MOST_AT_ONCE = 3  # loads


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
            return self._judged(calm, self._uniform(calm))
        (field, without), found = field_fit(frame), list[Verdict]()
        if before is not None and before.loads:
            found.append(self._settled(frame, before.loads, field, without))
        if not found or self._doubtful(found[0]):
            discs = self.search.starts(frame, rest)
            found.append(
                self._settled(frame, [self._coarse(load, frame, discs) for load in self.loads], field, without)
            )
        single, discs = found[-1], list[Disc]()
        while self._doubtful(found[-1]) and len(discs) < MOST_AT_ONCE:
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
        """One candidate fitted whether or not anything else would do; from everywhere, unless a start fits."""
        fit = None if start is None else self._whole(frame, start, start.explained, frame)
        if fit is None or fit.chi2 > SUSPICIOUS * frame.measured.size:
            discs = self.search.starts(frame, Whitening.at_rest(frame))
            field, calm = field_fit(frame)
            other = self._whole(frame, self._coarse(candidate, frame, discs), field.explained, calm)
            fit = other if fit is None or other.chi2 < fit.chi2 else fit
        return fit

    def fitting(self, candidate: Candidate, frame: Observation, whitening: Whitening) -> Fitting:
        """Of one candidate to one frame."""
        return Fitting(self.panel, self.patch_mm, candidate, frame, whitening)

    def _whole(self, frame: Observation, fit: Fit, explained: Explained, calm: Observation) -> Fit:
        """A single fit, sharpened, with the whole width of its posterior."""
        scatter = frame.baseline.model_errors.response
        calm, (fit,) = self._sharpened(frame, [fit], explained, calm, scatter)
        whitening = Whitening.of(calm, fit.explained, scatter)
        return self.fitting(fit.candidate, calm, whitening).best(fit.parameters)

    def _sharpened(
        self, frame: Observation, fits: Sequence[Fit], explained: Explained, calm: Observation, scatter: float
    ) -> tuple[Observation, list[Fit]]:
        """(the frame without outliers, all fits to it) with the errors about what is explained, then the best explains.

        Errors that all fits share follow none of them. calm : the frame to begin with. From the second round on
        outliers are sought every time among all readings, so that none stays out which a better fit explains.
        """
        dropped: list[int] | None = None
        for number in range(ROUNDS):
            whitening = Whitening.of(calm, explained, scatter)
            fits = [self.fitting(fit.candidate, calm, whitening).best(fit.parameters, quick=True) for fit in fits]
            best = best_of(fits)
            explained = best.explained
            if number:
                far = best.outliers(frame)
                if far.tolist() == dropped:
                    break
                calm, dropped = frame.without(far), far.tolist()
        return calm, list(fits)

    def _coarse(self, load: Candidate, frame: Observation, discs: Sequence[Disc]) -> Fit:
        """The best fit of a load from any disc, with the errors of a panel at rest."""
        fitting = self.fitting(load, frame, Whitening.at_rest(frame.blurred(COARSE)))
        fits: list[Fit] = []
        for disc in discs:
            most = min((fit.cost for fit in fits), default=np.inf) + UNLIKELY
            fits.append(fitting.best(load.start(disc), COARSE_STEPS, most, quick=True))
        return best_of(fits)

    def _settled(self, frame: Observation, fits: Sequence[Fit], field: Fit, calm: Observation) -> Verdict:
        """The verdict on all candidates from coarse fits; field, calm : of `field_fit`."""
        scatter = LEVELS[-1] * frame.baseline.model_errors.response
        calm, fits = self._sharpened(frame, fits, field.explained, calm, scatter)
        return self._judged(calm, (*self._uniform(calm), *self._weighed_alike(calm, fits), field))

    def _weighed_alike(self, frame: Observation, fits: Sequence[Fit]) -> list[Fit]:
        """All fits weighed by what the best of them explains, from where they are or where that is.

        The film's relative deviation is that of LEVELS under which the frame is most probable.
        """
        best, response = best_of(fits), frame.baseline.model_errors.response
        errors = [Whitening.of(frame, best.explained, level * response) for level in LEVELS]
        levels = [self.fitting(best.candidate, frame, one).best(best.parameters, quick=True) for one in errors]
        suits = max(levels, key=lambda fit: fit.evidence)
        whitening = errors[levels.index(suits)]
        return [
            best_of(
                self.fitting(fit.candidate, frame, whitening).best(start.parameters)
                for start in (fit, *_like(fit, suits))
            )
            for fit in fits
        ]

    def _together(self, frame: Observation, discs: Sequence[Disc]) -> list[Fit]:
        """Coarse fits of loads about some discs at once: each of the likeliest kind, and all that suck."""
        whitening = Whitening.at_rest(frame.blurred(COARSE))

        def fitted(loads: Sequence[tuple[Candidate, Array]]) -> Fit:
            parts, own = zip(*sorted(loads, key=lambda load: not load[0].sucks), strict=True)
            return self.fitting(Several.of(parts), frame, whitening).best(np.concatenate(own), COARSE_STEPS, quick=True)

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

    def _spread(self, frame: Observation, verdict: Verdict) -> Verdict:
        """The verdict with a single load as large as it may be."""
        best = verdict.best
        if best.candidate not in self.loads:
            return verdict
        wide = along_diameter(self.fitting(best.candidate, *best.with_errors(frame)), best)
        return replace(verdict, fits=tuple(wide if fit is best else fit for fit in verdict.fits))

    def _doubtful(self, verdict: Verdict) -> bool:
        """Whether another number of loads might explain more."""
        return verdict.best.candidate is FIELD or verdict.goodness > SUSPICIOUS

    def _uniform(self, frame: Observation) -> tuple[Fit, ...]:
        rest = Whitening.at_rest(frame)
        return tuple(self.fitting(kind, frame, rest).best(kind.mean(self.panel)) for kind in UNIFORM)

    def _judged(self, frame: Observation, fits: tuple[Fit, ...]) -> Verdict:
        return judged(self.panel, fits, frame.measured.size, frame.baseline.response)


def best_of(fits: Iterable[Fit]) -> Fit:
    """The one with the least score, the first of equal ones."""
    return min(fits, key=lambda fit: fit.score)


def discs_of(fit: Fit) -> list[Disc]:
    """The discs of all its loads that are like one."""
    discs = [part.disc(own) for part, own in fit.loads]
    return [disc for disc in discs if disc is not None]


def _like(fit: Fit, best: Fit) -> list[Fit]:
    """A start for a kind where another one is; none where that is itself, or has another number of loads."""
    begin = fit.candidate.like(best.candidate, best.parameters)
    return [] if begin is None or best is fit else [replace(best, candidate=fit.candidate, parameters=begin)]
