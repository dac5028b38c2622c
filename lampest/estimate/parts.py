"""Estimation of recordings that are too long for memory, part by part."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import MeasuredPart, first_stream, frame_period
from lampest.estimate.stream import CarriedOver, Stream
from lampest.files.errors import InputError
from lampest.inference.prepared import Prepared
from lampest.inference.readings.outliers import WINDOW
from lampest.panel.panel import Array, Numbers
from lampest.recording.readings import mean_change
from lampest.recording.recording import MEASURED, Recording, baseline_readings
from lampest.recording.stored import StoredRecording, first_unloaded, joined, measured_part

# Unloaded frames, and measured ones around the strongest, that represent a long recording; at most
# those of a part.
LEAD_FRAMES = 500
OPENING_FRAMES = 10  # first measured frames that replace the unloaded ones where there are none
# Number of the part, its estimates, memory for the next part.
SolvedPart = tuple[int, Estimates, CarriedOver]


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
        size: Array = np.where(cleaned.enough(stored.scene)[places], change, -1.0)
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
