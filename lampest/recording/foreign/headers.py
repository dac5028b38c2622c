"""What a column, an array or a line is called, and what that says: role, cell, line, unit."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from lampest.files.errors import InputError

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

LONGEST = 100  # signs of a name that are looked at


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
