"""A calibration as the scene it makes, with uncertainties as comments, and in one line for people."""

from dataclasses import replace
from typing import Any

import numpy as np

from lampest.files.document import to_yaml
from lampest.panel.readouts.lines import LineNumber
from lampest.panel.scene import Scene, SeriesPerLine
from lampest.recording.calibration.calibrate import Calibration
from lampest.recording.calibration.circuit import MEMORY, TYPICAL, WIRE, with_numbers
from lampest.recording.calibration.found import Found

SPOKEN = {MEMORY.name: "converter memory", "diode.drop_volt": "diode drop"}
SPOKEN |= dict(zip((wire.name for wire in WIRE), ("wire of rows", "wire of columns"), strict=True))
MEMORY_DIGITS = 5  # of a fraction: a hundredth of a code
DIGITS = 3  # of an ohm: below what any contact repeats to


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
