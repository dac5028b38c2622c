"""Frame after frame of one panel: every candidate fitted from where the frame before ended, and when it is at rest."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.recognition.baseline import Baseline, Remembered
from lampest.loads.recognition.candidates import LOADS, NOTHING, UNIFORM, Several
from lampest.loads.recognition.field import FIELD, field_fit
from lampest.loads.recognition.fit import Fit, along_diameter, with_errors
from lampest.loads.recognition.frame import SUSPICIOUS, Direct, Observation, Whitening, outliers, without
from lampest.loads.recognition.multistart import LEVELS, MultiStart, discs_of
from lampest.loads.recognition.search import cell_map
from lampest.loads.recognition.verdict import OR, OverTime, Verdict, judged, outline_cost
from lampest.loads.shapes.shape import Candidate
from lampest.loads.tare import FADES, stands_out
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Scene

QUIET = 4.5  # standard deviations by which something must stand out for loads to be looked for
FORGOTTEN = 60.0  # ln of a likelihood ratio beyond which a candidate is left out until the panel is searched again
CLEAR = 1.15  # χ² per reading: above, a field might win; below, it lost by more than 60 in all scenes that were tried
NO_DOUBT = 1.0  # of ln P: an outline that costs more might be anything's
STILL, ONE_MOVED = 0.02, 2.0  # relative change of readings, and times that or 6 σ of one alone, that ask for a search
MOST_AT_ONCE = 3  # loads
OF_MEDIAN = 1.2533  # standard deviation of a median over that of a mean
COUNTED = 0.02  # share below which a kind hardly counts for a load's size


@dataclass(frozen=True, eq=False)
class Detector:
    """Where a sequence of frames stands.

    starts : what fits to its frames need.
    previous : the verdict on the last frame, or None. changed : ln r/r0 of its field, where a field was fitted.
    searched : (rows, columns) ohm of the frame in which all of the panel was searched last.
    remembered : what the film remembers of loads. together : the evidence of all frames of the present load.
    """

    starts: MultiStart
    remembered: Remembered
    previous: Verdict | None = None
    changed: Array | None = None
    searched: Array | None = None
    together: OverTime = OverTime()

    @classmethod
    def of(cls, panel: Panel, patch_mm: float, first: Observation, loads: tuple[Candidate, ...] = LOADS) -> "Detector":
        """Before the first frame."""
        return cls(MultiStart.of(panel, patch_mm, first, loads), Remembered.nothing(panel.shape))

    def push(self, frame: Observation) -> tuple["Detector", Verdict]:
        """The verdict on a frame in the light of those before, and the detector for the next one."""
        resting = self.remembered.rest(frame.baseline, frame.seconds)
        here = self
        if resting is not frame.baseline:
            frame = replace(frame, baseline=resting)
            here = replace(self, starts=self.starts.against(frame))
        detector, verdict = here._pushed(frame)
        together, shown = self.together.after(verdict, UNIFORM + self.starts.loads)
        remembered = self.remembered.after(verdict.best.change, frame.seconds)
        return replace(detector, starts=self.starts, remembered=remembered, together=together), shown

    def _pushed(self, frame: Observation) -> tuple["Detector", Verdict]:
        """The verdict on a frame alone, with the baseline that the film has left."""
        calm, whitening = self._at_rest(frame)
        if whitening is not None:
            verdict = self._judged(calm, self._uniform(calm, whitening))
            return replace(self, previous=verdict, searched=None), verdict
        verdicts = []
        if self.previous is not None and self.previous.loads:
            first = self.previous.loads[0].evidence - FORGOTTEN
            likely = [fit for fit in self.previous.loads if fit.evidence > first]
            verdicts = [self._settled(calm, likely)]
            if self._clear(verdicts[0]):
                verdict = self._spread(calm, verdicts[0])
                return replace(self, previous=verdict), verdict
        direct, searched = calm.direct(), self.searched
        field = field_fit(direct, cell_map(direct), *(() if self.changed is None else (self.changed,)))
        verdicts = [self._judged(calm, (*one.fits, field)) for one in verdicts]
        if not verdicts or (self._doubtful(verdicts[0]) and self._moved(calm)):
            verdicts.append(self._settled(calm, self.starts.everywhere(calm), field))
            if self._doubtful(verdicts[-1]):
                verdicts += self._several(calm, verdicts[-1], field)
            searched = calm.measured
        verdict = self._spread(calm, max(verdicts, key=lambda one: one.evidence))
        return replace(self, previous=verdict, searched=searched, changed=field.change), verdict

    def _at_rest(self, frame: Observation) -> tuple[Observation, Whitening | None]:
        """(frame, None) where something stands out; else the frame without outliers, and its whitening."""
        residual, rest = self.starts.unexplained(frame), self.starts.rest
        far = outliers(rest, residual)
        calm = without(frame.direct(), far)
        whitening = Whitening.at_rest(calm) if len(far) else rest
        errors = whitening @ residual
        quiet = errors @ errors < SUSPICIOUS * errors.size and self.starts.search.stands_out(errors) < QUIET
        return (calm, whitening) if quiet else (frame, None)

    def _settled(self, frame: Observation, starts: Sequence[Fit], *others: Fit) -> Verdict:
        """The verdict on all candidates from those starts, and other fits."""
        frame, fits = self.starts.settled(frame, starts)
        return self._judged(frame, (*self._uniform(frame, Whitening.at_rest(frame)), *fits, *others))

    def _several(self, frame: Observation, single: Verdict, field: Fit) -> list[Verdict]:
        """Verdicts on two loads at once, then on three, while they explain more than what one load fewer does."""
        search = self.starts.search
        discs = search.beside(field.change, ())[:1]
        found: list[Verdict] = []
        for _ in range(1, MOST_AT_ONCE):
            places = [[*discs, place] for place in search.beside(field.change, discs)]
            if not places:
                break
            fits = self.starts.sharper(frame, self.starts.together(frame, places))
            verdict = self._settled(frame, (*fits, *single.loads[:1]), field)
            if verdict.evidence <= (found[-1] if found else single).evidence:
                break
            found.append(verdict)
            if not self._doubtful(verdict):
                break
            discs = discs_of(fits[0])
        return found

    def _spread(self, frame: Observation, verdict: Verdict) -> Verdict:
        """The verdict with single loads as large as they may be, where their shares count.

        Not against an estimate: far from it the linear model, by which a load is compared with it, does not hold.
        """
        best = verdict.best
        if frame.direct() is not frame or best not in verdict.loads or isinstance(best.candidate, Several):
            return verdict
        frame, whitening = with_errors(frame, best)
        fits = tuple(
            along_diameter(self.starts.fitting(fit.candidate, frame, whitening), fit)
            if share > COUNTED and not isinstance(fit.candidate, Several)
            else fit
            for fit, share in zip(verdict.fits, verdict.shares, strict=True)
        )
        return replace(verdict, fits=fits)

    def _clear(self, verdict: Verdict) -> bool:
        """Whether a shape explains so much, on a film that is not at its worst, that no field need stand against it."""
        best = verdict.best
        likely = verdict.goodness < CLEAR and best.scatter < LEVELS[-1] * self.starts.response
        return likely and outline_cost(self.starts.panel, best) < NO_DOUBT

    def _doubtful(self, verdict: Verdict) -> bool:
        """Whether another position, or another number of loads, might explain more."""
        return verdict.best.candidate is FIELD or verdict.goodness > SUSPICIOUS

    def _moved(self, frame: Observation) -> bool:
        """Whether readings are no longer those in which all of the panel was searched last; on large panels a few."""
        if self.searched is None:
            return True
        step = (frame.measured - self.searched) / np.hypot(3 * frame.sigma, STILL * frame.measured)
        return bool(np.sqrt(np.mean(np.minimum(step * step, 100.0))) > 1 or np.abs(step).max() > ONE_MOVED)

    def _uniform(self, frame: Observation, whitening: Whitening) -> tuple[Fit, ...]:
        return tuple(self.starts.fitting(kind, frame, whitening).best(kind.mean(self.starts.panel)) for kind in UNIFORM)

    def _judged(self, frame: Observation, fits: tuple[Fit, ...]) -> Verdict:
        candidates, response = UNIFORM + self.starts.loads, frame.baseline.response
        return judged(self.starts.panel, candidates, fits, frame.measured.size, response)


@dataclass(frozen=True, eq=False)
class Zero:
    """The unloaded panel that frames are compared with, taken anew where nothing touches it: drift does not pile up.

    Where so many frames in a row are called nothing, the median of the first half of them is the unloaded panel from
    then on; the other half is a guard, so that a load that begins to come is not in it. It is not, where cells on the
    way there stand out as a load might, nor while the memory of a load still fades.

    scene : they were taken in. count : frames that are needed in a row; 0: zero stays. baseline : the panel at rest.
    since : s of it, on the axis of the frames' seconds. calm : frames since something was
    there, each with what the film remembers after it. said : why zero was
    taken anew after the last frame, or ''.
    """

    scene: Scene
    count: int
    baseline: Baseline
    since: float = 0.0
    calm: tuple[tuple[Direct, Remembered], ...] = ()
    said: str = ""

    def seen(self, frame: Direct) -> Direct:
        """The frame against this baseline."""
        return frame if self.since == 0 else replace(frame, baseline=self.baseline, seconds=frame.seconds - self.since)

    def broken(self) -> "Zero":
        """After a frame of which nothing is known."""
        return replace(self, calm=(), said="")

    def after(self, frame: Direct, verdict: Verdict, detector: Detector) -> tuple["Zero", Detector]:
        """(zero after a frame that `seen` has given, the detector for the next one)."""
        calm = {candidate.label for candidate in UNIFORM}
        quiet = calm.issuperset(verdict.label.split(OR)) and verdict.best.candidate is NOTHING
        if not (self.count and quiet):
            return self.broken(), detector
        here = replace(self, calm=(*self.calm, (frame, detector.remembered)), said="")
        if len(here.calm) < self.count:
            return here, detector
        if here._fades():
            return replace(here, calm=here.calm[1:]), detector
        return here._anew(detector)

    def _fades(self) -> bool:
        """Whether the film still changes by its memory."""
        errors, ends = self.baseline.model_errors, (self.calm[0], self.calm[-1])
        first, last = (remembered.patterns(frame.seconds)[0] for frame, remembered in ends)
        return bool(np.hypot(errors.creep, errors.creep_sd) * np.abs(first - last).max() > FADES)

    def _anew(self, detector: Detector) -> tuple["Zero", Detector]:
        """With the baseline that the first half of the calm frames makes; as it was where that might be a load."""
        first = self.calm[: max(len(self.calm) // 2, 1)]
        middle, remembered = first[len(first) // 2]
        measured = np.median([frame.measured for frame, _ in first], axis=0)
        sigma = OF_MEDIAN / np.sqrt(np.sum([1 / np.square(frame.sigma) for frame, _ in first], axis=0))
        rest = remembered.rest(self.baseline, middle.seconds)
        change = cell_map(replace(middle, measured=measured, sigma=sigma, baseline=rest))
        if stands_out(change):
            return self.broken(), detector
        common = None if middle.common is None else OF_MEDIAN / np.sqrt(len(first)) * middle.common
        baseline = Baseline.of(measured, sigma, self.scene, self.baseline.model_errors, common)
        seconds = self.calm[-1][0].seconds - self.calm[0][0].seconds
        said = (
            f"nothing was there for {len(self.calm)} frames ({seconds:.3g} s): no cell was off by more than "
            f"{100 * np.expm1(np.abs(change).max()):.2g} %, as drift and the film's memory allow"
        )
        here = Zero(self.scene, self.count, baseline, self.since + middle.seconds, said=said)
        starts, first_frame = detector.starts, here.seen(replace(middle, seconds=here.since))
        fresh = Detector.of(starts.panel, starts.patch_mm, first_frame, starts.loads)
        return here, replace(fresh, remembered=detector.remembered.against(remembered, middle.seconds))
