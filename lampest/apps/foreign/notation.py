"""Notation of lines of text: prefixes of logs, labels, lists and separators of fields."""

import csv
import json
import re
import string
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from lampest.apps.foreign.words import cell_of, has_decimal_comma, number_of
from lampest.files.errors import InputError

SAMPLED = 50_000  # characters or fields at the beginning of a file that determine its notation
SAMPLED_LINES = 1000
MAX_LINE = 1_000_000  # characters
DELIMITERS = {";": "semicolon", "\t": "tab", ",": "comma", " ": "blank"}
# Colours of ESP-IDF's and Zephyr's logs; a screen that is cleared before each frame
CONTROL = re.compile(r"\x1b\[[\d;?]*[A-Za-z]")
DATE = r"(?:\d{4}-\d{2}-\d{2}[ T]|\d{1,2}\.\d{1,2}\.\d{4} )?"
TIME = r"\d{1,2}:\d{2}:\d{2}(?:[.,:]\d+)?"
# Prefixes of lines, with a time of day or milliseconds.
PREFIXES = (
    # Zephyr: '[00:00:01.234,567] <inf> mat: '
    re.compile(
        r"\s*(?:uart:~\$ )?\[(?P<clock>\d+:\d{2}:\d{2}\.\d{3}),(?P<micro>\d{3})\] <\w+> "
        r"(?:[\w.]+: )?"
    ),
    # ESP-IDF: 'I (1234) mat: ', 'I (12:34:56.789) mat: '
    re.compile(r"\s*[EWIDV] \((?:(?P<ms>\d+)|(?P<clock>\d+:\d{2}:\d{2}\.\d+))\) (?:[\w.-]+: )?"),
    # '12:34:56.789 -> ' of the Arduino IDE, '12:34:56.789 > ' of PlatformIO,
    # '[2025-01-31 12:34:56.789] ' of others
    re.compile(rf"\s*\[?(?P<clock>{DATE}{TIME})\s*(?:\]|->|>|\|)\s*"),
)
# 'ROW0=512,511', '"row0": 512,511', 'R0: 512 511', '0: 512 511', 'MAT:512,511'
LABELLED = re.compile(
    r"\s*(?:\"?([^\W\d]+[ _]?\d+)\"?\s*[=:]\s*|(\d+):[ \t]+|"
    r"([^\W\d]+)\s*:\s*(?=\S+[,;\t ]\s*[-+.\d]))(?=[-+.\d])"
)
BRACKETED = re.compile(r"[\[{(]+\s*[-+.\d]")  # '[512, 511],' of Python and JSON, '{512, 511},' of C
# '<512,511>', '*512,511#', between marks of begin and end; '$MAT,512,511*5A', with a checksum
ENCLOSED = re.compile(
    r"\s*(?:<\s*([-+.\d][^<>]*)>|\*\s*([-+.\d][^*#]*)#|\$([^$*]*)\*[0-9A-Fa-f]{2})\s*"
)
# '0.1,"[512, 511]"', '0.1;[[512 511] [513 514]]': a list behind other fields
LISTED = re.compile(r'^(.*?[,;\t ])"?(\[[\[\s]*[-+.\d]+[,;\s][^"]*\])"?(.*)$')
# 'r0c0:512' of the Serial Plotter, '[0][0] = 512'
VALUE = r"\s*[:=]\s*(?P<value>[-+.]?\d[^\s,;:=]*|nan|ovf|null)"
PAIR = re.compile(
    r"(?P<name>[^\W\d][\w ./\[\]()-]*?|[\[(]\d+(?:\]\[|, ?)\d+[\])])" + VALUE, re.IGNORECASE
)
# 'Row 0, Col 3: 512', 'Value at (0, 3) = 512': the only pair of a line
CELL = re.compile(r"(?P<cell>(?:[^\W\d]|[\[(]).*?)" + VALUE, re.IGNORECASE)
BETWEEN_PAIRS = re.compile(r"[\s,;]*")
# '1,2,3;4,5,6;', '[1 2 3; 4 5 6]' of MATLAB, '1 2 3 | 4 5 6': several rows in a line
BETWEEN_ROWS = re.compile(r"\d[\s,]*([;|])\s*(?=[-+.\d]|$)")
# '512x511xz300x301x' of two panels, 'z0x512x511' of a row: letters between numbers, but of no bytes
LETTERED = re.compile(r"[a-z]*-?\d+(?:[a-z]+-?\d+){2,}[a-z]*", re.IGNORECASE)
BYTES = re.compile(r"[\da-f]+", re.IGNORECASE)
# 'mat/left {"v": [512, 511]}' of MQTT's tools: a topic and an object of JSON
TOPIC = re.compile(r"([^\s{}\"=]+)\s+(\{.*\})")
# '>r0c0:1735725600125:752§V|g' of Teleplot: a name, ms since 1970 or of the board, a value
TELEPLOT = re.compile(
    r">(?P<cell>[^:]+):(?:(?P<time_ms>\d+(?:\.\d+)?):)?(?P<value>[-+.\d][^§|:;]*)(?:§[^|]*)?(?:\|.*)?"
)


def stamp_and_content(line: str) -> tuple[str, str]:
    """Return the time that a terminal or a log writes before a line, or '', and the rest."""
    line = CONTROL.sub("", line) if "\x1b" in line else line
    match = next(filter(None, (prefix.match(line) for prefix in PREFIXES)), None)
    if match is None:
        return "", line.strip(" ")
    parts = match.groupdict("")
    ms = parts.get("ms")
    stamp = f"{int(ms) / 1000:.3f}" if ms else f"{parts['clock']}{parts.get('micro', '')}"
    return stamp, line[match.end() :]


@dataclass(frozen=True)
class Notation:
    """How lines of text are written, settled on the first ones.

    Attributes
    ----------
    delimiter : str
        Sign between fields.
    joined : bool
        Whether consecutive tabs are one separator.
    names : tuple of str
        Names that stand beside the values in every line; empty if the values stand alone.
    separated : bool
        Whether lines have several fields.
    usual : int
        Number of names of a whole line, which are the first ones.
    rows : str
        Sign between the rows or the panels of a line, or ''.
    parts : int
        Number of such parts, or of lists with names, in a line.
    """

    delimiter: str
    joined: bool = False
    names: tuple[str, ...] = ()
    separated: bool = True
    usual: int = 0
    rows: str = ""
    parts: int = 1

    @classmethod
    def of(cls, contents: Sequence[str]) -> "Notation":
        """Return the notation of lines without their prefixes.

        The delimiter is the sign that gives most numbers.
        """
        sample = contents[:SAMPLED_LINES]
        named = [*filter(None, map(values_beside_names, sample))]
        if 2 * len(named) > len(sample):
            usual = Counter(map(tuple, named)).most_common(1)[0][0]
            often = Counter(name for line in named for name in line)
            # A name that one line alone has is a damaged one.
            others = [
                name
                for line in named
                for name in line
                if "\0" not in name and often[name] > 1 and not line.keys().isdisjoint(usual)
            ]
            names = tuple(dict.fromkeys([*usual, *others]))
            lists = _lengths(usual)
            parts = len(lists) if len(set(lists.values())) == 1 else 1
            return cls(",", names=names, usual=len(usual), parts=parts)
        sample = [_plain(content) for content in sample]
        delimiter = _delimiter(sample)
        # Lines may agree in their number of fields only if consecutive tabs are one.
        single = Counter(line.count("\t") for line in sample)
        joined = Counter(len(re.findall(r"\t+", line.strip("\t"))) for line in sample)
        by_tabs = max(joined.values(), default=0) > max(single.values(), default=0)
        separated = any(delimiter in line.strip() for line in sample)
        # The sign that parts most lines; parts are about equally long: a time before is none.
        rows = ""
        parts = 1
        often = Counter(sign for line in sample for sign in set(BETWEEN_ROWS.findall(line)))
        for sign, count in often.items():
            if not rows and 2 * count > len(sample) and sign != delimiter:
                rows = sign
                lengths = Counter(
                    tuple(part.count(delimiter) for part in line.strip(f" {sign}").split(sign))
                    for line in sample
                )
                equal = lengths.most_common(1)[0][0]
                parts = len(equal) if max(equal) <= 2 * min(equal) + 1 else 1
        return cls(delimiter, delimiter == "\t" and by_tabs, (), separated, 0, rows, parts)

    @property
    def sentence(self) -> str:
        """How fields are separated; '' for lines of one field."""
        if self.names:
            return f"names beside the values: {', '.join(filter(None, self.shown[:3]))} ..."
        sign = "one or more tabs" if self.joined else DELIMITERS[self.delimiter]
        rows = f", parts of a line by {self.rows!r}" if self.rows else ""
        return f"fields separated by {sign}{rows}" if self.separated else ""

    @property
    def shown(self) -> list[str]:
        """Names of the fields as a header has them; those within a list have none."""
        return ["" if "\0" in name else name for name in self.names]

    def fields(self, place: str, content: str) -> list[str]:
        """Return the fields of a line.

        Raises InputError with the place for a misplaced quotation mark.
        """
        if self.names:
            values = values_beside_names(content)
            if values is None:
                return [content]
            if "cell" in values and "cell" not in self.names:  # one pair of a line that was parted
                values = {values["cell"]: values["value"]}
            is_beginning = tuple(values) == self.names[: min(len(values), self.usual - 1)]
            if is_beginning or ("cell" in self.names and len(values) < self.usual):
                values.popitem()  # of a line that was cut, perhaps within its last value
            if _lengths(values) != _lengths(self.names):  # which value of a list is lost is unknown
                values = {name: value for name, value in values.items() if "\0" not in name}
            return [values.get(name, "") for name in self.names]
        content = _plain(content)
        if self.rows:
            content = re.sub(rf"[\s,]*[{self.rows}]\s*", self.delimiter, content)
        if self.joined:
            content = re.sub(r"\t+", "\t", content).strip("\t")
        if self.delimiter == " ":
            return content.split()
        if '"' not in content:
            return [text.strip() for text in content.split(self.delimiter)]
        try:
            (fields,) = csv.reader(
                [content], delimiter=self.delimiter, skipinitialspace=True, strict=True
            )
        except csv.Error as error:
            raise InputError(
                f"{place}: a quotation mark that is not closed, or within a field"
            ) from error
        return [text.strip() for text in fields]


def values_beside_names(content: str) -> dict[str, str] | None:
    """Return the values of a line by the names beside them; None for another line.

    Such lines are an object of JSON, alone or behind the topic of a message, pairs of the Serial
    Plotter, a value of Teleplot, or a cell's name and its value. Values of a list have names with
    a zero byte and their number.
    """
    content = content.strip()
    topic = TOPIC.fullmatch(content)
    if content.startswith("{") or topic:
        try:
            record = json.loads(topic[2] if topic else content)
        except (ValueError, RecursionError):
            return None
        if not isinstance(record, dict):
            return None
        return dict(_flat(({"topic": topic[1]} if topic else {}) | record))
    if content.startswith(">"):
        match = TELEPLOT.fullmatch(content)
        return match and {name: text for name, text in match.groupdict().items() if text}
    single = CELL.fullmatch(content)
    if single is not None and cell_of(single["cell"]):
        return single.groupdict()
    values = {}
    at = 0
    while at < len(content):
        pair = PAIR.match(content, at)
        if pair is None or pair["name"] in values:
            return None
        values[pair["name"]] = pair["value"]
        end = BETWEEN_PAIRS.match(content, pair.end())
        assert end is not None
        at = end.end()
        if at == pair.end() < len(content):
            return None
    return values if len(values) > 1 else None


def flat_names(record: dict[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a record and of those within it, under names joined by dots."""
    for name, value in record.items():
        path = f"{above}.{name}" if above else str(name)
        if isinstance(value, dict):
            yield from flat_names(value, path)
        else:
            yield path, value


def _flat(record: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the names and texts of a record, with one name for each value of a list."""
    for path, value in flat_names(record):
        for number, text in enumerate(_texts(value)):
            yield f"{path}\0{number}" if isinstance(value, list) else path, text


def _texts(value: Any) -> Iterator[str]:
    """Yield the text of a value, or those of all values of a list and of the lists within it."""
    if isinstance(value, list):
        for part in value:
            yield from _texts(part)
    elif value is None:
        yield ""
    else:
        yield value if isinstance(value, str) else json.dumps(value)


def _lengths(names: Iterable[str]) -> Counter[str]:
    """Return the number of values of each list among names."""
    return Counter(name.partition("\0")[0] for name in names if "\0" in name)


def _plain(content: str) -> str:
    """Return a line without the brackets of lists or frames, and with its label as a field."""
    enclosed = ENCLOSED.fullmatch(content)
    content = content if enclosed is None else enclosed[enclosed.lastindex or 0]
    if LETTERED.fullmatch(content) and not BYTES.fullmatch(content):
        return _without_letters(content)
    listed = LISTED.match(content) if "[" in content else None
    if BRACKETED.match(content):
        content = re.sub(r"[\[\]{}()]", " ", content)
    elif listed is not None:
        values = re.split(r"[,;\s\[\]]+", listed[2].strip("[] "))
        content = listed[1] + listed[1][-1].join(values) + listed[3].rstrip(", ")
    labelled = LABELLED.match(content)
    if labelled is None:
        return content
    values_text = content[labelled.end() :]
    sign = next((sign for sign in DELIMITERS if sign in values_text), " ")
    label = labelled[labelled.lastindex or 0].replace(" ", "_")
    return f"{label}{sign}{values_text}"


def _without_letters(content: str) -> str:
    """Return numbers with letters between them as fields, and rarer letters as `;`."""
    content = content.strip(string.ascii_letters)
    usual = Counter(re.findall(r"[A-Za-z]+", content)).most_common(1)[0][0]
    return re.sub(r"[A-Za-z]+", lambda match: "," if match[0] == usual else ";", content)


def _delimiter(lines: Sequence[str]) -> str:
    """Return the sign that gives most numeric fields in the first lines.

    If several signs give as many, the earliest in the list counts.
    """
    sample = "\n".join(lines)[:SAMPLED].split("\n")

    def numbers(sign: str) -> tuple[int, bool]:
        fields = [
            field.strip(' "')
            for line in sample
            for field in line.split(None if sign == " " else sign)
        ]
        comma = has_decimal_comma(fields)
        # Dashes are missing readings, or a line between frames.
        read = [field for field in fields if number_of(field, comma=comma) is not None]
        return sum(field.strip("-") != "" for field in read), any(sign in line for line in sample)

    return max(DELIMITERS, key=numbers)
