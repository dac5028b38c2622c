"""Recordings of known resistors: what was read, and what stood in place of the cells."""

import warnings
from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.files.whole import note_read
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import Readout
from lampest.panel.readouts.lines import PerLine, Side
from lampest.recording.recording import Recording
from lampest.recording.simulation.measure import OPEN_OHM, SHORT_OHM

FEWEST_REPEATS = 50  # they tell a noise to a tenth
ENDLESS = 65535  # readings: what is then left of σ does not average out
BELIEF = 4.0  # the scene's noise counts as much as so many repeats: few frames with equal codes do not mean no noise
FEWEST_FRAMES = 5  # from which on a wild reading, or one that drifts, can be told
CHANGE = "change from frame to frame, which fixed resistors do not"


@dataclass(frozen=True, eq=False)
class Trial:
    """One recording of known resistors: means over its frames, and what stood in place of the cells.

    known : (rows, columns) ohm, 0 shorted, NaN no resistor. volt, sigma_volt : (rows, columns) at the converter; σ is
    that of the mean, what quantisation leaves included. noise_lsb : (driven lines) of one reading, with the scene's as
    if it had been seen BELIEF times. seen : (driven lines) repeats of each. everywhere : whether readings of lines
    without a resistor count too, because something of the channel before may be in them.
    """

    name: str
    known: Array
    volt: Array
    sigma_volt: Array
    noise_lsb: Array
    seen: Array
    everywhere: bool

    @classmethod
    def of(cls, recording: Recording, known: Array) -> "Trial":
        """Means and noise over frames. Raises InputError without readout, or where readings change as no resistor's."""
        readout = recording.scene.readout
        if readout is None:
            raise InputError(f"{recording.name}: its scene names no readout, whose numbers a calibration could find")
        volt, other = readout.volt_from_recorded(recording.recorded), 1 if readout.noisy_side == "rows" else 0
        kept = _kept(recording, readout, volt, other)
        counts = kept.sum(axis=0)
        with np.errstate(invalid="ignore"):
            mean = np.where(kept, volt, 0.0).sum(axis=0) / counts
        inside = within_rails(readout, mean)
        rest = np.where(kept & inside, (volt - mean) / readout.lsb_volt, 0.0)
        # What stays from one frame to the next is no noise: von Neumann, Annals of Mathematical Statistics 12(4), 1941.
        total, quick = ((part**2).sum() / max(len(rest) - 1, 1) for part in (rest, np.diff(rest, axis=0) / np.sqrt(2)))
        lasting = np.sqrt(max(total - quick, 0.0) / mean.size) / 2.0**readout.adc_bits
        if len(rest) >= FEWEST_FRAMES and quick < total / 2 and lasting > 1e-3:
            raise InputError(
                f"{recording.name}: no calibration: its readings drift by {100 * lasting:.2g} % of the supply, and "
                f"{CHANGE}"
            )
        squares, freedom = (rest**2).sum(axis=(0, 1 + other)), np.where(inside, counts - 1, 0).sum(axis=other)
        variance = (BELIEF * _averaging(readout, readout.assumed_noise) + squares) / (BELIEF + freedom)
        noise = np.array([noise_of_variance(readout, value) for value in variance])
        left = np.array([float(sigma_code(readout, value, ENDLESS)) for value in noise])
        mean_variance = np.expand_dims(variance, other) / np.maximum(counts, 1) + np.expand_dims(left, other) ** 2
        memory, sigma = recording.scene.converter_memory is not None, readout.lsb_volt * np.sqrt(mean_variance)
        return cls(recording.name, known, mean, sigma, noise, freedom, memory)

    @cached_property
    def cells(self) -> Array:
        return np.nan_to_num(np.maximum(self.known, SHORT_OHM), nan=OPEN_OHM)

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """(rows, columns) where a reading says something: it is there, and both of its lines lead to a resistor."""
        rows, columns = self.led("rows")[:, None], self.led("columns")[None, :]
        return np.asarray((self.everywhere | (rows & columns)) & np.isfinite(self.volt))

    def led(self, side: Side) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.known).any(axis=1 if side == "rows" else 0))

    @cached_property
    def resistors(self) -> dict[tuple[float, int], tuple[int, int]]:
        """Where each resistor stands, by its value and its number among those of that value: the same one if moved."""
        count, found = Counter[float](), {}
        for row, column in np.argwhere(self.known > 0).tolist():
            value = float(self.known[row, column])
            found[value, count[value]] = (row, column)
            count[value] += 1
        return found


def usable_range(readout: Readout) -> tuple[float, float]:
    """V between which noise does not reach either end of the converter."""
    margin = (2 + 3 * float(np.max(readout.assumed_noise))) * readout.lsb_volt
    return margin, readout.full_scale_volt - margin


def within_rails(readout: Readout, volt: Array) -> NDArray[np.bool_]:
    """Where a mean is not drawn away from an end of the converter; any shape."""
    low, high = usable_range(readout)
    return np.asarray((volt > low) & (volt < high))


def sigma_code(readout: Readout, noise_lsb: PerLine, readings: int | None = None) -> Array:
    """σ of the mean code for another noise, and another number of readings, LSB."""
    return np.asarray(replace(readout, noise_lsb=noise_lsb, readings=readings or readout.readings).sigma_code())


def _averaging(readout: Readout, noise_lsb: PerLine) -> Array:
    """LSB², what repeats average out of the variance: σ²(readings) − σ²(endlessly many)."""
    return np.asarray(sigma_code(readout, noise_lsb) ** 2 - sigma_code(readout, noise_lsb, ENDLESS) ** 2)


def noise_of_variance(readout: Readout, variance: float) -> float:
    """The noise, LSB, of which repeats average out that variance, LSB²; by bisection."""
    low, high = 0.0, 2.0**readout.adc_bits
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (middle, high) if float(_averaging(readout, middle)) < variance else (low, middle)
    return low


def _kept(recording: Recording, readout: Readout, volt: Array, other: int) -> NDArray[np.bool_]:
    """(frames, rows, columns) that were read and are not wild. Raises InputError where too many are, for spikes."""
    kept = np.isfinite(volt)
    if len(volt) < FEWEST_FRAMES:
        return kept
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all-NaN lines
        deviation = (volt - np.nanmedian(volt, axis=0)) / readout.lsb_volt
        robust = 1.4826 * np.nanmedian(np.abs(deviation), axis=(0, 1 + other))
    # Codes come in steps, and where noise is smaller the median deviation is zero.
    least = np.maximum(sigma_code(readout, readout.assumed_noise), 1 / readout.readings)
    wild = np.abs(deviation) > 7.0 * np.expand_dims(np.maximum(np.nan_to_num(robust), least), other)  # robust σ
    if wild.sum() > 0.02 * wild.size + 2:  # spikes are some in ten thousand
        raise InputError(f"{recording.name}: no calibration: {100 * wild.mean():.0f} % of its readings {CHANGE}")
    return kept & ~wild


def known_resistors(text: str, panel: Panel) -> Array:
    """What stands in place of the cells, (rows, columns) ohm, from a number or the name of a .csv or .npy file.

    In a file every row is a line of the panel; inf, nan or nothing between two commas stands for no resistor. Raises
    InputError where it is neither a number nor such a table.
    """
    try:
        return np.full(panel.shape, float(text))
    except ValueError:
        path = Path(text)
    note_read(path)
    try:
        if path.suffix == ".npy":
            table = np.load(path, allow_pickle=False)
        else:
            table = np.genfromtxt(path.read_text(encoding="utf-8-sig").splitlines(), delimiter=",", ndmin=2)
    except FileNotFoundError as error:
        raise InputError(f"--known: '{text}' is neither a number of ohm nor a file") from error
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: no table of resistances ({' '.join(str(error).split())})") from error
    if table.dtype.kind not in "iuf" or table.shape != panel.shape:
        size, found = (" × ".join(map(str, shape)) for shape in (panel.shape, table.shape))
        raise InputError(f"{path}: the panel has {size} cells, but the table holds {found} numbers")
    return np.asarray(table, dtype=float)
