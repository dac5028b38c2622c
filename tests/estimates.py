"""Recordings of given readings, and how far their estimates are from the truth."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from lampest import Array, Estimates, Misfit, Recording, Scene, reconstruct


def recording_of(scene: Scene, recorded: Array, unloaded: int = 0, **fields: object) -> Recording:
    """A frame a second, the first ones unloaded."""
    time = np.arange(float(len(recorded)))
    return Recording(scene, recorded, time, (time >= unloaded).astype(np.uint8), **fields)


def log_errors(estimate: Estimates) -> Array:
    """log r − log truth, (frames, rows, columns)."""
    return np.asarray(
        np.log(estimate.cell_resistance / estimate.recording.truth_cell_resistance[estimate.frame])
    )


def in_intervals(estimate: Estimates) -> NDArray[np.bool_]:
    """Which true cells lie within their 95 % intervals, (frames, rows, columns)."""
    truth = estimate.recording.truth_cell_resistance[estimate.frame]
    return (estimate.cell_resistance_lower <= truth) & (truth <= estimate.cell_resistance_upper)


def rms(values: object) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def scores(estimate: Estimates) -> Array:
    """Errors of log r in their standard deviations, (frames, rows, columns)."""
    return log_errors(estimate) / (estimate.cell_resistance_errors / estimate.cell_resistance)


def share_in_bars(recordings: Iterable[Recording]) -> float:
    """Share of the true cells within 95 % bars of least squares."""
    within = []
    for recording in recordings:
        found = reconstruct(recording, [Misfit(weighting="noise")])
        truth = recording.truth_cell_resistance[recording.role == 1]
        within.append(np.abs(found.cell_resistance - truth) < 1.96 * found.cell_resistance_errors)
    return float(np.mean(within))
