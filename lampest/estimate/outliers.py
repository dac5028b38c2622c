"""Single readings that are outliers in time: far from what the frames around let expect, which agree.

A loose contact or a lost bit moves one reading for one frame; a touch moves many together. Among unloaded frames an
outlier is left out of the mean; among measured ones its neighbours in time replace it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.interval import largest_normal
from lampest.recording.readings import Readings

FAR = 6.0  # σ beyond the neighbours: of the 2,400 readings of a usual recording noise does it once in 200,000
STEADIER = 3.0  # times as far as the neighbours scatter: a load on its way is no outlier
NEAREST = 4  # frames in time that are compared: one of them may have an outlier, too
# Times as far as half of its row or half of its column. A load on one cell moves these by 0.22 of its own reading where
# all lines float, whatever it is: the change has rank one (10 x 10; 0.21 at 32 x 32).
ALONE = 6.0
SHARE = 0.05  # of a frame's readings may be outliers, and twice what unloaded frames show: beyond, it was touched
TO_SIGMA = 1.4826  # a normal distribution's σ over its median absolute deviation
LEAST_FRAMES = 3  # that tell which of them is the odd one
CHECKED = 5  # cells of a diagonal at which it is checked whether lines follow a load

MOVES = 2.0  # times its noise: a reading whose median error is larger moves
BLOCK = 8  # frames whose errors are compared with those of as many before and after
FALSE = 0.01  # recordings without outliers in which chance makes one

# (what neighbours in time let expect, how far off that may be by their scatter, and by noise as a multiple of its σ).
Expected = tuple[Array, Array, Array]
Predictor = Callable[[Array, NDArray[np.intp]], Expected]  # of neighbours, and by how many frames each is off


@dataclass(frozen=True, eq=False)
class Outliers:
    """outlying : (frames, rows, columns). instead : what frames around let expect; spread : its σ beside noise."""

    outlying: NDArray[np.bool_]
    instead: Array
    spread: Array

    @classmethod
    def of(cls, value: Array, scale: Array, most_share: float = 1.0) -> "Outliers":
        """Of readings (frames, rows, columns) in order of time, NaN where one says nothing; scale : their σ.

        A frame in which more than most_share would be outliers has none, nor have fewer than LEAST_FRAMES frames, nor
        readings beside σ = 0.
        """
        predictors = [_by_median, *([_by_line] if len(value) > NEAREST else [])]
        expected = [_predicted(value, predictor) for predictor in predictors]
        scale = np.broadcast_to(median(scale), scale.shape)  # of the frames around: that of a touched cell is another
        with np.errstate(divide="ignore", invalid="ignore"):
            far = [
                _stands_out(value, scale, one) & ~_usual(value, scale, one, predict)
                for one, predict in zip(expected, predictors, strict=True)
            ]
            outlying = (scale > 0) & np.any(far, axis=0)
        few = outlying.mean(axis=(1, 2)) <= most_share
        middle, spread, _ = expected[0]
        for other, wider, _ in expected[1:]:
            nearer = wider < spread
            middle, spread = np.where(nearer, other, middle), np.where(nearer, wider, spread)
        apart = np.max([np.abs(there - middle) for there, _, _ in expected], axis=0)
        outlying &= few[:, None, None] & (len(value) >= LEAST_FRAMES)
        return cls(outlying, middle, np.hypot(spread, np.nan_to_num(apart)))


def without_outliers(readings: Readings, unloaded: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Readings]:
    """(outliers (frames, rows, columns), the readings without them): unloaded ones say nothing, others are replaced.

    unloaded : (frames); these and the measured ones are compared apart, because between them a load comes. Bounds are
    no outliers.
    """
    value = readings.plain_values
    sigma = np.ones(value.shape) if readings.sigma is None else readings.sigma
    outlying, instead, spread = np.zeros(value.shape, dtype=bool), value.copy(), np.zeros(value.shape)
    # σ may be wrong, and frames may differ together: what most readings do from frame to frame is noise.
    seen = [pair_scale(value[chosen], sigma[chosen]) for chosen in (unloaded, ~unloaded)]
    scale = sigma * np.fmax(seen[0] if unloaded.sum() >= LEAST_FRAMES else seen[1], float(readings.sigma is not None))
    most = 1.0
    for chosen in (unloaded, ~unloaded):
        enough = chosen.sum() >= LEAST_FRAMES
        if enough:
            found = Outliers.of(value[chosen], scale[chosen], most)
            outlying[chosen], instead[chosen], spread[chosen] = found.outlying, found.instead, found.spread
            most = 2 * float(found.outlying.mean())
        most = max(SHARE, most if enough else 0.0)
    if not outlying.any():
        return outlying, readings
    resting, moving = outlying & unloaded[:, None, None], outlying & ~unloaded[:, None, None]
    wider = None if readings.sigma is None else np.where(moving, np.hypot(readings.sigma, spread), readings.sigma)
    plain = np.where(moving, instead, readings.value)
    return outlying, replace(readings, value=plain, sigma=wider, seen=np.where(resting, 0.0, readings.seen))


@dataclass(frozen=True, eq=False)
class FramesBefore:
    """The last frames of a stream, of which outliers are found as they come; the newest last, at most NEAREST.

    A touch of one cell moves its row and its column where lines are tied by cells alone: there a single outlier shows
    from the frames before. Where a reading answers to its own cell only it does not, and readings stay as they are.
    """

    frames: tuple[Readings, ...] = ()

    def after(self, readings: Readings) -> "FramesBefore":
        """Once a frame has come."""
        return FramesBefore((*self.frames, readings)[-NEAREST:])

    def without_outliers(
        self, readings: Readings, scene: Scene, resting: Readings, baseline: Array
    ) -> tuple[Readings, int]:
        """(a frame with what those before let expect in the place of outliers, how many there are).

        resting : unloaded readings, of which baseline is the estimate, ohm, or NaN; all (rows, columns).
        """
        if len(self.frames) < LEAST_FRAMES or readings.sigma is None or np.isnan(baseline).any():
            return readings, 0
        value = np.stack([frame.plain_values for frame in self.frames])
        scale = readings.sigma * np.fmax(pair_scale(value, np.broadcast_to(readings.sigma, value.shape)), 1.0)
        middle = median(value)
        spread, ones = TO_SIGMA * median(np.abs(value - middle)), np.ones((1, *middle.shape))
        with np.errstate(divide="ignore", invalid="ignore"):
            outlying = _stands_out(readings.plain_values[None], scale[None], (middle[None], spread[None], ones))[0]
        if not outlying.any() or outlying.mean() > SHARE:
            return readings, 0
        if not _lines_follow(scene.circuit.network(baseline, scene.circuit.ties(resting.value), scene.wiring), scale):
            return readings, 0
        calm = np.where(outlying, middle, readings.value)
        sigma = np.where(outlying, np.hypot(readings.sigma, spread), readings.sigma)
        return replace(readings, value=calm, sigma=sigma), int(outlying.sum())


def _lines_follow(network: Network, scale: Array) -> bool:
    """Whether a load on one cell moves its row or its column by more than an outlier may; scale : σ of readings."""
    rows, columns = scale.shape
    for number in range(CHECKED):
        place = int((number + 0.5) / CHECKED * rows), int((number + 0.5) / CHECKED * columns)
        step = np.zeros(scale.shape)
        step[place] = 1.0
        moved = np.abs(network.forward(step)) / scale
        if ALONE * max(_lines_median(moved[None], axis)[0][place] for axis in (1, 2)) <= moved[place]:
            return False
    return True


def _predicted(value: Array, predict: Predictor) -> Expected:
    """What up to NEAREST other frames around let expect of every frame."""
    frames, width = np.arange(len(value)), min(len(value), NEAREST + 1)
    first = np.clip(frames - NEAREST // 2, 0, len(value) - width)
    return _from_window(value, first, frames - first, predict)


def _from_window(value: Array, first: NDArray[np.intp], place: NDArray[np.intp], predict: Predictor) -> Expected:
    """Of frames first + place, each from the other frames of the window that begins at `first`."""
    width = min(len(value), NEAREST + 1)
    within = first[:, None] + np.arange(width)
    target = first + place
    nearest = within[within != target[:, None]].reshape(len(first), width - 1).T
    return predict(value[nearest], nearest - target)


def _usual(value: Array, scale: Array, expected: Expected, predict: Predictor) -> NDArray[np.bool_]:
    """Whether a reading that moves is no farther from what is expected than at other times.

    Its errors at the same place of other windows have a median of noise's size where it rests. Where it moves, it goes
    by chance as far as the largest of so many normal numbers. Few windows show nothing.
    """
    frames, width = len(value), min(len(value), NEAREST + 1)
    if frames - width < NEAREST:
        return np.zeros(value.shape, dtype=bool)
    first = np.clip(np.arange(frames) - NEAREST // 2, 0, frames - width)
    place = np.arange(frames) - first
    usual = np.zeros(value.shape)
    away = np.nan_to_num(np.abs(value - expected[0]))
    middle = place == NEAREST // 2
    for begin in range(0, frames, BLOCK):
        around = slice(max(begin - BLOCK, 0), begin + 2 * BLOCK)
        usual[begin : begin + BLOCK] = median(away[around][middle[around]])
    for frame in np.flatnonzero(~middle):
        begins = np.arange(frames - width + 1)
        near = begins[np.argsort(np.abs(begins - first[frame]), kind="stable")[: 3 * BLOCK]]
        there, _, _ = _from_window(value, near, np.full(len(near), place[frame]), predict)
        usual[frame] = median(np.abs(value[near + place[frame]] - there))
    usual = TO_SIGMA * np.nan_to_num(usual)
    return np.asarray((usual > MOVES * scale) & (away <= largest_normal(value.size, FALSE) * usual))


def _by_median(beside: Array, offset: NDArray[np.intp]) -> Expected:
    """The median of the neighbours (neighbours, frames, rows, columns), with their scatter."""
    middle = median(beside)
    noise = np.sqrt(1 + np.pi / (2 * len(beside)))
    return middle, TO_SIGMA * median(np.abs(beside - middle)), np.full(middle.shape, noise)


def _by_line(beside: Array, offset: NDArray[np.intp]) -> Expected:
    """The line through the neighbours, `offset` frames away: of a load that moves, or breathes.

    Twice what it leaves may be off: two degrees of freedom show little, and a load does not move along a line.
    """
    centre = offset.mean(axis=0)[:, None, None]
    apart = offset[..., None, None] - centre
    size = np.sum(apart**2, axis=0)
    height, slope = beside.mean(axis=0), np.sum(apart * beside, axis=0) / size
    left = np.sum((beside - height - slope * apart) ** 2, axis=0) / (len(beside) - 2)
    noise = np.sqrt(1 + 1 / len(beside) + centre**2 / size)
    return height - slope * centre, 2 * np.sqrt(left) * noise, np.broadcast_to(noise, height.shape)


def _stands_out(value: Array, scale: Array, expected: Expected) -> NDArray[np.bool_]:
    """Whether a reading is far from what is expected, while its row and its column are not."""
    middle, spread, noise = expected
    away = np.abs(value - middle)
    beside = np.fmax(*(_lines_median(away / scale, axis) for axis in (1, 2))) * scale
    return np.asarray(away > np.fmax(np.fmax(FAR * noise * scale, STEADIER * spread), ALONE * beside))


def _lines_median(values: Array, axis: int) -> Array:
    """Of each reading's row (axis 2) or column (axis 1), the same shape."""
    return np.broadcast_to(np.expand_dims(median(np.moveaxis(values, axis, 0)), axis), values.shape)


def median(values: Array) -> Array:
    """Over the first axis, NaN not counted; NaN where all are."""
    order = np.sort(values, axis=0)  # NaN last
    count = np.sum(~np.isnan(values), axis=0)
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    picked = [np.take_along_axis(order, np.minimum(at, len(order) - 1)[None], axis=0)[0] for at in (low, high)]
    return np.asarray((picked[0] + picked[1]) / 2)


def pair_scale(value: Array, sigma: Array) -> float:
    """Noise over its σ, from the median size of differences between successive frames; NaN without any.

    value, sigma : (frames, rows, columns). σ follows the reading: a reading over its own σ hardly varies.
    """
    difference = np.abs(np.diff(value, axis=0)) / np.hypot(sigma[1:], sigma[:-1])
    known = difference[~np.isnan(difference)]
    return float(TO_SIGMA * np.median(known)) if len(known) else float("nan")
