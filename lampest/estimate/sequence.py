"""Estimation of a whole recording, part by part where it is too long for memory."""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import ceil

import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import LogGradient, Misfit, Term
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.state import Step
from lampest.estimate.stream import CarriedOver, Stream
from lampest.estimate.weights import converter_and_faults, strongest, with_chosen_weights
from lampest.files.errors import InputError
from lampest.files.process import ONE_BLAS_THREAD
from lampest.inference.noise import NoiseEstimate
from lampest.inference.prepared import Prepared
from lampest.inference.readings.outliers import WINDOW
from lampest.panel.panel import Numbers
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings, mean_change
from lampest.recording.recording import (
    MEASURED,
    UNLOADED,
    Recording,
    baseline_readings,
    deciding_frames,
)
from lampest.recording.stored import StoredRecording, first_unloaded, joined, measured_part
from lampest.solvers.solution import Status

# Frames of a segment. Begun at the unloaded panel, its first frame takes up to twice as long as
# later ones (10 × 10 to 64 × 64), so that segments cost 2 % at most.
SEGMENT_FRAMES = 50
# Called after every frame with the number of solved frames, the number of all, and a function that
# returns the estimates so far, with the other frames unsolved; None for a method that solves all
# frames together.
OnFrame = Callable[[int, int, Callable[[], Estimates] | None], None]
# Unloaded frames, and measured ones around the strongest, that represent a long recording; at most
# those of a part.
LEAD_FRAMES = 500
OPENING_FRAMES = 10  # first measured frames that replace the unloaded ones where there are none
# Number of the part, its estimates, memory for the next part.
SolvedPart = tuple[int, Estimates, CarriedOver]


def default_terms(recording: Recording) -> tuple[Term, ...]:
    """Return the default terms: the misfit and the gradient of ln r.

    The misfit is weighted by the noise where it is known. Both are free of units and of scale.
    Raises InputError if `recording` is no Recording.
    """
    noise_known = Prepared.of(recording).recording.readings().sigma is not None
    return Misfit(weighting="noise" if noise_known else "plain"), LogGradient()


@ONE_BLAS_THREAD
def reconstruct(
    recording: Recording | Prepared,
    estimator: Estimator,
    on_frame: OnFrame = lambda done, frames, so_far: None,
) -> Estimates:
    """Solve every measured frame of a recording.

    A frame that fails, or that has too few readings, contains NaN and a status. The frames after it
    continue from the last solved one.

    Parameters
    ----------
    recording : Recording or Prepared
    estimator : Estimator
    on_frame : callable
        Called after every frame, see `OnFrame`.

    Raises
    ------
    InputError
        If the noise is needed and unknown, or `recording` is no Recording.
    """
    stream, part = begun(Prepared.of(recording), estimator)
    return part.solve(stream, on_frame)[1]


@ONE_BLAS_THREAD
def begun(prepared: Prepared, estimator: Estimator) -> tuple[Stream, "MeasuredPart"]:
    """Return the stream before a recording's first measured frame, and its measured frames.

    Raises InputError as `reconstruct`.
    """
    prepared.recording.scene.panel.check_memory()
    recording = prepared.resolved
    readings = prepared.noise.readings
    stream = first_stream(recording, readings, estimator, prepared.noise)
    return stream, MeasuredPart(recording, recording.measured_frames(), readings, prepared)


@dataclass(frozen=True, eq=False)
class MeasuredPart:
    """Measured frames that are solved from one stream: all of a recording, or some of a long one.

    Attributes
    ----------
    recording : Recording
        The frames, including unloaded ones.
    frames : integer array
        Indices of the measured frames in the recording.
    readings : Readings
        Readings of all frames of the recording.
    prepared : Prepared
        Noise, effects and warnings of the estimates.
    """

    recording: Recording
    frames: Numbers
    readings: Readings
    prepared: Prepared

    def solve(
        self, stream: Stream, on_frame: OnFrame = lambda done, frames, so_far: None
    ) -> tuple[Stream, Estimates]:
        """Solve these frames; see `reconstruct`.

        Returns
        -------
        stream : Stream
            The stream after these frames.
        estimates : Estimates
        """
        count = len(self.frames)
        if stream.estimator.method.needs_all_frames:
            numbers = iter(range(1, count + 1))
            resting = self.readings[self.recording.role == UNLOADED]
            stream, steps = stream.sequence(
                resting,
                self.readings[self.frames],
                lambda: on_frame(next(numbers, count), count, None),
            )
            return stream, self.estimates(stream, steps)
        steps = list[Step]()

        def so_far() -> Estimates:
            return self.estimates(stream, steps)

        start = stream
        for segment in segments(start, count):
            for after, step in self.segment_steps(start, segment):
                stream = after
                steps.append(step)
                on_frame(len(steps), count, so_far)
        return stream, so_far()

    def segment_steps(self, stream: Stream, segment: range) -> Iterator[tuple[Stream, Step]]:
        """Generate the stream after each frame of a segment, with the frame's step.

        Parameters
        ----------
        stream : Stream
            The stream before the segment.
        segment : range
            Places in `frames`.
        """
        readings = self.readings[self.frames]
        estimator = stream.estimator
        verifies = estimator.verify.chosen(readings, stream.resting) & estimator.method.optimum
        number = segment.start
        while number < segment.stop:
            steps: Iterable[tuple[Stream, Step]]
            if stream.takes_blocks and number + 1 < segment.stop:
                from lampest.estimate.batch import push_block  # for independent frames alone

                steps = push_block(stream, readings[number : segment.stop])
            else:
                steps = [stream.push(readings[number])]
            for after, step in steps:
                if verifies[number] and step.solution.solved:
                    after, step = stream.verified(readings[number], after, step)
                stream = after
                number += 1
                yield stream, step

    def estimates(self, stream: Stream, steps: Sequence[Step]) -> Estimates:
        """Return the estimates of these frames, of which the first ones are solved.

        Parameters
        ----------
        stream : Stream
            A stream with the baseline of these frames.
        steps : sequence of Step
            Steps of the first frames.
        """
        remaining = len(self.frames) - len(steps)
        solved = (*steps, *[stream.unsolved(Status.BROKEN_OFF)] * remaining)
        estimator = stream.estimator
        present = self.recording.scene.panel.present
        return Estimates(
            recording=self.recording,
            estimator=estimator,
            frame=self.frames,
            readings=self.readings[self.frames],
            resting=stream.resting,
            baseline_resistance=np.where(present, stream.baseline_resistance, np.nan),
            baseline=stream.baseline or solved[0],
            baseline_bars=None if stream.track is None else stream.track.baseline,
            steps=solved,
            joint_start=estimator.joint_start,
            prepared=self.prepared,
            contacts=stream.scene.contact_prior,
            automatic=estimator.automatic or bool(estimator.weight_sigma),
        )


def segments(stream: Stream, count: int) -> list[range]:
    """Divide frames into segments that are solved from the same stream.

    Segments have at most SEGMENT_FRAMES frames, and can be solved in any order. Frames that depend
    on earlier ones are one segment.

    Parameters
    ----------
    stream : Stream
        The stream before the first frame.
    count : int
        Number of frames.
    """
    several = segment_count(count) if stream.forgets else 1
    ends = np.linspace(0, count, several + 1).astype(int).tolist()
    return [range(start, end) for start, end in pairwise(ends)]


def segment_count(count: int) -> int:
    """Return the number of segments of frames that depend on no earlier one."""
    return ceil(count / SEGMENT_FRAMES)


@dataclass(frozen=True, eq=False)
class _Network:
    """A network that is estimated on its own: a panel, or one of its modules.

    Attributes
    ----------
    recording : Recording
        Frames of the network, with its scene.
    readings : Readings
        Readings of all its frames, (frames, rows, columns).
    """

    recording: Recording
    readings: Readings

    @cached_property
    def resting(self) -> Readings:
        """Its unloaded readings, (rows, columns)."""
        return baseline_readings(self.recording, self.readings)

    @property
    def kind(self) -> Hashable:
        """Networks of one kind share the choice of weights."""
        return converter_and_faults(self.recording.scene)


def first_stream(
    recording: Recording,
    readings: Readings,
    estimator: Estimator,
    noise: NoiseEstimate | None = None,
    period: float | None = None,
) -> Stream:
    """Return the stream before a recording's first measured frame.

    Open weights are chosen here. Networks with equal converters and faults share one choice, made
    by those of them that differ most from rest.

    Parameters
    ----------
    recording : Recording
    readings : Readings
        Readings of all frames, (frames, rows, columns).
    estimator : Estimator
    noise : NoiseEstimate, optional
        Noise that was estimated from frames.
    period : float, optional
        Time between frames, s; by default that of the recording.
    """
    scene = recording.scene
    period = frame_period(recording) if period is None else period
    layout = scene.panel.modules
    if layout is None:
        whole = _Network(recording, readings)
        return Stream.begin(_weighted(estimator, [whole]), scene, period, whole.resting, noise)
    from lampest.estimate.modules import begin_networks, network_readings, network_scenes

    recordings = [recording] if layout.coupled else recording.modules
    parts = network_readings(scene, readings)
    networks = {
        number: _Network(replace(recordings[number], scene=own), parts[number])
        for number, own in network_scenes(scene, estimator).items()
    }
    similar = dict[Hashable, list[_Network]]()
    for network in networks.values():
        similar.setdefault(network.kind, []).append(network)
    chosen = {kind: _weighted(estimator, several) for kind, several in similar.items()}
    begun = {
        number: (chosen[own.kind], own.recording.scene, own.resting)
        for number, own in networks.items()
    }
    return begin_networks(scene, begun, period, noise)


def _weighted(estimator: Estimator, networks: Sequence[_Network]) -> Estimator:
    """Return the estimator with open weights from the deciding frames of similar networks.

    Weights are those of the terms of `Estimator.in_scene`. Of a single network all frames of
    `deciding_frames` count, of several the first. Without measured frames the weights are
    unchanged.

    Parameters
    ----------
    estimator : Estimator
    networks : sequence of _Network
    """
    first = networks[0]
    estimator = estimator.in_scene(first.recording.scene, first.resting)
    if not estimator.automatic or estimator.auto_weight.per == "frame":
        return estimator
    count = 1 if len(networks) > 1 else None
    deciding = [
        (network, network.readings[frame])
        for network in networks
        for frame in deciding_frames(network.recording, network.readings, network.resting)[:count]
    ]
    if not deciding:
        return estimator
    changes = [
        float(mean_change(frame.plain_values, network.resting.value)) for network, frame in deciding
    ]
    frames_of = dict[_Network, list[Readings]]()
    for network, frame in (deciding[number] for number in strongest(changes)):
        frames_of.setdefault(network, []).append(frame)
    data, *further = (
        data
        for network, chosen in frames_of.items()
        for data in deciding_data(estimator, network.recording.scene, network.resting, *chosen)
    )
    scene = next(iter(frames_of)).recording.scene
    return with_chosen_weights(estimator, scene, data, None, further)


def deciding_data(
    estimator: Estimator, scene: Scene, resting: Readings, *frames: Readings
) -> list[Data]:
    """Return the data from which weights are chosen, of each frame.

    Where terms compare frames with their baseline, it is solved once for all of them.
    """
    if not estimator.relative:
        return [estimator.data(frame.alone(), Background(scene)) for frame in frames]
    stream = Stream.begin(estimator, scene, float("inf"), resting)
    return [stream.data_and_start(frame)[0] for frame in frames]


def frame_period(recording: Recording) -> float:
    """Return the median time between frames, s; infinite for a single frame."""
    return float(np.median(np.diff(recording.time))) if len(recording.time) > 1 else float("inf")


@dataclass(frozen=True, eq=False)
class Parts:
    """A recording too long for memory, estimated part by part.

    Each part is like a recording of its own. Baseline, noise, weights and the check of the circuit
    are determined once, from a bounded sample: the first unloaded frames and the measured ones
    around the strongest. Outliers are detected in every part. If estimates depend on no earlier
    frame, the parts are independent, and each begins with the baseline. Otherwise the memory of
    `CarriedOver` passes from part to part. The solver's caches are dropped between parts, so that a
    run that is resumed from the disk gives the same numbers.

    Attributes
    ----------
    stored : StoredRecording
    lead : Recording
        The first unloaded frames, or the first measured ones where there are none.
    sample : Prepared
        The lead and the frames around the strongest.
    stream : Stream
        The stream before the first frame.
    """

    stored: StoredRecording
    lead: Recording
    sample: Prepared
    stream: Stream

    @classmethod
    def of(
        cls,
        stored: StoredRecording,
        estimator: Estimator,
        representative: tuple[Recording, Prepared],
    ) -> "Parts":
        """Return the parts of a stored recording.

        Parameters
        ----------
        stored : StoredRecording
        estimator : Estimator
        representative : (Recording, Prepared)
            Lead and sample, see `asked_frames`.

        Raises InputError where the estimator needs all frames at once, or as `Stream.begin`.
        """
        check_by_parts(estimator, stored)
        lead, sample = representative
        noise = sample.noise
        period = frame_period(stored.part(stored.blocks[0]))
        stream = first_stream(sample.resolved, noise.readings, estimator, noise, period)
        return cls(stored, lead, sample, stream)

    @property
    def independent(self) -> bool:
        """Whether parts can be solved in any order."""
        return self.stream.forgets

    def estimates(self, done: Callable[[int], CarriedOver | None]) -> Iterator[SolvedPart]:
        """Solve every part that is not done, and generate its estimates.

        Parameters
        ----------
        done : callable
            Returns the memory after a part's last frame, given the part's number; None where it is
            not done.
        """
        start = self.stream
        stream = start
        for number, frames in enumerate(self.stored.blocks):
            carried = done(number)
            part = self._part(frames) if carried is None or not start.rested else None
            if carried is not None:
                # a finished part: its memory continues the stream; a joint baseline is found again
                # by its frames
                start = start if part is None else self._with_baseline(start, part)
                stream = start if self.independent else start.carrying(carried)
            elif part is not None:
                stream, estimates = part.solve(stream)
                yield number, estimates, stream.carried
                start = self.stream if self.independent else stream.restarted(self.stream)
                stream = start

    def _part(self, frames: range) -> MeasuredPart | None:
        """Return the measured frames of a range, together with the lead; None without any."""
        part = measured_part(self.stored, frames, WINDOW)
        if part is None:
            return None
        recording = joined((self.lead, part))
        readings = Prepared(recording, self.sample.noise).noise.readings
        recording = replace(recording, scene=self.stream.scene)
        own = _own_frames(recording, frames)
        return MeasuredPart(recording, own, readings, self.sample)

    def _with_baseline(self, begun: Stream, part: MeasuredPart) -> Stream:
        """Return the stream with its baseline.

        The part's frames are pushed until a joint baseline is solved.
        """
        for frame in part.frames if begun.estimator.joint_start else ():
            begun, _ = begun.push(part.readings[int(frame)])
            if begun.rested:
                return begun.restarted(self.stream)
        return begun


def check_by_parts(estimator: Estimator, stored: StoredRecording) -> None:
    """Raise InputError where all frames of a long recording are needed at once.

    An estimator, or the pressures of a scene, may need them.
    """
    reasons = {
        f"formulation: {estimator.method.kind} estimates all frames together": (
            estimator.method.needs_all_frames
        ),
        "film: what it remembers is followed through all frames": stored.scene.film is not None,
        "tare: zero is followed through all frames": estimator.tare is not None,
    }
    size = f"{stored.frames} frames of {stored.scene.panel.crossings} cells"
    for reason, holds in reasons.items():
        if holds:
            raise InputError(
                f"{reason}, and {size} are more than is held at once; split the recording"
            )


def asked_frames(stored: StoredRecording) -> tuple[Recording, Prepared]:
    """Return the lead and the prepared sample of a stored recording, see `Parts`.

    The whole recording is read once.

    Raises InputError where no frame is measured.

    Returns
    -------
    lead : Recording
        The first unloaded frames, or the measured ones of the opening.
    sample : Prepared
        The lead with the frames around the strongest one.
    """
    lead = first_unloaded(stored, min(LEAD_FRAMES, stored.length))
    if lead is None:
        opening = stored.part(range(min(OPENING_FRAMES, stored.frames)))
        lead = joined((opening,), opening.role == MEASURED)
    resting = baseline_readings(lead, lead.readings())
    candidates = list[tuple[float, int]]()
    for frames in stored.blocks:
        part = measured_part(stored, frames, WINDOW)
        if part is None:
            continue
        recording = joined((lead, part))
        cleaned = Prepared(recording).frame_noise.readings
        places = _own_frames(recording, frames)
        # the strongest frame of the part, by the change of its cleaned readings
        change = mean_change(cleaned.plain_values[places], resting.value)
        size = np.where(cleaned.enough(stored.scene)[places], change, -1.0)
        place = int(np.argmax(size))
        assert recording.number is not None
        candidates.append((float(size[place]), int(recording.number[places[place]])))
    if not candidates:
        raise InputError(f"{stored.path}: no frame is measured (role 1)")
    number = max(candidates)[1]
    around = stored.part(range(number, number + 1), min(LEAD_FRAMES // 2, stored.length))
    return lead, Prepared(joined((lead, joined((around,), around.role == MEASURED))))


def _own_frames(recording: Recording, frames: range) -> Numbers:
    """Return the indices of a part's own measured frames, without the lead and the margins."""
    number = recording.number
    assert number is not None
    return np.flatnonzero(
        (number >= frames.start) & (number < frames.stop) & (recording.role == MEASURED)
    )
