"""Estimation of the share of the channel before that a converter keeps, from the unloaded panel and a loaded frame.

With a wrong share every change of a cell appears in the next channel, too, so that more cells seem to have moved. The
evidence of the pair of frames (`lampest.estimate.nuisances`) is compared over MEMORIES, all equally probable before.
"""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from lampest.estimate.cells_fit import fitted
from lampest.estimate.nuisances import FittedPair
from lampest.files.errors import BROKEN
from lampest.panel.panel import Array
from lampest.panel.scene import ESTIMATED
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording

KEY = "converter_memory"
MEMORIES = np.linspace(0.0, 0.3, 16)
FINER = 9  # points between the neighbours of the most probable one
LIKELY = 0.05  # of a converter whose channel settles too briefly
MAX_DEVIATION = 0.05  # of the share: with more, the recording does not determine it


def estimated_memory(recording: Recording) -> tuple[float, float] | str:
    """Return the share and its standard deviation, or the reason why the recording cannot determine it, in words."""
    unloaded, measured = recording.role == UNLOADED, np.flatnonzero(recording.role == MEASURED)
    if recording.scene.readout is None:
        return "the scene has no readout"
    if not unloaded.any() or not len(measured):
        return "record unloaded frames, and a load on a few cells"
    if recording.scene.panel.crossings > MAX_CELLS:
        return f"the panel has more than {MAX_CELLS} cells: estimate it on a part of it"
    costs = _costs(recording, MEMORIES)
    best, step = float(MEMORIES[np.argmin(costs)]), float(MEMORIES[1])
    shares = np.linspace(max(best - step, 0.0), max(best, step) + step, FINER)
    costs = _costs(recording, shares)
    if not np.isfinite(costs).all():
        return "no cells explain the unloaded panel and a loaded frame"
    # parabola through the three points around the least cost: its vertex, and 1/√(half of its curvature)
    middle = int(np.clip(np.argmin(costs), 1, len(shares) - 2))
    before, at, after = costs[middle - 1 : middle + 2]
    spacing = float(shares[1] - shares[0])
    slope, curvature = (after - before) / (2 * spacing), (after - 2 * at + before) / spacing**2
    if not curvature > 0 or (deviation := float(np.sqrt(2 / curvature))) > MAX_DEVIATION:
        return "the load changes all channels alike: press a few cells"
    return max(float(shares[middle]) - slope / curvature, 0.0), deviation


def memory_gain(recording: Recording) -> float:
    """Return the decrease of −2 ln evidence by a memory of the size that converters have, LIKELY, against none."""
    small = recording.scene.panel.crossings <= MAX_CELLS
    if recording.scene.readout is None or not small or len(set(recording.role.tolist())) < 2:
        return 0.0
    without, likely = _costs(recording, np.array([0.0, LIKELY]))
    return float(without - likely) if np.isfinite(likely) else 0.0


def _costs(recording: Recording, shares: Array) -> Array:
    """Return −2 ln density of the strongest frame given the unloaded ones for each share; infinite without a fit."""
    unloaded, measured = recording.role == UNLOADED, np.flatnonzero(recording.role == MEASURED)
    plain = Readings.of(replace(recording.scene, converter_memory=None), recording.recorded, recording.sigma)
    frame = strongest_frame(plain.plain_values, plain[unloaded].mean().value, measured)
    costs = np.full(len(shares), np.inf)
    with np.errstate(all="ignore"):
        for number, share in enumerate(shares.tolist()):
            with suppress(*BROKEN):
                costs[number] = _cost(recording, share, frame)
    return costs


def _cost(recording: Recording, share: float, frame: int) -> float:
    """Return −2 ln density of the loaded frame given the unloaded ones, with the converter's memory."""
    scene = replace(recording.scene, converter_memory=share)
    readings = Readings.of(scene, recording.recorded, recording.sigma)
    resting, loaded = readings[recording.role == UNLOADED].mean(), readings[frame]
    base, frame_fit = fitted(scene, resting, patient=True), fitted(scene, loaded, patient=True)
    if base is None or frame_fit is None:
        return np.inf
    # p(recorded) = p(freed) |∂freed/∂recorded|, (1 − m)⁻¹ for each reading
    jacobian = 2 * np.log1p(-share) * float(np.sum(loaded.seen > 0))
    return float(FittedPair.of(base, frame_fit).density + base.chi_square + frame_fit.chi_square + jacobian)


def with_estimated_memory(recording: Recording) -> tuple[Recording, tuple[float, float] | str | None]:
    """Return the recording with a number for `converter_memory: estimated`, and the estimate or the reason for none."""
    if recording.scene.converter_memory != ESTIMATED:
        return recording, None
    found = estimated_memory(recording)
    share = None if isinstance(found, str) else found[0]
    return replace(recording, scene=replace(recording.scene, converter_memory=share)), found
