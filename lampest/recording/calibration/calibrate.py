"""Resistances of the electronics from known resistors, with their uncertainty, as the scene that they make."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.readouts.lines import LineNumber
from lampest.panel.scene import Scene, SeriesPerLine
from lampest.recording.calibration.circuit import MEMORY, TYPICAL, WIRE, Circuit, with_numbers
from lampest.recording.calibration.fit import (
    MOST_SIGMA_OF_LINES,
    Found,
    Problem,
    check_fit,
    check_number,
    fit,
    found_number,
)
from lampest.recording.calibration.repeats import FEWEST_REPEATS, Repeats, Trial, repeats
from lampest.recording.recording import Recording

TOLERANCE = 0.01  # of resistors as they are sold
LEAST_VARIANCE = 1 / 12  # LSB²: below quantisation's own, lines that differ make no difference
DIGITS = 3  # of an ohm and of a code: below what any contact or converter repeats to
SPOKEN = {MEMORY.name: "converter memory", "diode.drop_volt": "diode drop"}
MEMORY_DIGITS = 5  # of a fraction: a hundredth of a code


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
        """Of one reading, LSB: one number, or one for each driven line where they differ; None: too few repeats.

        The variance of n repeats is known to √(2/n) of itself. Lines with few repeats take the mean of the others.
        """
        enough = self.repeats >= FEWEST_REPEATS
        if not enough.any():
            return None
        variance = self.noise_lsb**2
        mean = float(np.average(variance[enough], weights=self.repeats[enough]))
        off = np.abs(np.log((variance[enough] + LEAST_VARIANCE) / (mean + LEAST_VARIANCE)))
        if np.all(off < MOST_SIGMA_OF_LINES * np.sqrt(2 / self.repeats[enough])):
            return round(float(np.sqrt(mean)), DIGITS)
        return tuple(round(float(one) ** 0.5, DIGITS) for one in np.where(enough, variance, mean))


def calibrate(
    recordings: Sequence[Recording], known: Sequence[Array | float] = (0.0,), tolerance: float = TOLERANCE
) -> Calibration:
    """The circuit's numbers that explain known resistors best, by weighted least squares through its equations.

    Parameters
    ----------
    recordings : of one panel and readout; the frames of each are repeats.
    known : ohm, for each recording (rows, columns) or one number for all cells; 0 where row and column lines are
        shorted together; inf or NaN where there is no resistor.
    tolerance : by which fraction the known resistors and the reference may be off, evenly.

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
    fitted = fit(Problem(Circuit.of(scene), trials, tolerance))
    check_fit(fitted)
    found = tuple(found_number(fitted, index) for index in range(len(fitted.problem.circuit.numbers)))
    for one in found:
        check_number(fitted, one)
    misfit = fitted.chi_square / max(fitted.freedom, 1)
    noise, seen = _noise([trial.readings for trial in trials])
    return Calibration(scene, found, noise, seen, fitted.readings, misfit, tolerance)


def _trial(recording: Recording, known: Array | float) -> Trial:
    ohm = np.broadcast_to(np.asarray(known, dtype=float), recording.scene.panel.shape)
    ohm = np.where(np.isinf(ohm), np.nan, ohm)
    if np.any(ohm < 0):
        raise InputError("known resistors must be zero or positive")
    if not np.isfinite(ohm).any():
        raise InputError(f"{recording.name}: no row line is joined to a column line by a known resistor")
    return Trial(recording.name, repeats(recording), ohm, recording.scene.converter_memory is not None)


def _noise(trials: list[Repeats]) -> tuple[Array, Array]:
    """Noise of one reading of every driven line over all recordings, by its variance, and the number of repeats."""
    seen = np.sum([trial.seen for trial in trials], axis=0)
    weights = np.array([trial.seen for trial in trials]) + 1e-9
    variance = np.average([trial.noise_lsb**2 for trial in trials], axis=0, weights=weights)
    return np.sqrt(variance), seen


SPOKEN |= dict(zip((wire.name for wire in WIRE), ("wire of rows", "wire of columns"), strict=True))


def calibrated_scene(calibration: Calibration) -> Scene:
    """The scene with the numbers found, rounded to a milliohm; a list where lines differ."""
    scene = calibration.scene
    readout: Any = scene.readout
    for found in calibration.found:
        each = {lines.side: tuple(map(rounded, found.on(lines))) for lines in found.lines}
        if found.number in TYPICAL:
            scene = with_numbers(scene, {found.number.name: round(found.value, MEMORY_DIGITS)})
        elif found.number.in_scene:
            series = SeriesPerLine(**each) if found.differ else rounded(found.value)
            scene = replace(scene, series_resistance_ohm=series)
        else:
            value = next(iter(each.values())) if found.differ else rounded(found.value)
            readout = with_numbers(readout, {found.number.name: value})
    if calibration.noise is not None:
        readout = replace(readout, noise_lsb=calibration.noise)
    return replace(scene, readout=readout)


def rounded(value: float) -> float:
    """To a thousandth, and not below zero, where the noise of a small number can be."""
    return round(max(float(value), 0.0), DIGITS)


def calibrated_scene_text(calibration: Calibration) -> str:
    """The calibrated scene as YAML, with the uncertainties and the lines as comments."""
    remarks = [remark for found in calibration.found for remark in _remarks(calibration, found)]
    if calibration.noise is not None:
        remarks.append(f"noise_lsb: of one reading, from {calibration.repeats.sum():g} repeats")
    remarks.append(
        f"resistors taken as within {100 * calibration.tolerance:g} %; what is left over is {calibration.misfit:.2g} "
        f"times what noise and tolerances explain"
    )
    return "".join(f"# {remark}\n" for remark in remarks) + to_yaml(calibrated_scene(calibration))


def summary(calibration: Calibration) -> str:
    """'drive resistance 70.7 ± 0.3 ohm, load resistance 9987 ± 15 ohm from 64 readings'."""
    each = (
        f"{spoken(found.number)} {found.value:.3f} ± {found.sigma:.3f} {found.number.unit}"
        for found in calibration.found
    )
    return f"{', '.join(each)} from {calibration.readings} readings"


def spoken(number: LineNumber) -> str:
    """'drive resistance', 'diode drop'."""
    if number.name in SPOKEN:
        return SPOKEN[number.name]
    return f"{number.name.removesuffix('_ohm').removesuffix('_resistance')} resistance"


def _certain(found: Found, sign: str) -> str:
    digits, unit = (MEMORY_DIGITS, "") if found.number == MEMORY else (DIGITS, f" {found.number.unit}")
    return f"{found.value:.{digits}f} {sign} {found.sigma:.{digits}f}{unit}"


def _remarks(calibration: Calibration, found: Found) -> list[str]:
    remarks = [
        f"{found.number.name}: {_certain(found, '+-')} (one standard deviation), from {calibration.readings} readings"
    ]
    if not found.differ:
        return remarks
    for lines in found.lines:
        each = ", ".join(
            "not measured" if np.isnan(ohm) else f"{ohm:+.2f} +- {sigma:.2f}"
            for ohm, sigma in zip(lines.off_ohm, lines.sigma_ohm, strict=True)
        )
        remarks.append(f"{lines.side} differ from the mean by {each} ohm")
    if len(found.lines) > 1:
        remarks.append("what rows and columns have in common is shared evenly, because only their sums are read")
    return remarks
