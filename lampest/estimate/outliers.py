"""Detection of outliers of a single frame.

A loose contact or a lost bit changes one reading in one frame; a touch changes many readings at once. A reading is an
outlier if it deviates from the prediction of its neighbouring frames while its row and column do not. Outliers in
unloaded frames are excluded from the mean. In measured frames the prediction replaces them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import FALSE_ALARM_RATE, MAD_TO_SIGMA, OUTLIER_THRESHOLD
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene
from lampest.posterior.interval import largest_normal, largest_of
from lampest.recording.readings import Readings

WINDOW = 4  # neighbouring frames that are compared
MIN_RATIO_TO_SCATTER = 3.0  # deviation over the scatter of the neighbours, so that an arriving load is not flagged
# Deviation over that of half the row or half the column. A load on one cell changes these by 0.22 of its own reading
# where all lines float: the change has rank one (10 x 10; 0.21 at 32 x 32).
MIN_RATIO_TO_LINES = 6.0
MAX_SHARE = 0.05  # of a frame's readings, and of twice the unloaded rate: a frame with more was touched
MIN_FRAMES = 3  # with fewer, the deviating frame cannot be identified

# (prediction of neighbours in time, its uncertainty by their scatter, and by noise as a multiple of its σ).
Expected = tuple[Array, Array, Array]
Predictor = Callable[[Array, NDArray[np.intp]], Expected]  # of neighbours, and by how many frames each is off


def detect_outliers(
    value: Array, scale: Array, max_share: float | Array = 1.0
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Flag readings that deviate from the prediction of their neighbouring frames.

    Parameters
    ----------
    value : array, shape (frames, ..., rows, columns)
        Readings in temporal order; NaN where missing.
    scale : array, same shape
        Standard deviations of the readings; where it is zero, nothing is flagged.
    max_share : float or array
        Frames with a larger share of flagged readings were touched, and are not flagged.

    Returns
    -------
    flagged : boolean array, same shape
    predicted, predicted_sigma : arrays, same shape
        Value predicted from the neighbours, and its standard deviation beside the noise.
    """
    predictors = [_by_median, *([_by_line] if len(value) > WINDOW else [])]
    frames, width = np.arange(len(value)), min(len(value), WINDOW + 1)
    first = np.clip(frames - WINDOW // 2, 0, len(value) - width)
    expected = [_from_window(value, first, frames - first, predict) for predict in predictors]
    scale = np.broadcast_to(median(scale), scale.shape)  # of the frames around: that of a touched cell is another
    outlying, size = np.zeros(value.shape, dtype=bool), len(value) * value.shape[-2] * value.shape[-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        for prediction, predict in zip(expected, predictors, strict=True):
            far = _exceeds_threshold(value, scale, prediction)
            some = far.any(axis=0)  # the scatter of the others is not needed
            far[:, some] &= ~_is_usual(
                value[:, some], prediction[0][:, some], first, predict, largest_normal(size, FALSE_ALARM_RATE)
            )
            outlying |= far
        outlying &= scale > 0
    outlying &= (outlying.mean(axis=(-2, -1), keepdims=True) <= max_share) & (len(value) >= MIN_FRAMES)
    if not outlying.any():
        return outlying, value, np.zeros(value.shape)
    middles, spreads = (np.stack([prediction[part] for prediction in expected]) for part in (0, 1))
    nearest = np.where(spreads[-1] < spreads[0], len(expected) - 1, 0)[None]
    middle, spread = (np.take_along_axis(part, nearest, axis=0)[0] for part in (middles, spreads))
    apart = np.abs(middles - middle).max(axis=0)
    return outlying, middle, np.hypot(spread, np.nan_to_num(apart))


def impossible_readings(circuit: Readout, readings: Readings) -> NDArray[np.bool_]:
    """Single readings of a frame that are larger than any cells allow beside the others, (frames, …, rows, columns).

    A contact that failed for one reading is such an outlier, however long it lasts. A frame with more than MAX_SHARE of
    them has another circuit, and no outliers of this kind. Outliers are left out, and the others are tested again.
    """
    shape = readings.value.shape
    outliers = np.zeros((int(np.prod(shape[:-2])), *shape[-2:]), dtype=bool)
    if (sigma := readings.sigma_of_values) is None:
        return outliers.reshape(shape)
    value, deviation = readings.value.reshape(outliers.shape), sigma.reshape(outliers.shape)
    while (more := _larger_than_cells_allow(circuit, value, deviation, len(readings.value))).any():
        outliers, deviation = outliers | more, np.where(more, np.inf, deviation)
    return outliers.reshape(shape)


def _larger_than_cells_allow(circuit: Readout, value: Array, sigma: Array, beside: int) -> NDArray[np.bool_]:
    """Return one pass of `impossible_readings`; beside : the number of frames of which the worst is taken."""
    outliers, frames = np.zeros(value.shape, dtype=bool), np.arange(len(value))
    for _ in range(int(MAX_SHARE * value[0].size) + 1):
        broken = np.zeros(len(frames), dtype=bool)
        for test in circuit.free_tests(value[frames], sigma[frames]):
            if test.single is None:
                continue
            broken |= (significant := largest_of(test.excess, test.count * beside) < FALSE_ALARM_RATE)
            place = test.single.reshape(len(frames), -1).argmax(axis=1)
            outliers.reshape(len(outliers), -1)[frames[significant], place[significant]] = True
        frames = frames[broken]
        if not len(frames):
            break
        sigma = np.where(outliers, np.inf, sigma)
    outliers[frames] = False
    return outliers


def without_outliers(
    circuit: Readout, readings: Readings, unloaded: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Readings]:
    """(outliers (frames, rows, columns), the readings without them): see `without_outliers_at`."""
    return without_outliers_at(impossible_readings(circuit, readings), readings, unloaded)


def without_outliers_at(
    impossible: NDArray[np.bool_], readings: Readings, unloaded: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Readings]:
    """(outliers (frames, …, rows, columns), the readings without them): unloaded ones are left out, others replaced.

    Parameters
    ----------
    impossible : boolean array
        Readings that no cells allow; they are left out whenever they were read.
    unloaded : boolean array, shape (frames)
        These and the measured ones are compared apart, because between them a load comes. Bounds are no outliers. Every
        panel of those beside each other is judged by itself.
    """
    if impossible.any():
        readings = replace(readings, seen=np.where(impossible, 0.0, readings.seen))
    value = readings.plain_values
    sigma = np.ones(value.shape) if readings.sigma is None else readings.sigma
    outlying, instead, spread = np.zeros(value.shape, dtype=bool), value.copy(), np.zeros(value.shape)
    # σ may be wrong, and frames may differ together: the change of most readings from frame to frame is noise.
    seen = [_pair_scale(value[chosen], sigma[chosen]) for chosen in (unloaded, ~unloaded)]
    scale = sigma * np.fmax(seen[0] if unloaded.sum() >= MIN_FRAMES else seen[1], float(readings.sigma is not None))
    most: float | Array = 1.0
    for chosen in (unloaded, ~unloaded):
        if chosen.sum() >= MIN_FRAMES:
            detected = detect_outliers(value[chosen], scale[chosen], most)
            outlying[chosen], instead[chosen], spread[chosen] = detected
            most = np.maximum(MAX_SHARE, 2 * detected[0].mean(axis=(0, -2, -1), keepdims=True))
        else:
            most = MAX_SHARE
    resting = np.broadcast_to(median(value[unloaded]) if unloaded.any() else np.nan, value.shape[1:])
    lies = unloaded.reshape(-1, *(1,) * resting.ndim)
    outlying &= lies | _alone_in_time(value, resting, ~unloaded)
    if not outlying.any():
        return impossible, readings
    left = replace(readings, seen=np.where(outlying & lies, 0.0, readings.seen))
    return outlying | impossible, _replaced(left, outlying & ~lies, instead, spread)


def _alone_in_time(value: Array, resting: Array, measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether a measured reading is farther from the frames before and after than these are from each other.

    A load that comes moves readings by such steps, and overshoots. Before the first measured frame the panel is as it
    rests (…, rows, columns); the last frame has none after it.
    """
    alone, own = np.ones(value.shape, dtype=bool), value[measured]
    if len(own) > 1:
        before, after = np.concatenate([resting[None], own[:-2]]), own[1:]
        nearer = np.minimum(np.abs(own[:-1] - before), np.abs(own[:-1] - after))
        alone[np.flatnonzero(measured)[:-1]] = ~(nearer < np.abs(after - before))
    return alone


def _replaced(readings: Readings, outlying: NDArray[np.bool_], instead: Array, spread: Array) -> Readings:
    value, sigma = np.where(outlying, instead, readings.value), readings.sigma
    wider = None if sigma is None else np.where(outlying, np.hypot(sigma, spread), sigma)
    return replace(readings, value=value, sigma=wider)


@dataclass(frozen=True, eq=False)
class FramesBefore:
    """The last frames of a stream, of which outliers are found as they come; the newest last, at most WINDOW.

    A touch of one cell moves its row and its column where lines are tied by cells alone: there a single outlier shows
    from the frames before. Where a reading answers to its own cell only it does not, and readings stay as they are.
    """

    frames: tuple[Readings, ...] = ()

    def after(self, readings: Readings) -> "FramesBefore":
        """Return the frames after one more has come."""
        return FramesBefore((*self.frames, readings)[-WINDOW:])

    def without_outliers(
        self, readings: Readings, scene: Scene, resting: Readings, baseline: Array
    ) -> tuple[Readings, int]:
        """Return a frame with predictions in the place of outliers, and the number of these.

        resting : unloaded readings, of which baseline is the estimate, ohm, or NaN; all (rows, columns).
        """
        impossible = impossible_readings(scene.circuit, readings.alone())[0]
        count = int(impossible.sum())
        if count:
            readings = replace(readings, seen=np.where(impossible, 0.0, readings.seen))
        if len(self.frames) < MIN_FRAMES or readings.sigma is None or np.isnan(baseline).any():
            return readings, count
        value = np.stack([frame.plain_values for frame in self.frames])
        scale = readings.sigma * np.fmax(_pair_scale(value, np.broadcast_to(readings.sigma, value.shape))[0], 1.0)
        middle, spread, _ = _by_median(value, np.zeros(0, dtype=int))
        expected = middle[None], spread[None], np.ones((1, *middle.shape))
        with np.errstate(divide="ignore", invalid="ignore"):
            outlying = _exceeds_threshold(readings.plain_values[None], scale[None], expected)[0]
        if not outlying.any() or outlying.mean() > MAX_SHARE:
            return readings, count
        network = scene.circuit.network(baseline, scene.circuit.ties(resting.value), scene.wiring)
        for place in np.argwhere(outlying):  # would a load on this cell move its row or its column?
            step = np.zeros(scale.shape)
            step[*place] = 1.0
            moved = np.abs(network.forward(step)) / scale
            outlying[*place] = MIN_RATIO_TO_LINES * _beside(moved[None])[0][*place] > moved[*place]
        return _replaced(readings, outlying, middle, spread), count + int(outlying.sum())


def _from_window(value: Array, first: NDArray[np.intp], place: NDArray[np.intp], predict: Predictor) -> Expected:
    """Predict frames first + place, each from the other frames of the window that begins at `first`."""
    width = min(len(value), WINDOW + 1)
    within, target = first[:, None] + np.arange(width), first + place
    nearest = within[within != target[:, None]].reshape(len(first), width - 1).T
    return predict(value[nearest], nearest - target)


def _is_usual(
    value: Array, expected: Array, first: NDArray[np.intp], predict: Predictor, largest: float
) -> NDArray[np.bool_]:
    """Return whether a reading is as near to its prediction as chance allows, by its errors in other windows.

    Parameters
    ----------
    value, expected : array, shape (frames, …)
    largest : float
        Multiple of σ that chance does not reach.
    """
    frames, block = len(value), 2 * WINDOW  # errors are compared with those of a block before and one after
    if frames - WINDOW - 1 < WINDOW:
        return np.zeros(value.shape, dtype=bool)
    place, usual = np.arange(frames) - first, np.zeros(value.shape)
    middle, away = place == WINDOW // 2, np.nan_to_num(np.abs(value - expected))
    for begin in range(0, frames, block):
        around = slice(max(begin - block, 0), begin + 2 * block)
        usual[begin : begin + block] = median(away[around][middle[around]])
    begins = np.arange(frames - WINDOW)
    for frame in np.flatnonzero(~middle):
        near = begins[np.argsort(np.abs(begins - first[frame]), kind="stable")[: 3 * block]]
        predicted, _, _ = _from_window(value, near, np.full(len(near), place[frame]), predict)
        usual[frame] = median(np.abs(value[near + place[frame]] - predicted))
    usual = MAD_TO_SIGMA * np.nan_to_num(usual)
    return np.asarray((usual > 0) & (away <= largest * usual))


def _by_median(beside: Array, offset: NDArray[np.intp]) -> Expected:
    """Return the median of the neighbours (neighbours, frames, …), with their scatter."""
    middle = median(beside)
    noise = np.sqrt(1 + np.pi / (2 * len(beside)))
    return middle, MAD_TO_SIGMA * median(np.abs(beside - middle)), np.full(middle.shape, noise)


def _by_line(beside: Array, offset: NDArray[np.intp]) -> Expected:
    """Return the line through the neighbours, `offset` frames away: of a load that moves, or breathes."""
    offset = offset.reshape(*offset.shape, *(1,) * (beside.ndim - 2))
    centre = offset.mean(axis=0)
    apart = offset - centre
    size = np.sum(apart**2, axis=0)
    height, slope = beside.mean(axis=0), np.sum(apart * beside, axis=0) / size
    left = np.sum((beside - height - slope * apart) ** 2, axis=0) / (len(beside) - 2)
    noise = np.sqrt(1 + 1 / len(beside) + centre**2 / size)
    return height - slope * centre, 2 * np.sqrt(left) * noise, np.broadcast_to(noise, height.shape)


def _exceeds_threshold(value: Array, scale: Array, expected: Expected) -> NDArray[np.bool_]:
    """Return whether a reading is far from its prediction, while its row and its column are not."""
    middle, spread, noise = expected
    away = np.abs(value - middle)
    # Within the scatter of the neighbours, so that an arriving load is not flagged.
    far: NDArray[np.bool_] = away > np.fmax(OUTLIER_THRESHOLD * noise * scale, MIN_RATIO_TO_SCATTER * spread)
    some = far.any(axis=(-2, -1))  # frames of panels
    scale = np.broadcast_to(scale, away.shape)[some]
    far[some] &= ~(away[some] <= MIN_RATIO_TO_LINES * _beside(away[some] / scale) * scale)
    return far


def _beside(values: Array) -> Array:
    """Return the larger of the medians of each reading's row and of its column, (frames, rows, columns)."""
    rows, columns = (median(np.moveaxis(values, axis, 0)) for axis in (2, 1))
    return np.asarray(np.fmax(rows[:, :, None], columns[:, None, :]))


def median(values: Array) -> Array:
    """Return the median over the first axis, NaN not counted; NaN where all are."""
    order = np.sort(values, axis=0)  # NaN last
    count = np.sum(~np.isnan(values), axis=0)
    low, high = np.maximum(count - 1, 0) // 2, count // 2
    picked = [np.take_along_axis(order, np.minimum(at, len(order) - 1)[None], axis=0)[0] for at in (low, high)]
    return np.asarray((picked[0] + picked[1]) / 2)


def _pair_scale(value: Array, sigma: Array) -> Array:
    """Noise over its σ, from the median size of differences between successive frames; NaN without any.

    value, sigma : (frames, …, rows, columns); (1, …, 1, 1), of each panel. σ follows the reading: a reading over its
    own σ hardly varies.
    """
    difference = np.abs(np.diff(value, axis=0)) / np.hypot(sigma[1:], sigma[:-1])
    over = (0, value.ndim - 2, value.ndim - 1)
    if not difference.size:
        return np.full((1, *value.shape[1:-2], 1, 1), np.nan)
    if not np.isnan(difference).any():
        return np.asarray(MAD_TO_SIGMA * np.median(difference, axis=over, keepdims=True))
    panels = np.moveaxis(difference, over, (0, 1, 2)).reshape(-1, *value.shape[1:-2])
    return np.asarray(MAD_TO_SIGMA * median(panels))[None, ..., None, None]
