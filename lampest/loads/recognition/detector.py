"""What stands on a panel in one frame: every candidate fitted from wherever the change looks like something.

Between patches lie many minima: fits begin wherever a template matches, with coarse errors and then sharper ones. In
the end all are weighed by the errors about what the best explains; where none fits, more loads at once are tried.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lampest.loads.recognition.candidates import FIELD, LOADS, UNIFORM, Several
from lampest.loads.recognition.evidence import Verdict, judged, prior_cost
from lampest.loads.recognition.field import field_fit
from lampest.loads.recognition.fit import COARSE_STEPS, UNLIKELY, Fit, Fitting, along_diameter
from lampest.loads.recognition.observation import FARTHEST, SUSPICIOUS, Observation, Whitening, outliers
from lampest.loads.recognition.search import DiscSearch, unit
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel

COARSE, FINER = 0.2, 0.03  # standard deviations of cells at rest in ln r: while a load is looked for, and then
# Of a fit with the errors, or without the outliers, that the one before left: how often, and from which difference of
# ln r/r0 on.
ROUNDS, FAR = 3, 1.0
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
        field, found = field_fit(frame), list[Verdict]()
        if before is not None and before.loads:
            found.append(self._settled(frame, before.loads, field))
        if not found or self._doubtful(found[0]):
            discs = self.search.starts(frame, rest)
            found.append(self._settled(frame, [self._coarse(load, frame, discs) for load in self.loads], field))
        single, discs = found[-1], list[Disc]()
        while self._doubtful(found[-1]) and len(discs) < MOST_AT_ONCE:
            beside = self.search.beside(field.change, discs)
            if beside is None:
                break
            discs.append(beside)
            if len(discs) > 1:
                fits = self._together(frame, discs)
                found.append(self._settled(frame, (*fits, *single.loads[:1]), field))
                discs = discs_of(fits[0])
        return self._spread(frame, max(found, key=lambda one: one.evidence))

    def fitted(self, candidate: Candidate, frame: Observation, start: Fit | None) -> Fit:
        """One candidate fitted whether or not anything else would do; from everywhere, unless a start fits."""
        fit = None if start is None else self._without_outliers(frame, start)
        if fit is None or fit.chi2 > SUSPICIOUS * frame.measured.size:
            discs = self.search.starts(frame, Whitening.at_rest(frame))
            other = self._without_outliers(frame, self._coarse(candidate, frame, discs))
            fit = other if fit is None or other.chi2 < fit.chi2 else fit
        return fit

    def fitting(self, candidate: Candidate, frame: Observation, whitening: Whitening) -> Fitting:
        """Of one candidate to one frame."""
        return Fitting(self.panel, self.patch_mm, candidate, frame, whitening)

    def _without_outliers(self, frame: Observation, fit: Fit) -> Fit:
        for _ in range(ROUNDS):
            fit = self._weighed(frame, fit, frame.baseline.model_errors.response)
            far = fit.outliers(frame)
            if len(far) == 0:
                break
            frame = frame.without(far)
        return fit

    def _weighed(self, frame: Observation, fit: Fit, scatter: float, rough: bool = False) -> Fit:
        """The fit from a start, with the errors about what it explains, until these stay."""
        for _ in range(ROUNDS):
            before = fit.change
            fitting = self.fitting(fit.candidate, frame, Whitening.of(frame, fit.explained, scatter))
            fit = fitting.best(fit.parameters, rough=rough)
            if np.abs(fit.change - before).max() < FAR:
                break
        return fit

    def _coarse(self, load: Candidate, frame: Observation, discs: Sequence[Disc]) -> Fit:
        """The best fit of a load from any disc, with the errors of a panel at rest."""
        fitting = self.fitting(load, frame, Whitening.at_rest(frame.blurred(COARSE)))
        fits: list[Fit] = []
        for disc in discs:
            most = min((fit.cost for fit in fits), default=np.inf) + UNLIKELY
            fits.append(fitting.best(load.start(disc), COARSE_STEPS, most, rough=True))
        return best_of(fits)

    def _settled(self, frame: Observation, fits: Sequence[Fit], field: Fit) -> Verdict:
        """The verdict on all candidates from coarse fits, compared step by step more sharply and without outliers."""
        scatter = LEVELS[-1] * frame.baseline.model_errors.response
        for blurred in (frame.blurred(FINER), frame):
            fits = [self._weighed(blurred, fit, scatter, rough=True) for fit in fits]
        for _ in range(ROUNDS):
            far = best_of(fits).outliers(frame)
            if len(far) == 0:
                break
            frame = frame.without(far)
            fits = [self._weighed(frame, fit, scatter, rough=True) for fit in fits]
        return self._judged(frame, (*self._uniform(frame), *self._weighed_alike(frame, fits), field))

    def _weighed_alike(self, frame: Observation, fits: Sequence[Fit]) -> list[Fit]:
        """All fits weighed by what the best of them explains, from where they are or where that is.

        The film's relative deviation is that of LEVELS under which the frame is most probable.
        """
        best, response = best_of(fits), frame.baseline.model_errors.response
        errors = [Whitening.of(frame, best.explained, level * response) for level in LEVELS]
        levels = [self.fitting(best.candidate, frame, one).best(best.parameters, rough=True) for one in errors]
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
            return self.fitting(Several.of(parts), frame, whitening).best(np.concatenate(own), COARSE_STEPS, rough=True)

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
