"""A recording's frames in order: absolute methods one by one, relative methods from a joint first pair on."""

from collections.abc import Callable

import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.noise.seen import NoiseSeen, noise_seen
from lampest.estimate.stream import Stream
from lampest.estimate.weights import with_chosen_weights
from lampest.files.errors import InputError, in_words
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import UNLOADED, Recording


def reconstruct(recording: Recording, estimator: Estimator, on_frame: Callable[[], None] = lambda: None) -> Estimates:
    """Solve every measured frame of a recording.

    A frame that fails, or of which too little was read, holds NaN and a status; the frames after it continue from the
    last one that was solved. Raises InputError where the noise is needed and unknown, or what is given is no Recording.
    """
    if not isinstance(recording, Recording):
        raise InputError(f"recording must be a Recording, such as Recording.load('mine.h5'), not {in_words(recording)}")
    recording.scene.panel.check_memory()
    noise = noise_seen(recording)
    readings = noise.readings
    stream = first_stream(recording, readings, estimator, noise)
    frames = recording.measured_frames()
    stream, steps = stream.sequence(readings[recording.role == UNLOADED], readings[frames], on_frame)
    return Estimates(
        recording,
        stream.estimator,
        frames,
        readings[frames],
        stream.resting,
        stream.baseline_resistance,
        stream.baseline or steps[0],
        None if stream.track is None else stream.track.baseline,
        tuple(steps),
        estimator.joint_start,
        stream.scene.contacts,
    )


def first_stream(
    recording: Recording,
    readings: Readings,
    estimator: Estimator,
    noise: NoiseSeen | None = None,
    period: float | None = None,
) -> "Stream":
    """The stream before a recording's first measured frame; see `resting_readings`. noise : what frames told of it.

    period : s between frames; None: the recording's.
    """
    resting, scene = resting_readings(recording, readings), recording.scene
    if estimator.automatic and estimator.auto_weight.per == "recording":
        frame = deciding_frame(recording, readings, resting)
        if frame is not None:
            estimator = with_weights_of_a_recording(estimator, scene, resting, readings[frame])
    return Stream.begin(estimator, scene, frame_period(recording) if period is None else period, resting, noise)


def resting_readings(recording: Recording, readings: Readings) -> Readings:
    """The mean of the unloaded frames; the first frame of which enough was read where there is none, or too little."""
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    mean = readings[unloaded if len(unloaded) else [0]].mean()
    enough = np.flatnonzero(readings.enough(recording.scene))
    return mean if mean.enough(recording.scene) or not len(enough) else readings[enough[:1]].mean()


def deciding_frame(recording: Recording, readings: Readings, resting: Readings) -> int | None:
    """Of the measured frames of which enough was read the one that differs most from rest; None where there is none."""
    frames = recording.measured_frames()
    frames = frames[readings.enough(recording.scene)[frames]]
    if not len(frames):
        return None
    return strongest_frame(readings.plain_values, resting.value, frames)


def with_weights_of_a_recording(estimator: Estimator, scene: Scene, resting: Readings, frame: Readings) -> Estimator:
    """The estimator with the weights that suit one frame; with the baseline where terms compare it with that."""
    data = deciding_data(estimator, scene, resting, frame)
    return with_chosen_weights(estimator, scene, data, None, frame.sigma is not None)


def deciding_data(estimator: Estimator, scene: Scene, resting: Readings, frame: Readings) -> Data:
    """What weights are chosen from: one frame, with the baseline where terms compare it with that."""
    return estimator.data(resting.together(frame) if estimator.relative else frame.alone(), Background(scene))


def frame_period(recording: Recording) -> float:
    """Median time between frames, s."""
    return float(np.median(np.diff(recording.time))) if len(recording.time) > 1 else float("inf")
