"""Text files and sheets of Excel files as lines of fields."""

import csv
import datetime
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError, extra
from lampest.recording.foreign.arrays import check_archive
from lampest.recording.foreign.table import SAMPLED, Rows
from lampest.recording.foreign.words import Numerals

MOST_FIELDS = 10_000_000  # 50 bytes each in memory
SAMPLED_LINES = 1000  # that decide what keeps fields apart, and whether a sheet may be a table
LINE_END = re.compile(r"\r\n|\r|\n")
DELIMITERS = {";": "semicolon", "\t": "tab", ",": "comma", " ": "blank"}
COMMENT = re.compile(r"\s*(?:#(?!N/A|NA|DIV/0!|NUM!|VALUE!|REF!)|%|//)", re.IGNORECASE)  # not where Excel has no number
TIME = r"\d{1,2}:\d{2}:\d{2}(?:[.,:]\d+)?"
DATE = r"\d{4}-\d{2}-\d{2}[ T]|\d{1,2}\.\d{1,2}\.\d{4} "
# '12:34:56.789 -> ' of the Arduino IDE, '12:34:56.789 > ' of PlatformIO, '[2025-01-31 12:34:56.789] ' of others
STAMPED = re.compile(rf"\s*(?:\[({DATE})?({TIME})\]|({DATE})?({TIME})\s*(?:->|>|\|))\s*")
LISTED = re.compile(r"\s*[\[{(]+\s*[-+.\d]")  # '[512, 511],' of Python and JSON, '{512, 511},' of C
BRACKETS = str.maketrans("[]{}()", "      ")


class _Line(NamedTuple):
    number: int
    text: str
    stamp: str
    comment: bool
    blank: bool


def rows_of_text(path: Path) -> Rows:
    """The lines of a text file that hold anything, in fields; comments, too.

    Fields are separated by the sign that gives most numbers. Raises InputError with the line where the file is no text,
    a line is too long, or a quotation mark is not closed.
    """
    text, notes = _decoded(path)
    lines = _lines(path, text)
    if any(line.stamp for line in lines):
        notes.append("a terminal's time before the lines")
    delimiter = _delimiter([line.text for line in lines if not line.comment])
    fields, counts = _fields(path, lines, delimiter)
    whole = text.endswith(("\r", "\n"))
    if len(counts) > 1 and not whole and counts[-1] < np.median(counts):  # the file ends within a line
        fields[-1, counts[-1] - 1] = ""
        notes.append(f"the last number of line {lines[-1].number} is cut off and missing")
    return Rows(
        str(path),
        fields,
        counts,
        [line.number for line in lines],
        "line",
        np.array([line.comment for line in lines], dtype=bool),
        np.array([line.blank for line in lines], dtype=bool),
        [line.stamp for line in lines],
        lambda number, field: f"{path}:{number}" + ("" if field is None else f":{field + 1}"),
        (f"fields separated by {DELIMITERS[delimiter]}", *notes),
    )


def _decoded(path: Path) -> tuple[str, list[str]]:
    """UTF-8, UTF-16 by its mark or its zero bytes, and what older Windows programs write into headers."""
    _check_lines(path)
    data = path.read_bytes()
    for mark, encoding in ((b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be")):
        halves = data[: 2 * (len(data) // 2)]
        zeros = halves[1::2] if encoding.endswith("le") else halves[::2]
        if data.startswith(mark) or (b"\0" in data and zeros.count(0) > 0.9 * len(zeros)):
            try:
                return halves.decode(encoding).removeprefix("\ufeff"), ["UTF-16"]
            except UnicodeDecodeError as error:
                raise InputError(f"{path}: no text table (byte {error.start} is not UTF-16)") from error
    if b"\0" in data:
        raise InputError(f"{path}: no text table (it holds zero bytes)")
    try:
        return data.decode("utf-8-sig"), []
    except UnicodeDecodeError as error:
        if not re.search(rb"^\s*[+-]?[\d.]", data[: error.start], flags=re.MULTILINE) and re.search(rb"\n\s*\d", data):
            return data.decode("latin-1"), ["Latin-1"]
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}:{line}: no text table (byte {error.start} is not UTF-8)") from error


def _check_lines(path: Path) -> None:
    """Raise InputError where a file has more lines than are imported, before it is read as a whole."""
    with path.open("rb") as stream:
        count = sum(max(block.count(b"\n"), block.count(b"\r")) for block in iter(lambda: stream.read(2**20), b""))
    if count > MOST_FIELDS:
        raise InputError(f"{path}: {count} lines, more than {MOST_FIELDS} are not imported")


def _each_line(text: str) -> Iterator[str]:
    """The lines of a text one by one: a list of all of them may take more than the text."""
    begin = 0
    for end in LINE_END.finditer(text):
        yield text[begin : end.start()]
        begin = end.end()
    yield text[begin:]


def _lines(path: Path, text: str) -> list[_Line]:
    """Lines that hold anything; their numbers as an editor shows them."""
    lines, blank = [], False
    for number, line in enumerate(_each_line(text), 1):
        if len(line) > 1_000_000:
            raise InputError(f"{path}:{number}: longer than 1000000 characters, which no table is")
        stamped = STAMPED.match(line) if line else None
        rest = line[stamped.end() :] if stamped else line
        rest = rest.translate(BRACKETS) if LISTED.match(rest) else rest
        if not rest.strip(" \t;,\0"):
            blank = True
            continue
        stamp = "".join(part or "" for part in stamped.groups()) if stamped else ""
        lines.append(_Line(number, rest, stamp, COMMENT.match(rest) is not None, blank))
        blank = False
    return lines


def _delimiter(lines: Sequence[str]) -> str:
    """The sign that leaves most fields that are numbers, in the first lines; the earlier in the list of equal ones."""
    sample = "\n".join(lines[:SAMPLED_LINES])[:SAMPLED].split("\n")

    def numbers(sign: str) -> tuple[int, bool]:
        fields = [field.strip(' "') for line in sample for field in line.split(None if sign == " " else sign)]
        numerals = Numerals.of(fields)
        return sum(field != "" and numerals.is_number(field) for field in fields), any(sign in line for line in sample)

    return max(DELIMITERS, key=numbers)


def _fields(path: Path, lines: Sequence[_Line], delimiter: str) -> tuple[NDArray[Any], NDArray[np.intp]]:
    """(lines, fields) stripped texts, and how many fields each line has."""
    split, total, width = list[list[str]](), 0, 0
    for line in lines:
        split.append(_split(path, line, delimiter))
        total, width = total + len(split[-1]), max(width, len(split[-1]))
        if total > MOST_FIELDS or len(lines) * width > 2 * MOST_FIELDS:
            raise InputError(f"{path}:{line.number}: more than {MOST_FIELDS} values are not imported")
    return _as_table(split, width)


def _split(path: Path, line: _Line, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.text.split()
    if '"' not in line.text:
        return [text.strip() for text in line.text.split(delimiter)]
    try:
        (fields,) = csv.reader([line.text], delimiter=delimiter, skipinitialspace=True, strict=True)
    except csv.Error as error:
        raise InputError(f"{path}:{line.number}: a quotation mark that is not closed, or within a field") from error
    return [text.strip() for text in fields]


def _as_table(lines: Sequence[Sequence[str]], width: int) -> tuple[NDArray[Any], NDArray[np.intp]]:
    """(lines, width) texts, '' where a line ends earlier; how many each has."""
    fields = np.full((len(lines), width), "", dtype=object)
    for number, texts in enumerate(lines):
        fields[number, : len(texts)] = texts
    return fields, np.array([len(texts) for texts in lines], dtype=np.intp)


def sheets_of(path: Path, wanted: str | None, least: int) -> dict[str, Rows]:
    """Name → lines of every sheet that holds anything, or of the wanted one, in the file's order.

    Read row by row, because a few bytes may claim 10¹⁰ cells. least : fields that a line of any table must have.
    Raises InputError where the file is no readable .xlsx, has no such sheet, or a sheet is too large.
    """
    check_archive(path, ".xlsx")
    with _workbook(path) as book:
        names = [str(sheet.title) for sheet in book.worksheets]
        if wanted is not None and wanted not in names:
            raise InputError(f"{path}: no sheet '{wanted}'; there are {', '.join(names) or 'none'}")
        chosen = [sheet for sheet in book.worksheets if wanted in (None, sheet.title)]
        sheets = {str(sheet.title): _rows(path, sheet, least) for sheet in chosen}
    return {name: rows for name, rows in sheets.items() if len(rows.counts)}


@contextmanager
def _workbook(path: Path) -> Iterator[Any]:
    with extra("tables"):
        import openpyxl  # takes 0.2 s

    try:
        with path.open("rb") as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions that it does not keep
            with closing(openpyxl.load_workbook(stream, read_only=True, data_only=True)) as book:
                yield book
    except (InputError, MemoryError):
        raise
    except Exception as error:  # its readers of parts and of XML raise whatever they meet
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: no readable .xlsx file ({said})") from error


def _rows(path: Path, sheet: Any, least: int) -> Rows:
    """The rows that hold anything; what comes after the last value of a row counts for nothing."""
    from openpyxl.utils import get_column_letter

    sheet.reset_dimensions()  # what a file says of its size may be wrong
    lines: list[list[str]] = []
    numbers: list[int] = []
    cells = width = 0
    for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
        texts = [_text_of_cell(value) for value in row]
        while texts and not texts[-1]:
            texts.pop()
        if texts:
            cells, width = cells + len(texts), max(width, len(texts))
            lines.append(texts)
            numbers.append(number)
        if max(cells, number, len(lines) * width // 2) > MOST_FIELDS:
            raise InputError(f"{path}: sheet {sheet.title}: more than {MOST_FIELDS} values are not imported")
        if len(lines) == SAMPLED_LINES and width < least:
            break  # no table: what follows is not waited for
    return Rows(
        f"{path}: sheet {sheet.title}",
        *_as_table(lines, width),
        numbers,
        "row",
        np.array([texts[0].startswith(("#", "%")) and len(texts) == 1 for texts in lines], dtype=bool),
        np.diff(np.array([0, *numbers])) > 1,
        ("",) * len(lines),
        lambda number, field: f"{path}: {sheet.title}!{'' if field is None else get_column_letter(field + 1)}{number}",
        (f"sheet {sheet.title}",),
    )


def _text_of_cell(value: Any) -> str:
    """A cell as a text file would have it; all digits of a number."""
    if value is None:
        return ""
    if isinstance(value, float):
        return repr(value).removesuffix(".0")
    if isinstance(value, datetime.datetime):
        return value.isoformat(sep=" ")
    if isinstance(value, datetime.timedelta):
        return repr(value.total_seconds())
    return str(value).strip()
