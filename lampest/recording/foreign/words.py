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
    """'row', 'column', 'value', 'frame', 'date' or 'time'; None for any other name. Units are left aside."""
    plain = _plain(name)
    if plain in WORD_ROLE:
        return WORD_ROLE[plain]
    first, last = plain.split("_")[0], plain.split("_")[-1]
    if WORD_ROLE.get(first) == "time" and len(plain.split("_")) == 2:
        return "time"
    return WORD_ROLE.get(first) if last in UNITS_OF_WORD or first in ("resistance", "voltage", "ohm") else None


def cell_of(name: str) -> CellName | None:
    """The cell in r0c0, R1C1, 'row 0 col 3', c3_r0, Z1S1, cell_0_3, (0, 3), [0][3]; None in any other name."""
    text = _without_unit(name[:LONGEST]).strip().lower()
    for pattern, turned in ((ROW_FIRST, False), (COLUMN_FIRST, True), (TWO_NUMBERS, False)):
        match = pattern.fullmatch(text)
        if match and len(match[1]) + len(match[2]) < 12:
            first, second = int(match[1]), int(match[2])
            return CellName(second, first) if turned else CellName(first, second)
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
    _, mark, last = name.rpartition(" in ")
    if mark:
        return last.strip()
    _, mark, last = name.rpartition("/")
    return last.strip() if mark and not last.strip().isdigit() else ""


def units_of(words: Sequence[str]) -> tuple[str, ...]:
    """Units that the names of columns or arrays leave; none where they say nothing.

    Raises InputError where they name a unit that is not imported, or contradict each other.
    """
    said: tuple[str, ...] = ()
    for word in words:
        units = _units_of_one(word)
        if said and units and not set(said) & set(units):
            raise InputError(f"the headers name both {said[0]} and {units[0]}; --unit says which it is")
        if units:
            said = units if not said or len(units) < len(said) else said
    return said


def _units_of_one(name: str) -> tuple[str, ...]:
    """Of the bracket, else of the whole name, else of a word of it."""
    unit, plain = bracketed(name), _plain(name)
    if _folded(unit) == "v":
        return ("volt",)
    if _folded(unit) not in UNITS_OF_WORD and _electric(unit):
        raise InputError(f"the header's unit '{unit}' is none of ohm, kohm, volt, mV and code; --unit overrides")
    parts = [part for part in (plain.split("_")[0], plain.split("_")[-1]) if len(part) > 1]  # r_0_c_1 is a cell
    words = [_folded(text) for text in (unit, plain, *parts)]
    return next((UNITS_OF_WORD[word] for word in words if word in UNITS_OF_WORD), ())


def _electric(text: str) -> bool:
    folded = _folded(text)
    return folded.endswith(("ohm", "ohms", "ω", "volt", "volts")) or (folded.endswith("v") and len(folded) == 2)


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
        numbers = [field for field in fields if _is_comma(field) or _is_point(field)]
        commas = sum(map(_is_comma, numbers)) - sum(map(_is_point, numbers))
        text = "".join(numbers)
        return cls(commas > 0 or (commas == 0 and "," in text and "." not in text))

    def is_number(self, field: str) -> bool:
        """Whether a text is a number, a word for infinity, or one for a missing reading."""
        word = field.strip().lower()
        written = _is_comma(word) if self.comma else _is_point(word)
        return written or word in MISSING_WORDS or word in INFINITE_WORDS or (word != "" and not word.strip("-"))

    def numbers(self, fields: NDArray[Any]) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Numbers of texts, any shape; where a reading is missing by a word or an empty field; where neither.

        NaN where there is no number.
        """
        texts = fields.ravel()
        values = np.fromiter(map(self._plain, texts), dtype=float, count=len(texts))
        missing, words = np.zeros(len(texts), dtype=bool), np.zeros(len(texts), dtype=bool)
        for number in np.flatnonzero(np.isnan(values) | np.isneginf(values)):
            values[number], missing[number] = self._read(texts[number].lower())
            words[number] = np.isnan(values[number]) and not missing[number]
        return values.reshape(fields.shape), missing.reshape(fields.shape), words.reshape(fields.shape)

    def _plain(self, text: str) -> float:
        """The number of a text without signs that set thousands apart; NaN for any other: `_read` has those."""
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
        if (_is_comma if self.comma else _is_point)(word):
            decimal, thousands = (",", ".") if self.comma else (".", ",")
            return float(word.replace(thousands, "").replace(decimal, ".")), False
        return np.nan, False


def _is_comma(field: str) -> bool:
    return len(field) <= LONGEST and COMMA.fullmatch(field) is not None


def _is_point(field: str) -> bool:
    return len(field) <= LONGEST and POINT.fullmatch(field) is not None
