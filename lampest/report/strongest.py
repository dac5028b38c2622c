"""The frame of a recording that shows most: of many, that in which the cells have moved furthest."""

import warnings
from collections.abc import Sequence

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.recording import UNLOADED, Recording
from lampest.runs.case import CaseResult


def percent_change(resistance: Array, baseline: Array) -> Array:
    """100·(R/R₀ − 1), any shape, in percent."""
    return 100 * (resistance / baseline - 1)


def as_recorded(value: Array, scene: Scene) -> Array:
    """Return readings of the network as the converter had them: with pull-ups, the supply less the load's voltage."""
    return scene.circuit.to_recorded(value, scene) if scene.circuit.mirrored else value


def strongest_index(cases: Sequence[CaseResult]) -> int:
    """Of the frames that most of the cases solved, the one whose cells have moved furthest."""
    solved = np.sum([case.solved for case in cases], axis=0)
    frames = np.flatnonzero(solved == solved.max())
    return int(frames[furthest(cases[0].measured[frames], cases[0].measured_baseline)])


def furthest(value: Array, resting: Array) -> int:
    """The last of some frames (frames, rows, columns) whose rms `likely_change` reaches 90 % of the largest.

    The last one, because a load settles after it has set in.
    """
    change = likely_change(value, resting)
    known = np.isfinite(change)
    square = np.where(known, change**2, 0.0).sum(axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    return int(np.flatnonzero(square >= 0.9**2 * square.max())[-1])


def likely_change(value: Array, resting: Array) -> Array:
    """ln(r/r₀) ≈ K·(x̄/K + a/M + b/N + w/2), x = ln(y/y₀) = x̄ + a + b + w, K = M + N − 1; (frames, rows, columns).

    The inverse of the derivative of a uniform panel's two-point resistances: mean, effects of rows, of columns, and
    what is left of a cell are each mixed in by a factor of their own. Readings alone fall less as suction lets cells
    rise amid others that a rim presses; cells do not, so that suction counts. A measure to choose by, no estimate.
    value : (frames, rows, columns), resting : (rows, columns), in any unit; NaN where a reading is missing.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.log(value / resting)
    moved = np.where(np.isfinite(moved), moved, np.nan)
    rows, columns = value.shape[1:]
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # a line without readings has no mean
        mean = np.nanmean(moved, axis=(1, 2), keepdims=True)
        across = np.nanmean(moved, axis=2, keepdims=True) - mean
        down = np.nanmean(moved, axis=1, keepdims=True) - mean
    own = moved - mean - across - down
    return np.asarray(mean + (rows + columns - 1) * (across / rows + down / columns + own / 2))


def strongest_readings(recording: Recording) -> tuple[int, Array] | None:
    """The frame whose readings have moved furthest, and their change in percent of the mean unloaded ones.

    None where the recording has no unloaded frames, or no others.
    """
    unloaded = recording.role == UNLOADED
    if not np.any(unloaded) or np.all(unloaded):
        return None
    resting, frames = mean_reading(recording.recorded[unloaded]), np.flatnonzero(~unloaded)
    frame = int(frames[furthest(recording.recorded[frames], resting)])
    with np.errstate(divide="ignore", invalid="ignore"):
        return frame, percent_change(recording.recorded[frame], resting)


def mean_reading(recorded: Array) -> Array:
    """Of (frames, rows, columns) over the frames that have one, (rows, columns)."""
    known = np.isfinite(recorded)
    total = np.where(known, recorded, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)
