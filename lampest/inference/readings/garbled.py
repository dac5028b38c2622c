"""Detection of garbled frames: lines whose readings were lost or displaced in transmission.

Transmission fails for one frame or for some of its lines: their readings are bytes of something
else, or those of other cells. Such readings deviate from the neighbouring frames in whole lines
while the other lines do not, and they are rougher than the lines ever are. Or they equal those of
another line, or of cells further along the scan. A load that is present for one frame does neither:
it changes a patch of cells, which is as smooth in one frame as in the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from operator import attrgetter
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import first_and_more
from lampest.files.levels import MAD_TO_SIGMA, NOISE_REACH, OUTLIER_THRESHOLD, SIGNIFICANCE
from lampest.inference.readings.outliers import (
    MIN_RATIO_TO_SCATTER,
    by_median,
    first_of_windows,
    from_window,
)
from lampest.panel.panel import Array, Mask, Numbers
from lampest.recording.readings import median
from lampest.recording.recording import UNLOADED, Recording

MIN_FRAMES = 5  # with fewer, the neighbours of a frame do not show which one is the odd one
MIN_ALIKE = 3  # unloaded or measured frames: of two, none is the odd one
MIN_LINE_SHARE = 0.25  # of deviating readings, beyond which a line counts as affected
# of deviating readings in the affected lines, and in the other ones
MIN_SHARE = 0.6
MAX_SHARE_BESIDE = 0.05
MIN_LINE_CELLS = 5  # readings of a line: with fewer, chance makes it as rough as a garbled one
MIN_DIFFERENCED = 3  # readings of a line that have a second difference
# Median second difference of ln y along the lines, and its ratio to the largest one of the lines
# that follow their neighbours in time. That of random bytes is 1.5; film that scatters by 0.3 has
# 0.5, and loads add
# little (tests/oracles/test_garbled.py).
MIN_ROUGHNESS = 0.5
MIN_ROUGHNESS_RATIO = 1.3
# Median deviation of the changes of ln y of a line from their median: below it they are alike.
MAX_SPREAD = 0.1
# Times as rough: such lines are garbled even if other lines of the frame move as well.
CLEARLY = 1.5
MAX_DISPLACEMENT = 4  # readings along the scan
# Probability that lines agree with other places by chance: below it those of a frame are displaced,
# of which each has less than the second one.
MAX_CHANCE = SIGNIFICANCE
MAX_CHANCE_OF_LINE = 1e-2
# Of a scan: along the rows, or along the columns.
ORDERS: tuple[Literal["C", "F"], ...] = ("C", "F")


@dataclass(frozen=True, eq=False)
class GarbledLines:
    """Garbled lines of one frame.

    Attributes
    ----------
    frame : int
        Index of the frame.
    name : str
        'row' or 'column'.
    numbers : tuple of int
        The lines; all of them if the whole frame is garbled.
    whole : bool
    """

    frame: int
    name: str
    numbers: tuple[int, ...]
    whole: bool

    @property
    def name_in_words(self) -> str:
        """The lines in words, such as 'rows 2, 3 of frame 14'."""
        if self.whole:
            return f"frame {self.frame}"
        plural = "s" if len(self.numbers) > 1 else ""
        return f"{self.name}{plural} {', '.join(map(str, self.numbers))} of frame {self.frame}"


def garbled_lines(recording: Recording) -> tuple[GarbledLines, ...]:
    """Return the garbled lines of all frames, in temporal order.

    Garbled frames leave before the frames around them are predicted again, until none is found, so
    that they do not hide each other. A panel of modules counts as one image.
    """
    values = _signal(recording)
    garbled = dict[int, GarbledLines]()
    while True:
        frames = np.setdiff1d(np.arange(len(values)), list(garbled))
        found = _garbled_among(recording, values[frames], recording.role[frames])
        if not found:
            return tuple(sorted(garbled.values(), key=attrgetter("frame")))
        for lines in found:
            frame = int(frames[lines.frame])
            garbled[frame] = replace(lines, frame=frame)


def _garbled_among(
    recording: Recording, values: Array, role: NDArray[np.uint8]
) -> list[GarbledLines]:
    """Return the garbled lines of frames that are predicted by each other.

    Parameters
    ----------
    recording : Recording
    values : array, shape (frames, rows, columns)
        Voltages at the converter.
    role : array, shape (frames,)
    """
    if len(values) < MIN_FRAMES or min(values.shape[1:]) < MIN_DIFFERENCED:
        return []
    expected, spread = _expected(values, role)
    # The noise by changes from frame to frame; the converter's step is the least one.
    steps = np.abs(np.diff(values, axis=0))
    measured = float(MAD_TO_SIGMA / np.sqrt(2) * median(steps.ravel())[0])
    readout = recording.scene.readout
    scale = measured if readout is None else max(measured, float(readout.lsb_volt))
    if not scale > 0:
        return []
    threshold = np.fmax(OUTLIER_THRESHOLD * scale, MIN_RATIO_TO_SCATTER * spread)
    with np.errstate(invalid="ignore"):
        deviates = np.abs(values - expected) > threshold
    suspicious = np.flatnonzero(deviates.any(axis=(1, 2))).tolist()
    ends = (0.0,)
    if readout is not None:
        ends = tuple(readout.volt_from_recorded(np.array(readout.rails())).tolist())
    film = median(values[role == UNLOADED] if np.any(role == UNLOADED) else values)
    garbled = dict[int, GarbledLines]()
    for name, axes in (("row", (0, 1, 2)), ("column", (0, 2, 1))):
        turned, predicted, of_film = (part.transpose(axes) for part in (values, expected, film))
        along = Along(turned, predicted, of_film, deviates.transpose(axes), scale, ends)
        for frame in suspicious:
            lines = along.garbled(frame)
            if len(lines) and frame not in garbled:
                whole = len(lines) == along.values.shape[1]
                garbled[frame] = GarbledLines(frame, name, tuple(lines.tolist()), whole)
    return list(garbled.values())


def readings_of(garbled: Sequence[GarbledLines], recording: Recording) -> Mask:
    """Return whether a reading is part of a garbled line, boolean (frames, rows, columns)."""
    flagged = np.zeros(recording.recorded.shape, dtype=bool)
    for lines in garbled:
        of_frame = flagged[lines.frame]
        if lines.name == "column":
            of_frame = of_frame.T
        of_frame[list(lines.numbers)] = True
    return flagged


def garbled_sentence(garbled: Sequence[GarbledLines]) -> str:
    """Return the garbled lines in words; '' without any."""
    places = [lines.name_in_words for lines in garbled]
    return f"garbled and left out: {first_and_more(places)}" if places else ""


def _signal(recording: Recording) -> Array:
    """Return the voltages at the converter, or conductances in 1/ohm without a readout.

    The shape is (frames, rows, columns). Bounds are included, because garbled codes may lie at a
    rail, beyond which nothing is known; missing readings are NaN.
    """
    scene = recording.scene
    recorded = recording.recorded
    with np.errstate(divide="ignore", invalid="ignore"):
        if scene.readout is None:
            values = np.asarray(1 / recorded)
        else:
            known = np.clip(recorded, *scene.readout.rails())
            values = np.asarray(scene.readout.volt_from_recorded(known))
    return np.where(np.isfinite(values) & scene.requested, values, np.nan)


def _expected(values: Array, role: NDArray[np.uint8]) -> tuple[Array, Array]:
    """Return median and scatter of each frame's neighbours, (frames, rows, columns) each.

    Unloaded frames have unloaded neighbours and measured frames measured ones: between them a load
    arrives. A frame has none, and NaN, where fewer than MIN_ALIKE frames have its role.
    """
    middle, spread = np.full((2, *values.shape), np.nan)
    for alike in (role == UNLOADED, role != UNLOADED):
        own = values[alike]
        frames = np.arange(len(own))
        if len(own) < MIN_ALIKE:
            continue
        first = first_of_windows(len(own))
        middle[alike], spread[alike], _ = from_window(own, first, frames - first, by_median)
    return middle, spread


@dataclass(frozen=True, eq=False)
class Along:
    """Lines of one side of the panel, each along its cells.

    Attributes
    ----------
    values, expected : array, shape (frames, lines, cells)
        Voltages at the converter, and those that the neighbouring frames predict.
    film : array, shape (1, lines, cells)
        Median of the unloaded frames, or of all without any.
    deviates : boolean array, same shape
        Whether a reading deviates from the neighbouring frames.
    scale : float
        Standard deviation of the noise, volt.
    ends : tuple of float
        Voltages of the rails, beyond which nothing is known; of readings without a converter zero.
    """

    values: Array
    expected: Array
    film: Array
    deviates: Mask
    scale: float
    ends: tuple[float, ...]

    @property
    def _short(self) -> bool:
        """Whether lines have too few readings for their roughness."""
        return bool(self.values.shape[2] < MIN_LINE_CELLS)

    @cached_property
    def roughness(self) -> Array:
        """Median size of second differences of ln y along each line, (frames, lines).

        Noise is taken off. Of ln y and of its change ln y/ŷ the smoother one counts: the film is in
        the former alone, and a load that leaves in the latter alone. A load explains the changes of
        a line, which are 0, where they follow those of a line beside it, or where all but one
        are alike: one cell that is pressed moves the other readings of its line by one factor.
        """
        observed, expected = (np.maximum(part, self.scale) for part in (self.values, self.expected))
        change = np.log(observed / expected)
        of_both = [_roughness(part, self.scale / observed) for part in (np.log(observed), change)]
        rough = np.nan_to_num(np.minimum(*of_both))
        pressed = np.nan_to_num(np.abs(change)).argmax(axis=2)[:, :, None]
        cells = np.arange(change.shape[2] - 1)
        others = np.take_along_axis(change, cells + (cells >= pressed), axis=2)
        spread = median(np.abs(others - median(others, 2)), 2)[:, :, 0]
        explained = (spread < MAX_SPREAD) | follows_beside(self.values - self.expected)
        return np.where(explained | self._short, 0.0, rough)

    @cached_property
    def _following(self) -> Mask:
        """Whether a line follows its neighbours in time, (frames, lines): the measure of others."""
        judged = np.isfinite(self.expected).any(axis=2)
        return np.asarray(judged & (self.deviates.mean(axis=2) <= MIN_LINE_SHARE))

    @cached_property
    def _lost(self) -> Mask:
        """Whether a line lies at one end of the converter as no following line, (frames, lines)."""
        ends = [np.abs(self.values - end) < self.scale for end in self.ends]
        usual = self._following[:, :, None]
        lost = [at_end.all(axis=2) & ~(at_end & usual).any() for at_end in ends]
        return np.asarray(np.any(lost, axis=0) & usual.any() & (not self._short))

    def garbled(self, frame: int) -> Numbers:
        """Return the garbled lines of a frame."""
        shares = self.deviates[frame].mean(axis=1)
        # Least roughness of a garbled line, from the lines that follow their neighbours
        following = np.where(self._following, self.roughness, np.nan)
        usual = float(np.nanmax(median(following), initial=0.0))
        least = max(MIN_ROUGHNESS, MIN_ROUGHNESS_RATIO * usual)
        roughness = self.roughness[frame]
        # Lines that deviate as a whole while the others do not.
        inside = shares > MIN_LINE_SHARE
        if inside.any() and shares[inside].mean() >= MIN_SHARE:
            apart = inside.all() or shares[~inside].mean() <= MAX_SHARE_BESIDE
            if apart and float(np.median(roughness[inside])) > least:
                return np.flatnonzero(inside)
        clear = (shares > MIN_SHARE) & ((roughness > CLEARLY * least) | self._lost[frame])
        chance = np.ones(len(shares))
        if inside.any():
            gains = self._gains_elsewhere(frame)
            places = gains.shape[0] * gains.shape[2]
            gain = np.maximum(gains.max(axis=(0, 2)), 0.0)
            chance = np.where(inside, places * np.exp(-gain / 2), 1.0)
            # A scan that lost readings, or has some twice, displaces all lines from one on.
            alike = gains[:, ::-1, len(shares) - 1 :].cumsum(axis=1)[:, ::-1]
            gain_from = np.maximum(alike.max(axis=(0, 2)), 0.0)
            chance_from = alike.size * np.exp(-gain_from / 2)
            first = int(chance_from.argmin())
            if chance_from[first] < MAX_CHANCE:
                clear[first:] = True
                return np.flatnonzero(clear)
        unlikely = chance < MAX_CHANCE_OF_LINE
        displaced = unlikely & (np.prod(chance[unlikely]) < MAX_CHANCE)
        return np.flatnonzero(clear | displaced)

    def _gains_elsewhere(self, frame: int) -> Array:
        """Return twice the ln likelihood ratio of other cells to a line's own.

        These are the cells of another line, or those further along the scan. Either the readings
        are those of other cells, or of the line's own cells, which a load elsewhere has changed by
        one amount. With the deviations e of readings under both, the odds of the former are
        exp(Σ (e² of the latter − e² of the former)/2), over the number of places. A load may also
        have changed a reading to that of any other cell: the film's contrast is the deviation of
        such readings. Only places count at which no load is predicted: a load moves from line to
        line, and the film does not.

        Returns
        -------
        array, shape (images, lines, places)
            Images are those that other frames predict; places those of `_elsewhere`.
        """
        first = min(max(frame - 1, 0), len(self.values) - 3)
        before, after = (self.values[at] for at in range(first, first + 3) if at != frame)
        images = [self.expected[frame], (before + after) / 2]
        noise = np.sqrt(2) * self.scale
        own_film = self.film[0]
        film = _elsewhere(own_film)
        current = self.values[frame, :, None]
        # The variance of a second difference, which smooth loads do not have, is 6 times that of a
        # reading, and here of two.
        rough = np.abs(np.diff(film - own_film[:, None], 2, axis=2))
        contrast = MAD_TO_SIGMA * median(rough, 2) / np.sqrt(12)
        # −2 ln of the density of a load's readings, over that of a reading without deviation
        of_load = 2 * np.log(np.maximum(contrast / noise, 1.0))
        gains = []
        for image in images:
            predicted = _elsewhere(image)
            unloaded = np.abs(predicted - film) < NOISE_REACH * noise

            def misfit(errors: Array, counted: Mask = unloaded) -> Array:
                """Return Σ e² of each line and place, without unknown deviations."""
                squares = np.nan_to_num(np.minimum(np.square(errors / noise), of_load))
                return np.asarray(np.where(counted, squares, 0.0).sum(axis=2))

            stays = np.full(film.shape[:2], np.inf)
            for own in (*images, own_film):
                errors = current - own[:, None]
                middles = median(np.where(unloaded, errors, np.nan), 2)
                stays = np.minimum(stays, np.minimum(misfit(errors), misfit(errors - middles)))
            gains.append(stays - misfit(current - predicted))
        return np.array(gains)


def _elsewhere(image: Array) -> Array:
    """Return the cells of other places, for each line, (lines, places, cells).

    First come the other lines, then the line's readings further along the scan.
    """
    lines = np.arange(len(image))
    others = np.array([np.delete(lines, line) for line in lines])
    displacements = (*range(-MAX_DISPLACEMENT, 0), *range(1, MAX_DISPLACEMENT + 1))
    along = [
        np.roll(image.ravel(order), steps).reshape(image.shape, order=order)
        for steps, order in product(displacements, ORDERS)
    ]
    return np.concatenate([image[others], np.stack(along, axis=1)], axis=1)


def _roughness(values: Array, sigma: Array) -> Array:
    """Return the median size of second differences along lines beyond their noise.

    Parameters
    ----------
    values, sigma : array, shape (frames, lines, cells)

    Returns
    -------
    array, shape (frames, lines)
    """
    square = np.diff(values, 2, axis=2) ** 2
    variance = sigma**2
    noise = variance[:, :, 2:] + 4 * variance[:, :, 1:-1] + variance[:, :, :-2]
    return np.sqrt(np.maximum(median(square - noise, 2)[:, :, 0], 0.0))


def follows_beside(change: Array) -> Mask:
    """Return whether the changes of a line have the shape of those of a line beside it.

    A load covers neighbouring lines, or couples them; lines of random bytes have nothing in common.
    The correlation r of n unrelated changes has a standard normal artanh(r) √(n − 3)
    (Fisher, Metron 1, 1921).

    Parameters
    ----------
    change : array, shape (frames, lines, cells)
        Changes y − ŷ; NaN where unknown.

    Returns
    -------
    boolean array, shape (frames, lines)
    """
    known = np.isfinite(change[:, 1:]) & np.isfinite(change[:, :-1])
    count = np.maximum(known.sum(axis=2, keepdims=True), 1)
    lines = [np.where(known, part, 0.0) for part in (change[:, 1:], change[:, :-1])]
    first, second = (
        np.where(known, part - part.sum(axis=2, keepdims=True) / count, 0.0) for part in lines
    )
    size = np.sqrt((first**2).sum(axis=2) * (second**2).sum(axis=2))
    correlation = (first * second).sum(axis=2) / np.maximum(size, np.finfo(float).tiny)
    largest = np.tanh(NOISE_REACH / np.sqrt(np.maximum(count[:, :, 0] - 3, 1)))
    alike = correlation > largest
    follows = np.zeros(change.shape[:2], dtype=bool)
    follows[:, 1:] |= alike
    follows[:, :-1] |= alike
    return follows


def middle(values: Array) -> float:
    """Return the median of all values; NaN are ignored, and NaN is returned without any value."""
    return float(median(values.ravel())[0]) if values.size else np.nan
