"""A frame that was solved in haste, solved again: by weights of its own, from all starts, and with error bars."""

from dataclasses import dataclass, replace

import numpy as np

from lampest.estimate.step import Step
from lampest.estimate.stream import Stream
from lampest.loads.pressure import PressureTrack
from lampest.panel.panel import Array
from lampest.posterior.track import Track
from lampest.recording.readings import Readings
from lampest.report.live.force import Force, read_load
from lampest.solvers.search import SAME


@dataclass(frozen=True, eq=False)
class Findings:
    """What a second look gives to later frames.

    number : of the frame. weights, weighed_at : as `Stream` has them. lower : its cells (rows, columns) ohm where their
    minimum is lower than the one found in haste, or belongs to other weights; None where it is not. force : with its
    error, or None.
    """

    number: int
    weights: tuple[float, ...] | None
    weighed_at: float
    lower: Array | None
    force: Force | None

    def into(self, stream: Stream) -> Stream:
        """The stream as the next frame takes it."""
        stream = replace(stream, weights=self.weights, weighed_at=self.weighed_at)
        return stream if self.lower is None else replace(stream, previous=self.lower)


@dataclass(frozen=True, eq=False)
class SecondLook:
    """number, time : of the frame. stream, load : before it, without what cannot travel to another process.

    objective : of the minimum that was found in haste. due : whether weights or starts were left open.
    """

    number: int
    time: float
    stream: Stream
    load: PressureTrack
    readings: Readings
    objective: float
    due: bool

    @classmethod
    def at(
        cls,
        number: int,
        time: float,
        stream: Stream,
        load: PressureTrack,
        readings: Readings,
        step: Step,
        track: Track | None,
    ) -> "SecondLook | None":
        """None where the frame left nothing open.

        step : how it was solved. track : for error bars, of the unloaded panel; None: none are wanted.
        """
        due = step.solution.unsearched or stream.due(readings)
        if not stream.hasty or not step.solution.solved or not (due or track is not None):
            return None
        baseline = None if stream.baseline is None else stream.baseline.bare()
        stream = replace(stream, hasty=False, prepared=None, track=track, baseline=baseline)
        return cls(number, time, stream, load, readings, step.solution.objective, due)

    def findings(self) -> Findings:
        """Solve the frame once more."""
        stream, step = self.stream.push(self.readings)
        found, lower = step.estimate(-1), None
        if found is not None:
            same = stream.weights == self.stream.weights
            lower = None if same and step.solution.objective > self.objective * (1 - SAME) else found
        return Findings(self.number, stream.weights, stream.weighed_at, lower, self._force(stream, step))

    def _force(self, stream: Stream, step: Step) -> Force | None:
        found, baseline = step.estimate(-1), stream.baseline_resistance
        if found is None or step.bars is None or np.isnan(baseline).any():
            return None
        return read_load(self.load, found / baseline, step.bars, self.time)[1]
