"""Frame after frame of one panel: every candidate fitted, from where the frame before ended."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.recognition.fit import STEPS, Fit, Fitting
from lampest.loads.recognition.frame import Frame, Weight, outliers, without
from lampest.loads.recognition.loads import CUP, FLAT, LAMPREY, NOTHING, RING, ROD, Candidate, Disc, Round
from lampest.loads.recognition.search import Search, cell_map
from lampest.loads.recognition.verdict import KINDS, Verdict, judged
from lampest.panel.panel import Array, Panel

FAR = 1.0  # difference of ln r/r0 beyond which errors are weighed anew
SUSPICIOUS = 1.4  # χ² per reading beyond which outliers, or another place, are looked for
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
    rest, coarse : weights of errors against a panel at rest: exact ones, and those for the search.
    search : discs all over the panel.
    previous : the verdict on the last frame, or None.
    """

    panel: Panel
    patch_mm: float
    rest: Weight
    coarse: Weight
    search: Search
    previous: Verdict | None = None

    @classmethod
    def of(cls, panel: Panel, patch_mm: float, first: Frame) -> "Detector":
        """Before the first frame."""
        rest = np.zeros(panel.shape)
        coarse = Weight.of(blurred(first, COARSE), rest)
        exact = Weight.of(first, rest)
        return cls(panel, patch_mm, exact, coarse, Search.over(panel, patch_mm, first.baseline, exact))

    def push(self, frame: Frame) -> tuple["Detector", Verdict]:
        """The verdict on a frame, and the detector for the next one."""
        frame, weight = self._at_rest(frame)
        if weight is not None:
            verdict = self._judged(frame, self._everywhere(frame, weight))
            return replace(self, previous=verdict), verdict
        verdicts = []
        if self.previous is not None and self.previous.round:
            verdicts.append(self._settled(frame, self.previous.round))
        if not verdicts or verdicts[0].goodness > SUSPICIOUS:
            verdicts.append(self._settled(frame, self._found(frame)))
        verdict = min(verdicts, key=lambda one: one.goodness)
        return replace(self, previous=verdict), verdict

    def lamprey(self, frame: Frame, start: Fit | None) -> Fit:
        """An oral disc fitted whether or not anything else would do; from everywhere, unless a start fits."""
        fit = None if start is None else self._lamprey(frame, start)
        if fit is None or fit.chi2 > SUSPICIOUS * frame.measured.size:
            discs = self._places(frame)
            other = self._lamprey(frame, min(self._coarse(LAMPREY, frame, discs), key=lambda one: one.cost))
            fit = other if fit is None or other.chi2 < fit.chi2 else fit
        return fit

    def _lamprey(self, frame: Frame, start: Fit) -> Fit:
        for _ in range(ROUNDS):
            weight = Weight.of(frame, start.change)
            fit = self._fitting(LAMPREY, frame, weight).best(start.parameters)
            far = outliers(weight, fit.residual) if fit.chi2 > SUSPICIOUS * frame.measured.size else NONE
            if len(far) == 0 and np.abs(fit.change - weight.change).max() < FAR:
                break
            frame, start = without(frame, far), fit
        return fit

    def _at_rest(self, frame: Frame) -> tuple[Frame, Weight | None]:
        """(frame, None) where something stands out; else the frame without outliers, and its weight."""
        residual = self._unexplained(frame)
        far = outliers(self.rest, residual)
        calm = without(frame.direct(), far)
        weight = Weight.of(calm, self.rest.change) if len(far) else self.rest
        errors = weight @ residual
        quiet = errors @ errors < SUSPICIOUS * errors.size and self.search.stands_out(errors) < QUIET
        return (calm, weight) if quiet else (frame, None)

    def _found(self, frame: Frame) -> tuple[Fit, ...]:
        """Coarse fits of all kinds from wherever the change looks like something; one of each, the best first."""
        discs = self._places(frame)
        lampreys = sorted(self._coarse(LAMPREY, frame, discs), key=lambda fit: fit.cost)
        likely = [variant for fit in lampreys[:BEST] for variant in _alike(_disc(fit))]
        found = [lampreys[0]]
        for kind, starts in ((CUP, likely), (RING, likely), (ROD, discs)):
            found.append(min(self._coarse(kind, frame, starts), key=lambda fit: fit.cost))
        for settled in FINER:
            found.sort(key=lambda fit: fit.cost)
            found = list(self._fits(frame, Weight.of(blurred(frame, settled), found[0].change), tuple(found)))
        return tuple(sorted(found, key=lambda fit: fit.cost))

    def _places(self, frame: Frame) -> list[Disc]:
        return self.search.starts(cell_map(frame.direct()), self.rest @ self._unexplained(frame))

    def _unexplained(self, frame: Frame) -> Array:
        """The readings without those of the panel at rest, (cells) ohm."""
        return frame.direct().missed(self.rest.change, NONE)[0]

    def _coarse(self, kind: Round, frame: Frame, discs: Sequence[Disc]) -> list[Fit]:
        fitting = self._fitting(kind, frame, self.coarse)
        fits: list[Fit] = []
        for disc in discs:
            least = min((fit.cost for fit in fits), default=np.inf)
            fits.append(fitting.best(kind.parameters(disc), COARSE_STEPS, least + HOPELESS))
        return fits

    def _settled(self, frame: Frame, starts: tuple[Fit, ...]) -> Verdict:
        """All candidates from those starts, weighed anew and without outliers until that changes nothing."""
        weight = Weight.of(frame, starts[0].change)
        for _ in range(ROUNDS):
            verdict = self._judged(frame, (*self._everywhere(frame, weight), *self._fits(frame, weight, starts)))
            best = verdict.best
            far = outliers(weight, best.residual) if verdict.goodness > SUSPICIOUS else NONE
            if len(far) == 0 and np.abs(best.change - weight.change).max() < FAR:
                break
            frame, starts = without(frame, far), verdict.round
            weight = Weight.of(frame, best.change)
        return verdict

    def _everywhere(self, frame: Frame, weight: Weight) -> tuple[Fit, ...]:
        return tuple(self._fitting(kind, frame, weight).best(kind.mean(self.panel)) for kind in (NOTHING, FLAT))

    def _fits(self, frame: Frame, weight: Weight, starts: tuple[Fit, ...]) -> tuple[Fit, ...]:
        """Every round candidate from its own start, in the order of KINDS.

        Hollow loads can do nearly all that others do: where they end higher, they try from there.
        """
        fits: dict[str, Fit] = {}
        for start in starts:
            kind = start.candidate
            least = min((fit.cost for fit in fits.values()), default=np.inf)
            fits[kind.label] = self._fitting(kind, frame, weight).best(start.parameters, STEPS, least + HOPELESS)
        best = min(fits.values(), key=lambda fit: fit.cost)
        for kind in (RING, CUP, LAMPREY):
            if fits[kind.label].cost > best.cost + HIGHER:
                again = self._fitting(kind, frame, weight).best(
                    kind.parameters(_disc(best)), STEPS, best.cost + HOPELESS
                )
                fits[kind.label] = min(fits[kind.label], again, key=lambda fit: fit.cost)
        return tuple(fits[label] for label in KINDS if label in fits)

    def _judged(self, frame: Frame, fits: tuple[Fit, ...]) -> Verdict:
        return judged(self.panel, fits, frame.measured.size)

    def _fitting(self, kind: Candidate, frame: Frame, weight: Weight) -> Fitting:
        return Fitting(self.panel, self.patch_mm, kind, frame, weight)


def _disc(fit: Fit) -> Disc:
    assert isinstance(fit.candidate, Round)
    return fit.candidate.disc(fit.parameters)[0]


def _alike(disc: Disc) -> list[Disc]:
    """Itself, a wider rim and a narrower one: between patches a wide rim that presses less looks much the same."""
    width, outer = (disc.diameter_mm - disc.inner_mm) / 2, disc.diameter_mm
    wider = disc._replace(diameter_mm=outer + width, inner_mm=max(disc.inner_mm - width, 0.1 * outer))
    narrower = disc._replace(diameter_mm=outer - width / 2, inner_mm=disc.inner_mm + width / 2)
    return [disc, wider._replace(rim_kpa=disc.rim_kpa / 2), narrower._replace(rim_kpa=2 * disc.rim_kpa)]


def blurred(frame: Frame, settled: float) -> Frame:
    """The frame with cells that are known no better at rest than to `settled`, in ln r."""
    doubts = replace(frame.baseline.doubts, settled=settled)
    return replace(frame, baseline=replace(frame.baseline, doubts=doubts))
