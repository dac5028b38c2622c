"""The constants of an estimator as a C header."""

from collections.abc import Callable, Iterable

import numpy as np

from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.driven import DrivenCircuit
from lampest.report.export.microcontroller.constants import Constants

NUMBERS_A_LINE = 8
MIN_NUMBER = 1e-37  # smaller ones are zero: about the smallest that single precision has with all its digits


def number(value: float) -> str:
    """Return a number as a C literal of single precision, with the nine digits that determine it."""
    text = f"{value if abs(value) >= MIN_NUMBER else 0.0:.9g}"
    return (text if any(mark in text for mark in ".en") else text + ".0") + "f"


def header(constants: Constants, name: str, about: Iterable[str]) -> str:
    """Return the header that declares name_constants, and the numbers NAME_ROWS, NAME_COLUMNS and NAME_MEMORY.

    Parameters
    ----------
    constants : Constants
    name : str
        An identifier of C.
    about : iterable of str
        Lines of the comment at the top.
    """
    panel = constants.scene.panel
    budget = constants.budget
    rows, columns = panel.shape
    arrays: list[str] = []
    fields: list[tuple[str, str]] = [("rows", str(rows)), ("columns", str(columns))]

    def array(field: str, kind: str, values: Iterable[str]) -> None:
        """Declare an array, and name it in the struct."""
        texts = list(values)
        lines = [", ".join(texts[at : at + NUMBERS_A_LINE]) for at in range(0, len(texts), NUMBERS_A_LINE)]
        body = ",\n    ".join(lines)
        arrays.append(f"static const {kind} {name}_{field}[{len(texts)}] = {{\n    {body}}};\n")
        fields.append((field, f"{name}_{field}"))

    def floats(field: str, values: Array) -> None:
        """Declare an array of floats."""
        array(field, "float", (number(float(value)) for value in np.ravel(values)))

    if panel.cells is not None:
        array("present", "uint8_t", (str(int(cell)) for cell in panel.present.ravel()))
    if (pairs := constants.pairs) is not None:
        texts = (f"{{{a}, {b}, {number(d)}}}" for a, b, d in zip(*pairs, strict=True))
        array("pairs", "lampest_pair", texts)
        fields.append(("pair_count", str(len(pairs[0]))))
    _circuit(constants, fields, floats)
    low, high = constants.valid_sums
    readout = constants.scene.circuit
    per_sum = readout.lsb_volt / readout.readings
    fields += [("top_sum", str(constants.top_sum)), ("low_sum", str(low)), ("high_sum", str(high))]
    fields += [("volt_per_sum", number(per_sum)), ("volt_at_zero", number(0.5 * readout.lsb_volt))]
    fields += [("supply_volt", number(readout.supply_volt))]
    alike = bool(np.all(constants.sigma_volt == constants.sigma_volt.flat[0]))
    floats("sigma_volt", constants.sigma_volt.ravel()[: 1 if alike else None])
    fields += [("sigma_count", str(1 if alike else constants.sigma_volt.size))]
    fields += [("plain_sigma", number(constants.plain_sigma))]
    fields += [("data_loss", constants.data_loss), ("data_corner", number(constants.data_corner))]
    if constants.penalties:
        terms = (
            f"{{{p.quantity}, {p.difference}, {p.loss}, {number(p.corner)}, {number(p.weight)}}}"
            for p in constants.penalties
        )
        array("terms", "lampest_term", terms)
        fields.append(("term_count", str(len(constants.penalties))))
    fields += [("least_ohm", number(constants.least_ohm)), ("largest_ohm", number(constants.largest_ohm))]
    fields += [("native_bounds", str(constants.native_bounds).lower())]
    floats("baseline", constants.baseline)
    fields += [("loaded_limit", number(constants.loaded_limit))]
    fields += [("steps", str(budget.steps)), ("products", str(budget.products)), ("within", number(budget.within))]
    guard = f"{name.upper()}_CONSTANTS_H"
    comment = "\n".join(f" * {line}".rstrip() for line in about)
    memory = f"LAMPEST_MEMORY({rows}, {columns}, {int(constants.lines is not None)}, {int(constants.relative)})"
    body = "\n".join(f"    .{field} = {value}," for field, value in _in_order(fields))
    return (
        f'/*\n{comment}\n */\n#ifndef {guard}\n#define {guard}\n\n#include "lampest_estimate.h"\n\n'
        f"#define {name.upper()}_ROWS {rows}\n#define {name.upper()}_COLUMNS {columns}\n"
        f"#define {name.upper()}_MEMORY {memory}\n\n"
        + "\n".join(arrays)
        + f"\nstatic const lampest_constants {name}_constants = {{\n{body}\n}};\n\n#endif\n"
    )


# The fields of lampest_constants in the order of their declaration, which C++ demands of designated initialisers.
ORDER = (
    "rows",
    "columns",
    "present",
    "pairs",
    "pair_count",
    "driven",
    "rows_driven",
    "tie",
    "drive",
    "release",
    "load",
    "gain",
    "top_sum",
    "low_sum",
    "high_sum",
    "volt_per_sum",
    "volt_at_zero",
    "supply_volt",
    "mirrored",
    "reference_ohm",
    "across_reference",
    "ohm_scale",
    "shunt_siemens",
    "series",
    "sigma_volt",
    "sigma_count",
    "plain_sigma",
    "data_loss",
    "data_corner",
    "terms",
    "term_count",
    "least_ohm",
    "largest_ohm",
    "native_bounds",
    "baseline",
    "loaded_limit",
    "steps",
    "products",
    "within",
)


def _in_order(fields: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return all fields in the order of their declaration, as compilers of C++ want them; 0 where there is none."""
    known = dict(fields)
    return [(field, known.get(field, "0")) for field in ORDER]


def _circuit(constants: Constants, fields: list[tuple[str, str]], floats: Callable[[str, Array], None]) -> None:
    """Add the circuit's numbers to the fields."""
    scene = constants.scene
    lines = constants.lines
    readout = constants.scene.circuit
    if lines is not None and isinstance(readout, DrivenCircuit):
        fields += [("driven", "true"), ("rows_driven", str(readout.driven == "rows").lower())]
        fields += [("mirrored", str(readout.mirrored).lower())]
        for field in ("tie", "drive", "release", "load", "gain"):
            floats(field, getattr(lines, field))
        return
    assert isinstance(readout, TwoPointReadout)
    across = readout.measured_across == "reference"
    input_ohm = readout.input_ohm
    scale = 1 / (1 + readout.reference_ohm / input_ohm) if across and input_ohm else 1.0
    shunt = 1 / input_ohm if input_ohm and not across else 0.0
    fields += [("driven", "false"), ("reference_ohm", number(readout.reference_ohm))]
    fields += [("across_reference", str(across).lower()), ("ohm_scale", number(scale))]
    fields += [("shunt_siemens", number(shunt))]
    if np.any(scene.series_ohm):
        series = np.broadcast_to(scene.series_ohm, scene.panel.shape)
        # Rows bear what they differ by, columns the rest: the sum is all that a reading shows.
        rows = series[:, 0] - series[:, 0].min()
        columns = series[0] - rows[0]
        floats("series", np.concatenate([rows, columns]))
