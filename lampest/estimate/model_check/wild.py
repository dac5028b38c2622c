"""Readings that leap: far from the frame before and from the frame after, which agree.

A circuit is wrong in every frame; a loose contact or a lost bit in one reading. Such readings say nothing of a circuit.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.recording.readings import Readings

LEAP = 10.0  # σ beyond both neighbours: noise never does it, in any number of readings
STEADIER = 3.0  # times as far as the neighbours are apart: what moves on its way from one to the other is no leap
SHARE = 0.05  # of a frame's readings: where more leap together, the panel was touched


def wild_readings(readings: Readings) -> NDArray[np.bool_]:
    """Which of the readings (frames, rows, columns) leap; none of fewer than three frames.

    The first and the last frame are held against the two next to them. Frames of which many readings leap have none.
    """
    frames, sigma = len(readings.value), readings.sigma
    if frames < 3 or sigma is None:
        return np.zeros(readings.value.shape, dtype=bool)
    at = np.arange(frames)
    before, after = np.where(at == 0, 2, at - 1), np.where(at == frames - 1, frames - 3, at + 1)
    value = readings.shown
    apart = np.abs(value[before] - value[after])
    away = np.minimum(np.abs(value - value[before]), np.abs(value - value[after]))
    noise = np.maximum(sigma[before], sigma[after])
    leaps: NDArray[np.bool_] = away > np.maximum(LEAP * noise, STEADIER * apart)
    few = leaps.sum(axis=(1, 2)) <= max(1.0, SHARE * readings.value[0].size)
    wild: NDArray[np.bool_] = leaps & few[:, None, None]
    return wild


def said_of_wild(count: int) -> str:
    """What a sentence on the circuit says of them; nothing where there are none."""
    if count == 0:
        return ""
    return (
        f"; {count} reading{'s' if count > 1 else ''} that leap{'s' if count == 1 else ''} for one frame alone left out"
    )
