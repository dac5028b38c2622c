"""Where a live panel stands: its stream, what its film remembers, and its zero, which may be taken anew."""

from dataclasses import dataclass, replace

import numpy as np

from lampest.estimate.estimator import Estimator
from lampest.estimate.noise.before import FramesBefore
from lampest.estimate.step import Step
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.loads.pressure import PressureTrack
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.track import Track
from lampest.recording.readings import Readings
from lampest.report.live.force import read_load
from lampest.report.live.second_look import SecondLook
from lampest.report.live.verdict import verdict_of
from lampest.report.live.view import Picture

ASKED = "it was asked for"


@dataclass(frozen=True, eq=False)
class Carried:
    """What is carried from frame to frame.

    stream, load : cells, and pressures from them. recent : the newest readings. missing : frames that still have to
    come for a zero that was asked for; None where none was. zeroed : why the last frame led to a new zero, or ''.
    track : what error bars of second looks need, where frames are solved in haste. look : what is still to be found out
    of the last frame, or None. before : the frames before, as they came.
    """

    stream: Stream
    load: PressureTrack
    recent: tuple[Readings, ...] = ()
    missing: int | None = None
    zeroed: str = ""
    track: Track | None = None
    look: SecondLook | None = None
    before: FramesBefore = FramesBefore()

    @classmethod
    def begin(
        cls, estimator: Estimator, scene: Scene, period: float, resting: Readings, hasty: bool = False
    ) -> "Carried":
        """Against the unloaded readings; hasty : see `hurried`. Raises InputError as `Stream.begin`."""
        begun = cls(Stream.begin(estimator, scene, period, resting), PressureTrack.begin(scene, tare=estimator.tare))
        return begun.hurried() if hasty else begun

    def hurried(self) -> "Carried":
        """Frames take no longer than they must, and say what they leave open.

        The first weights are the baseline's. Error bars are left to second looks, but those that the next frame needs.
        """
        stream, baseline = self.stream, self.stream.baseline
        if stream.weights is None and baseline is not None and len(baseline.weights) == len(stream.estimator.terms):
            stream = replace(stream, weights=baseline.weights if baseline.solution.solved else None)
        track = None if stream.estimator.relative else stream.track
        return replace(self, stream=replace(stream, hasty=True, track=None if track else stream.track), track=track)

    def asked(self, frames: int) -> "Carried":
        """Once somebody has said that nothing touches the panel, and that so many frames shall be its zero."""
        return replace(self, recent=(), missing=frames)

    def after(self, readings: Readings, step: Step, time: float) -> "Carried":
        """Once a frame was solved: its zero is new where enough frames have come, or nothing touches the panel."""
        here = replace(self, zeroed="", recent=self._kept(readings))
        ratio = self.ratio(step)
        if ratio is not None:
            here = replace(here, load=self.load.after(ratio, time))
        if self.missing is not None:
            here = replace(here, missing=self.missing - 1)
            return here if here.missing else here._zeroed(here.recent, time, ASKED)
        tared, tare = here.load.tared, self.stream.estimator.tare
        if ratio is None or not tared or tare is None:
            return here
        return here._zeroed(here.recent[: tare.frames // 2], time, tared)

    def calmed(self, readings: Readings) -> tuple["Carried", Readings, int]:
        """With a frame among those before the next; the frame without readings that leap, and how many do."""
        stream, after = self.stream, replace(self, before=self.before.after(readings))
        known = stream.scene, stream.resting, stream.baseline_resistance
        return after, *self.before.without_leaps(readings, *known)

    def ratio(self, step: Step) -> Array | None:
        """r/r_baseline (rows, columns) of a frame; None where it was not solved, or there is no baseline."""
        baseline = self.stream.baseline_resistance
        if not step.solution.solved or np.isnan(baseline).any():
            return None
        return np.asarray(step.solution.cell_resistance[-1] / baseline)

    def _kept(self, readings: Readings) -> tuple[Readings, ...]:
        tare = self.stream.estimator.tare
        most = max(0 if tare is None else tare.frames, len(self.recent) + 1 if self.missing else 0)
        return (*self.recent, readings)[-most:] if most else ()

    def _zeroed(self, frames: tuple[Readings, ...], time: float, why: str) -> "Carried":
        """Against the mean of some frames from now on; as it was where too little of them was read."""
        first, *others = frames
        try:
            stream = replace(self.stream, track=self.track or self.stream.track)
            stream = stream.tared(first.together(*others).mean())
        except InputError:
            return replace(self, missing=None, recent=())
        begun = Carried(stream, self.load.rebased(time), zeroed=why)
        return begun.hurried() if stream.hasty else begun


def solved_picture(carried: Carried, readings: Readings, picture: Picture) -> tuple[Carried, Picture]:
    """Solve one frame without its leaps: (where the panel stands then, the picture with what the solver found).

    Where it cannot be solved, the picture holds NaN and says why, and the cells stay as they were.
    """
    carried, readings, leaps = carried.calmed(readings)
    picture = replace(picture, leaps=leaps)
    try:
        stream, step = carried.stream.push(readings)
    except InputError as error:
        return carried, replace(picture, status=str(error))
    look = SecondLook.at(picture.number, picture.time, carried.stream, carried.load, readings, step, carried.track)
    here, solution = replace(carried, stream=stream, look=look), step.solution
    picture = replace(picture, status=solution.status.value, seconds=step.seconds)
    ratio = here.ratio(step)
    if ratio is not None:
        pressed, force = read_load(here.load, ratio, step.bars, picture.time)
        picture = replace(
            picture,
            relative_change=100 * (ratio - 1),
            open_cell=solution.open_cell[-1],
            total=force.newton,
            total_deviation=force.deviation,
            cell_resistance=solution.cell_resistance[-1],
            pressure=pressed.pressure,
            saturated=pressed.saturated,
            verdict=verdict_of(readings, stream.resting, ratio, np.asarray(solution.open_cell[-1], dtype=bool)),
        )
    elif solution.solved:
        assert stream.baseline is not None
        picture = replace(picture, status=f"no baseline: {stream.baseline.solution.status.value}")
    return here.after(readings, step, picture.time), picture
