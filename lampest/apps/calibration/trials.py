"""Recordings of known resistors in place of the cells."""

import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from lampest.apps.calibration.calibration import MIN_SAMPLE
from lampest.files.errors import InputError
from lampest.files.levels import MAD_TO_SIGMA
from lampest.files.whole import note_read
from lampest.panel.lines import Side
from lampest.panel.panel import Array, Mask, Panel
from lampest.panel.readouts import Readout
from lampest.panel.readouts.converter import (
    ENDLESS,
    averaged_variance,
    noise_of_variance,
    sigma_code,
)
from lampest.recording.recording import Recording
from lampest.recording.simulation.measure import OPEN_OHM, SHORT_OHM

# Repeats to which the scene's noise is equivalent: few frames with equal codes do not imply no
# noise.
BELIEF = 4.0
CHANGE = "change from frame to frame, which fixed resistors do not"


@dataclass(frozen=True, eq=False)
class Trial:
    """One recording of known resistors.

    Attributes
    ----------
    name : str
        Name of the recording.
    known : array, shape (rows, columns)
        Resistors, ohm; 0 shorted, NaN no resistor.
    volt, sigma_volt : array, shape (rows, columns)
        Mean voltage at the converter over the frames, and its standard deviation including
        quantisation, V.
    noise_lsb : array, shape (driven lines,)
        Noise of one reading, LSB, with the scene's noise as BELIEF additional repeats.
    repeats : array, shape (driven lines,)
        Degrees of freedom of the noise.
    everywhere : bool
        Whether readings of lines without a resistor count, because the converter has a memory of
        the channel before.
    """

    name: str
    known: Array
    volt: Array
    sigma_volt: Array
    noise_lsb: Array
    repeats: Array
    everywhere: bool

    @classmethod
    def of(cls, recording: Recording, known: Array | float) -> "Trial":
        """Return the trial of a recording with known resistors, (rows, columns) or one number, ohm.

        Raises InputError without a readout or a resistor, or where readings change from frame to
        frame.
        """
        readout = recording.scene.readout
        name = recording.name
        if readout is None:
            raise InputError(
                f"{name}: its scene names no readout, whose numbers a calibration could find"
            )
        ohm = np.broadcast_to(np.asarray(known, dtype=float), recording.scene.panel.shape)
        ohm = np.where(np.isinf(ohm), np.nan, ohm)
        if np.any(ohm < 0):
            raise InputError("known resistors must be zero or positive")
        if not np.isfinite(ohm).any():
            raise InputError(f"{name}: no row line is joined to a column line by a known resistor")
        volt = readout.volt_from_recorded(recording.recorded)
        across = 1 if readout.noisy_side == "rows" else 0
        valid = _valid(name, readout, volt, across)
        counts = valid.sum(axis=0)
        with np.errstate(invalid="ignore"):
            mean = np.where(valid, volt, 0.0).sum(axis=0) / counts
        inside = within_rails(readout, mean)
        residual = np.where(valid & inside, (volt - mean) / readout.lsb_volt, 0.0)
        # Residuals of successive frames that are correlated show a drift.
        parts = (residual, np.diff(residual, axis=0) / np.sqrt(2))
        total, quick = ((part**2).sum() / max(len(residual) - 1, 1) for part in parts)
        # rms of the drift: the variance less half of the mean square successive difference, as a
        # fraction of full scale
        lasting = np.sqrt(max(total - quick, 0.0) / residual[0].size) / 2.0**readout.adc_bits
        if len(residual) >= MIN_SAMPLE and quick < total / 2 and lasting > 1e-3:
            raise InputError(
                f"{name}: no calibration: its readings drift "
                f"by {100 * lasting:.2g} % of the supply, and {CHANGE}"
            )
        squares = (residual**2).sum(axis=(0, 1 + across))
        freedom = np.where(inside, counts - 1, 0).sum(axis=across)
        # pooled variance: (BELIEF σ_scene² + Σ residual²)/(BELIEF + freedom), LSB²
        variance = (BELIEF * averaged_variance(readout, readout.assumed_noise) + squares) / (
            BELIEF + freedom
        )
        noise = np.array([noise_of_variance(readout, value) for value in variance])
        lasting = np.array([float(sigma_code(readout, value, ENDLESS)) for value in noise])
        of_mean = (
            np.expand_dims(variance, across) / np.maximum(counts, 1)
            + np.expand_dims(lasting, across) ** 2
        )
        memory = recording.scene.known_memory is not None
        return cls(name, ohm, mean, readout.lsb_volt * np.sqrt(of_mean), noise, freedom, memory)

    @cached_property
    def cells(self) -> Array:
        """Resistors (rows, columns) ohm, with finite values for open and shorted ones."""
        return np.nan_to_num(np.maximum(self.known, SHORT_OHM), nan=OPEN_OHM)

    @cached_property
    def used(self) -> Mask:
        """Whether a reading exists and both of its lines lead to a resistor, (rows, columns)."""
        rows = self.connected("rows")[:, None]
        columns = self.connected("columns")[None, :]
        return (self.everywhere | (rows & columns)) & np.isfinite(self.volt)

    def connected(self, side: Side) -> Mask:
        """Return whether each line of a side leads to a resistor, (lines,)."""
        return np.asarray(np.isfinite(self.known).any(axis=1 if side == "rows" else 0))

    @cached_property
    def resistors(self) -> dict[tuple[float, int], tuple[int, int]]:
        """Place (row, column) of each resistor by value and number among those of equal value.

        A resistor with the same key in another trial is the same resistor, moved.
        """
        places = [(row, column) for row, column in np.argwhere(self.known > 0).tolist()]
        values = [float(self.known[place]) for place in places]
        return {(value, values[:n].count(value)): places[n] for n, value in enumerate(values)}


def usable_range(readout: Readout) -> tuple[float, float]:
    """Return the voltages between which noise reaches no rail of the converter.

    Returns
    -------
    lowest, highest : float
        In volts.
    """
    margin = (2 + 3 * float(np.max(readout.assumed_noise))) * readout.lsb_volt
    return margin, min(readout.full_scale_volt, readout.range_volt[1]) - margin


def within_rails(readout: Readout, volt: Array) -> Mask:
    """Return whether mean voltages, of any shape, are unbiased by the rails of the converter."""
    low, high = usable_range(readout)
    return (volt > low) & (volt < high)


def _valid(name: str, readout: Readout, volt: Array, across: int) -> Mask:
    """Return the readings that exist and are no spikes, (frames, rows, columns).

    Raises InputError where there are too many outliers to be spikes.

    Parameters
    ----------
    name : str
    readout : Readout
    volt : array, shape (frames, rows, columns)
    across : int
        Axis of the lines that are not driven.
    """
    valid = np.isfinite(volt)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all-NaN lines
        deviation = (volt - np.nanmedian(volt, axis=0)) / readout.lsb_volt
        robust = MAD_TO_SIGMA * np.nanmedian(np.abs(deviation), axis=(0, 1 + across))
    # Where the noise is below one step of the code, the median deviation is zero.
    least = np.maximum(sigma_code(readout, readout.assumed_noise), 1 / readout.readings)
    # Robust σ.
    wild = np.abs(deviation) > 7.0 * np.expand_dims(
        np.maximum(np.nan_to_num(robust), least), across
    )
    if wild.sum() > 0.02 * wild.size + 2:  # spikes are some in ten thousand
        raise InputError(
            f"{name}: no calibration: {100 * wild.mean():.0f} % of its readings {CHANGE}"
        )
    return valid & ~wild


def known_resistors(text: str, panel: Panel) -> Array:
    """Return the resistors in place of the cells, (rows, columns) ohm.

    `text` is a number, or the path of a .csv or .npy file. In a file every row is a line of the
    panel; inf, nan or nothing between two commas stands for no resistor. Raises InputError where it
    is neither a number nor such a table.
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
            table = np.genfromtxt(
                path.read_text(encoding="utf-8-sig").splitlines(), delimiter=",", ndmin=2
            )
    except FileNotFoundError as error:
        raise InputError(f"--known: '{text}' is neither a number of ohm nor a file") from error
    except (OSError, ValueError, EOFError) as error:
        raise InputError(
            f"{path}: no table of resistances ({' '.join(str(error).split())})"
        ) from error
    if table.dtype.kind not in "iuf" or table.shape != panel.shape:
        size, shape = (" × ".join(map(str, lengths)) for lengths in (panel.shape, table.shape))
        raise InputError(f"{path}: the panel has {size} cells, but the table holds {shape} numbers")
    return np.asarray(table, dtype=float)
