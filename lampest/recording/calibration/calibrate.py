"""Resistances of the electronics from known resistors, with their uncertainty, as the scene that they make."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import fdtrc

from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.readouts.lines import LineNumber, Side
from lampest.panel.scene import Scene, SeriesPerLine
from lampest.recording.calibration.fit import (
    BEST_OHM,
    MEMORY,
    RESISTOR_TOLERANCE,
    TYPICAL,
    TYPICAL_OHM,
    WIRE,
    WORST_OHM,
    CircuitFit,
    Problem,
    Unknown,
    fit,
    with_numbers,
)
from lampest.recording.calibration.repeats import BELIEF, FEWEST_REPEATS, Trial
from lampest.recording.recording import Recording

DIGITS, MEMORY_DIGITS = 3, 5  # of an ohm, below what any contact repeats to; of a fraction: a hundredth of a code
SURE = 5.0  # σ by which one of 32 lines is off by chance once in 50,000 calibrations
# σ of a number that the readings tell: a part of itself, or of a channel less than channels differ by, or these.
ENOUGH = {MEMORY.name: 0.01} | {wire.name: 0.5 for wire in WIRE} | {"diode.drop_volt": 0.2}
LIKELY = {True: "channels of a CD74HC4067 have 40 to 160 ohm", False: "resistors of 5 % differ by less"}
SPOKEN = {MEMORY.name: "converter memory", "diode.drop_volt": "diode drop"} | dict(
    zip((wire.name for wire in WIRE), ("wire of rows", "wire of columns"), strict=True)
)


class LineOffsets(NamedTuple):
    """Lines of one side: by how much each differs from their mean, and σ of that, ohm; NaN where not measured."""

    side: Side
    off_ohm: Array
    sigma_ohm: Array


@dataclass(frozen=True, eq=False)
class Found:
    """A number of the electronics, in its unit.

    value, sigma : mean over the lines that were measured (of two channels' sum where a reading has two), and its
    standard deviation. lines : what single lines add to it; none where it is one for all.
    """

    number: LineNumber
    value: float
    sigma: float
    lines: tuple[LineOffsets, ...]

    @property
    def differ(self) -> bool:
        """Whether lines differ by more than chance, and more than a scene is written to."""
        least = 10.0**-DIGITS
        return any(bool(np.any(np.abs(lines.off_ohm) > SURE * lines.sigma_ohm + least)) for lines in self.lines)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What known resistors say of the electronics.

    scene : of the recordings. found : its resistances. noise_lsb : (driven lines) of one reading, as repeats show it;
    repeats : of each line. readings : how many took part. misfit : χ² per degree of freedom. tolerance : of resistors.
    """

    scene: Scene
    found: tuple[Found, ...]
    noise_lsb: Array
    repeats: Array
    readings: int
    misfit: float
    tolerance: float

    @property
    def noise(self) -> float | tuple[float, ...] | None:
        """LSB of one reading; of each driven line where they differ, the mean where repeats are few; None: all few."""
        enough = self.repeats >= FEWEST_REPEATS
        if not enough.any():
            return None
        variance = self.noise_lsb**2
        mean = float(np.average(variance[enough], weights=self.repeats[enough]))
        quantisation = 1 / 12  # LSB²: below it, lines that differ make no difference
        off = np.abs(np.log((variance[enough] + quantisation) / (mean + quantisation)))
        if np.all(off < SURE * np.sqrt(2 / self.repeats[enough])):
            return round(float(np.sqrt(mean)), DIGITS)
        return tuple(round(float(one) ** 0.5, DIGITS) for one in np.where(enough, variance, mean))


def calibrate(
    recordings: Sequence[Recording], known: Sequence[Array | float] = (0.0,), tolerance: float = 0.01
) -> Calibration:
    """The circuit's numbers that explain known resistors best, by weighted least squares through its equations.

    recordings : of one panel and readout; the frames of each are repeats. known : ohm, for each recording (rows,
    columns) or one number for all cells; 0 where row and column lines are shorted together; inf or NaN where there is
    no resistor. tolerance : by which fraction the known resistors and the reference may be off, evenly.

    Raises InputError where the scene's readout has no such numbers, the readings do not tell them, or are none of these
    resistors'.
    """
    scene, name = recordings[0].scene, recordings[0].name
    for other in recordings[1:]:
        if other.scene != scene:
            raise InputError(f"{other.name}: its scene is another than that of {name}")
    if not scene.circuit.line_numbers():
        raise InputError(f"{name}: known resistors tell nothing of this readout ({scene.circuit.description()})")
    trials = tuple(_trial(one, ohm) for one, ohm in zip(recordings, known, strict=True))
    fitted = fit(Problem(scene, trials, tolerance))
    _check_fit(fitted)
    found = tuple(_found(fitted, unknown) for unknown in fitted.problem.unknowns)
    counts = np.array([trial.seen for trial in trials])
    variance = np.average([trial.noise_lsb**2 for trial in trials], axis=0, weights=counts + 1e-9)
    misfit = fitted.chi_square / max(fitted.freedom, 1)
    return Calibration(scene, found, np.sqrt(variance), counts.sum(axis=0), fitted.readings, misfit, tolerance)


def _trial(recording: Recording, known: Array | float) -> Trial:
    ohm = np.broadcast_to(np.asarray(known, dtype=float), recording.scene.panel.shape)
    ohm = np.where(np.isinf(ohm), np.nan, ohm)
    if np.any(ohm < 0):
        raise InputError("known resistors must be zero or positive")
    if not np.isfinite(ohm).any():
        raise InputError(f"{recording.name}: no row line is joined to a column line by a known resistor")
    return Trial.of(recording, ohm)


def _found(fit: CircuitFit, one: Unknown) -> Found:
    """A number, with its covariance to first order in the unknowns. Raises InputError as `_check_number`."""
    spread, (common, own) = one.spread(fit.unknowns), one.common(fit.unknowns)
    value, slope, sides = common, np.zeros(len(fit.unknowns)), []
    slope[one.index] = own
    for side, part in one.lines.items():
        off, slopes = spread * fit.unknowns[part], spread * np.eye(len(fit.unknowns))[part]
        slopes[:, one.index] = 0.0 if one.number.channel else off * own / common
        measured = np.any([trial.led(side) for trial in fit.problem.trials], axis=0)
        mean, mean_slope = off[measured].mean(), slopes[measured].mean(axis=0)
        value, slope, centred = value + float(mean), slope + mean_slope, slopes - mean_slope
        sigma = np.sqrt(np.maximum(np.einsum("li,ij,lj->l", centred, fit.covariance, centred), 0.0))
        nothing = np.where(measured, 0.0, np.nan)
        sides.append(LineOffsets(side, off - mean + nothing, sigma + nothing))
    found = Found(one.number, value, float(np.sqrt(slope @ fit.covariance @ slope)), tuple(sides))
    _check_number(f"{fit.problem.trials[0].name}: no calibration: ", found, one.specified)
    return found


def _check_fit(fit: CircuitFit) -> None:
    """Raise InputError where the readings are not those of the known resistors behind any such circuit."""
    trials, readout = fit.problem.trials, fit.problem.readout

    def spoken(volt: float) -> str:
        return f"{float(readout.recorded_from_volt(np.array(volt))):.4g} {readout.unit}"

    for trial in trials:
        reads, elsewhere = trial.volt, ~trial.used & np.isfinite(trial.volt)
        missed = np.where(elsewhere, np.abs(reads - fit.problem.volt(fit.unknowns, trial.cells)), 0.0)
        if missed.max() > 0.1 * readout.full_scale_volt:  # hum, and a memory of 3 %, stay below
            row, column = (int(part) for part in np.unravel_index(missed.argmax(), missed.shape))
            raise InputError(
                f"{trial.name}: no calibration: row {row}, column {column} reads {spoken(reads[row, column])}, but no "
                f"known resistor leads there; was the panel unplugged?"
            )
    if fit.freedom < 0 or not fit.readings:
        many = "nothing was read across a known resistor" if not fit.readings else f"only {fit.readings} readings"
        raise InputError(f"{trials[0].name}: no calibration: {many}; join lines by more known resistors")
    # σ itself is known from as many repeats only: χ² over its freedom follows Fisher's distribution.
    freedom, repeated = max(fit.freedom, 1), sum(BELIEF + trial.seen.sum() for trial in trials)
    if fdtrc(freedom, repeated, fit.chi_square / freedom) < 1e-7:  # of good calibrations may be refused
        off = np.abs(fit.rest) / fit.sigma
        index = int(off.argmax())
        names = [trial.name for trial in trials for _ in range(trial.used.sum())]
        row, column = np.concatenate([np.argwhere(trial.used) for trial in trials])[index]
        measured = fit.problem.measured[index]
        raise InputError(
            f"{names[index]}: no calibration: row {row}, column {column} reads {spoken(measured)}, but behind the "
            f"circuit that fits best the known resistors give {spoken(measured - fit.rest[index])}; noise and "
            f"tolerances explain {100 * np.mean(off < 3):.0f} % of the readings"
        )


def _check_number(where: str, found: Found, specified: float) -> None:
    """Raise InputError where the readings do not tell a number, or it is none that such electronics have."""
    number, channels = found.number, len(found.lines)
    enough = ENOUGH.get(number.name, WORST_OHM - TYPICAL_OHM if number.channel else 0.0)
    if found.sigma > max(enough, 0.3 * found.value):
        raise InputError(
            f"{where}the readings do not tell {number.name} ({found.value:.4g} ± {found.sigma:.2g} {number.unit}); "
            f"known resistors of different values, on more lines, do"
        )
    # Equal cells look like a larger series resistance: channels have at most what the worst have, or as much above it.
    most = max(channels * WORST_OHM, specified + channels * (WORST_OHM - TYPICAL_OHM))
    if number.in_scene and number.channel and found.value - SURE * found.sigma > most:
        raise InputError(
            f"{where}a {number.name} of {found.value:.4g} ohm is more than the {most:g} ohm that {channels} "
            f"channels have at worst; were the known resistors in place of the panel, and are their values right?"
        )
    most = max(WORST_OHM - BEST_OHM if number.channel else 0.0, 4 * RESISTOR_TOLERANCE * found.value)
    for side, off, sigma in found.lines:
        high, low = int(np.nanargmax(off)), int(np.nanargmin(off))
        apart = float(off[high] - off[low])
        if apart - SURE * np.hypot(sigma[high], sigma[low]) > most:
            raise InputError(
                f"{where}{number.name} of {side} {high} and {low} would differ by {apart:.4g} ohm, and at most "
                f"{most:.4g} ohm is likely ({LIKELY[number.channel]})"
            )


def calibrated_scene(calibration: Calibration) -> Scene:
    """The scene with the numbers found, rounded to a milliohm; a list where lines differ."""
    scene = calibration.scene
    readout: Any = scene.readout

    def rounded(value: float) -> float:
        """Not below zero, where the noise of a small number can be."""
        return round(max(float(value), 0.0), DIGITS)

    for found in calibration.found:
        number, value = found.number, rounded(found.value)
        # Every line's share of the sum where readings have two; the mean where it was not measured.
        share = found.value / max(len(found.lines), 1)
        each = {side: tuple(map(rounded, share + np.nan_to_num(off))) for side, off, _ in found.lines}
        if number in TYPICAL:
            scene = with_numbers(scene, {number.name: round(found.value, MEMORY_DIGITS)})
        elif number.in_scene:
            scene = replace(scene, series_resistance_ohm=SeriesPerLine(**each) if found.differ else value)
        else:
            readout = with_numbers(readout, {number.name: next(iter(each.values())) if found.differ else value})
    if calibration.noise is not None:
        readout = replace(readout, noise_lsb=calibration.noise)
    return replace(scene, readout=readout)


def calibrated_scene_text(calibration: Calibration) -> str:
    """The calibrated scene as YAML, with the uncertainties and the lines as comments."""
    remarks = [remark for found in calibration.found for remark in _remarks(found, calibration.readings)]
    if calibration.noise is not None:
        remarks.append(f"noise_lsb: of one reading, from {calibration.repeats.sum():g} repeats")
    remarks.append(
        f"resistors taken as within {100 * calibration.tolerance:g} %; what is left over is {calibration.misfit:.2g} "
        f"times what noise and tolerances explain"
    )
    return "".join(f"# {remark}\n" for remark in remarks) + to_yaml(calibrated_scene(calibration))


def summary(calibration: Calibration) -> str:
    """'drive resistance 70.7 ± 0.3 ohm, load resistance 9987 ± 15 ohm from 64 readings'."""
    each = []
    for found in calibration.found:
        plain = f"{found.number.name.removesuffix('_ohm').removesuffix('_resistance')} resistance"
        name = SPOKEN.get(found.number.name, plain)
        each.append(f"{name} {found.value:.3f} ± {found.sigma:.3f} {found.number.unit}")
    return f"{', '.join(each)} from {calibration.readings} readings"


def _remarks(found: Found, readings: int) -> list[str]:
    digits, unit = (MEMORY_DIGITS, "") if found.number == MEMORY else (DIGITS, f" {found.number.unit}")
    value = f"{found.value:.{digits}f} +- {found.sigma:.{digits}f}{unit}"
    remarks = [f"{found.number.name}: {value} (one standard deviation), from {readings} readings"]
    for side, off, sigma in found.lines if found.differ else ():
        each = (
            "not measured" if np.isnan(ohm) else f"{ohm:+.2f} +- {sd:.2f}" for ohm, sd in zip(off, sigma, strict=True)
        )
        remarks.append(f"{side} differ from the mean by {', '.join(each)} ohm")
    if found.differ and len(found.lines) > 1:
        remarks.append("what rows and columns have in common is shared evenly, because only their sums are read")
    return remarks
