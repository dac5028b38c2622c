"""A recording too long for memory, part by part: each is estimated like a recording of its own, and the stream goes on.

What needs many frames is asked of a sample that is bounded: the first LEAD unloaded frames, and the measured ones
AROUND that which differs most from them. From these come the baseline, the noise, the weights that data choose, the
share of its period that a scan takes, and the check of the circuit. Readings that leap are found in every part, with
the frames BESIDE it. A stream goes on from part to part by what `CarriedOver` holds, so that one that is resumed from
the disk finds the same numbers; what a solver kept for speed alone begins anew.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.noise.seen import NoiseSeen, noise_seen, noise_seen_in_part
from lampest.estimate.sequence import first_stream, resting_readings
from lampest.estimate.state import CarriedOver
from lampest.estimate.step import Step
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.readings import Readings, changes
from lampest.recording.recording import MEASURED, Recording
from lampest.recording.stored import StoredRecording, first_unloaded, measured_part, of_parts, only_frames

LEAD = 500  # unloaded frames, and no more than a part has: more tell no more of the noise than a scene does
AROUND = 250  # measured frames before, and after, the one that differs most; no more than a part has
BESIDE = 4  # frames in time that tell whether a reading leaps
OPENING = 10  # first frames that stand for the unloaded ones where there are none, if enough of one can be read


@dataclass(frozen=True, eq=False)
class Parts:
    """A long recording, ready for its first frame.

    lead : the unloaded frames, or the first ones where there are none. asked : these, and frames around the strongest.
    noise : what they tell. stream : before the first frame.
    """

    stored: StoredRecording
    lead: Recording
    asked: Recording
    noise: NoiseSeen
    stream: Stream

    @classmethod
    def of(cls, stored: StoredRecording, estimator: Estimator, asked: tuple[Recording, Recording]) -> "Parts":
        """asked : of `asked_frames`. Raises InputError where the estimator needs all frames at once, or as `Stream`."""
        check_by_parts(estimator, stored)
        lead, whole = asked
        noise = noise_seen(whole)
        first = stored.part(stored.blocks()[0]).time
        period = float(np.median(np.diff(first))) if len(first) > 1 else float("inf")
        return cls(stored, lead, whole, noise, first_stream(whole, noise.readings, estimator, noise, period))

    def estimates(
        self, done: Callable[[int], CarriedOver | None], on_frame: Callable[[], None]
    ) -> Iterator[tuple[int, Estimates, CarriedOver]]:
        """(number, what became of its frames, what the next one needs) of every part of which none is `done`.

        done : number → what its last frame left, where its estimates are kept.
        """
        stream, begun = self.stream, self.stream
        for number, frames in enumerate(self.stored.blocks()):
            kept = done(number)
            if kept is not None:
                begun = self._with_baseline(begun, frames)
                stream = kept.onto(begun)
                continue
            part = measured_part(self.stored, frames, BESIDE)
            if part is None:
                continue
            recording, readings, inside = self._taken(frames, part)
            stream, steps = stream.sequence(self.noise.readings[:0], readings, on_frame)
            yield number, self._estimates(stream, recording, inside, readings, steps), CarriedOver.of(stream)
            begun = replace(stream, prepared=self.stream.prepared)
            stream = CarriedOver.of(stream).onto(begun)

    def _taken(self, frames: range, part: Recording) -> tuple[Recording, Readings, NDArray[np.intp]]:
        """The part with the lead, the readings of its own measured frames, and which these are."""
        recording = of_parts((self.lead, part))
        number = recording.number
        assert number is not None
        own = (number >= frames.start) & (number < frames.stop) & (recording.role == MEASURED)
        inside = np.flatnonzero(own)
        return recording, noise_seen_in_part(recording, self.noise)[inside], inside

    def _with_baseline(self, begun: Stream, frames: range) -> Stream:
        """A stream whose baseline is solved together with a frame once it has come to that frame."""
        if not begun.estimator.joint_start or (begun.baseline is not None and begun.baseline.solution.solved):
            return begun
        part = measured_part(self.stored, frames, BESIDE)
        assert part is not None
        _, readings, _ = self._taken(frames, part)
        for frame in range(len(readings.value)):
            begun, _ = begun.push(readings[frame])
            if begun.baseline is not None and begun.baseline.solution.solved:
                break
        return replace(begun, prepared=self.stream.prepared)

    def _estimates(
        self, stream: Stream, recording: Recording, inside: NDArray[np.intp], readings: Readings, steps: list[Step]
    ) -> Estimates:
        return Estimates(
            recording,
            stream.estimator,
            inside,
            readings,
            stream.resting,
            stream.baseline_resistance,
            stream.baseline or steps[0],
            None if stream.track is None else stream.track.baseline,
            tuple(steps),
            stream.estimator.joint_start,
            stream.scene.contacts,
            self.asked,
        )


def check_by_parts(estimator: Estimator, stored: StoredRecording) -> None:
    """Raise InputError where an estimator, or the pressures of a scene, need all frames of a long recording at once."""
    reason = ""
    if estimator.method.together:
        reason = f"formulation: {estimator.method.kind} estimates all frames together"
    elif stored.scene.film is not None:
        reason = "film: what it remembers is followed through all frames"
    elif estimator.tare is not None:
        reason = "tare: zero is followed through all frames"
    if reason:
        raise InputError(
            f"{reason}, and {stored.frames} frames of {stored.scene.panel.cells} cells are more than is held at once; "
            "split the recording"
        )


def asked_frames(stored: StoredRecording) -> tuple[Recording, Recording]:
    """(the lead, the lead with the frames around the strongest): see `Parts`. Raises InputError where none is measured.

    It reads the whole recording once.
    """
    lead = first_unloaded(stored, min(LEAD, stored.length))
    if lead is None:
        lead = only_frames(opening := stored.part(range(min(OPENING, stored.frames))), opening.role == MEASURED)
    readings = lead.readings()
    resting = resting_readings(lead, readings)
    best: tuple[float, int] = (-1.0, -1)
    for frames in stored.blocks():
        part = measured_part(stored, frames, BESIDE)
        if part is None:
            continue
        recording = of_parts((lead, part))
        number = recording.number
        assert number is not None
        taken = noise_seen_in_part(recording, None)
        own = np.flatnonzero((number >= frames.start) & (number < frames.stop) & (recording.role == MEASURED))
        size: Array = np.where(taken.enough(stored.scene)[own], changes(taken.plain_values[own], resting.value), -1.0)
        at = int(np.argmax(size))
        best = max(best, (float(size[at]), int(number[own[at]])))
    if best[1] < 0:
        raise InputError(f"{stored.path}: no frame is measured (role 1)")
    around = stored.part(range(best[1], best[1] + 1), min(AROUND, stored.length))
    return lead, of_parts((lead, only_frames(around, around.role == MEASURED)))
