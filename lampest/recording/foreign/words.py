"""What words in a foreign file mean: roles of columns, cells, lines, units, and numbers however they are written."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array

ROLES = {
    "row": "row rows zeile reihe y i",
    "column": "column columns col cols spalte x j",
    "cell": "cell taxel pixel index sensor",
    "value": "value values reading resistance ohm kohm volt voltage code adc raw counts mv r v "
    "wert widerstand spannung",
    "frame": "frame frames scan step sample frame_id frame_nr frame_no scan_nr nr messung bild",
    "date": "date datum day tag",
    "time": "time times t timestamp timestamps time_stamp "
    "datetime date_time zeit uhrzeit zeitstempel elapsed clock millis micros ms us "
    "µs s sec second seconds unix epoch device_ms",
}
WORD_ROLE = {word: role for role, words in ROLES.items() for word in words.split()}
# Units by the words for them; a quantity's name leaves two.
UNIT_WORDS = {
    ("ohm",): "ohm ohms ω",
    ("kohm",): "kohm kohms kω kiloohm kiloohms k",
    ("volt",): "volt volts",
    ("mV",): "mv millivolt millivolts",
    ("code",): "code codes adc count counts raw lsb digits digit dn",
    ("ohm", "kohm"): "resistance resistances widerstand r",
    ("volt", "mV"): "voltage voltages spannung",
}
UNITS_OF_WORD = {word: units for units, words in UNIT_WORDS.items() for word in words.split()}
BRACKETED = re.compile(r"[\[(<{]\s*([^\[\](){}<>]*?)\s*[\])>}]\s*$")
ROW = r"(?:r|rows?|zeile|z|y)"
COLUMN = r"(?:c|cols?|columns?|spalte|s|x)"
GAP = r"[\s_\-.,;:/|=\[\]()]*"
BETWEEN = r"[\s_\-.,;:/|x\[\]()]+"
ROW_FIRST = re.compile(rf"(?:[a-z]+{GAP})??{ROW}{GAP}(\d+){GAP}{COLUMN}{GAP}(\d+){GAP}")
COLUMN_FIRST = re.compile(rf"(?:[a-z]+{GAP})??{COLUMN}{GAP}(\d+){GAP}{ROW}{GAP}(\d+){GAP}")
TWO_NUMBERS = re.compile(rf"(?:[a-z]+{GAP}|{GAP})(\d+){BETWEEN}(\d+){GAP}")
ONE_NUMBER = re.compile(rf"([^\W\d]*){GAP}(\d+){GAP}")

LONGEST = 100  # signs of a name or a number that are looked at: patterns would take long over more
# What programs write where they have no number: NumPy, R, MATLAB, JSON, Arduino's Print (ovf), multimeters (OL),
# Microsoft's C library (1.#QNAN) and Excel (#DIV/0!).
MISSING = (
    "nan -nan +nan na n/a null none nil ovf -ovf ol o.l o.l. overload overflow over err error missing ? ?? . "
    "-inf -infinity nan(ind) -nan(ind) 1.#ind -1.#ind 1.#qnan #n/a #na #div/0! #num! #value! #ref!"
)
MISSING_WORDS = frozenset(MISSING.split())
INFINITE_WORDS = frozenset(("inf", "+inf", "infinity", "+infinity", "∞", "1.#inf"))
POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+|\d{1,3}(,\d{3})+(\.\d*)?)([eE][+-]?\d+)?", re.ASCII)
COMMA = re.compile(r"[+-]?(\d+(,\d+)?|,\d+|\d{1,3}(\.\d{3})+(,\d+)?)([eE][+-]?\d+)?", re.ASCII)


class CellName(NamedTuple):
    """Row and column that a name holds, as they are written."""

    row: int
    column: int


def role_of(name: str) -> str | None:
    """'row', 'column', 'cell', 'value', 'frame', 'date' or 'time'; None for any other name. Units are left aside."""
    plain = _plain(name)
    if plain in WORD_ROLE:
        return WORD_ROLE[plain]
    first, last = plain.split("_")[0], plain.split("_")[-1]
    if WORD_ROLE.get(first) == "time" and plain.count("_") == 1:
        return "time"
    return WORD_ROLE.get(first) if last in UNITS_OF_WORD or first in ("resistance", "voltage", "ohm") else None


def cell_of(name: str) -> CellName | None:
    """The cell in r0c0, R1C1, 'row 0 col 3', c3_r0, Z1S1, cell_0_3, (0, 3), [0][3]; None in any other name."""
    text = _without_unit(name[:LONGEST]).strip().lower()
    for pattern in (ROW_FIRST, COLUMN_FIRST, TWO_NUMBERS):
        match = pattern.fullmatch(text)
        if match and len(match[1]) + len(match[2]) < 12:
            first, second = int(match[1]), int(match[2])
            return CellName(second, first) if pattern is COLUMN_FIRST else CellName(first, second)
    return None


def line_of(name: str) -> tuple[str, int] | None:
    """Word and number of R3, 'row 3', 3, col_3: ('r', 3); None in any other name."""
    match = ONE_NUMBER.fullmatch(_without_unit(name[:LONGEST]).strip().lower())
    return (match[1], int(match[2])) if match and len(match[2]) < 10 else None


def side_of(word: str) -> str | None:
    """'row' or 'column' for the word before a line's number, None where it does not say."""
    if re.fullmatch(ROW, word):
        return "row"
    return "column" if re.fullmatch(COLUMN, word) else None


def bracketed(name: str) -> str:
    """What stands in brackets at the end of a name, or after its last slash or ' in ': a unit."""
    match = BRACKETED.search(name)
    if match and not match[1].isdigit():
        return match[1]
    for mark in (" in ", "/"):
        _, found, last = name.rpartition(mark)
        if found:
            return "" if mark == "/" and last.strip().isdigit() else last.strip()
    return ""


def units_of(words: Sequence[str]) -> tuple[str, ...]:
    """Units that the names of columns or arrays leave; none where they say nothing.

    Raises InputError where they name a unit that is not imported, or contradict each other.
    """
    said: tuple[str, ...] = ()
    for units in filter(None, map(_units_of_one, words)):
        if said and not set(said) & set(units):
            raise InputError(f"the headers name both {said[0]} and {units[0]}; --unit says which it is")
        said = units if not said or len(units) < len(said) else said
    return said


def _units_of_one(name: str) -> tuple[str, ...]:
    """Of the bracket, else of the whole name, else of a word of it."""
    unit, plain = _folded(bracketed(name)), _plain(name)
    if unit == "v":
        return ("volt",)
    electric = unit.endswith(("ohm", "ohms", "ω", "volt", "volts")) or (unit.endswith("v") and len(unit) == 2)
    if unit not in UNITS_OF_WORD and electric:
        raise InputError(
            f"the header's unit '{bracketed(name)}' is none of ohm, kohm, volt, mV and code; --unit overrides"
        )
    parts = [part for part in (plain.split("_")[0], plain.split("_")[-1]) if len(part) > 1]  # r_0_c_1 is a cell
    words = (unit, *map(_folded, (plain, *parts)))
    return next((UNITS_OF_WORD[word] for word in words if word in UNITS_OF_WORD), ())


def _folded(text: str) -> str:
    return text.strip().lower().replace("Ω", "ω")


def _without_unit(name: str) -> str:
    unit = bracketed(name)
    if not unit or _folded(unit) not in UNITS_OF_WORD | {"v": ()}:
        return name
    return name[: name.rindex(unit)].rstrip(" [(<{/").removesuffix(" in")


def _plain(name: str) -> str:
    """A name in small letters without its unit, its words joined by one underscore."""
    unit = bracketed(name)
    text = name[: name.rindex(unit)] if unit else name
    text = re.sub(r"\bin\s*$", "", text.strip(" [(<{/#%"))
    return re.sub(r"[\s_\-.:]+", "_", text.strip().lower()).strip("_")


@dataclass(frozen=True)
class Numerals:
    """How a file writes numbers: with a decimal comma or a point; the other sign may set thousands apart."""

    comma: bool

    @classmethod
    def of(cls, fields: Sequence[str]) -> "Numerals":
        """The way that reads more of these fields; where both read the same, a comma that stands alone is decimal."""
        numbers = [field for field in fields if _written(COMMA, field) or _written(POINT, field)]
        commas = sum(_written(COMMA, field) - _written(POINT, field) for field in numbers)
        text = "".join(numbers)
        return cls(commas > 0 or (commas == 0 and "," in text and "." not in text))

    def is_number(self, field: str) -> bool:
        """Whether a text is a number, a word for infinity, one for a missing reading, or nothing."""
        value, missing = self._read(field.strip().lower())
        return missing or not np.isnan(value)

    def numbers(self, fields: NDArray[Any]) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Numbers of texts (any shape), NaN for none; where a reading is said to be missing; where neither."""
        texts = fields.ravel()
        values = np.fromiter(map(self._plain, texts), dtype=float, count=len(texts))
        missing, words = np.zeros(len(texts), dtype=bool), np.zeros(len(texts), dtype=bool)
        for number in np.flatnonzero(np.isnan(values) | np.isneginf(values)):
            values[number], missing[number] = self._read(texts[number].lower())
            words[number] = np.isnan(values[number]) and not missing[number]
        return values.reshape(fields.shape), missing.reshape(fields.shape), words.reshape(fields.shape)

    def _plain(self, text: str) -> float:
        """The number of most texts, quickly; NaN of those that `_read` has to look at."""
        if len(text) > LONGEST or "_" in text or not text.isascii() or (self.comma and "." in text):
            return np.nan
        try:
            return float(text.replace(",", ".") if self.comma else text)
        except ValueError:
            return np.nan

    def _read(self, word: str) -> tuple[float, bool]:
        """The number of one text, NaN for none; whether it stands for a missing one."""
        if word in MISSING_WORDS or not word.strip("-"):
            return np.nan, True
        if word in INFINITE_WORDS:
            return np.inf, False
        if not _written(COMMA if self.comma else POINT, word):
            return np.nan, False
        decimal, thousands = (",", ".") if self.comma else (".", ",")
        return float(word.replace(thousands, "").replace(decimal, ".")), False


def _written(pattern: re.Pattern[str], field: str) -> bool:
    return len(field) <= LONGEST and pattern.fullmatch(field) is not None
