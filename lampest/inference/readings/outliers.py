"""Outliers: readings that no cells give, and those that deviate in a single frame.

A reading is an outlier if it deviates from the prediction of its neighbouring frames while its row
and column do not. A loose contact and a lost bit make such a reading. So does a tap of one frame,
where a cell moves its own reading alone: such a reading stays, and is named. Where the circuit
couples the readings of a row or a column, a cell that explained the reading would move them as
well: a reading that stands alone is impossible there, and missing. In unloaded frames no cell
changes, and all outliers are missing. No reading is replaced.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lampest.files.levels import (
    FALSE_ALARM_RATE,
    MAD_TO_SIGMA,
    MIN_EVIDENCE_GAIN,
    OUTLIER_THRESHOLD,
    UNUSUAL,
)
from lampest.inference.readings.free_tests import free_tests, largest_possible
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene
from lampest.posterior.interval import largest_normal, largest_of
from lampest.recording.readings import Readings, Sidedness, median, stand_in

# Ratio of the deviation to the median deviation of the row or the column. A load on one cell
# changes these by 0.22 of the change of its own reading where all lines float: the change has rank
# one (10 x 10; 0.21 at 32 x 32).
MIN_RATIO_TO_LINES = 6.0
# Of a frame's readings, and of twice the unloaded rate: a frame with more was touched.
MAX_SHARE = 0.05
ABSENT_OHM = 1e12  # a place without a cell
LOAD_REACH = 2.0  # cells, standard deviation of a wide load
TINY = 1e-30
MIN_FRAMES = 3  # with fewer, the deviating frame cannot be identified
WINDOW = 4  # neighbouring frames that are compared
# Deviation over the scatter of the neighbours, so that an arriving load is not flagged.
MIN_RATIO_TO_SCATTER = 3.0

# (prediction from the neighbours in time, its standard deviation by their scatter, standard
# deviation of the deviation by noise alone as a multiple of σ).
Expected = tuple[Array, Array, Array]
# arguments: the neighbours, and their offsets in frames
Predictor = Callable[[Array, Numbers], Expected]


def first_of_windows(frames: int) -> Numbers:
    """Return the first frame of the window of WINDOW + 1 frames about each frame, (frames,)."""
    width = min(frames, WINDOW + 1)
    return np.clip(np.arange(frames) - WINDOW // 2, 0, frames - width)


def from_window(value: Array, first: Numbers, place: Numbers, predict: Predictor) -> Expected:
    """Return the prediction of frames first + place from the other frames of their window.

    The window of a prediction begins at `first`. The neighbours are gathered as (width − 1, frames,
    ...), with their offsets (width − 1, frames).
    """
    width = min(len(value), WINDOW + 1)
    within = first[:, None] + np.arange(width)
    target = first + place
    nearest = within[within != target[:, None]].reshape(len(first), width - 1).T
    return predict(value[nearest], nearest - target)


def by_median(neighbours: Array, offset: Numbers | None = None) -> Expected:
    """Return the median of the neighbours, (frames, …), with their scatter.

    Parameters
    ----------
    neighbours : array, shape (neighbours, frames, …)
    offset : integer array
        Not used.
    """
    middle = median(neighbours)[0]
    # var(y − median of n) = σ² (1 + π/(2n))
    noise = np.sqrt(1 + np.pi / (2 * len(neighbours)))
    return (
        middle,
        MAD_TO_SIGMA * median(np.abs(neighbours - middle))[0],
        np.full(middle.shape, noise),
    )


def detect_outliers(
    value: Array, scale: Array, max_share: float = 1.0
) -> tuple[Mask, Array, Array]:
    """Flag readings that deviate from the prediction of their neighbouring frames.

    Parameters
    ----------
    value : array, shape (frames, rows, columns)
        Readings in temporal order; NaN where missing.
    scale : array, same shape
        Standard deviations of the readings; where it is zero, nothing is flagged.
    max_share : float
        Frames with a larger share of flagged readings were touched, and are not flagged.

    Returns
    -------
    flagged : boolean array, same shape
    predicted, predicted_sigma : arrays, same shape
        Value predicted from the neighbours, and its standard deviation beside the noise.
    """
    # Two predictions: the median suits rest, a straight line suits motion. A reading is flagged if
    # either one fails.
    predictors = [by_median, *([_by_line] if len(value) > WINDOW else [])]
    frames = np.arange(len(value))
    first = first_of_windows(len(value))
    expected = [from_window(value, first, frames - first, predict) for predict in predictors]
    # Of the frames around: that of a touched cell is another.
    scale = np.broadcast_to(median(scale), scale.shape)
    outlying = np.zeros(value.shape, dtype=bool)
    size = value.size
    with np.errstate(divide="ignore", invalid="ignore"):
        for prediction, predict in zip(expected, predictors, strict=True):
            far = _exceeds_threshold(value, scale, prediction)
            largest = largest_normal(size, FALSE_ALARM_RATE)
            outlying |= far & ~_is_usual(value, prediction[0], first, predict, largest)
        outlying &= scale > 0
    outlying &= (outlying.mean(axis=(-2, -1), keepdims=True) <= max_share) & (
        len(value) >= MIN_FRAMES
    )
    # The prediction with the smaller scatter is used; its disagreement with the other one adds to
    # its uncertainty.
    middle, spread, _ = expected[0]
    line, line_spread, _ = expected[-1]
    nearer = line_spread < spread
    deviation = np.nan_to_num(np.abs(line - middle))
    return (
        outlying,
        np.where(nearer, line, middle),
        np.hypot(np.where(nearer, line_spread, spread), deviation),
    )


def impossible_readings(circuit: Readout, readings: Readings) -> Mask:
    """Flag single readings that are larger than any cells allow, given the frame's other readings.

    A contact that fails for one reading makes such an outlier, however long it lasts. So does an
    infinite one among good ones, a lower bound that the others do not allow. After a pass
    the flagged readings are ignored and the others are tested again. If more than MAX_SHARE of a
    frame's readings violate the circuit's inequalities, the circuit is another one, and none is
    flagged.

    Parameters
    ----------
    circuit : Readout
    readings : Readings
        (frames, rows, columns).

    Returns
    -------
    boolean array, same shape
    """
    value = readings.value
    sigma = readings.sigma_of_values
    outliers = _impossible_bounds(circuit, readings)
    frames = np.arange(len(value))
    if sigma is None or not len(frames):
        return outliers
    bounds = outliers.copy()
    for _ in range(int(MAX_SHARE * value[0].size) + 1):
        broken = np.zeros(len(frames), dtype=bool)
        for test in free_tests(circuit, value[frames], np.where(outliers, np.inf, sigma)[frames]):
            if test.single is None:
                continue
            # the largest excess of all frames decides on the significance
            significant = largest_of(test.excess, test.count * len(value)) < FALSE_ALARM_RATE
            broken |= significant
            place = test.single.reshape(len(frames), -1).argmax(axis=1)
            outliers.reshape(len(outliers), -1)[frames[significant], place[significant]] = True
        frames = frames[broken]
        if not len(frames):
            break
    outliers[frames] = bounds[frames]
    return outliers


def _impossible_bounds(circuit: Readout, readings: Readings) -> Mask:
    """Flag lower bounds beyond the largest value that a frame's other readings allow.

    Noise of that value counts. If more than MAX_SHARE of a frame's readings are, none is flagged.
    """
    bound = (readings.side == Sidedness.AT_LEAST) & (readings.seen > 0)
    if not np.any(bound):
        return np.zeros(bound.shape, dtype=bool)
    plain = np.where(readings.plain, readings.value, np.inf)
    allowed = largest_possible(circuit, plain)
    if readings.sigma is not None:
        noise = circuit.sigma(np.where(np.isfinite(allowed), allowed, 1.0))
        allowed = allowed + OUTLIER_THRESHOLD * noise
    # A bound without a finite number has the largest value of its frame.
    largest = np.max(
        readings.value, axis=(-2, -1), keepdims=True, initial=0.0, where=readings.plain
    )
    impossible = bound & (np.where(readings.value > largest, readings.value, np.inf) > allowed)
    count = impossible.sum(axis=(-2, -1), keepdims=True)
    return np.asarray(impossible & (count <= max(1.0, MAX_SHARE * bound[0].size)))


def outliers_of_one_frame(readings: Readings, unloaded: Mask) -> tuple[Mask, Array, Array]:
    """Return the readings that deviate from their neighbours in time while their lines do not.

    Bounds that the other readings allow are never outliers.

    Parameters
    ----------
    readings : Readings
        (frames, rows, columns), without those that no cells allow.
    unloaded : boolean array, shape (frames,)
        Unloaded and measured frames are compared separately, because a load arrives between them.

    Returns
    -------
    outlying : boolean array, shape (frames, rows, columns)
    predicted, scale : arrays, same shape
        Values that the neighbours in time predict, and the standard deviations of the differences.
    """
    value = readings.plain_values
    sigma = np.ones(value.shape) if readings.sigma is None else readings.sigma
    outlying = np.zeros(value.shape, dtype=bool)
    expected = value.copy()
    spread = np.zeros(value.shape)
    # The specified σ may be wrong, so it is rescaled by the median change from frame to frame,
    # which is noise.
    quiet = unloaded if unloaded.sum() >= MIN_FRAMES else ~unloaded
    least_ratio = float(readings.sigma is not None)  # a specified σ is not reduced
    scale = sigma * np.fmax(_pair_scale(value[quiet], sigma[quiet]), least_ratio)
    max_share = 1.0
    for chosen in (unloaded, ~unloaded):
        if chosen.sum() < MIN_FRAMES:
            max_share = MAX_SHARE
            continue
        flagged, predicted, predicted_sigma = detect_outliers(
            value[chosen], scale[chosen], max_share
        )
        outlying[chosen] = flagged
        expected[chosen] = predicted
        spread[chosen] = predicted_sigma
        max_share = max(MAX_SHARE, 2 * float(flagged.mean()))
    resting = median(value[unloaded])[0] if unloaded.any() else np.full(value.shape[1:], np.nan)
    at_rest = unloaded[:, None, None]
    outlying &= at_rest | _alone_in_time(value, scale, resting, ~unloaded)
    return outlying, expected, np.hypot(scale, spread)


def no_cell_moves(
    scene: Scene,
    outlying: Mask,
    value: Array,
    expected: Array,
    scale: Array,
) -> Mask:
    """Return outliers of one frame that no load on their cell explains.

    A load that moves a reading by d moves the others of its row and column by c d, c by the
    circuit's derivative at the cells of the frame. The load is on the one cell, on a wide place
    around it, or in part on each, as the others' residuals e fit best. With their standard
    deviations s, the reading stands alone if Σ [(e − c d)² − e²]/s² exceeds MIN_EVIDENCE_GAIN.
    Where a cell moves its own reading alone, c of the one cell is 0, and none does. Where another
    reading of these lines deviates, other cells change as well, and none is judged.

    Parameters
    ----------
    scene : Scene
        Scene of a single network.
    outlying : boolean array, shape (rows, columns)
    value, expected, scale : arrays, same shape
        Readings of a frame, NaN where there is none, their predictions and standard deviations.
    """
    alone = np.zeros(outlying.shape, dtype=bool)
    known = np.isfinite(expected) & (expected > 0)
    filled = np.where(known, expected, stand_in(np.where(known, expected, 1.0), known))
    cells = scene.circuit.uniform_start(filled)
    cells = np.where(scene.panel.present, cells, ABSENT_OHM)
    try:
        network = scene.circuit.network(cells, scene.circuit.ties(filled), scene.wiring)
    except np.linalg.LinAlgError:
        return alone
    residual = value - expected
    usable = np.isfinite(residual) & ~outlying & (scale > 0)
    down, across = np.indices(outlying.shape)
    for row, column in np.argwhere(outlying):
        beside = np.zeros(outlying.shape, dtype=bool)
        beside[row] = beside[:, column] = True
        beside &= usable
        apart = residual[beside] / scale[beside]
        distance = np.hypot(down - row, across - column)
        loads = (np.where(distance == 0, 1.0, 0.0), np.exp(-0.5 * (distance / LOAD_REACH) ** 2))
        moved = [network.forward(load) for load in loads]
        of_cell, of_wide = (
            residual[row, column] * part[beside] / (part[row, column] * scale[beside])
            for part in moved
        )
        wider = of_wide - of_cell
        share = np.clip(wider @ (apart - of_cell) / max(float(wider @ wider), TINY), 0, 1)
        by_load = of_cell + share * wider
        gain = np.sum((apart - by_load) ** 2 - apart**2)
        still = np.abs(apart).max(initial=0.0) < UNUSUAL
        alone[row, column] = still and gain > MIN_EVIDENCE_GAIN
    return alone


def _alone_in_time(value: Array, scale: Array, resting: Array, measured: Mask) -> Mask:
    """Return whether a reading deviates from both neighbouring frames.

    An outlier deviates by more than these differ from each other. Otherwise the reading may be the
    last one before a load arrives, or belong to its step. The unloaded panel precedes the first
    measured frame. The last frame, without a successor, is never excluded.

    Parameters
    ----------
    value, scale : array, shape (frames, rows, columns)
        Readings and their standard deviations.
    resting : array, shape (rows, columns)
        Median of the unloaded frames.
    measured : boolean array, shape (frames,)
    """
    isolated = np.ones(value.shape, dtype=bool)
    frames = value[measured]
    if len(frames) > 1:
        before = np.concatenate([resting[None], frames[:-2]])
        after = frames[1:]
        nearer = np.minimum(np.abs(frames[:-1] - before), np.abs(frames[:-1] - after))
        least = np.fmax(np.abs(after - before), OUTLIER_THRESHOLD * scale[measured][:-1])
        isolated[np.flatnonzero(measured)[:-1]] = ~(nearer < least)
    return isolated


@dataclass(frozen=True, eq=False)
class FramesBefore:
    """Last frames of a stream, WINDOW at most, for the detection of outliers online.

    The newest frame comes last. Where a touch of one cell moves its row and column, previous frames
    alone distinguish an outlier from it. Where it moves its own reading only, they cannot, and the
    reading stays.
    """

    frames: tuple[Readings, ...] = ()

    def after(self, readings: Readings) -> "FramesBefore":
        """Return the frames after one more has come."""
        return FramesBefore((*self.frames, readings)[-WINDOW:])

    def without_impossible(self, readings: Readings, scene: Scene) -> tuple[Readings, int]:
        """Return a frame without the readings that no cells give, and their number.

        Parameters
        ----------
        readings : Readings
            The new frame, (rows, columns).
        scene : Scene
        """
        impossible = impossible_readings(scene.circuit, readings.alone())[0]
        readings = readings.without(impossible)
        sigma = readings.sigma
        if len(self.frames) >= MIN_FRAMES and sigma is not None:
            # those that differ from the frames before as no cell makes them differ
            value = np.stack([frame.plain_values for frame in self.frames])
            scale = sigma * np.fmax(_pair_scale(value, np.broadcast_to(sigma, value.shape)), 1.0)
            expected = by_median(value)
            middle, spread, _ = expected
            now = readings.plain_values
            with np.errstate(divide="ignore", invalid="ignore"):
                outlying = _exceeds_threshold(now, scale, expected)
            if 0 < outlying.mean() <= MAX_SHARE:
                impossible |= no_cell_moves(scene, outlying, now, middle, np.hypot(scale, spread))
        return readings.without(impossible), int(impossible.sum())


def _is_usual(
    value: Array, expected: Array, first: Numbers, predict: Predictor, largest: float
) -> Mask:
    """Return whether the error of a prediction is usual for this reading.

    The reading's errors in windows near by are the measure.

    Parameters
    ----------
    value, expected : array, shape (frames, …)
        Readings and their predictions.
    first : integer array, shape (frames,)
        First frame of each window.
    predict : callable
    largest : float
        Multiple of σ that chance does not exceed.
    """
    # errors are compared with those of a block before and one after
    frames = len(value)
    block = 2 * WINDOW
    if frames - WINDOW - 1 < WINDOW:
        return np.zeros(value.shape, dtype=bool)
    place = np.arange(frames) - first
    usual = np.zeros(value.shape)
    # Frames within the recording lie in the middle of their windows: median error over three blocks
    # of frames.
    middle = place == WINDOW // 2
    deviation = np.nan_to_num(np.abs(value - expected))
    for begin in range(0, frames, block):
        around = slice(max(begin - block, 0), begin + 2 * block)
        usual[begin : begin + block] = median(deviation[around][middle[around]])
    # Frames at the ends lie elsewhere in theirs: the same place in windows near by is predicted for
    # comparison.
    begins = np.arange(frames - WINDOW)
    for frame in np.flatnonzero(~middle):
        near = begins[np.argsort(np.abs(begins - first[frame]), kind="stable")[: 3 * block]]
        predicted, _, _ = from_window(value, near, np.full(len(near), place[frame]), predict)
        usual[frame] = median(np.abs(value[near + place[frame]] - predicted))
    usual = MAD_TO_SIGMA * np.nan_to_num(usual)
    return (usual > 0) & (deviation <= largest * usual)


def _by_line(neighbours: Array, offset: Numbers) -> Expected:
    """Return the value of the regression line through the neighbours.

    The line follows a load that moves or breathes.

    Parameters
    ----------
    neighbours : array, shape (neighbours, frames, …)
    offset : integer array, shape (neighbours, frames)
        Distance of each neighbour in frames.
    """
    offset = offset[..., None, None]
    centre = offset.mean(axis=0)
    centred = offset - centre
    size = np.sum(centred**2, axis=0)
    height = neighbours.mean(axis=0)
    slope = np.sum(centred * neighbours, axis=0) / size
    # residual variance s² with n − 2 degrees of freedom; var(y − line at offset 0) = σ² (1 + 1/n +
    # x̄²/Σ(x − x̄)²)
    squares = np.sum((neighbours - height - slope * centred) ** 2, axis=0)
    variance = squares / (len(neighbours) - 2)
    noise = np.sqrt(1 + 1 / len(neighbours) + centre**2 / size)
    scatter = 2 * np.sqrt(variance) * noise
    return height - slope * centre, scatter, np.broadcast_to(noise, height.shape)


def _exceeds_threshold(value: Array, scale: Array, expected: Expected) -> Mask:
    """Return whether a reading deviates from its prediction while its row and its column do not.

    Parameters
    ----------
    value, scale : array, shape (frames, …, rows, columns)
        Readings and their standard deviations.
    expected : tuple of array
        Prediction with its uncertainties, see `Expected`.
    """
    middle, spread, noise = expected
    deviation = np.abs(value - middle)
    # |y − ŷ| > max(6 σ √(1 + …), 3 spread).
    # Within the scatter of the neighbours, so that an arriving load is not flagged.
    far: Mask = deviation > np.fmax(
        OUTLIER_THRESHOLD * noise * scale, MIN_RATIO_TO_SCATTER * spread
    )
    # the larger of the medians over each reading's row and over its column
    beside = np.fmax(*(median(deviation / scale, axis) for axis in (-1, -2)))
    return far & ~(deviation <= MIN_RATIO_TO_LINES * beside * scale)


def _pair_scale(value: Array, sigma: Array) -> float:
    """Return the ratio of the noise to σ; NaN for a single frame.

    The median size of differences between successive frames determines the ratio.

    Parameters
    ----------
    value, sigma : array, shape (frames, rows, columns)
        Differences are divided by √(σ₀² + σ₁²), not the readings by σ: σ depends on the reading,
        and the ratio of a reading to its own σ hardly varies.
    """
    difference = np.abs(np.diff(value, axis=0)) / np.hypot(sigma[1:], sigma[:-1])
    return MAD_TO_SIGMA * float(median(difference.ravel())[0]) if difference.size else np.nan
