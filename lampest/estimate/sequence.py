"""A recording's frames in order: absolute methods one by one, relative methods from a joint first pair on."""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import LogGradient, Misfit, Term
from lampest.estimate.batch import push_block
from lampest.estimate.deciding import baseline_readings, deciding_frame, frames_beside
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.modules import begin_stream
from lampest.estimate.noise import NoiseEstimate
from lampest.estimate.outliers import WINDOW
from lampest.estimate.prepared import Prepared
from lampest.estimate.state import CarriedOver, Step
from lampest.estimate.stream import Stream
from lampest.estimate.weights import converter_and_faults, strongest, with_chosen_weights
from lampest.files.errors import InputError
from lampest.files.process import ONE_BLAS_THREAD
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings, mean_change
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.stored import StoredRecording, first_unloaded, measured_part, of_parts, only_frames
from lampest.solvers.solution import Status

# Unloaded frames, and measured ones around the strongest, that tell of the noise; no more than a part has.
LEAD_FRAMES = 500
OPENING_FRAMES = 10  # first frames that stand for the unloaded ones where there are none, if enough of one can be read


def default_terms(recording: Recording) -> tuple[Term, ...]:
    """Return the terms where none are given: both are free of unit and scale.

    Readings count by their noise where that is known; the penalty is of ln r between neighbours.
    Raises InputError where what is given is no Recording.
    """
    known = Prepared.of(recording).recording.readings().sigma is not None
    return Misfit(weighting="noise" if known else "plain"), LogGradient()


@ONE_BLAS_THREAD
def reconstruct(
    recording: Recording | Prepared,
    estimator: Estimator,
    on_frame: Callable[[int, int, Callable[[], Estimates] | None], None] = lambda done, frames, so_far: None,
) -> Estimates:
    """Solve every measured frame of a recording.

    A frame that fails, or of which too little was read, holds NaN and a status; the frames after it continue from the
    last one that was solved.

    Parameters
    ----------
    recording : Recording
    estimator : Estimator
    on_frame : callable
        Called after every frame with the number of frames done, the number of all, and a function that returns the
        estimates so far, in which the other frames are not solved; None for a method that solves all frames together.

    Raises
    ------
    InputError
        If the noise is needed and unknown, or what is given is no Recording.
    """
    prepared = Prepared.of(recording)
    prepared.recording.scene.panel.check_memory()
    readings, frames = prepared.noise.readings, prepared.recording.measured_frames()
    stream = first_stream(prepared.recording, readings, estimator, prepared.noise)
    return MeasuredPart(prepared.recording, frames, readings, prepared, estimator.automatic).solve(stream, on_frame)[1]


@dataclass(frozen=True, eq=False)
class MeasuredPart:
    """Measured frames that are solved from one stream: all of a recording, or some of a long one.

    Attributes
    ----------
    recording : Recording
        With frames at rest.
    frames : array
        Indices of the measured frames in the recording.
    readings : Readings
        Of all frames of the recording.
    prepared : Prepared
        Noise, effects and warnings that hold for the estimates.
    automatic : bool
        Whether the data choose weights.
    """

    recording: Recording
    frames: NDArray[np.intp]
    readings: Readings
    prepared: Prepared
    automatic: bool

    def solve(
        self,
        stream: Stream,
        on_frame: Callable[[int, int, Callable[[], Estimates] | None], None] = lambda done, frames, so_far: None,
    ) -> tuple[Stream, Estimates]:
        """Return the stream after these frames, and their estimates; see `reconstruct`."""
        readings, count, steps = self.readings[self.frames], len(self.frames), list[Step]()

        def so_far() -> Estimates:
            missing = [stream.unsolved(Status.BROKEN_OFF)] * (count - len(steps))
            return self._estimates(stream, readings, steps + missing)

        if stream.estimator.method.needs_all_frames:
            numbers, resting = iter(range(1, count + 1)), self.readings[self.recording.role == UNLOADED]
            stream, steps = stream.sequence(resting, readings, lambda: on_frame(next(numbers, count), count, None))
        while len(steps) < count:
            for after, step in push_block(stream, readings[len(steps) :]):
                stream = after
                steps.append(step)
                on_frame(len(steps), count, so_far)
        return stream, so_far()

    def _estimates(self, stream: Stream, readings: Readings, steps: list[Step]) -> Estimates:
        return Estimates(
            self.recording,
            stream.estimator,
            self.frames,
            readings,
            stream.resting,
            np.where(self.recording.scene.panel.present, stream.baseline_resistance, np.nan),
            stream.baseline or steps[0],
            None if stream.track is None else stream.track.baseline,
            tuple(steps),
            stream.estimator.joint_start,
            self.prepared,
            stream.scene.contacts,
            automatic=self.automatic,
        )


def first_stream(
    recording: Recording,
    readings: Readings,
    estimator: Estimator,
    noise: NoiseEstimate | None = None,
    period: float | None = None,
) -> Stream:
    """Return the stream before a recording's first measured frame; see `baseline_readings`.

    Parameters
    ----------
    noise : NoiseEstimate or None
        Learned from frames.
    period : float or None
        s between frames; None: the recording's. Networks that are alike share the weights that those of them choose
        that differ most from rest.
    """
    layout, chosen = recording.scene.panel.modules, dict[Hashable, Estimator]()

    @cache
    def network(scene: Scene, number: int | None) -> tuple[Recording, Readings, Readings]:
        if layout is None or number is None:
            part, read = replace(recording, scene=scene), readings
        else:
            part, read = recording.modules[number], readings.of_module(layout, number)
        return part, read, baseline_readings(part, read)

    def own(scene: Scene, number: int | None) -> tuple[Estimator, Readings]:
        resting = network(scene, number)[2]
        if not (estimator.automatic and estimator.auto_weight.per == "recording"):
            return estimator, resting
        if (kind := converter_and_faults(scene)) not in chosen:
            every = recording.scene.of_modules if number is not None else (scene,)
            similar = [
                n
                for n, module in enumerate(every)
                if converter_and_faults(module) == kind and n not in recording.scene.dead_modules
            ]
            some = [network(every[n], None if number is None else n) for n in similar]
            chosen[kind] = _weighted(estimator, some)
        return chosen[kind], resting

    period = frame_period(recording) if period is None else period
    return begin_stream(estimator, recording.scene, period, readings[0], noise, own)


def _weighted(estimator: Estimator, networks: Sequence[tuple[Recording, Readings, Readings]]) -> Estimator:
    """Return the estimator with weights from the deciding frames of networks that are alike.

    Of one network also of frames beside. As it is where no frame is measured.
    """
    deciding = [(*network, frame) for network in networks if (frame := deciding_frame(*network)) is not None]
    if not deciding:
        return estimator
    if len(networks) == 1:
        deciding += [(*networks[0], frame) for frame in frames_beside(*networks[0], deciding[0][3])]
        numbers: Sequence[int] = range(len(deciding))
    else:
        numbers = strongest(
            [float(mean_change(read.plain_values[f], resting.value)) for _, read, resting, f in deciding]
        )
    parts = (deciding[number] for number in numbers)
    first, *beside = [
        deciding_data(estimator, part.scene, resting, read[frame]) for part, read, resting, frame in parts
    ]
    part = deciding[numbers[0]][0]
    return with_chosen_weights(estimator, part.scene, first, None, beside)


def deciding_data(estimator: Estimator, scene: Scene, resting: Readings, frame: Readings) -> Data:
    """Return the data from which weights are chosen: one frame, with its baseline where terms compare it with that."""
    if not estimator.relative:
        return estimator.data(frame.alone(), Background(scene))
    if estimator.joint_start:
        return estimator.data(resting.together(frame), Background(scene))
    return Stream.begin(estimator, scene, float("inf"), resting).given(frame)[0]


def frame_period(recording: Recording) -> float:
    """Median time between frames, s."""
    return float(np.median(np.diff(recording.time))) if len(recording.time) > 1 else float("inf")


SolvedPart = tuple[int, Estimates, CarriedOver]  # its number, what became of its frames, what the next part needs


@dataclass(frozen=True, eq=False)
class Parts:
    """A recording too long for memory, ready for its first frame: part by part, each like a recording of its own.

    Baseline, noise, weights and the check of the circuit need many frames, and are taken from a bounded sample: the
    first unloaded frames, and the measured ones around the strongest. Outliers are detected in every part. Parts whose
    estimates look back at no earlier frame stand `apart`, and all begin with the baseline. Else a stream goes on from
    part to part by the arrays of `CarriedOver`, so that a stream that is resumed from the disk finds the same numbers;
    anything that a solver kept for speed alone begins anew.

    Attributes
    ----------
    stored : StoredRecording
    lead : Recording
        The unloaded frames, or the first ones where there are none.
    sample : Prepared
        The lead, and frames around the strongest.
    stream : Stream
        Before the first frame.
    automatic : bool
        Whether the data choose weights.
    """

    stored: StoredRecording
    lead: Recording
    sample: Prepared
    stream: Stream
    automatic: bool

    @classmethod
    def of(cls, stored: StoredRecording, estimator: Estimator, asked: tuple[Recording, Prepared]) -> "Parts":
        """asked : of `asked_frames`. Raises InputError where the estimator needs all frames at once, or as `Stream`."""
        check_by_parts(estimator, stored)
        noise, period = asked[1].noise, frame_period(stored.part(stored.blocks()[0]))
        stream = first_stream(asked[1].recording, noise.readings, estimator, noise, period)
        return cls(stored, *asked, stream, estimator.automatic)

    @property
    def independent(self) -> bool:
        """Whether parts can be solved in any order."""
        return self.stream.rested and not self.stream.estimator.uses_previous

    def estimates(self, done: Callable[[int], CarriedOver | None]) -> Iterator[SolvedPart]:
        """Solve every part that is not `done`. done : number → state after its last frame, where estimates are kept."""
        stream = start = self.stream
        for number, frames in enumerate(self.stored.blocks()):
            carried = done(number)
            if self.independent:
                yield from () if carried is not None else self.solve_part(number)
                continue
            part = self._part(frames) if carried is None or not start.rested else None
            if carried is not None:
                start = start if part is None else self._with_baseline(start, part)
                stream = carried.onto(start)
            elif part is not None:
                stream, estimates = part.solve(stream)
                carried = CarriedOver.of(stream)
                yield number, estimates, carried
                start = stream.restarted(self.stream)
                stream = carried.onto(start)

    def solve_part(self, number: int) -> Iterator[SolvedPart]:
        """Solve a part, where it stands apart and some of its frames are measured."""
        if self.independent and (part := self._part(self.stored.blocks()[number])) is not None:
            stream, estimates = part.solve(self.stream)
            yield number, estimates, CarriedOver.of(stream)

    def _part(self, frames: range) -> MeasuredPart | None:
        """Return the measured ones of some frames, with the lead; None without any."""
        part = measured_part(self.stored, frames, WINDOW)
        if part is None:
            return None
        recording = of_parts((self.lead, part))
        readings = Prepared(recording, self.sample.noise).noise.readings
        return MeasuredPart(recording, _own_frames(recording, frames), readings, self.sample, self.automatic)

    def _with_baseline(self, begun: Stream, part: MeasuredPart) -> Stream:
        """Return a stream whose baseline is solved together with a frame once it has come to that frame."""
        for frame in part.frames if begun.estimator.joint_start else ():
            begun, _ = begun.push(part.readings[int(frame)])
            if begun.rested:
                return begun.restarted(self.stream)
        return begun


def check_by_parts(estimator: Estimator, stored: StoredRecording) -> None:
    """Raise InputError where an estimator, or the pressures of a scene, need all frames of a long recording at once."""
    reason = ""
    if estimator.method.needs_all_frames:
        reason = f"formulation: {estimator.method.kind} estimates all frames together"
    elif stored.scene.film is not None:
        reason = "film: what it remembers is followed through all frames"
    elif estimator.tare is not None:
        reason = "tare: zero is followed through all frames"
    if reason:
        raise InputError(
            f"{reason}, and {stored.frames} frames of {stored.scene.panel.crossings} cells are more than is held at "
            "once; split the recording"
        )


def asked_frames(stored: StoredRecording) -> tuple[Recording, Prepared]:
    """Return the lead, and the prepared lead with the frames around the strongest; see `Parts`.

    Raises InputError where none is measured.

    It reads the whole recording once.
    """
    lead = first_unloaded(stored, min(LEAD_FRAMES, stored.length))
    if lead is None:
        lead = only_frames(opening := stored.part(range(min(OPENING_FRAMES, stored.frames))), opening.role == MEASURED)
    resting = baseline_readings(lead, lead.readings())
    best: tuple[float, int] = (-1.0, -1)
    for frames in stored.blocks():
        part = measured_part(stored, frames, WINDOW)
        if part is None:
            continue
        recording = of_parts((lead, part))
        taken, own = Prepared(recording).frame_noise.readings, _own_frames(recording, frames)
        size: Array = np.where(
            taken.enough(stored.scene)[own], mean_change(taken.plain_values[own], resting.value), -1.0
        )
        at = int(np.argmax(size))
        assert recording.number is not None
        best = max(best, (float(size[at]), int(recording.number[own[at]])))
    if best[1] < 0:
        raise InputError(f"{stored.path}: no frame is measured (role 1)")
    around = stored.part(range(best[1], best[1] + 1), min(LEAD_FRAMES // 2, stored.length))
    return lead, Prepared(of_parts((lead, only_frames(around, around.role == MEASURED))))


def _own_frames(recording: Recording, frames: range) -> NDArray[np.intp]:
    """Return the indices of a part's own measured frames."""
    number = recording.number
    assert number is not None
    return np.flatnonzero((number >= frames.start) & (number < frames.stop) & (recording.role == MEASURED))
