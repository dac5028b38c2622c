"""Every candidate fitted from many starts: the least cost that any of them reaches is taken for the most probable.

Between patches lie many minima. So fits begin wherever a template matches, first with coarse errors and then step by
step with sharper ones; candidates whose rim is about an inside can do nearly all that others do, and begin again where
the best of all ended. In the end all are weighed by the errors about what the best explains: by what each explains
itself, errors would jump with every edge that passes a patch, by more than kinds differ.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from lampest.loads.recognition.candidates import Several, loads_of
from lampest.loads.recognition.fit import STEPS, Fit, Fitting, linear_evidence, outliers_of
from lampest.loads.recognition.frame import (
    NONE,
    SUSPICIOUS,
    Observation,
    Whitening,
    outliers,
    whitenings,
    without,
)
from lampest.loads.recognition.search import DiscSearch, cell_map
from lampest.loads.recognition.verdict import prior_cost
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel

FAR = 1.0  # difference of ln r/r0 beyond which errors are weighed anew
# Standard deviation of cells at rest in ln r: while a load is looked for, and then step by step more sharply.
COARSE, FINER = 0.2, (0.05, 0.01)
COARSE_STEPS, REFINED, BEST = 12, 8, 2  # evaluations of a coarse fit, and of one more; coarse fits that others follow
# Of the ln of a likelihood ratio: beyond HOPELESS a candidate is not fitted to the end, beyond ALIVE not at all levels,
# above HIGHER a hollow one begins again at the best's place, and by CLEARLY another kind must be better to stand in for
# the most flexible one.
HOPELESS, ALIVE, HIGHER, CLEARLY = 30.0, 12.0, 3.0, 3.0
ROUNDS = 3  # of a fit without the outliers that the one before left
LEVELS = (0.5, 1.2, 2.5)  # times the response's standard deviation: from a film as published to a bent, uneven one


@dataclass(frozen=True, eq=False)
class MultiStart:
    """What fits to frames of one panel need.

    panel, patch_mm : the cells, and the edge of their film. loads : the candidates beside UNIFORM.
    rest, coarse : whitening of errors against a panel at rest: exact, and that for the search.
    search : templates all over the panel. response : the film's relative deviation that `LEVELS` multiply.
    """

    panel: Panel
    patch_mm: float
    loads: tuple[Candidate, ...]
    rest: Whitening
    coarse: Whitening
    search: DiscSearch
    response: float

    @classmethod
    def of(cls, panel: Panel, patch_mm: float, first: Observation, loads: tuple[Candidate, ...]) -> "MultiStart":
        """For frames against the first one's baseline."""
        coarse, exact = Whitening.at_rest(blurred(first, COARSE)), Whitening.at_rest(first)
        templates = tuple(dict.fromkeys(template for load in loads for template in load.templates))
        search = DiscSearch.over(panel, patch_mm, first.baseline, exact, templates)
        return cls(panel, patch_mm, loads, exact, coarse, search, first.baseline.model_errors.response)

    def against(self, frame: Observation) -> "MultiStart":
        """For a frame against another baseline."""
        rest = Whitening.at_rest(frame)
        return replace(self, rest=rest, search=self.search.against(rest))

    def fitting(self, candidate: Candidate, frame: Observation, whitening: Whitening) -> Fitting:
        """Of one candidate to one frame."""
        return Fitting(self.panel, self.patch_mm, candidate, frame, whitening)

    def unexplained(self, frame: Observation) -> Array:
        """The readings without those of the panel at rest, (cells) ohm."""
        return frame.missed(np.zeros(self.panel.shape), NONE)[0]

    def fitted(self, candidate: Candidate, frame: Observation, start: Fit | None) -> Fit:
        """One candidate fitted whether or not anything else would do; from everywhere, unless a start fits."""
        fit = None if start is None else self._refined(frame, start)
        if fit is None or fit.chi2 > SUSPICIOUS * frame.measured.size:
            other = self._refined(frame, best_of(self._coarse(candidate, frame, self._discs(frame))))
            fit = other if fit is None or other.chi2 < fit.chi2 else fit
        return fit

    def _refined(self, frame: Observation, start: Fit) -> Fit:
        """The fit from a start, weighed anew and without outliers until that changes nothing."""
        fit, scatter = start, self.response
        for _ in range(ROUNDS):
            whitening, before = Whitening.of(frame, fit.explained, scatter), fit.change
            fit = self.fitting(start.candidate, frame, whitening).best(fit.parameters)
            far = outliers(whitening, fit.residual) if fit.chi2 > SUSPICIOUS * frame.measured.size else NONE
            if len(far) == 0 and np.abs(fit.change - before).max() < FAR:
                break
            frame = without(frame, far)
        return fit

    def everywhere(self, frame: Observation) -> tuple[Fit, ...]:
        """Coarse fits of all loads from wherever the change looks like something; one of each, the best first."""
        discs = self._discs(frame)
        coarse = [self._coarse(load, frame, discs) for load in self.loads if not load.follows]
        hollow = sorted((fit for fits in coarse for fit in fits if fit.candidate.hollow), key=_score)
        likely = [variant for fit in hollow[:BEST] for variant in _alike(fit)]
        coarse += [self._coarse(load, frame, likely or discs) for load in self.loads if load.follows]
        return self.sharper(frame, sorted(map(best_of, coarse), key=_score))

    def sharper(self, frame: Observation, fits: Sequence[Fit]) -> tuple[Fit, ...]:
        """Coarse fits, compared step by step more sharply; the best first."""
        for settled in FINER:
            fits = sorted(self._each(blurred(frame, settled), fits, LEVELS[-1]), key=_score)
        return tuple(fits)

    def _discs(self, frame: Observation) -> list[Disc]:
        return self.search.starts(cell_map(frame), self.rest @ self.unexplained(frame))

    def _coarse(self, load: Candidate, frame: Observation, discs: Sequence[Disc]) -> list[Fit]:
        fitting = self.fitting(load, frame, self.coarse)
        fits: list[Fit] = []
        for disc in discs:
            fits.append(fitting.best(load.start(disc), COARSE_STEPS, _least(fits) + HOPELESS, rough=True))
        return fits

    def settled(self, frame: Observation, starts: Sequence[Fit]) -> tuple[Observation, tuple[Fit, ...]]:
        """(the frame without outliers, all candidates from those starts, with the film's deviation that suits each)."""
        level = next((level for level in LEVELS if level * self.response == starts[0].scatter), LEVELS[1])
        for _ in range(ROUNDS):
            fits = self._each(frame, starts, level)
            best, labels = best_of(fits), [fit.candidate.label for fit in fits]
            twins = [twin for twin in _twins(best, self.loads) if twin.candidate.label not in labels]
            fits += [self._from(frame, twin, level, best.score + HOPELESS) for twin in twins]
            far = outliers_of(frame, best)
            if len(far) == 0:
                break
            frame, starts = without(frame, far), sorted(fits, key=_score)
        return frame, self._weighed_alike(frame, fits)

    def _each(self, frame: Observation, starts: Sequence[Fit], level: float) -> list[Fit]:
        """Every load from its own start, each with errors of its own; hollow ones again from the best.

        level : of the film's deviation, in units of that of `ModelErrors`.
        """
        fits: dict[str, Fit] = {}
        for start in starts:
            fits[start.candidate.label] = self._from(frame, start, level, _least(fits.values()) + HOPELESS)
        best = best_of(fits.values())
        for load in self.loads:
            before = fits.get(load.label)
            enough = before is not None and before.score < best.score + HIGHER
            begin = load.like(best.candidate, best.parameters)
            if begin is None or not load.hollow or enough:
                continue
            again = replace(best, candidate=load, parameters=begin)
            again = self._from(frame, again, level, best.score + HOPELESS)
            fits[load.label] = again if before is None else best_of((before, again))
        return list(fits.values())

    def _from(self, frame: Observation, start: Fit, level: float, hopeless: float) -> Fit:
        """A load from a start, weighed by what the start explains; anew where it ends far from that."""
        for _ in range(2):
            before = start.change
            whitening = Whitening.of(frame, start.explained, level * self.response)
            start = self.fitting(start.candidate, frame, whitening).best(start.parameters, STEPS, hopeless, rough=True)
            if start.score > hopeless or np.abs(start.change - before).max() < FAR:
                break
        return start

    def _weighed_alike(self, frame: Observation, fits: Sequence[Fit]) -> tuple[Fit, ...]:
        """All fits weighed by what the best of them explains, from where they are or where that is, at all levels.

        Where another has found a better place since, hollow ones that stay behind are tried from there, too.
        """
        best = best_of(fits)
        for _ in range(2):
            errors = whitenings(frame, best.explained, [level * self.response for level in LEVELS])
            found: list[Fit] = []
            for fit in sorted(fits, key=lambda one: one is not best):
                found.append(self._at_all_levels(frame, fit, best, errors, _least(found)))
            winner, fits = best_of(found), found
            if winner.candidate.label != best.candidate.label:
                fits = [
                    best_of((fit, self._at_all_levels(frame, fit, winner, errors, winner.score)))
                    if fit.candidate.hollow and fit.score > winner.score + HIGHER
                    else fit
                    for fit in found
                ]
            best = max(fits, key=lambda one: one.evidence)
        return tuple(fits)

    def _at_all_levels(self, frame: Observation, fit: Fit, best: Fit, errors: Sequence[Whitening], least: float) -> Fit:
        """The fit with the film's deviation that suits it best, and its evidence over all of them, alike beforehand.

        Hollow kinds are tried from the best of all, too. least : the best's score; one that stays far above is fitted
        roughly.
        """
        here = next(number for number, one in enumerate(errors) if one.scatter == best.scatter)
        fitting, starts = self.fitting(fit.candidate, frame, errors[here]), [fit.parameters]
        if fit.candidate.hollow and fit is not best:
            begin = fit.candidate.like(best.candidate, best.parameters)
            starts += [] if begin is None else [begin]
        fit = best_of(fitting.best(start, REFINED, least + HOPELESS, rough=True) for start in starts)
        if fit.score > least + ALIVE:
            return fit
        mean, sd = fit.candidate.mean(self.panel), fit.candidate.sd(self.panel)
        evidence = np.array([linear_evidence(fit, whitening, mean, sd) for whitening in errors])
        suits = int(np.argmax(evidence))
        if suits != here:
            fitting = self.fitting(fit.candidate, frame, errors[suits])
            fit = fitting.best(fit.parameters, REFINED, rough=True)
        fit = fitting.widened(fit)
        evidence += fit.evidence - evidence[suits]
        return replace(fit, evidence=float(logsumexp(evidence)) - float(np.log(len(LEVELS))))

    def together(self, frame: Observation, places: Sequence[Sequence[Disc]]) -> tuple[Fit, ...]:
        """The best kinds of loads about the best of some sets of discs, all fitted together, sucking ones first.

        Kinds are exchanged one by one from the most flexible ones; where the best are others, those are given, too: so
        coarse a comparison may be wrong.
        """
        frame = blurred(frame, COARSE)
        flexible = next((load for load in self.loads if load.sucks), self.loads[0])

        def fitted(loads: Sequence[tuple[Candidate, Array]], least: float) -> Fit:
            parts, begin = zip(*loads, strict=True)
            fitting = self.fitting(Several.of(parts), frame, self.coarse)
            return fitting.best(np.concatenate(begin), STEPS, least + HOPELESS)

        def likely(fit: Fit) -> float:
            return fit.evidence - prior_cost(self.panel, fit)

        tried: list[Fit] = []
        for discs in places:
            tried.append(fitted([(flexible, flexible.start(disc)) for disc in discs], _least(tried)))
        best = first = best_of(tried)
        discs = places[tried.index(first)]
        for place, disc in enumerate(discs):
            for load in self.loads:
                if load is flexible:
                    continue
                loads = loads_of(best.candidate, best.parameters)
                alike = load.like(*loads[place])
                loads[place] = (load, load.start(disc) if alike is None else alike)
                other = fitted(loads, best.score)
                if likely(other) > likely(best) + CLEARLY:
                    best = other
        return (_sucking_first(best), first) if best is not first else (first,)


def best_of(fits: Iterable[Fit]) -> Fit:
    """The one with the least score, the first of equal ones."""
    return min(fits, key=_score)


def _score(fit: Fit) -> float:
    return fit.score


def _least(fits: Iterable[Fit]) -> float:
    """The least score; infinite where there are none."""
    return min((fit.score for fit in fits), default=np.inf)


def _alike(fit: Fit) -> list[Disc]:
    """Its disc, a wider rim and a narrower one: between patches a wide rim that presses less looks much the same."""
    disc = fit.candidate.disc(fit.parameters)
    if disc is None:
        return []
    width, outer = (disc.diameter_mm - disc.inner_mm) / 2, disc.diameter_mm
    wider = disc._replace(diameter_mm=outer + width, inner_mm=max(disc.inner_mm - width, 0.1 * outer))
    narrower = disc._replace(diameter_mm=outer - width / 2, inner_mm=disc.inner_mm + width / 2)
    return [disc, wider._replace(rim_kpa=disc.rim_kpa / 2), narrower._replace(rim_kpa=2 * disc.rim_kpa)]


def blurred(frame: Observation, settled: float) -> Observation:
    """The frame with cells that have a standard deviation of `settled` at rest, in ln r."""
    model_errors = replace(frame.baseline.model_errors, settled=settled)
    return replace(frame, baseline=replace(frame.baseline, model_errors=model_errors))


def _twins(fit: Fit, kinds: Sequence[Candidate]) -> list[Fit]:
    """Starts for the same loads, of which those that suck are all of another kind; none for a single load."""
    if not isinstance(fit.candidate, Several):
        return []
    found = []
    for kind in kinds:
        loads = loads_of(fit.candidate, fit.parameters)
        for number, load in enumerate(loads):
            alike = kind.like(*load)
            if load[0].sucks and load[0] is not kind and alike is not None:
                loads[number] = (kind, alike)
        if tuple(part for part, _ in loads) != fit.candidate.parts:
            found.append(_several(fit, loads))
    return found


def _sucking_first(fit: Fit) -> Fit:
    """The fit with its parts in the order in which they are reported."""
    return _several(fit, loads_of(fit.candidate, fit.parameters))


def _several(fit: Fit, loads: Sequence[tuple[Candidate, Array]]) -> Fit:
    """A fit to begin with, of these loads, sucking ones first."""
    parts, own = zip(*sorted(loads, key=lambda load: not load[0].sucks), strict=True)
    return replace(fit, candidate=Several.of(parts), parameters=np.concatenate(own))


def discs_of(fit: Fit) -> list[Disc]:
    """The discs of all its loads that are like one."""
    discs = [part.disc(own) for part, own in loads_of(fit.candidate, fit.parameters)]
    return [disc for disc in discs if disc is not None]
