"""Values in a named unit as the quantity that a readout records."""

from collections.abc import Callable

import numpy as np

from lampest.files.errors import InputError, meant
from lampest.panel.panel import Array, Mask
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings, Sidedness

FACTORS = {"ohm": 1.0, "kohm": 1e3, "volt": 1.0, "mV": 1e-3, "code": 1.0}
Place = Callable[[int, int, int], str]  # frame, row and column of a value → its place in the source
RESISTANCES = ("ohm", "kohm")
# Words for units, and for quantities that permit two of them.
UNITS_OF_WORD = {
    word: unit
    for unit, words in {
        "ohm": "ohm ohms ω",
        "kohm": "kohm kohms kω kiloohm kiloohms k",
        "volt": "volt volts",
        "mV": "mv millivolt millivolts",
        "code": "code codes adc count counts raw lsb digits digit dn",
        "resistance": "resistance resistances widerstand r",
        "voltage": "voltage voltages spannung",
    }.items()
    for word in words.split()
}


def check_unit(unit: str | None, scene: Scene | None, source: object) -> None:
    """Raise InputError if a unit is unknown, or the scene cannot convert it to recorded values."""
    if unit is not None and unit not in FACTORS:
        word = "volt" if unit.lower() == "v" else UNITS_OF_WORD.get(unit.lower(), "")
        write = f"; write {word}" if word in FACTORS else meant(unit, FACTORS)
        raise InputError(f"the unit '{unit}' is unknown; there are {', '.join(FACTORS)}{write}")
    if unit is not None and unit not in RESISTANCES and (scene is None or scene.readout is None):
        raise InputError(
            f"{source}: {unit} values need a scene with a readout, which says how they become ohm"
        )
    if unit in RESISTANCES and scene is not None and scene.circuit.unit != "ohm":
        raise InputError(
            f"{source}: the scene's readout gives {scene.circuit.unit}; say unit volt, mV or code"
        )


def recorded_values(
    values: Array, unit: str, scene: Scene, place: Place | None, source: object
) -> Array:
    """Return values converted from their unit to the readout's recorded quantity.

    Values have the shape (frames, rows, columns). NaN is kept. Codes and voltages at a rail,
    infinite resistances and those of zero remain bounds. Raises InputError with the place (frame,
    row, column) of an impossible value, or with the source if most readings are at the rail of a
    shorted cell: unit or range are probably wrong. Without places impossible values are NaN.
    """
    scaled = values * FACTORS[unit]
    readout = scene.readout

    def refuse(bad: Mask, why: str) -> None:
        if place is None:
            finite[bad] = np.nan
            scaled[bad] = np.nan
            return
        for frame, row, column in np.argwhere(bad).tolist():
            raise InputError(f"{place(frame, row, column)}: {values[frame, row, column]:.6g} {why}")

    finite = np.where(np.isinf(values), np.nan, values)
    if unit in RESISTANCES or readout is None:
        refuse(values < 0, "must be a positive resistance in ohm")
        recorded = scaled
    elif unit == "code":
        no_code = f"is no code of a {readout.adc_bits}-bit converter"
        refuse(finite > readout.codes[1], no_code)
        if not readout.characteristic.signed:
            no_code += "; of a signed one, say converter: {signed: true}"
        refuse(finite < readout.codes[0], no_code)
        floor = readout.codes[0] - 1 if readout.floor_code is None else readout.floor_code
        floored = finite <= floor
        recorded = readout.recorded_from_volt(
            np.where(floored, readout.zero_volt, readout.volt_from_code(finite))
        )
    else:
        least = min(0.0, readout.range_volt[0])
        most = max(readout.full_scale_volt, readout.range_volt[1])
        outside = np.isfinite(values) & ((scaled < least) | (scaled > most))
        ends = f"{least / FACTORS[unit]:g} to {most / FACTORS[unit]:g}"
        name = "V" if unit == "volt" else unit
        refuse(outside, f"lies outside {ends} {name}, the range of the readout's converter")
        recorded = readout.recorded_from_volt(np.where(np.isnan(finite), np.nan, scaled))
    if readout is not None and place is not None:
        _check_shorted(scene, readout, recorded, unit, source)
    return recorded


def _check_shorted(
    scene: Scene, readout: Readout, recorded: Array, unit: str, source: object
) -> None:
    """Raise InputError if most readings are at the rail that a shorted cell reaches."""
    rail = Sidedness.AT_MOST if readout.unit == "ohm" else Sidedness.AT_LEAST
    count = int((Readings.of(scene, recorded).side == rail).sum())
    total = int(np.isfinite(recorded).sum())
    if 2 * count <= total:
        return
    key = "converter_volt" if hasattr(readout, "converter_volt") else "supply_volt"
    if readout.range_volt[1] != readout.full_scale_volt:
        key = "converter"
    wrong = (
        f"{count} of {total} readings "
        "stand at the rail of the converter that a shorted cell reaches"
    )
    scale = f"readout.{key}, {readout.range_volt[1]:g} V, the end of its range"
    raise InputError(f"{source}: {wrong}: are they in {unit}, and is {scale}?")
