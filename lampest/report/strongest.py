"""Selection of the frame with the strongest change."""

from collections.abc import Sequence

import numpy as np

from lampest.inference.readings.garbled import garbled_lines, readings_of
from lampest.panel.circuit import nominal_terminations
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.recording import UNLOADED, UNREFERENCED, Recording
from lampest.runs.case import CaseResult


def percent_change(resistance: Array, baseline: Array) -> Array:
    """Return 100·(R/R₀ − 1), any shape, in percent."""
    return 100 * (resistance / baseline - 1)


def as_recorded(value: Array, scene: Scene) -> Array:
    """Return readings of the network as the converter recorded them.

    Readings with pull-ups are the supply less the load voltage.
    """
    mirrored = nominal_terminations(scene.circuit).sign < 0
    return scene.circuit.to_recorded(value, scene) if mirrored else value


def apparent_change(value: Array, baseline: Array, scene: Scene) -> Array:
    """Return the change of each cell by its own reading alone, in percent of its resistance.

    A reading in ohm changes like the cell. For a reading in volt, the change is that of the cell
    that would give the reading if it were alone. Measured and estimated changes then have one scale
    and one sign.

    Parameters
    ----------
    value, baseline : array, shape (rows, columns)
        Readings of the network, of a frame and of the unloaded panel.
    scene : Scene
    """
    if scene.circuit.unit == "ohm":
        return percent_change(value, baseline)
    alone = scene.circuit.apparent_resistance
    return percent_change(alone(value), alone(baseline))


def reference_words(case: CaseResult) -> str:
    """Return the frames with which the changes of a case are compared, in words."""
    first = UNREFERENCED in case.warnings
    return "the first measured frame" if first else "the unloaded panel"


def strongest_index(cases: Sequence[CaseResult]) -> int:
    """Return the index of the strongest frame among those that most cases solved."""
    solved = np.sum([case.solved for case in cases], axis=0)
    frames = np.flatnonzero(solved == solved.max())
    return int(frames[furthest(cases[0].measured[frames], cases[0].measured_baseline)])


def furthest(value: Array, resting: Array) -> int:
    """Return the index of the last frame whose rms `likely_change` reaches 90 % of the largest.

    Loads settle after their onset, so that the last of similar frames shows them best.

    Parameters
    ----------
    value : array, shape (frames, rows, columns)
    resting : array, shape (rows, columns)
        Unloaded readings.
    """
    change = np.ma.masked_invalid(likely_change(value, resting))
    square = np.ma.filled((change**2).mean(axis=(1, 2)), 0.0)
    return int(np.flatnonzero(square >= 0.9**2 * square.max())[-1])


def likely_change(value: Array, resting: Array) -> Array:
    """Approximate ln(r/r₀) by K·(x̄/K + a/M + b/N + w/2).

    The logarithm x = ln(y/y₀) = x̄ + a + b + w is the sum of mean, row effects, column effects and
    residuals, and K = M + N − 1. The formula inverts the derivative of the two-point resistances of
    a uniform panel, of which these parts are eigenvectors. Unlike readings, the result also
    responds to suction within a pressed rim. It is used to select frames only.

    Parameters
    ----------
    value : array, shape (frames, rows, columns)
        Readings in any unit; NaN if missing.
    resting : array, shape (rows, columns)
        Unloaded readings.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.ma.masked_invalid(np.log(value / resting))
    rows, columns = value.shape[1:]
    mean = moved.mean(axis=(1, 2), keepdims=True)
    # x = x̄ + a (rows) + b (columns) + w; eigenvalues of ∂ln R/∂ln r: 1, M/K, N/K and 2/K
    across, down = (moved.mean(axis=axis, keepdims=True) - mean for axis in (2, 1))
    interaction = moved - mean - across - down
    change = mean + (rows + columns - 1) * (across / rows + down / columns + interaction / 2)
    return np.asarray(change.filled(np.nan))


def strongest_readings(recording: Recording) -> tuple[int, Array] | None:
    """Return the strongest frame and the change of its readings.

    Frames with garbled lines are not considered. Returns None without unloaded frames or without
    measured ones.

    Returns
    -------
    frame : int
        Number of the frame.
    change : array, shape (rows, columns)
        Change in percent of the mean unloaded readings.
    """
    garbled = readings_of(garbled_lines(recording), recording)
    unloaded = recording.role == UNLOADED
    frames = np.flatnonzero(~unloaded & ~garbled.any(axis=(1, 2)))
    if not np.any(unloaded) or not frames.size:
        return None
    recorded = np.where(garbled | recording.scene.blind, np.nan, recording.recorded)
    resting = mean_reading(recorded[unloaded])
    frame = int(frames[furthest(recorded[frames], resting)])
    with np.errstate(divide="ignore", invalid="ignore"):
        return frame, percent_change(recorded[frame], resting)


def mean_reading(recorded: Array) -> Array:
    """Return the mean over the frames, shape (rows, columns), ignoring missing readings."""
    return np.asarray(np.ma.masked_invalid(recorded).mean(axis=0).filled(np.nan))
