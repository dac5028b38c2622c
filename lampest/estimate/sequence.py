"""A recording's frames in order: absolute methods one by one, relative methods from a joint first pair on."""

from collections.abc import Callable

import numpy as np

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.step import Step
from lampest.estimate.stream import Stream
from lampest.estimate.weights import with_chosen_weights
from lampest.files.errors import InputError, in_words
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import UNLOADED, Recording


def reconstruct(recording: Recording, estimator: Estimator, on_frame: Callable[[], None] = lambda: None) -> Estimates:
    """Solve every measured frame of a recording.

    A frame that fails holds NaN and a status; the frames after it continue from the last one that was solved. Raises
    InputError where readings do not exceed the series resistance, the noise is needed and unknown, or what is given is
    no Recording.
    """
    if not isinstance(recording, Recording):
        raise InputError(f"recording must be a Recording, such as Recording.load('mine.h5'), not {in_words(recording)}")
    readings = recording.readings()
    stream = first_stream(recording, readings, estimator)
    frames = recording.measured_frames()
    steps: list[Step] = []
    for frame in frames:
        stream, step = stream.push(readings[frame])
        steps.append(step)
        on_frame()
    return Estimates(
        recording,
        stream.estimator,
        frames,
        readings.value[frames],
        stream.resting.value,
        readings[frames].sigma_of_values,
        stream.resting.sigma_of_values,
        stream.baseline_resistance,
        stream.baseline or steps[0],
        None if stream.track is None else stream.track.baseline,
        tuple(steps),
        estimator.joint_start,
        stream.scene.contacts,
    )


def first_stream(recording: Recording, readings: Readings, estimator: Estimator) -> "Stream":
    """The stream before a recording's first measured frame; the baseline is the mean of the unloaded frames."""
    resting, scene = resting_readings(recording, readings), recording.scene
    if estimator.automatic and estimator.auto_weight.per == "recording":
        frame = strongest_frame(readings.value, resting.value, recording.measured_frames())
        estimator = with_weights_of_a_recording(estimator, scene, resting, readings[frame])
    return Stream.begin(estimator, scene, frame_period(recording), resting)


def resting_readings(recording: Recording, readings: Readings) -> Readings:
    """The mean of the unloaded frames, or the first frame where there is none."""
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    return readings[unloaded if len(unloaded) else [0]].mean()


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
