"""Readings that leap: far from what the same reading is in the frames around it, which agree.

A loose contact or a lost bit moves one reading for one frame; a touch moves many together. Among unloaded frames a
leap is left out of the mean; between measured ones its neighbours in time stand for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

FAR = 6.0  # σ beyond the neighbours: of the 2,400 readings of a usual recording noise does it once in 200,000
STEADIER = 3.0  # times as far as the neighbours scatter: what moves on its way is no leap
NEAREST = 4  # frames in time that are asked: one of them may leap too
# Times as far as half of its row or half of its column. A load on one cell moves these by 0.22 of its own reading where
# all lines float, whatever it is: the change has rank one (10 x 10; 0.21 at 32 x 32).
ALONE = 6.0
SHARE = 0.05  # of a frame's readings may leap, and twice what unloaded frames show: where more do, it was touched
TO_SIGMA = 1.4826  # a normal distribution's σ over its median absolute deviation
LEAST_FRAMES = 3  # that tell which of them is the odd one


@dataclass(frozen=True, eq=False)
class Leaps:
    """leaping : (frames, rows, columns). instead : what frames around let expect there; spread : its σ beside noise."""

    leaping: NDArray[np.bool_]
    instead: Array
    spread: Array


def leaps(value: Array, scale: Array, most_share: float = 1.0) -> Leaps:
    """Of readings (frames, rows, columns) in order of time, NaN where one says nothing; scale : their σ, one frame's.

    None leaps in a frame in which more than most_share do, in fewer than LEAST_FRAMES frames, or beside σ = 0.
    """
    expected = [by_median(value), *by_line(value)]
    scale = np.broadcast_to(median(scale), scale.shape)  # of the frames around: that of a touched cell is another
    with np.errstate(divide="ignore", invalid="ignore"):
        leaping = (scale > 0) & np.any([strays(value, scale, one) for one in expected], axis=0)
    crowded = leaping.mean(axis=(1, 2)) > most_share
    middle, spread = nearest_of(expected)
    apart = np.max([np.abs(there - middle) for there, _ in expected], axis=0)
    return Leaps(
        leaping & ~crowded[:, None, None] & (len(value) >= LEAST_FRAMES), middle, np.hypot(spread, np.nan_to_num(apart))
    )


Expected = tuple[Array, Array]  # (what neighbours in time let expect, how far off that may be) of each reading


def nearest_of(expected: Sequence[Expected]) -> Expected:
    """For each reading the one that may be off by less; NaN where none says anything."""
    middle, spread = expected[0]
    for other, wider in expected[1:]:
        nearer = wider < spread
        middle, spread = np.where(nearer, other, middle), np.where(nearer, wider, spread)
    return middle, spread


def neighbours(value: Array) -> tuple[Array, NDArray[np.intp]]:
    """The NEAREST other frames of every frame, (neighbours, frames, rows, columns), and how far off each is."""
    frames, width = np.arange(len(value)), min(len(value), NEAREST + 1)
    within = np.clip(frames - NEAREST // 2, 0, len(value) - width)[:, None] + np.arange(width)
    nearest = within[within != frames[:, None]].reshape(len(value), width - 1).T
    return value[nearest], nearest - frames


def by_median(value: Array) -> Expected:
    """Their median, with their scatter."""
    beside, _ = neighbours(value)
    middle = median(beside)
    return middle, TO_SIGMA * median(np.abs(beside - middle))


def by_line(value: Array) -> list[Expected]:
    """The line through them, where there are enough: of a load that moves, or breathes.

    Twice what it leaves may be off: two degrees of freedom tell little, and a load does not move along a line.
    """
    beside, offset = neighbours(value)
    if len(beside) < NEAREST:
        return []
    centre = offset.mean(axis=0)[:, None, None]
    apart = offset[..., None, None] - centre
    size = np.sum(apart**2, axis=0)
    height, slope = beside.mean(axis=0), np.sum(apart * beside, axis=0) / size
    left = np.sum((beside - height - slope * apart) ** 2, axis=0) / (len(beside) - 2)
    return [(height - slope * centre, 2 * np.sqrt(left * (1 + 1 / len(beside) + centre**2 / size)))]


def strays(value: Array, scale: Array, expected: Expected) -> NDArray[np.bool_]:
    """Whether a reading is far from what is expected, while its row and its column are not."""
    middle, spread = expected
    away = np.abs(value - middle)
    beside = np.fmax(*(lines_median(away / scale, axis) for axis in (1, 2))) * scale
    return np.asarray(away > np.fmax(np.fmax(FAR * scale, STEADIER * spread), ALONE * beside))


def lines_median(values: Array, axis: int) -> Array:
    """Of each reading's row (axis 2) or column (axis 1), the same shape."""
    return np.broadcast_to(np.expand_dims(median(np.moveaxis(values, axis, 0)), axis), values.shape)


def median(values: Array) -> Array:
    """Over the first axis, NaN not counted; NaN where all are."""
    order = np.sort(values, axis=0)  # NaN last
    count = np.sum(~np.isnan(values), axis=0)
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    picked = [np.take_along_axis(order, np.minimum(at, len(order) - 1)[None], axis=0)[0] for at in (low, high)]
    return np.asarray((picked[0] + picked[1]) / 2)


def pair_scale(value: Array) -> float:
    """σ from the median size of differences between successive frames (frames, rows, columns); NaN without any."""
    difference = np.abs(np.diff(value, axis=0)) / np.sqrt(2)
    known = difference[~np.isnan(difference)]
    return float(TO_SIGMA * np.median(known)) if len(known) else float("nan")
