"""Meaning of names, numbers and times in foreign files."""

import re
from collections.abc import Sequence
from functools import lru_cache

from lampest.files.errors import InputError
from lampest.recording.unit import UNITS_OF_WORD


def _by_word(**words: str) -> dict[str, str]:
    """Return the meanings by word, for lists of words that are separated by blanks."""
    return {word: meaning for meaning, listed in words.items() for word in listed.split()}


ROLE_OF_WORD = _by_word(
    row="row rows zeile reihe y i",
    column="column columns col cols spalte x j",
    cell="cell taxel pixel index sensor",
    value="value values reading measured resistance ohm kohm volt voltage code adc raw counts "
    "mv r v wert widerstand spannung",
    frame="frame frames scan step sample seq counter frame_id frame_nr frame_no scan_nr nr messung "
    "bild",
    date="date datum day tag",
    time="time times t timestamp timestamps time_stamp datetime date_time zeit uhrzeit zeitstempel "
    "elapsed clock ts millis micros ms us µs s sec second seconds unix epoch",
)
# Words for the parts of a time of day that stands in columns of their own.
PART_OF_CLOCK = _by_word(
    hour="hh h hour hours stunde stunden",
    minute="mm m min mins minute minutes minuten",
    second="ss s sec secs second seconds sekunde sekunden",
    millisecond="ms msec millis millisecond milliseconds",
)
# Names that permit two units.
QUANTITIES = {"resistance": ("ohm", "kohm"), "voltage": ("volt", "mV")}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
TIME_UNIT_OF_WORD = _by_word(
    s="s sec secs second seconds sekunde sekunden",
    ms="ms milli millis millisecond milliseconds msec",
    us="us µs μs micro micros microsecond microseconds usec",
    ns="ns nanosecond nanoseconds",
    min="min minute minutes",
    h="h hour hours",
)
# Units and quantities of loads, which a resistance follows but is not.
PRESSURE_UNITS = _by_word(
    pressure="pa kpa mpa hpa mmhg mmh2o cmh2o psi bar mbar atm torr n/cm2 n/mm2 n/cm² n/mm² kg/cm2"
)
LOADS = PRESSURE_UNITS | _by_word(
    load="n newton newtons g gram grams kg lb lbs lbf kgf pressure pressures druck force forces "
    "kraft weight gewicht load last conductance leitwert temperature"
)
ANY_PRESSURE_UNIT = "|".join(sorted(map(re.escape, PRESSURE_UNITS), key=len, reverse=True))
STATED_PRESSURE = re.compile(rf"(?:\d\s*|[\[(:=]\s*)({ANY_PRESSURE_UNIT})(?![\w/²])", re.IGNORECASE)
UNITS = {*UNITS_OF_WORD, *TIME_UNIT_OF_WORD, *PRESSURE_UNITS}
BRACKETED = re.compile(
    r"(.*?)\s*[\[({<]\s*([^\[\](){}<>]*[^\[\](){}<>\s\d,;:|/x_.-][^\[\](){}<>]*?)\s*[\])}>]",
    re.IGNORECASE,
)
PARTED = re.compile(r"(.*?)(\s*[\[(<{]\s*|\s+in\s+|\s*/\s*|[\s_]+)([^\W\d_]+)\s*[\])>}]?")
ELECTRIC = re.compile(r".*(ohms?|[ωΩΩ]|volts?)|.?v", re.IGNORECASE)
ROW = r"(?:r|rows?|zeile|z|y)"
COLUMN = r"(?:c|cols?|columns?|spalte|s|x)"
GAP = r"[_,;/|=\[\]()]*"
# In brackets: a part of a cell's name, no unit.
LINE_NUMBER = re.compile(rf"(?:{ROW}|{COLUMN})\s*{GAP}\s*\d{{1,9}}")
WORDS = r"[a-z_,;/|=\[\]()]*?"  # before the numbers, as in 'value_at_(0,3)'
CELLS = (
    re.compile(rf"{WORDS}{ROW}{GAP}(?P<row>\d{{1,9}}){GAP}{COLUMN}{GAP}(?P<column>\d{{1,9}}){GAP}"),
    re.compile(rf"{WORDS}{COLUMN}{GAP}(?P<column>\d{{1,9}}){GAP}{ROW}{GAP}(?P<row>\d{{1,9}}){GAP}"),
    re.compile(rf"{WORDS}(?P<row>\d{{1,9}})[_,;/|x\[\]()]+(?P<column>\d{{1,9}}){GAP}"),
)
ONE_NUMBER = re.compile(rf"([^\W\d]*){GAP}(\d{{1,9}}){GAP}")

# Characters of a name or a number that are analysed; patterns would take long for more.
MAX_LENGTH = 100
# Words for missing or infinite numbers, as written by NumPy, R, MATLAB, JSON, Arduino's Print
# (ovf), multimeters (OL, open), Microsoft's C library (1.#QNAN) and Excel (#DIV/0!).
NO_NUMBERS = _by_word(
    nan="nan -nan +nan na n/a n.a. null none nil ovf -ovf ol o.l o.l. ovl open overload overflow "
    "over err error missing ? ?? . -inf -infinity nan(ind) -nan(ind) 1.#ind -1.#ind 1.#qnan "
    "#n/a #na #div/0! #num! #value! #ref!",
    inf="inf +inf infinity +infinity ∞ 1.#inf",
)
NUMBER = r"[+-]?(\d+({0}\d*)?|{0}\d+|\d{{1,3}}({1}\d{{3}})+({0}\d*)?)([eE][+-]?\d+)?"
POINT, COMMA = (
    re.compile(NUMBER.format(*signs), re.ASCII) for signs in ((r"\.", ","), (",", r"\."))
)

# Share of the stamps that may be cut and interpolated; more indicate another clock, or no times.
MAX_CUT = 0.1


def parted(name: str) -> tuple[str, str]:
    """Split a name into its words and its unit.

    Returns
    -------
    word : str
        Name in lower case without the unit, its words joined by underscores.
    unit : str
        Unit at the end of the name as written, or ''.
    """
    text = name[:MAX_LENGTH].strip()
    unit = ""
    match = PARTED.fullmatch(text)
    bracketed = BRACKETED.fullmatch(text)
    if bracketed and bracketed[1] and not LINE_NUMBER.fullmatch(bracketed[2].lower()):
        text, unit = bracketed.groups()
    elif match and (
        match[2].strip(" _") in tuple("[(<{")
        or match[3].lower() in UNITS
        or ELECTRIC.fullmatch(match[3])
    ):
        text, _, unit = match.groups()
    return re.sub(r"[\s_\-.:]+", "_", text.strip("#% ").lower()).strip("_"), unit


def role_of(name: str) -> str | None:
    """Return the role of a name without its unit, or None.

    The role is 'row', 'column', 'cell', 'value', 'frame', 'date' or 'time'.
    """
    word, unit = parted(name)
    seconds = unit.lower() in TIME_UNIT_OF_WORD and unit[1:] != "S"  # mS are millisiemens
    role = ROLE_OF_WORD.get(word) or ("time" if seconds else None)
    other_unit = unit and not seconds and BRACKETED.fullmatch(name.strip())
    return None if role == "time" and other_unit else role


def cell_of(name: str) -> tuple[int, int] | None:
    """Return (row, column) of a name such as r0c0 or 'row 0 col 3'; else None.

    Other such names are R1C1, c3_r0, cell_0_3, (0, 3) and [0][3].
    """
    word, _ = parted(name)
    matches = filter(None, (pattern.fullmatch(word) for pattern in CELLS))
    return next(((int(match["row"]), int(match["column"])) for match in matches), None)


@lru_cache(10_000)
def line_of(name: str) -> tuple[str, int] | None:
    """Return (word, number), such as ('r', 3), of a name such as R3 or 'row 3'; else None.

    Other such names are 3 and col_3.
    """
    match = ONE_NUMBER.fullmatch(parted(name)[0])
    return (match[1].strip("_"), int(match[2])) if match else None


def units_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the electrical units that the names of columns or arrays permit; () if they name none.

    Raises InputError if they name a unit that is not imported, or contradict each other.
    """
    permitted: tuple[str, ...] = ()
    for units in filter(None, map(_units_of_one, dict.fromkeys(names))):
        if permitted and not set(permitted) & set(units):
            raise InputError(
                f"the headers name both {permitted[0]} and {units[0]}; `unit` says which it is"
            )
        permitted = min(permitted or units, units, key=len)
    return permitted


def _units_of_one(name: str) -> tuple[str, ...]:
    """Return the units that a name permits.

    The unit at the end of the name decides, otherwise the whole name, its first or its last word.
    """
    stem, unit = parted(name)
    if unit in ("v", "V"):
        return ("volt",)
    load = load_named(name)
    if load:
        raise InputError(
            f"the header says {load!r}: readings must be ohm, kohm, volt, mV or code, "
            "from which cells are computed. If they are, `unit` says which"
        )
    bracketed = BRACKETED.fullmatch(name.strip()) is not None and unit != ""
    if unit.lower() not in UNITS_OF_WORD and (bracketed or ELECTRIC.fullmatch(unit)):
        raise InputError(
            f"the header's unit {unit!r} is none of ohm, kohm, volt, mV and code; `unit` overrides"
        )
    # r_0_c_1 is a cell
    ends = [word for word in (stem.split("_")[0], stem.split("_")[-1]) if len(word) > 1]
    names = (UNITS_OF_WORD[word] for word in (unit.lower(), stem, *ends) if word in UNITS_OF_WORD)
    return next((QUANTITIES.get(name, (name,)) for name in names), ())


def load_named(name: str) -> str:
    """Return the word for a load's quantity or unit in a name, such as 'mmHg' or 'pressure'.

    The result is '' without one.
    """
    stem, unit = parted(name)
    if unit.lower() in UNITS_OF_WORD or unit in ("v", "V"):
        return ""  # 'pressure sensor [mV]' holds voltages
    words = (unit, *re.split(r"[_\s]+", stem))
    return next((word for word in words if word.lower() in LOADS), "")


def names_unit(name: str) -> bool:
    """Return whether the name of a column says anything of the unit of its numbers.

    The unit may be known or not.
    """
    try:
        return _units_of_one(name) != ()
    except InputError:
        return True


def names_pressure(name: str) -> bool:
    """Return whether a name ends with a unit of pressure: 'Average Pressure (mmHg)'."""
    return parted(name)[1].lower() in PRESSURE_UNITS


def pressures_in(text: str) -> str:
    """Return the unit of pressure that a line with numbers states, or ''.

    Examples are 'Max: 200 mmHg' and 'Mean (kPa) 3'.
    """
    match = STATED_PRESSURE.search(text)
    return match[1] if match else ""


def states_unit(title: str) -> bool:
    """Return whether a title or a comment without numbers ends with a unit of readings.

    An example is 'Resistance (kOhm)'.
    """
    plain, unit = parted(title)
    meaning = UNITS_OF_WORD.get(unit.lower(), "volt" if unit in ("v", "V") else "")
    electric = meaning in ("ohm", "kohm", "volt", "mV")
    return (electric or names_pressure(title)) and re.search(r"\d", plain) is None


def has_decimal_comma(fields: Sequence[str]) -> bool:
    """Return whether more of the fields are numbers with a decimal comma than with a point.

    If equal, it is decided by the signs.
    """
    comma, point = (
        [field for field in fields if pattern.fullmatch(field)] for pattern in (COMMA, POINT)
    )
    text = "".join(comma)
    return len(comma) > len(point) or (len(comma) == len(point) and "," in text and "." not in text)


@lru_cache(100_000)
def number_of(text: str, *, comma: bool) -> float | None:
    """Return the number of a text; NaN for words for a missing number, None for any other word.

    `comma` states whether the comma is the decimal sign; the other sign may separate thousands.
    """
    if len(text) <= MAX_LENGTH and (COMMA if comma else POINT).fullmatch(text):
        return float(text.replace(".", "").replace(",", ".") if comma else text.replace(",", ""))
    word = NO_NUMBERS.get(text.lower(), "" if text.strip("-") else "nan")
    return float(word) if word else None
