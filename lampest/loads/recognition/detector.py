"""Frame after frame of one panel: every candidate fitted, from where the frame before ended."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from lampest.loads.recognition.baseline import Remembered
from lampest.loads.recognition.candidates import LOADS, UNIFORM, Several
from lampest.loads.recognition.field import FIELD, field_fit
from lampest.loads.recognition.fit import STEPS, Fit, Fitting, along_diameter, linear_evidence
from lampest.loads.recognition.frame import (
    SUSPICIOUS,
    Observation,
    Uncertain,
    Whitening,
    outliers,
    with_errors,
    without,
)
from lampest.loads.recognition.search import DiscSearch, cell_map
from lampest.loads.recognition.together import Together, discs_of, twins
from lampest.loads.recognition.verdict import OverTime, Verdict, judged, outline_cost
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel

FAR = 1.0  # difference of ln r/r0 beyond which errors are weighed anew
QUIET = 4.5  # standard deviations by which something must stand out for loads to be looked for
# Of ln r: while a load is looked for, cells are compared as coarsely as that, and then step by step more sharply.
COARSE = 0.2
FINER = (0.05, 0.01)
COARSE_STEPS, BEST = 12, 2
HOPELESS = 30.0  # ln of a likelihood ratio beyond which a candidate need not be fitted to the end
HIGHER = 3.0
ROUNDS = 3
LEVELS = (0.5, 1.2, 2.5)  # times the response's standard deviation: from a film as published to a bent, uneven one
ALIVE = 12.0  # ln of a likelihood ratio within which a candidate is fitted at all levels
REFINED = 8
FORGOTTEN = 60.0  # ln of a likelihood ratio beyond which a candidate is left out until the panel is searched again
CLEAR = 1.15  # χ² per reading: above, a field might win; below, it lost by more than 60 in all scenes that were tried
NO_DOUBT = 1.0  # of ln P: an outline that costs more might be anything's
STILL = 0.02  # relative change of readings below which a panel is not searched again
ONE_MOVED = 2.0  # times that, or 6 σ, of one reading alone
MOST_AT_ONCE = 3
COUNTED = 0.02  # share below which a kind says next to nothing of a load's size
NONE = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Detector:
    """Where a sequence of frames stands.

    Parameters
    ----------
    panel, patch_mm : the cells, and the edge of their film.
    loads : the candidates beside UNIFORM.
    rest, coarse : whitening of errors against a panel at rest: exact, and that for the search.
    search : templates all over the panel. response : the film's relative deviation that `LEVELS` multiply.
    previous : the verdict on the last frame, or None. changed : ln r/r0 of its field, where a field was fitted.
    searched : (rows, columns) ohm of the frame in which all of the panel was searched last.
    remembered : what the film remembers of loads. together : what frames of the present load say together.
    """

    panel: Panel
    patch_mm: float
    loads: tuple[Candidate, ...]
    rest: Whitening
    coarse: Whitening
    search: DiscSearch
    response: float
    previous: Verdict | None = None
    changed: Array | None = None
    searched: Array | None = None
    remembered: Remembered | None = None
    together: OverTime = OverTime()

    @classmethod
    def of(cls, panel: Panel, patch_mm: float, first: Observation, loads: tuple[Candidate, ...] = LOADS) -> "Detector":
        """Before the first frame."""
        coarse = Whitening.at_rest(blurred(first, COARSE))
        exact = Whitening.at_rest(first)
        templates = tuple(dict.fromkeys(template for load in loads for template in load.templates))
        search = DiscSearch.over(panel, patch_mm, first.baseline, exact, templates)
        return cls(panel, patch_mm, loads, exact, coarse, search, first.baseline.model_errors.response)

    def push(self, frame: Observation) -> tuple["Detector", Verdict]:
        """The verdict on a frame in the light of those before, and the detector for the next one."""
        remembered = self.remembered or Remembered.nothing(self.panel.shape)
        resting = remembered.rest(frame.baseline, frame.seconds)
        here = self
        if resting is not frame.baseline:
            frame = replace(frame, baseline=resting)
            rest = Whitening.at_rest(frame)
            here = replace(self, rest=rest, search=self.search.against(rest))
        detector, verdict = here._pushed(frame)
        together, shown = self.together.after(verdict, UNIFORM + self.loads)
        return replace(
            detector,
            rest=self.rest,
            search=self.search,
            remembered=remembered.after(verdict.best.change, frame.seconds),
            together=together,
        ), shown

    def _pushed(self, frame: Observation) -> tuple["Detector", Verdict]:
        """The verdict on a frame alone, with the baseline that the film has left."""
        calm, whitening = self._at_rest(frame)
        if whitening is not None:
            verdict = self._judged(calm, self._uniform(calm, whitening))
            return replace(self, previous=verdict, searched=None), verdict
        tracked = None if self.previous is None or not self.previous.loads else self._tracked(calm, self.previous.loads)
        if tracked is not None and self._clear(tracked):
            verdict = self._spread(calm, tracked)
            return replace(self, previous=verdict), verdict
        direct = calm.direct()
        field = field_fit(direct, cell_map(direct), *(() if self.changed is None else (self.changed,)))
        verdicts = [] if tracked is None else [self._against(field, tracked, calm)]
        searched = self.searched
        if not verdicts or (self._doubtful(verdicts[0]) and self._moved(calm)):
            verdicts.append(self._settled(calm, self._searched(calm), field))
            if self._doubtful(verdicts[-1]):
                verdicts += self._several(calm, verdicts[-1], field)
            searched = calm.measured
        verdict = self._spread(calm, max(verdicts, key=lambda one: one.evidence))
        return replace(self, previous=verdict, searched=searched, changed=field.change), verdict

    def _spread(self, frame: Observation, verdict: Verdict) -> Verdict:
        """The verdict with single loads as large as they may be, where their shares count.

        Not against an estimate: far from it the straight line, by which a load is compared with it, does not hold.
        """
        best = verdict.best
        if frame.direct() is not frame or best not in verdict.loads or isinstance(best.candidate, Several):
            return verdict
        frame, whitening = with_errors(frame, best.explained, best.scatter, best.residual, best.chi2)
        fits = tuple(
            along_diameter(self._fitting(fit.candidate, frame, whitening), fit)
            if share > COUNTED and not isinstance(fit.candidate, Several)
            else fit
            for fit, share in zip(verdict.fits, verdict.shares, strict=True)
        )
        return replace(verdict, fits=fits)

    def _tracked(self, frame: Observation, loads: tuple[Fit, ...]) -> Verdict:
        """All that was likely in the frame before, from where it was; hollow ones are tried again in any case."""
        likely = tuple(fit for fit in loads if fit.evidence > loads[0].evidence - FORGOTTEN)
        return self._settled(frame, likely, None)

    def _against(self, field: Fit, verdict: Verdict, frame: Observation) -> Verdict:
        """The verdict with the field among what was compared."""
        return self._judged(frame, (*verdict.fits, field))

    def _clear(self, verdict: Verdict) -> bool:
        """Whether a shape explains so much, on a film that is not at its worst, that no field need stand against it."""
        best = verdict.best
        likely = verdict.goodness < CLEAR and best.scatter < LEVELS[-1] * self.response
        return likely and outline_cost(self.panel, best) < NO_DOUBT

    def fitted(self, candidate: Candidate, frame: Observation, start: Fit | None) -> Fit:
        """One candidate fitted whether or not anything else would do; from everywhere, unless a start fits."""
        fit = None if start is None else self._refined(frame, start)
        if fit is None or fit.chi2 > SUSPICIOUS * frame.measured.size:
            other = self._refined(frame, min(self._coarse(candidate, frame, self._discs(frame)), key=_score))
            fit = other if fit is None or other.chi2 < fit.chi2 else fit
        return fit

    def _refined(self, frame: Observation, start: Fit) -> Fit:
        """The fit from a start, weighed anew and without outliers until that changes nothing."""
        fit, scatter = start, self.response
        for _ in range(ROUNDS):
            whitening, before = Whitening.of(frame, fit.explained, scatter), fit.change
            fit = self._fitting(start.candidate, frame, whitening).best(fit.parameters)
            far = outliers(whitening, fit.residual) if fit.chi2 > SUSPICIOUS * frame.measured.size else NONE
            if len(far) == 0 and np.abs(fit.change - before).max() < FAR:
                break
            frame = without(frame, far)
        return fit

    def _at_rest(self, frame: Observation) -> tuple[Observation, Whitening | None]:
        """(frame, None) where something stands out; else the frame without outliers, and its whitening."""
        residual = self._unexplained(frame)
        far = outliers(self.rest, residual)
        calm = without(frame.direct(), far)
        whitening = Whitening.at_rest(calm) if len(far) else self.rest
        errors = whitening @ residual
        quiet = errors @ errors < SUSPICIOUS * errors.size and self.search.stands_out(errors) < QUIET
        return (calm, whitening) if quiet else (frame, None)

    def _doubtful(self, verdict: Verdict) -> bool:
        """Whether another position, or another number of loads, might explain more."""
        return verdict.best.candidate is FIELD or verdict.goodness > SUSPICIOUS

    def _moved(self, frame: Observation) -> bool:
        """Whether readings are no longer those in which all of the panel was searched last; on large panels a few."""
        if self.searched is None:
            return True
        step = (frame.measured - self.searched) / np.hypot(3 * frame.sigma, STILL * frame.measured)
        return bool(np.sqrt(np.mean(np.minimum(step * step, 100.0))) > 1 or np.abs(step).max() > ONE_MOVED)

    def _searched(self, frame: Observation) -> tuple[Fit, ...]:
        """Coarse fits of all loads from wherever the change looks like something; one of each, the best first."""
        discs = self._discs(frame)
        coarse = [self._coarse(load, frame, discs) for load in self.loads if not load.follows]
        hollow = sorted((fit for fits in coarse for fit in fits if fit.candidate.hollow), key=_score)
        likely = [variant for fit in hollow[:BEST] for variant in _alike(fit)]
        coarse += [self._coarse(load, frame, likely or discs) for load in self.loads if load.follows]
        fits = sorted((min(fits, key=_score) for fits in coarse), key=_score)
        return self._sharper(frame, tuple(fits))

    def _sharper(self, frame: Observation, fits: tuple[Fit, ...]) -> tuple[Fit, ...]:
        """Coarse fits, compared step by step more sharply; the best first."""
        for settled in FINER:
            fits = tuple(sorted(self._each(blurred(frame, settled), fits, LEVELS[-1]), key=_score))
        return fits

    def _discs(self, frame: Observation) -> list[Disc]:
        return self.search.starts(cell_map(frame.direct()), self.rest @ self._unexplained(frame))

    def _unexplained(self, frame: Observation) -> Array:
        """The readings without those of the panel at rest, (cells) ohm."""
        return frame.direct().missed(np.zeros(self.panel.shape), NONE)[0]

    def _coarse(self, load: Candidate, frame: Observation, discs: Sequence[Disc]) -> list[Fit]:
        fitting = self._fitting(load, frame, self.coarse)
        fits: list[Fit] = []
        for disc in discs:
            least = min((fit.score for fit in fits), default=np.inf)
            fits.append(fitting.best(load.start(disc), COARSE_STEPS, least + HOPELESS, rough=True))
        return fits

    def _settled(self, frame: Observation, starts: tuple[Fit, ...], field: Fit | None) -> Verdict:
        """All candidates from those starts, without outliers, and with the film's deviation that suits each best."""
        level = next((level for level in LEVELS if level * self.response == starts[0].scatter), LEVELS[1])
        for _ in range(ROUNDS):
            fits = self._each(frame, starts, level)
            best = min(fits, key=_score)
            fits += tuple(
                self._from(frame, twin, level, best.score + HOPELESS)
                for twin in twins(best, self.loads)
                if twin.candidate.label not in [fit.candidate.label for fit in fits]
            )
            far = NONE
            if best.chi2 > SUSPICIOUS * frame.measured.size:
                far = outliers(Whitening.of(frame, best.explained, best.scatter), best.residual)
            if len(far) == 0:
                break
            frame, starts = without(frame, far), tuple(sorted(fits, key=_score))
        fits = self._weighed_alike(frame, fits)
        others = () if field is None else (field,)
        return self._judged(frame, (*self._uniform(frame, Whitening.at_rest(frame)), *fits, *others))

    def _weighed_alike(self, frame: Observation, fits: tuple[Fit, ...]) -> tuple[Fit, ...]:
        """All fits weighed by what the best of them explains, from where they are or where that is, at all levels.

        Errors by what each explains itself would jump with every edge that passes a patch, by more than kinds differ.
        """
        best = min(fits, key=_score)
        for _ in range(2):
            uncertain = Uncertain.of(frame, best.explained)
            whitenings = [uncertain.whitening(level * self.response) for level in LEVELS]
            found: list[Fit] = []
            for fit in sorted(fits, key=lambda one: one is not best):
                least = min((one.score for one in found), default=np.inf)
                found.append(self._at_all_levels(frame, fit, best, whitenings, least))
            fits = tuple(self._after_winner(frame, found, best, whitenings))
            best = max(fits, key=lambda one: one.evidence)
        return fits

    def _after_winner(
        self, frame: Observation, fits: list[Fit], best: Fit, whitenings: Sequence[Whitening]
    ) -> Iterator[Fit]:
        """All fits; where another than `best` has found a better place since, hollow ones are tried from there, too."""
        winner = min(fits, key=_score)
        for fit in fits:
            behind = fit.candidate.hollow and fit.score > winner.score + HIGHER
            if not behind or winner.candidate.label == best.candidate.label:
                yield fit
            else:
                again = self._at_all_levels(frame, fit, winner, whitenings, winner.score)
                yield min(fit, again, key=_score)

    def _at_all_levels(
        self, frame: Observation, fit: Fit, best: Fit, whitenings: Sequence[Whitening], least: float
    ) -> Fit:
        """The fit with the film's deviation that suits it best, and its evidence over all of them, alike beforehand.

        Hollow kinds are tried from the best of all, too: between patches lie many minima. least : the best's score; one
        that stays far above is fitted roughly.
        """
        begin = (
            fit.candidate.like(best.candidate, best.parameters) if fit.candidate.hollow and fit is not best else None
        )
        here = next(number for number, one in enumerate(whitenings) if one.scatter == best.scatter)
        fitting = self._fitting(fit.candidate, frame, whitenings[here])
        starts = [fit.parameters] if begin is None else [fit.parameters, begin]
        tries = [fitting.best(start, REFINED, least + HOPELESS, rough=True) for start in starts]
        fit = min(tries, key=_score)
        if fit.score > least + ALIVE:
            return fit
        mean, sd = fit.candidate.mean(self.panel), fit.candidate.sd(self.panel)
        evidence = np.array([linear_evidence(fit, whitening, mean, sd) for whitening in whitenings])
        suits = int(np.argmax(evidence))
        if suits != here:
            fitting = self._fitting(fit.candidate, frame, whitenings[suits])
            fit = fitting.best(fit.parameters, REFINED, rough=True)
        fit = fitting.widened(fit)
        evidence += fit.evidence - evidence[suits]
        return replace(fit, evidence=float(logsumexp(evidence)) - float(np.log(len(LEVELS))))

    def _uniform(self, frame: Observation, whitening: Whitening) -> tuple[Fit, ...]:
        return tuple(self._fitting(kind, frame, whitening).best(kind.mean(self.panel)) for kind in UNIFORM)

    def _each(self, frame: Observation, starts: tuple[Fit, ...], level: float) -> tuple[Fit, ...]:
        """Every load from its own start, each with errors of its own; hollow ones again from the best.

        level : of the film's deviation, in units of that of `ModelErrors`.
        """
        fits: dict[str, Fit] = {}
        for start in starts:
            least = min((fit.score for fit in fits.values()), default=np.inf)
            fits[start.candidate.label] = self._from(frame, start, level, least + HOPELESS)
        best = min(fits.values(), key=_score)
        for load in self.loads:
            before = fits.get(load.label)
            enough = before is not None and before.score < best.score + HIGHER
            begin = load.like(best.candidate, best.parameters)
            if begin is None or not load.hollow or enough:
                continue
            again = replace(best, candidate=load, parameters=begin)
            again = self._from(frame, again, level, best.score + HOPELESS)
            fits[load.label] = again if before is None else min(before, again, key=_score)
        return tuple(fits.values())

    def _from(self, frame: Observation, start: Fit, level: float, hopeless: float) -> Fit:
        """A load from a start, weighed by what the start explains; anew where it ends far from that."""
        scatter = level * self.response
        for _ in range(2):
            before = start.change
            whitening = Whitening.of(frame, start.explained, scatter)
            start = self._fitting(start.candidate, frame, whitening).best(start.parameters, STEPS, hopeless, rough=True)
            if start.score > hopeless or np.abs(start.change - before).max() < FAR:
                break
        return start

    def _several(self, frame: Observation, single: Verdict, field: Fit) -> list[Verdict]:
        """Verdicts on two loads at once, then on three, while they explain more than what one load fewer does."""
        together, discs = self._roughly(frame), self.search.beside(field.change, ())[:1]
        found: list[Verdict] = []
        for _ in range(1, MOST_AT_ONCE):
            ways = [[*discs, place] for place in self.search.beside(field.change, discs)]
            if not ways:
                break
            fits = self._sharper(frame, together.about(ways))
            verdict = self._settled(frame, (*fits, *single.loads[:1]), field)
            before = found[-1] if found else single
            if verdict.evidence <= before.evidence:
                break
            found.append(verdict)
            if not self._doubtful(verdict):
                break
            discs = discs_of(fits[0])
        return found

    def _roughly(self, frame: Observation) -> Together:
        """How several loads are sought: compared as coarsely as single ones are."""
        rough = blurred(frame, COARSE)

        def fit(candidate: Candidate, start: Array, least: float) -> Fit:
            return self._fitting(candidate, rough, self.coarse).best(start, STEPS, least + HOPELESS)

        return Together(self.panel, self.loads, fit)

    def _judged(self, frame: Observation, fits: tuple[Fit, ...]) -> Verdict:
        response = frame.baseline.response
        return judged(self.panel, UNIFORM + self.loads, fits, frame.measured.size, response)

    def _fitting(self, candidate: Candidate, frame: Observation, whitening: Whitening) -> Fitting:
        return Fitting(self.panel, self.patch_mm, candidate, frame, whitening)


def _score(fit: Fit) -> float:
    return fit.score


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
