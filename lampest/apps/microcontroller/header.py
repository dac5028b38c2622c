"""The constants of an estimator as a C header."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from lampest.apps.microcontroller.constants import Constants
from lampest.apps.microcontroller.library import constants_fields, library_version
from lampest.panel.circuit import nominal_terminations
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene

NUMBERS_A_LINE = 8
# Smaller ones are zero: about the smallest that single precision has with all its digits.
MIN_NUMBER = 1e-37


def number(value: float) -> str:
    """Return a number as a C literal of single precision.

    Nine digits determine the number.
    """
    text = f"{value if abs(value) >= MIN_NUMBER else 0.0:.9g}"
    return (text if any(mark in text for mark in ".en") else text + ".0") + "f"


class CArray(NamedTuple):
    """Array of C.

    Attributes
    ----------
    kind : str
        Type of its entries.
    texts : tuple of str
        Its entries as literals.
    """

    kind: str
    texts: tuple[str, ...]

    @classmethod
    def of_floats(cls, values: Array) -> "CArray":
        """Return an array of floats."""
        return cls("float", tuple(number(float(value)) for value in np.ravel(values)))

    def declaration(self, name: str) -> str:
        """Return the declaration under a name."""
        count = len(self.texts)
        lines = [
            ", ".join(self.texts[at : at + NUMBERS_A_LINE])
            for at in range(0, count, NUMBERS_A_LINE)
        ]
        body = ",\n    ".join(lines)
        return f"static const {self.kind} {name}[{count}] = {{\n    {body}}};\n"


Entries = dict[str, str | CArray]  # field of lampest_constants → literal, or array


def header(constants: Constants, name: str, about: Iterable[str]) -> str:
    """Return the header that declares name_constants and three numbers.

    The numbers are NAME_ROWS, NAME_COLUMNS and NAME_MEMORY.

    Parameters
    ----------
    constants : Constants
    name : str
        An identifier of C.
    about : iterable of str
        Lines of the comment at the top.
    """
    rows, columns = constants.scene.panel.shape
    budget = constants.budget
    entries = (
        _panel(constants)
        | _circuit(constants)
        | _converter(constants)
        | _cost(constants)
        | {
            "steps": str(budget.steps),
            "products": str(budget.products),
            "within": number(budget.within),
        }
    )
    arrays = [
        entry.declaration(f"{name}_{field}")
        for field, entry in entries.items()
        if isinstance(entry, CArray)
    ]
    values = {
        field: f"{name}_{field}" if isinstance(entry, CArray) else entry
        for field, entry in entries.items()
    }
    # C++ demands designated initialisers in the order of their declaration; absent ones are 0.
    body = "\n".join(f"    .{field} = {values.get(field, '0')}," for field in constants_fields())
    guard = f"{name.upper()}_CONSTANTS_H"
    comment = "\n".join(f" * {line}".rstrip() for line in about)
    memory = (
        f"LAMPEST_MEMORY({rows}, {columns}, "
        f"{int(constants.lines is not None)}, {int(constants.relative)})"
    )
    return (
        f'/*\n{comment}\n */\n#ifndef {guard}\n#define {guard}\n\n#include "lampest_estimate.h"\n\n'
        f"#define {name.upper()}_ROWS {rows}\n#define {name.upper()}_COLUMNS {columns}\n"
        f"#define {name.upper()}_MEMORY {memory}\n\n"
        + "\n".join(arrays)
        + f"\nstatic const lampest_constants {name}_constants = {{\n{body}\n}};\n\n#endif\n"
    )


def _panel(constants: Constants) -> Entries:
    """Return the panel's size, its cells where some are missing, and the pairs of neighbours."""
    panel = constants.scene.panel
    rows, columns = panel.shape
    entries: Entries = {
        "version": str(library_version()),
        "rows": str(rows),
        "columns": str(columns),
    }
    if panel.cells is not None:
        entries["present"] = CArray(
            "uint8_t", tuple(str(int(cell)) for cell in panel.present.ravel())
        )
    if (pairs := constants.pairs) is not None:
        texts = tuple(f"{{{a}, {b}, {number(d)}}}" for a, b, d in zip(*pairs, strict=True))
        entries["pairs"] = CArray("lampest_pair", texts)
        entries["pair_count"] = str(len(pairs[0]))
    return entries


def _circuit(constants: Constants) -> Entries:
    """Return the circuit's numbers of a readout that drives its lines, or of two-point readings."""
    readout = constants.scene.circuit
    ends = nominal_terminations(readout)
    if constants.lines is not None:
        lines = {
            field: CArray.of_floats(getattr(constants.lines, field))
            for field in ("tie", "drive", "release", "load", "gain")
        }
        sides = {
            "rows_driven": _literal(ends.driven == "rows"),
            "mirrored": _literal(ends.sign < 0),
        }
        return {"driven": "true"} | sides | lines
    assert isinstance(readout, TwoPointReadout)
    return _two_point(constants.scene, readout)


def _two_point(scene: Scene, readout: TwoPointReadout) -> Entries:
    """Return the divider's numbers, and the series resistance of each line."""
    across = readout.measured_across == "reference"
    input_ohm = readout.input_ohm
    scale = 1 / (1 + readout.reference_ohm / input_ohm) if across and input_ohm else 1.0
    shunt = 1 / input_ohm if input_ohm and not across else 0.0
    entries: Entries = {
        "driven": "false",
        "reference_ohm": number(readout.reference_ohm),
        "across_reference": _literal(across),
        "ohm_scale": number(scale),
        "shunt_siemens": number(shunt),
    }
    if np.any(scene.series_ohm):
        series = np.broadcast_to(scene.series_ohm, scene.panel.shape)
        # Rows bear what they differ by, columns the rest: the sum is all that a reading shows.
        rows = series[:, 0] - series[:, 0].min()
        columns = series[0] - rows[0]
        entries["series"] = CArray.of_floats(np.concatenate([rows, columns]))
    return entries


def _converter(constants: Constants) -> Entries:
    """Return the range of valid sums, volts of a sum, and σ of each reading, or of all if alike."""
    readout = constants.scene.circuit
    low, high = constants.valid_sums
    # A mirrored voltage is taken from where loads end: the converter's input lowers this potential
    mirrored_at = readout.supply_volt
    ends = nominal_terminations(readout)
    if ends.sign < 0:
        mirrored_at = ends.recorded_reference
    alike = bool(np.all(constants.sigma_volt == constants.sigma_volt.flat[0]))
    return {
        "top_sum": f"{constants.top_sum}u",
        "low_sum": f"{low}u",
        "high_sum": f"{high}u",
        "volt_per_sum": number(readout.lsb_volt / readout.readings),
        "volt_at_zero": number(readout.zero_volt),
        "supply_volt": number(mirrored_at),
        "sigma_volt": CArray.of_floats(constants.sigma_volt.ravel()[: 1 if alike else None]),
        "sigma_count": str(1 if alike else constants.sigma_volt.size),
        "plain_sigma": number(constants.plain_sigma),
    }


def _cost(constants: Constants) -> Entries:
    """Return the loss of the misfit, the penalties, the bounds of cells, and the baseline."""
    entries: Entries = {
        "data_loss": constants.data_loss,
        "data_corner": number(constants.data_corner),
    }
    if constants.penalties:
        terms = tuple(
            f"{{{p.quantity}, {p.difference}, {p.loss}, {number(p.corner)}, {number(p.weight)}}}"
            for p in constants.penalties
        )
        entries["terms"] = CArray("lampest_term", terms)
        entries["term_count"] = str(len(constants.penalties))
    return entries | {
        "least_ohm": number(constants.least_ohm),
        "largest_ohm": number(constants.largest_ohm),
        "native_bounds": _literal(constants.native_bounds),
        "baseline": CArray.of_floats(constants.baseline),
        "loaded_limit": number(constants.loaded_limit),
        "follow": number(constants.follow),
    }


def _literal(value: object) -> str:
    """Return a truth value as a literal of C."""
    return str(value).lower()
