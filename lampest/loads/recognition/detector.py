"""Frame after frame of one panel: every candidate fitted, from where the frame before ended."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.recognition.candidates import LOADS, UNIFORM
from lampest.loads.recognition.fit import STEPS, Fit, Fitting
from lampest.loads.recognition.frame import Observation, Whitening, outliers, without
from lampest.loads.recognition.search import DiscSearch, cell_map
from lampest.loads.recognition.verdict import Verdict, judged
from lampest.loads.shapes.disc import Disc
from lampest.loads.shapes.shape import Candidate
from lampest.panel.panel import Array, Panel

FAR = 1.0  # difference of ln r/r0 beyond which errors are weighed anew
SUSPICIOUS = 1.4  # χ² per reading beyond which outliers, or another position, are looked for
QUIET = 4.5  # standard deviations by which something must stand out for loads to be looked for
# Of ln r: while a load is looked for, cells are compared as coarsely as that, and then step by step more sharply.
COARSE = 0.2
FINER = (0.05, 0.015, 0.005)
COARSE_STEPS, BEST = 12, 2
HOPELESS = 30.0  # ln of a likelihood ratio beyond which a candidate need not be fitted to the end
HIGHER = 3.0
ROUNDS = 3
NONE = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Detector:
    """Where a sequence of frames stands.

    Parameters
    ----------
    panel, patch_mm : the cells, and the edge of their film.
    loads : the candidates beside UNIFORM.
    rest, coarse : whitening of errors against a panel at rest: exact, and that for the search.
    search : templates all over the panel.
    previous : the verdict on the last frame, or None.
    """

    panel: Panel
    patch_mm: float
    loads: tuple[Candidate, ...]
    rest: Whitening
    coarse: Whitening
    search: DiscSearch
    previous: Verdict | None = None

    @classmethod
    def of(cls, panel: Panel, patch_mm: float, first: Observation, loads: tuple[Candidate, ...] = LOADS) -> "Detector":
        """Before the first frame."""
        rest = np.zeros(panel.shape)
        coarse = Whitening.of(blurred(first, COARSE), rest)
        exact = Whitening.of(first, rest)
        templates = tuple(dict.fromkeys(template for load in loads for template in load.templates))
        search = DiscSearch.over(panel, patch_mm, first.baseline, exact, templates)
        return cls(panel, patch_mm, loads, exact, coarse, search)

    def push(self, frame: Observation) -> tuple["Detector", Verdict]:
        """The verdict on a frame, and the detector for the next one."""
        frame, whitening = self._at_rest(frame)
        if whitening is not None:
            verdict = self._judged(frame, self._uniform(frame, whitening))
            return replace(self, previous=verdict), verdict
        verdicts = []
        if self.previous is not None and self.previous.loads:
            verdicts.append(self._settled(frame, self.previous.loads))
        if not verdicts or verdicts[0].goodness > SUSPICIOUS:
            verdicts.append(self._settled(frame, self._searched(frame)))
        verdict = min(verdicts, key=lambda one: one.goodness)
        return replace(self, previous=verdict), verdict

    def fitted(self, candidate: Candidate, frame: Observation, start: Fit | None) -> Fit:
        """One candidate fitted whether or not anything else would do; from everywhere, unless a start fits."""
        fit = None if start is None else self._refined(frame, start)
        if fit is None or fit.chi2 > SUSPICIOUS * frame.measured.size:
            other = self._refined(frame, min(self._coarse(candidate, frame, self._discs(frame)), key=_cost))
            fit = other if fit is None or other.chi2 < fit.chi2 else fit
        return fit

    def _refined(self, frame: Observation, start: Fit) -> Fit:
        """The fit from a start, weighed anew and without outliers until that changes nothing."""
        fit = start
        for _ in range(ROUNDS):
            whitening = Whitening.of(frame, fit.change)
            fit = self._fitting(start.candidate, frame, whitening).best(fit.parameters)
            far = outliers(whitening, fit.residual) if fit.chi2 > SUSPICIOUS * frame.measured.size else NONE
            if len(far) == 0 and np.abs(fit.change - whitening.change).max() < FAR:
                break
            frame = without(frame, far)
        return fit

    def _at_rest(self, frame: Observation) -> tuple[Observation, Whitening | None]:
        """(frame, None) where something stands out; else the frame without outliers, and its whitening."""
        residual = self._unexplained(frame)
        far = outliers(self.rest, residual)
        calm = without(frame.direct(), far)
        whitening = Whitening.of(calm, self.rest.change) if len(far) else self.rest
        errors = whitening @ residual
        quiet = errors @ errors < SUSPICIOUS * errors.size and self.search.stands_out(errors) < QUIET
        return (calm, whitening) if quiet else (frame, None)

    def _searched(self, frame: Observation) -> tuple[Fit, ...]:
        """Coarse fits of all loads from wherever the change looks like something; one of each, the best first."""
        discs = self._discs(frame)
        coarse = [self._coarse(load, frame, discs) for load in self.loads if not load.follows]
        hollow = sorted((fit for fits in coarse for fit in fits if fit.candidate.hollow), key=_cost)
        likely = [variant for fit in hollow[:BEST] for variant in _alike(fit)]
        coarse += [self._coarse(load, frame, likely or discs) for load in self.loads if load.follows]
        fits = sorted((min(fits, key=_cost) for fits in coarse), key=_cost)
        for settled in FINER:
            whitening = Whitening.of(blurred(frame, settled), fits[0].change)
            fits = sorted(self._fits(frame, whitening, tuple(fits)), key=_cost)
        return tuple(fits)

    def _discs(self, frame: Observation) -> list[Disc]:
        return self.search.starts(cell_map(frame.direct()), self.rest @ self._unexplained(frame))

    def _unexplained(self, frame: Observation) -> Array:
        """The readings without those of the panel at rest, (cells) ohm."""
        return frame.direct().missed(self.rest.change, NONE)[0]

    def _coarse(self, load: Candidate, frame: Observation, discs: Sequence[Disc]) -> list[Fit]:
        fitting = self._fitting(load, frame, self.coarse)
        fits: list[Fit] = []
        for disc in discs:
            least = min((fit.cost for fit in fits), default=np.inf)
            fits.append(fitting.best(load.start(disc), COARSE_STEPS, least + HOPELESS))
        return fits

    def _settled(self, frame: Observation, starts: tuple[Fit, ...]) -> Verdict:
        """All candidates from those starts, weighed anew and without outliers until that changes nothing."""
        whitening = Whitening.of(frame, starts[0].change)
        for _ in range(ROUNDS):
            fits = (*self._uniform(frame, whitening), *self._fits(frame, whitening, starts))
            verdict = self._judged(frame, fits)
            best = verdict.best
            far = outliers(whitening, best.residual) if verdict.goodness > SUSPICIOUS else NONE
            if len(far) == 0 and np.abs(best.change - whitening.change).max() < FAR:
                break
            frame, starts = without(frame, far), verdict.loads
            whitening = Whitening.of(frame, best.change)
        return verdict

    def _uniform(self, frame: Observation, whitening: Whitening) -> tuple[Fit, ...]:
        return tuple(self._fitting(kind, frame, whitening).best(kind.mean(self.panel)) for kind in UNIFORM)

    def _fits(self, frame: Observation, whitening: Whitening, starts: tuple[Fit, ...]) -> tuple[Fit, ...]:
        """Every load from its own start, in their order; the hollow ones again from the best, where they end higher."""
        fits: dict[str, Fit] = {}
        for start in starts:
            load = start.candidate
            least = min((fit.cost for fit in fits.values()), default=np.inf)
            fits[load.label] = self._fitting(load, frame, whitening).best(start.parameters, STEPS, least + HOPELESS)
        best = min(fits.values(), key=_cost)
        disc = best.candidate.disc(best.parameters)
        for load in self.loads:
            if disc is not None and load.hollow and fits[load.label].cost > best.cost + HIGHER:
                again = self._fitting(load, frame, whitening).best(load.start(disc), STEPS, best.cost + HOPELESS)
                fits[load.label] = min(fits[load.label], again, key=_cost)
        return tuple(fits[load.label] for load in self.loads)

    def _judged(self, frame: Observation, fits: tuple[Fit, ...]) -> Verdict:
        return judged(self.panel, UNIFORM + self.loads, fits, frame.measured.size)

    def _fitting(self, candidate: Candidate, frame: Observation, whitening: Whitening) -> Fitting:
        return Fitting(self.panel, self.patch_mm, candidate, frame, whitening)


def _cost(fit: Fit) -> float:
    return fit.cost


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
