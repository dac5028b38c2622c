"""Readings of a network from recorded values: two-sided values, one-sided bounds, or missing."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from lampest.files.errors import InputError, brief, in_words
from lampest.files.levels import NOISE_REACH, UNUSUAL
from lampest.files.typed import ReadOnlyArrays, real_array
from lampest.panel.circuit import nominal_terminations
from lampest.panel.panel import Array, Mask, Modules, Numbers, beyond_any_panel, check_line_memory
from lampest.panel.readouts.converter import constant_share
from lampest.panel.scene import Scene

CELL_AXES = (-2, -1)  # of arrays (…, rows, columns)


class Sidedness(float, Enum):
    """Side on which a reading bounds the true value, as entries of `Readings.side`."""

    VALUE = 0.0
    AT_LEAST = 1.0
    AT_MOST = -1.0


def stand_in(value: Array, known: Mask) -> Array:
    """Return substitutes for missing readings, exp(m + a_j + b_k), (…, rows, columns).

    1 if nothing is known. m, a_j and b_k are the overall, row and column effects of the median
    polish of log y over the known values.
    """
    return np.exp(_polished(value, known)[0])


def stand_in_spread(value: Array, known: Mask) -> Array:
    """Return the standard deviation of log(stand_in) for one frame, (rows, columns).

    Cross-validation, which leaves out one diagonal after the other, gives the rms error, or more if
    this does not cover 95 % of the errors. For a line without any known reading the variance of the
    other lines' effects is added. The deviation is 1 if nothing is known.
    """
    if not known.any():
        return np.ones(known.shape)
    # Number of the diagonal of every reading; each is predicted from the median polish without its
    # diagonal.
    diagonal = np.add.outer(*map(np.arange, known.shape)) % max(known.shape)
    remaining = known & (diagonal != np.arange(max(known.shape))[:, None, None])
    left_out = np.take_along_axis(_polished(value, remaining)[0], diagonal[None], axis=0)[0]
    stray = np.abs(left_out - np.log(np.where(known, value, 1.0)))[known]
    # Standard deviation: the rms error, or the 95 % quantile over 1.96
    size = max(np.sqrt(np.mean(stray**2)), np.quantile(stray, 0.95, method="higher") / 1.96)
    # The lower limit serves simulations without noise.
    return np.asarray(np.maximum(np.sqrt(size**2 + _polished(value, known)[1]), 1e-3))


def _polished(value: Array, known: Mask) -> tuple[Array, Array]:
    """Return the median polish m + a_j + b_k of log y, and a variance.

    The latter is the variance of effects of unknown lines. Both are (…, rows, columns).
    """
    # Source: Tukey, Exploratory Data Analysis, 1977, chapter 11.
    residual = np.where(known, np.log(np.where(known, value, 1.0)), np.nan)
    expected = np.nan_to_num(median(residual.reshape(*residual.shape[:-2], 1, -1), -1))
    residual = residual - expected
    between = np.zeros(residual.shape)
    effects = {axis: np.zeros_like(median(residual, axis)) for axis in (-1, -2)}
    # Panels of 3 × 3 to 64 × 64 with holes change by less than their spread after two.
    for _ in range(6):
        for axis in effects:
            step = np.nan_to_num(median(residual, axis))
            effects[axis] = effects[axis] + step
            residual = residual - step
    # Lines without a known reading have the mean effect of the others, with the variance of these.
    for axis, effect in effects.items():
        lines = known.any(axis=axis, keepdims=True)
        across: dict[str, Any] = {"axis": -3 - axis, "keepdims": True}
        count = np.maximum(lines.sum(**across), 1)
        mean = effect.sum(**across, where=lines) / count
        square = ((effect - mean) ** 2).sum(**across, where=lines) / count
        expected = expected + np.where(lines, effect, mean)
        between = between + np.where(lines, 0.0, square)
    return expected, between


def median(values: Array, axis: int = 0) -> Array:
    """Return medians along an axis, which is kept, without NaN.

    The median of NaN alone is NaN. The function is faster than nanmedian.
    """
    # NaN last
    ordered = np.sort(values, axis=axis)
    count = np.sum(~np.isnan(values), axis=axis, keepdims=True)
    low, high = (
        np.take_along_axis(ordered, np.maximum(count - more, 0) // 2, axis) for more in (1, 0)
    )
    return (low + high) / 2


@dataclass(frozen=True, eq=False)
class Readings(ReadOnlyArrays):
    """Readings of the network, (…, rows, columns), in the readout's unit (ohm or volt).

    Attributes
    ----------
    value : array
        Positive values; a missing reading has a substitute from its row and column (`stand_in`).
    sigma : array, or None
        Standard deviations; that of a missing reading is the geometric mean of its frame.
    side : array
        0 for a value; 1 or -1 if the truth is at least or at most the reading.
    seen : array
        1, or 0 for a missing reading.
    constant : array, or None
        Part of σ that frames have in common, which their mean keeps: the rounding of a converter
        that noise does not dither. None: none is known.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> lampest.Readings.of(recording.scene, recording.recorded).value.shape
    (4, 2, 3)
    """

    value: Array
    sigma: Array | None
    side: Array
    seen: Array
    constant: Array | None = None

    def __repr__(self) -> str:
        """Return the object in one line, arrays by their shapes."""
        return brief(self)

    @classmethod
    def of(cls, scene: Scene, recorded: Array, sigma: Array | None = None) -> "Readings":
        """Return the network's readings of recorded values; one frame (rows, columns) or many.

        Missing readings are NaN, readings whose σ is not finite, and those without information
        because of faults. Bounds are values at or beyond a rail of the converter, infinity,
        resistances that are below NOISE_REACH σ after subtraction of the series resistance, and
        voltages of the network that are not positive. A bound without a finite number has the
        largest or smallest value of its frame.

        Parameters
        ----------
        scene : Scene
        recorded : array, shape (rows, columns) or (frames, rows, columns)
            In ohm for two-point readouts, including series resistance; otherwise in volt.
        sigma : array, same shape or (rows, columns), or None
            Standard deviations in the same unit; None: those of the readout.

        Raises
        ------
        InputError
            If shapes disagree, or a standard deviation is not positive.
        """
        if not isinstance(scene, Scene):
            raise InputError(f"Readings.of: scene must be a Scene, not {in_words(scene)}")
        recorded = real_array(recorded, "Readings.of: recorded")
        sigma = None if sigma is None else real_array(sigma, "Readings.of: sigma")
        check_sigma(scene, recorded, sigma)
        if scene.panel.modules is not None:
            return cls._of_modules(scene, scene.panel.modules, recorded, sigma)
        # What a converter without memory rounds is a part of its own noise.
        rounds = scene.readout if sigma is None and scene.known_memory is None else None
        # Rails and infinite values are bounds; memory of the converter is removed from the values.
        within, side, sigma = _without_memory(scene, recorded, sigma)
        # Readings of the network; missing and blind ones have no weight.
        noise = None
        if sigma is not None:
            noise = scene.circuit.sigma_of_reading(within, np.broadcast_to(sigma, within.shape))
        network = scene.circuit.from_recorded(within, scene)
        side = side * nominal_terminations(scene.circuit).sign
        seen = np.where(np.isnan(recorded), 0.0, 1.0)
        if noise is not None:
            seen = np.where(np.isfinite(noise), seen, 0.0)
        seen[..., scene.blind] = 0.0
        # Resistances within their noise of zero, and voltages below zero, are upper bounds.
        reach = np.zeros_like(network) if noise is None else NOISE_REACH * noise
        small = (network <= _least_value(scene, reach)) & (side != Sidedness.AT_LEAST)
        side = np.where(small, Sidedness.AT_MOST, side)
        network = np.where(small, np.maximum(network, 0) + reach, network)
        # Finite numbers for bounds, and substitutes for missing readings.
        network, seen = _numbered(network, seen)
        side = np.where(seen > 0, side, Sidedness.VALUE)
        network = np.where((seen > 0) | scene.panel.present, network, _filled(network, seen))
        value = _standing_in(network, side, np.where(scene.panel.present, seen, 1.0), seen)
        if noise is None:
            return cls(value, None, side, seen)
        filled = _filled(noise, seen)
        constant = None if rounds is None else filled * constant_share(rounds)
        return cls(value, filled, side, seen, constant)

    def without(self, omitted: Mask) -> "Readings":
        """Return the readings without some of them, which are missing."""
        if not omitted.any():
            return self
        seen = np.where(omitted, 0.0, self.seen)
        side = np.where(omitted, Sidedness.VALUE, self.side)
        value = _standing_in(self.value, side, np.where(omitted, 0.0, 1.0), seen)
        return replace(self, value=value, side=side, seen=seen)

    @classmethod
    def _of_modules(
        cls, scene: Scene, layout: Modules, recorded: Array, sigma: Array | None
    ) -> "Readings":
        """Return the readings of a panel of modules, each by its own scene.

        Dead modules have no readings.
        """
        values = layout.split(recorded).copy()
        values[..., list(scene.dead_modules), :, :] = np.nan
        noise = None if sigma is None else np.broadcast_to(layout.split(sigma), values.shape)
        parts: dict[int, Readings] = {}
        for module, numbers in scene.alike:
            inside = (..., numbers, slice(None), slice(None))
            similar = cls.of(module, values[inside], None if noise is None else noise[inside])
            parts |= {number: similar[..., at, :, :] for at, number in enumerate(numbers)}
        return cls.of_parts(layout, [parts[number] for number in range(layout.count)])

    def each(self, change: Callable[[Array], Array]) -> "Readings":
        """Return the readings with a function such as `layout.split` applied to all arrays."""
        arrays: Any = [None if part is None else change(part) for part in self._arrays]
        return Readings(*arrays)

    @property
    def _arrays(self) -> tuple[Any, ...]:
        return self.value, self.sigma, self.side, self.seen, self.constant

    def of_module(self, layout: Modules, number: int) -> "Readings":
        """Return the readings of one module of the image."""
        return self[(..., *layout.cells(number))]

    @classmethod
    def of_parts(cls, layout: Modules, parts: Sequence["Readings"]) -> "Readings":
        """Return the readings of the whole image from those of its modules.

        The modules are in the order of their numbers.
        """
        return parts[0].together(*parts[1:], axis=-3).each(layout.joined)

    def together(self, *frames: "Readings", axis: int = 0) -> "Readings":
        """Return frames (rows, columns) stacked as (frames, rows, columns).

        The stack has no σ if a frame has none, and no constant part of it.
        """
        stacks = zip(self._arrays, *(part._arrays for part in frames), strict=True)
        arrays: Any = [
            None if any(part is None for part in stack) else np.stack(stack, axis)
            for stack in stacks
        ]
        return Readings(*arrays)

    def __getitem__(self, frames: Any) -> "Readings":
        """Return the readings at an index of the arrays, such as a range of frames."""
        return self.each(lambda part: part[frames])

    @property
    def plain(self) -> Mask:
        """Whether a reading is a value, neither a bound nor missing."""
        return np.asarray((self.seen > 0) & (self.side == Sidedness.VALUE))

    @property
    def plain_values(self) -> Array:
        """Values of the readings; NaN for bounds and missing readings."""
        return np.where(self.plain, self.value, np.nan)

    @property
    def bounds(self) -> Mask:
        """Whether a reading is a bound."""
        return np.asarray((self.seen > 0) & (self.side != Sidedness.VALUE))

    def missing(self, scene: Scene) -> Mask:
        """Return whether a cell's reading is missing for another reason than the scene's faults."""
        return np.asarray((self.seen == 0) & scene.requested)

    @property
    def shown(self) -> Array:
        """Values and bounds of the readings; NaN for missing readings."""
        return np.where(self.seen > 0, self.value, np.nan)

    def enough(self, scene: Scene) -> Mask:
        """Return whether frames can be estimated, (…).

        At most half of the scene's requested readings may be missing. At least half of them, or M +
        N − 1, must be values: a panel with one factor for each line has M + N − 1 unknowns.
        """
        requested = scene.requested
        lines = int(requested.any(axis=1).sum() + requested.any(axis=0).sum())
        least = min(-(-int(requested.sum()) // 2), lines - 1)
        missing = ((self.seen == 0) & requested).sum(axis=CELL_AXES)
        return np.asarray(
            ((self.plain & requested).sum(axis=CELL_AXES) >= least)
            & (2 * missing <= requested.sum())
        )

    @cached_property
    def partial(self) -> bool:
        """Whether any reading is not a plain value."""
        return bool(self.side.any() or (self.seen < 1).any())

    @property
    def known_sigma(self) -> Array:
        """Standard deviations of readings whose noise is known."""
        assert self.sigma is not None
        return self.sigma

    @property
    def mostly_rounding(self) -> bool:
        """Whether the constant part makes more than half of the variance."""
        if self.sigma is None or self.constant is None:
            return False
        return bool(np.mean(self.constant**2) > np.mean(self.sigma**2) / 2)

    @property
    def sigma_of_values(self) -> Array | None:
        """Standard deviations, infinite for bounds and missing readings; None if unknown."""
        return None if self.sigma is None else np.where(self.plain, self.sigma, np.inf)

    def mean(self) -> "Readings":
        """Return the mean over frames (frames, rows, columns), cell by cell over the values.

        If bounds outnumber the values of a cell, or are within the noise of their mean, the mean of
        values and bounds is a bound. Lower and upper bounds in equal numbers count as missing.
        """
        value = self.plain
        bound = self.bounds
        of_values, deviation = self._averaged(value)
        is_bound = bound.sum(axis=0) > value.sum(axis=0)
        if self.sigma is not None:
            near = bound & (np.abs(self.value - of_values) <= NOISE_REACH * self.sigma)
            is_bound |= near.any(axis=0)
        of_all, deviation_of_all = self._averaged(value | bound)
        side = np.where(
            is_bound, np.sign(np.where(bound, self.side, 0.0).sum(axis=0)), Sidedness.VALUE
        )
        undecided = is_bound & (side == Sidedness.VALUE)
        seen = np.where((value | bound).any(axis=0) & ~undecided, 1.0, 0.0)
        mean = _standing_in(np.where(is_bound, of_all, of_values), side, seen, seen)
        if deviation is None or deviation_of_all is None:
            return Readings(mean, None, side, seen)
        sigma = np.where(is_bound, deviation_of_all, deviation)
        constant = None if self.constant is None else self.constant.mean(axis=0)
        return Readings(mean, _filled(sigma, seen), side, seen, constant)

    def _averaged(self, counted: Mask) -> tuple[Array, Array | None]:
        """Return the mean over the counted frames and its σ, (rows, columns) each; else 1.

        With the constant part k of σ the mean of n frames has σ² = Σ (σ² − k²)/n² + Σ k²/n.
        """
        count = np.maximum(counted.sum(axis=0), 1)
        blank = ~counted.any(axis=0)
        mean = self.value.sum(axis=0, where=counted) / count + blank
        if self.sigma is None:
            return mean, None
        variance = (self.sigma**2).sum(axis=0, where=counted) / count**2
        if self.constant is not None:
            constant = np.minimum(self.constant, self.sigma) ** 2
            variance += constant.sum(axis=0, where=counted) / count * (1 - 1 / count)
        return mean, np.sqrt(variance) + blank

    def beside(self, count: int) -> "Readings":
        """Return these readings as one of `count` of the same values.

        The constant part of σ counts `count` times, so that the mean of all of them has it once.
        """
        if self.sigma is None or self.constant is None:
            return self
        sigma = np.sqrt(self.sigma**2 + (count - 1) * self.constant**2)
        return replace(self, sigma=sigma, constant=np.sqrt(count) * self.constant)

    def alone(self) -> "Readings":
        """Return one frame (rows, columns) as (1, rows, columns)."""
        return self[None]


def mean_change(value: Array, resting: Array) -> Array:
    """Return the mean |log y/y₀| of each frame, (…), without NaN.

    Parameters
    ----------
    value : array, shape (…, rows, columns)
        Readings y.
    resting : array, shape (rows, columns)
        Unloaded readings y₀.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.abs(np.log(value / resting))
    finite = np.isfinite(change)
    total = change.sum(axis=CELL_AXES, where=finite)
    return np.asarray(total / np.maximum(finite.sum(axis=CELL_AXES), 1))


def strongest_frame(value: Array, resting: Array, frames: Numbers) -> int:
    """Return the number of the frame, among `frames`, with the largest mean |log y/y₀|.

    The last such frame is returned if there are several.
    """
    change = mean_change(value[frames], resting)
    return int(frames[np.flatnonzero(change == change.max())[-1]])


def check_sigma(scene: Scene, recorded: Array, sigma: Array | None, where: str = "") -> None:
    """Raise InputError unless readings have the panel's shape.

    σ (or None) must have the same shape and positive entries. `where` is the beginning of the
    message.
    """
    shape = scene.panel.shape
    if recorded.shape[-2:] != shape:
        size = " × ".join(map(str, recorded.shape))
        raise InputError(
            f"{where}the readings are {size}, but the scene's panel is {shape[0]} × {shape[1]}"
        )
    if sigma is None:
        return
    if sigma.shape not in (recorded.shape, shape):
        raise InputError(f"{where}sigma has another shape than the readings")
    impossible = beyond_any_panel(sigma)
    if np.any(impossible):
        raise InputError(
            f"{where}sigma holds {sigma[impossible][0]:.6g} {scene.circuit.unit}, "
            "which no electronics has"
        )
    if np.any(sigma <= 0):
        index = tuple(np.argwhere(sigma <= 0)[0].tolist())
        raise InputError(
            f"{where}sigma{list(index)} is {sigma[index]:.6g} {scene.circuit.unit}; "
            "it must be positive"
        )


def _without_memory(
    scene: Scene, recorded: Array, sigma: Array | None
) -> tuple[Array, Array, Array | None]:
    """Return recorded values without the converter's memory of other channels.

    Returns
    -------
    recorded, side, sigma : array, shape of `recorded`
        Values within the rails, the sides of bounds, and standard deviations, None if unknown.
    """
    within, side = _within_rails(scene, recorded)
    if sigma is None and scene.readout is not None:
        sigma = scene.readout.sigma(within)
    if scene.known_memory is None:
        return within, side, sigma
    from lampest.panel.readouts.channel_memory import without_memory  # for this key alone

    if scene.readout is None or sigma is None:
        raise InputError(
            "converter_memory needs a readout in the scene, of whose voltages it is a fraction"
        )
    noise = np.broadcast_to(sigma, recorded.shape)
    corrected, sigma = without_memory(scene.readout, scene.known_memory, within, noise)
    within, beyond = _within_rails(scene, corrected)
    return within, np.where(side == Sidedness.VALUE, beyond, side), sigma


def _least_value(scene: Scene, reach: Array) -> Array:
    """Return the network's reading up to which a value is an upper bound.

    `reach` is NOISE_REACH standard deviations of the readings.
    """
    if scene.circuit.unit != "ohm":
        return np.zeros_like(reach)
    if scene.readout is None:
        return reach
    # Noise of a reading that consists of the series resistance alone
    series = scene.readout.sigma(np.broadcast_to(scene.series_ohm, scene.panel.shape))
    return np.asarray(np.minimum(reach, NOISE_REACH * series))


def _within_rails(scene: Scene, recorded: Array) -> tuple[Array, Array]:
    """Return values clipped to the converter's rails, and the sides of those that are bounds."""
    side = np.zeros(recorded.shape)
    least, largest = (0.0, np.inf) if scene.readout is None else scene.readout.rails()
    side[recorded < least] = Sidedness.AT_MOST
    side[(recorded > largest) | np.isposinf(recorded)] = Sidedness.AT_LEAST
    return np.clip(recorded, least, largest), side


def _numbered(network: Array, seen: Array) -> tuple[Array, Array]:
    """Return readings with numbers for bounds without a finite number, and `seen`.

    The number is the largest or smallest value of the frame. `seen` is 0 for all readings of a
    frame without any finite number.
    """
    is_number = (seen > 0) & np.isfinite(network) & (network > 0)
    largest = np.max(network, axis=CELL_AXES, keepdims=True, initial=0.0, where=is_number)
    smallest = np.min(network, axis=CELL_AXES, keepdims=True, initial=np.inf, where=is_number)
    network = np.where(is_number, network, np.where(network > 0, largest, smallest))
    return network, np.where(is_number.any(axis=CELL_AXES, keepdims=True), seen, 0.0)


def _standing_in(value: Array, side: Array, whole: Array, seen: Array) -> Array:
    """Return frames with predictions from the seen values where `whole` is 0."""
    if np.all(whole):
        return value
    known = (seen > 0) & (side == Sidedness.VALUE)
    predicted = value.copy()
    with_holes = ~np.all(whole > 0, axis=CELL_AXES)
    predicted[with_holes] = stand_in(value[with_holes], known[with_holes])
    return np.where(whole > 0, value, predicted)


def _filled(values: Array, seen: Array) -> Array:
    """Return frames with their geometric mean in place of missing readings.

    1 if all of a frame are missing.
    """
    logarithm = np.log(np.where(seen > 0, values, 1.0))
    count = np.maximum(seen.sum(axis=CELL_AXES, keepdims=True), 1)
    mean = np.exp((logarithm * seen).sum(axis=CELL_AXES, keepdims=True) / count)
    return np.where(seen > 0, values, mean)


def equal_rows(readings: Readings) -> tuple[tuple[int, ...], ...]:
    """Return groups of rows whose readings are equal within their noise in all frames.

    Rows that touch and rows that are read twice are such groups, and so are rows of a uniform film
    that no load tells apart. The mean square of n normal differences is 1 ± √(2/n).

    Parameters
    ----------
    readings : Readings
        (frames, rows, columns).

    Returns
    -------
    tuple of tuple of int
        Numbers of the rows of each group; empty if the noise is unknown.
    """
    rows = readings.value.shape[-2]
    if readings.sigma is None:
        return ()
    check_line_memory(rows, 1)
    unlike, count = line_differences(readings)
    similar = (unlike <= 1 + UNUSUAL * np.sqrt(2 / np.maximum(count, 1))) & (count >= 4)
    # Each row takes the lowest number among those like it, until no number changes.
    joined = similar | similar.T | np.eye(rows, dtype=bool)
    group, lowest = np.full(rows, rows), np.arange(rows)
    while np.any(lowest < group):
        group, lowest = lowest, np.where(joined, lowest, rows).min(axis=1)
    members = (np.flatnonzero(group == number) for number in np.unique(group))
    return tuple(tuple(lines.tolist()) for lines in members if len(lines) > 1)


def line_differences(readings: Readings) -> tuple[Array, Numbers]:
    """Return the mean square difference of each two rows, and the number of its values.

    The difference is in units of their noise, which must be known.
    """
    rows = readings.value.shape[-2]
    noise = np.where(readings.plain, readings.known_sigma, np.inf)
    value, noise = (part.swapaxes(-1, -2).reshape(-1, rows) for part in (readings.value, noise))
    unlike = np.zeros((rows, rows))
    count = np.zeros((rows, rows), dtype=np.intp)
    for row in range(rows):
        spread = np.hypot(noise[:, [row]], noise)
        finite = np.isfinite(spread)
        square = ((value[:, [row]] - value) / spread) ** 2
        count[row] = finite.sum(axis=0)
        unlike[row] = square.sum(axis=0, where=finite) / np.maximum(count[row], 1)
    return unlike, count
