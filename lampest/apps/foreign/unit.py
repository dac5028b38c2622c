"""Unit of foreign numbers.

The unit is specified, named in the header, or the only one that values and scene permit.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np

from lampest.apps.foreign.words import units_of
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene
from lampest.recording.unit import FACTORS, RESISTANCES, check_unit

# Least share of the converter's range that readings use; less indicates another unit.
MIN_USED = 0.01
# Share of zeros among resistances without a unit; more are pressures, or codes of open cells.
MAX_SHORTED = 0.05
MAX_CODE = 65535  # of a 16-bit converter; larger whole numbers are resistances


def understood_unit(
    values: Array, unit: str | None, words: Sequence[str], scene: Scene | None, source: object
) -> tuple[str, str]:
    """Return the unit of values (any shape, NaN if missing) and the reason for it.

    `unit` is the specified one, if any; `words` are names in the file that may contain it. Raises
    InputError with the file if no unit fits, or several, or if the words name one that is not
    imported.

    Returns
    -------
    unit : str
    reason : str
        Sentence for the user.
    """
    if unit is not None:
        return unit, f"unit {unit}, as specified"
    try:
        named = units_of(words)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    readout = None if scene is None else scene.readout
    possible: Sequence[str] = RESISTANCES
    if readout is not None:
        possible = tuple(FACTORS) if readout.unit == "ohm" else ("volt", "mV", "code")
    allowed = [unit for unit in possible if not named or unit in named]
    if len(named) == 1 or not allowed:
        check_unit(named[0], scene, source)
        return named[0], f"unit {named[0]}, as the header says"
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return allowed[0], f"unit {allowed[0]}, assumed: no reading says otherwise"
    span = f"values from {finite.min():.6g} to {finite.max():.6g}"
    if readout is None:
        fitting, reason = _without_readout(finite, allowed if named else [*allowed, "code"])
    else:
        fitting, reason = _explaining(finite, allowed, readout)
    if not fitting:
        scene_text = ""
        if readout is not None:
            scene_text = f" in this scene, whose converter ends at {readout.full_scale_volt:g} V"
        none = f"{span} fit none of {', '.join(allowed)}{scene_text}{reason}"
        raise InputError(f"{source}: {none}; `unit` says what they are")
    if len(fitting) > 1:
        ways = " or ".join(f"`unit={unit!r}`" for unit in fitting)
        raise InputError(
            f"{source}: {span} may be {' or '.join(fitting)}{reason}; say which with {ways}"
        )
    how = "assumed" if fitting[0] == "ohm" and readout is None else "guessed"
    return fitting[0], f"unit {fitting[0]}, {how}: {span} ({reason})"


def _explaining(finite: Array, allowed: Sequence[str], readout: Readout) -> tuple[list[str], str]:
    """Return the allowed units that explain the values, and the reason.

    The reason explains a single unit; for several units it is a remark.
    """
    lowest, top = readout.codes
    supply = readout.full_scale_volt
    middle = float(np.median(finite))
    largest = float(finite.max())
    whole = bool(np.all(finite == np.round(finite)))
    in_steps = {unit: _on_steps(finite, unit, readout) for unit in allowed}
    # Codes are whole, or means of as many as a reading has; others are filtered, and compete with
    # every other unit.
    counted = whole or in_steps.get("code") is True or _are_means(finite, readout.readings)
    fits = {
        "code": lowest <= finite.min()
        and largest <= top
        and (counted or largest > max(supply, MIN_USED * top)),
        "volt": largest <= supply and not whole,
        "mV": 1000 * supply * MIN_USED < largest <= 1000 * supply,
    }
    for unit in RESISTANCES:
        share = float(readout.volt_from_recorded(np.array(middle * FACTORS[unit]))) / supply
        fits[unit] = MIN_USED <= share <= 1 - MIN_USED
    units = [unit for unit in allowed if fits[unit]]
    certain = [unit for unit in units if in_steps[unit] is True]
    if len(units) > 1 and len(certain) == 1:
        return certain, "as such they lie on the converter's steps"
    if len(units) > 1 and whole and "code" in units and not set(RESISTANCES) & set(units):
        reason = f"whole numbers, within {lowest} to {top} of a {readout.adc_bits}-bit converter"
        if "mV" in units and in_steps["mV"] is None:
            reason += "; whole mV would look alike"
        if middle == 0:
            reason += "; most are 0, as of open cells or in pressures, which are no readings"
        return ["code"], reason
    if len(units) > 1:
        if counted or "code" not in units:
            return units, ""
        expected = "whole numbers"
        if readout.readings > 1:
            expected = f"means of {readout.readings} whole numbers"
        return units, f" (codes would be {expected}, by the scene)"
    if units:
        reasons = {
            "code": f"within {lowest} to {top} of a {readout.adc_bits}-bit converter",
            "volt": f"within the converter's range of {supply:g} V",
            "mV": f"within the converter's range of {1000 * supply:g} mV",
        }
        return units, reasons.get(units[0], "the divider can tell such resistances")
    least, most = readout.rails()
    if "ohm" in allowed and least <= middle <= most:
        return ["ohm"], "no other unit is within the converter's rails"
    return [], ""


def _without_readout(finite: Array, allowed: Sequence[str]) -> tuple[list[str], str]:
    """Return which resistances' units explain values that no readout describes, and the reason."""
    middle = float(np.median(finite))
    zeros = float(np.mean(finite == 0))
    if zeros > MAX_SHORTED:
        share = f"{100 * zeros:.0f} % of them are 0"
        return [], f": {share}, as in pressures or codes; a resistance of 0 is a short circuit"
    whole = bool(np.all(finite == np.round(finite))) and finite.max() <= MAX_CODE
    fits = {"ohm": middle >= 1, "kohm": middle < 100, "code": whole}
    units = [unit for unit in allowed if fits[unit]]
    if len(units) > 1:
        codes = ", the whole numbers of a converter, which need a scene"
        return units, codes if "code" in units else ""
    least = "too small for ohm" if units == ["kohm"] else "too large for kohm"
    return units, f"their median, {middle:.3g}, is {least}; no readout describes them"


def _are_means(finite: Array, readings: int) -> bool:
    """Return whether values are means of whole numbers, rounded or cut to their written digits."""
    sums = finite * readings
    slack = 2 * _rounding(finite) * readings
    distance = np.abs(sums - np.round(sums))
    return 2 * slack < 1 and bool(np.all(distance <= slack + 1e-9 * np.maximum(1.0, np.abs(sums))))


def _on_steps(finite: Array, unit: str, readout: Readout) -> bool | None:
    """Return whether values in this unit would be means of the converter's codes.

    The result is None if undecidable.
    """
    values = np.unique(finite)
    digit = _rounding(values)
    # Written numbers are rounded to the nearest digit, or cut to the next lower one.
    nearest = _in_volt(values, digit, unit, readout)
    cut = _in_volt(values + digit, digit, unit, readout)
    half = nearest[1]
    # A value is on a step by chance with a probability of ½ at most: of twelve, in eight tries,
    # once in 500 times.
    if len(values) < 12 or np.median(half) * 4 > readout.lsb_volt / readout.readings:
        return None
    least, most = readout.range_volt
    # Many programs take the latter.
    for steps in (2.0**readout.adc_bits, 2.0**readout.adc_bits - 1):
        scale = steps / (most - least) * readout.readings
        for offset, (volt, slack) in product((0.0, 0.5), (nearest, cut)):
            sums = (volt - least) * scale - offset * readout.readings
            if np.all(
                np.abs(sums - np.round(sums)) <= slack * scale + 1e-6 * np.maximum(1, np.abs(sums))
            ):
                return True
    return False


def _in_volt(values: Array, slack: float, unit: str, readout: Readout) -> tuple[Array, Array]:
    """Return values in this unit as volt at the converter, and half their range.

    The range is the one that values ± slack have there.
    """
    ends = [(values + sign * slack) * FACTORS[unit] for sign in (-1, 0, 1)]
    if unit in RESISTANCES:
        ends = [readout.volt_from_recorded(np.maximum(end, 0)) for end in ends]
    elif unit == "code":
        ends = [readout.volt_from_code(end) for end in ends]
    low, volt, high = ends
    return volt, np.abs(high - low) / 2


def _rounding(values: Array) -> float:
    """Return half a unit of the last decimal digit with which values are written."""
    slack = 1e-12 * np.maximum(1.0, np.abs(values))
    digits = (
        digit for digit in range(9) if np.all(np.abs(values - np.round(values, digit)) <= slack)
    )
    return 0.5 * 10.0 ** -next(digits, 9)
