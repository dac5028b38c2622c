"""The unloaded panel taken anew where nothing touches it, so that drift of hours does not pile up.

Where so many frames in a row are called nothing (a flat load at most, and less likely), the median of the first half of
them is the unloaded panel from then on; the other half is a guard, so that a load that begins to come is not in it. It
is not, where cells on the way there stand out as a load might, nor while the memory of a load still fades.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.loads.recognition.baseline import Baseline, Remembered
from lampest.loads.recognition.candidates import NOTHING, UNIFORM
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.frame import Direct
from lampest.loads.recognition.search import cell_map
from lampest.loads.recognition.verdict import OR, Verdict
from lampest.loads.tare import FADES, stands_out
from lampest.panel.scene import Scene

CALM = frozenset(candidate.label for candidate in UNIFORM)
OF_MEDIAN = 1.2533  # standard deviation of a median over that of a mean


@dataclass(frozen=True, eq=False)
class Zero:
    """What frames are compared with.

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
        quiet = frozenset(verdict.label.split(OR)) <= CALM and verdict.best.candidate is NOTHING
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
