"""The constants of an estimator as a C header."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from lampest.apps.microcontroller.constants import Constants
from lampest.apps.microcontroller.library import constants_fields, library_version
from lampest.panel.circuit import nominal_terminations
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout

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

    def declaration(self, name: str) -> str:
        """Return the declaration under a name."""
        count = len(self.texts)
        starts = range(0, count, NUMBERS_A_LINE)
        body = ",\n    ".join(", ".join(self.texts[at : at + NUMBERS_A_LINE]) for at in starts)
        return f"static const {self.kind} {name}[{count}] = {{\n    {body}}};\n"


def floats(values: Array) -> CArray:
    """Return an array of floats."""
    return CArray("float", tuple(map(number, np.ravel(values).tolist())))


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
    entries = _panel(constants) | _circuit(constants) | _converter(constants) | _cost(constants)
    arrays = []
    values = dict[str, str]()
    for field, entry in entries.items():
        if isinstance(entry, CArray):
            values[field] = f"{name}_{field}"
            arrays.append(entry.declaration(values[field]))
        else:
            values[field] = entry
    # C++ demands designated initialisers in the order of their declaration; absent ones are 0.
    body = "\n".join(f"    .{field} = {values.get(field, '0')}," for field in constants_fields())
    guard = f"{name.upper()}_CONSTANTS_H"
    comment = "\n".join(f" * {line}".rstrip() for line in about)
    options = f"{constants.lines is not None:d}, {constants.relative:d}"
    memory = f"LAMPEST_MEMORY({rows}, {columns}, {options})"
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
        "version": f"{library_version()}",
        "rows": f"{rows}",
        "columns": f"{columns}",
    }
    if panel.cells is not None:
        cells = panel.present.ravel().astype(int)
        entries["present"] = CArray("uint8_t", tuple(map(str, cells)))
    if (pairs := constants.pairs) is not None:
        texts = tuple(f"{{{a}, {b}, {number(d)}}}" for a, b, d in zip(*pairs, strict=True))
        entries["pairs"] = CArray("lampest_pair", texts)
        entries["pair_count"] = f"{len(texts)}"
    return entries


def _circuit(constants: Constants) -> Entries:
    """Return the circuit's numbers of a readout that drives its lines, or of two-point readings."""
    readout = constants.scene.circuit
    ends = nominal_terminations(readout)
    if constants.lines is not None:
        lines = {
            field: floats(getattr(constants.lines, field))
            for field in ("tie", "drive", "release", "load", "gain")
        }
        return lines | {
            "driven": "true",
            "rows_driven": _literal(ends.driven == "rows"),
            "mirrored": _literal(ends.sign < 0),
        }
    assert isinstance(readout, TwoPointReadout)
    # The divider's numbers, and the series resistance of each line.
    scene = constants.scene
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
        entries["series"] = floats(np.concatenate([rows, columns]))
    return entries


def _converter(constants: Constants) -> Entries:
    """Return the range of valid sums, volts of a sum, and σ of each reading, or of all if alike."""
    readout = constants.scene.circuit
    low, high = constants.valid_sums
    # A mirrored voltage is taken from where loads end: the converter's input lowers this potential
    ends = nominal_terminations(readout)
    mirrored_at = ends.recorded_reference if ends.sign < 0 else readout.supply_volt
    alike = bool(np.all(constants.sigma_volt == constants.sigma_volt.flat[0]))
    return {
        "top_sum": f"{constants.top_sum}u",
        "low_sum": f"{low}u",
        "high_sum": f"{high}u",
        "volt_per_sum": number(readout.lsb_volt / readout.readings),
        "volt_at_zero": number(readout.zero_volt),
        "supply_volt": number(mirrored_at),
        "sigma_volt": floats(constants.sigma_volt.ravel()[: 1 if alike else None]),
        "sigma_count": f"{1 if alike else constants.sigma_volt.size}",
        "plain_sigma": number(constants.plain_sigma),
    }


def _cost(constants: Constants) -> Entries:
    """Return losses, penalties, the bounds of cells, the baseline, and the budget."""
    entries: Entries = {}
    if constants.penalties:
        terms = tuple(
            f"{{{p.quantity}, {p.difference}, {p.loss}, {number(p.corner)}, {number(p.weight)}}}"
            for p in constants.penalties
        )
        entries["terms"] = CArray("lampest_term", terms)
        entries["term_count"] = f"{len(terms)}"
    budget = constants.budget
    return entries | {
        "data_loss": constants.data_loss,
        "data_corner": number(constants.data_corner),
        "least_ohm": number(constants.least_ohm),
        "largest_ohm": number(constants.largest_ohm),
        "native_bounds": _literal(constants.native_bounds),
        "baseline": floats(constants.baseline),
        "loaded_limit": number(constants.loaded_limit),
        "follow": number(constants.follow),
        "steps": f"{budget.steps}",
        "products": f"{budget.products}",
        "within": number(budget.within),
    }


def _literal(value: object) -> str:
    """Return a truth value as a literal of C."""
    return str(value).lower()
