"""Tables of foreign files: lines and fields of texts and sheets, and the lines and columns with readings."""

import csv
import datetime
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError, extra, first_and_more
from lampest.panel.panel import Array
from lampest.recording.foreign.arrays import Frames, Index, Shape, Timing, check_archive, check_count, reading
from lampest.recording.foreign.words import (
    clock_of,
    has_decimal_comma,
    is_stamp,
    line_of,
    names_pressure,
    names_unit,
    number_of,
    parted,
    pressures_in,
    role_of,
    states_unit,
)

DAMAGED = "\ufffd"  # in place of a byte that no text holds
MAX_DAMAGED = 0.01  # share of such bytes; a serial line loses one now and then, and binary files have many more
# Letters of Western Europe in words, and µ and ° before a unit, in the single bytes that Excel writes on Windows.
WINDOWS_WORDS = re.compile(
    rb"(?<=[A-Za-z])[\xc0-\xff]+|(?<![\xc0-\xff])[\xc0-\xff]+(?=[A-Za-z])|(?<!\d)[\xb0\xb5](?=[A-Za-z])"
)
# First bytes of files that are no text.
PICKLE = "a pickle, which runs code when it is opened; save the array as .npy, .json or .csv"
MARKS = {bytes([0x80, protocol]): PICKLE for protocol in range(2, 6)} | {
    b"\x93NUMPY": "NumPy's format; name it .npy",
    b"PK\x03\x04": "a zip archive; name a workbook .xlsx, NumPy's arrays .npz, and unpack others first",
    b"\x89HDF": "HDF5; save the array as .npy. lampest's own recordings need no import",
    b"\xd0\xcf\x11\xe0": "an old Excel file; save it as .xlsx",
    b"\x1f\x8b": "compressed; unpack it first",
    b"PAR1": "Parquet; name it .parquet",
}
READ = "Other kinds: .xlsx, .npy, .npz, .mat, .json, .jsonl, .parquet; `layout` names a layout of your own"
MAX_FIELDS = 10_000_000  # 50 bytes each in memory
SAMPLED = 50_000  # characters or fields at the beginning of a file that determine its notation
SAMPLED_LINES = 1000
DELIMITERS = {";": "semicolon", "\t": "tab", ",": "comma", " ": "blank"}
COMMENT = re.compile(r"#(?!N/?A|DIV/0!|NUM!|VALUE!|REF!)|%|//", re.IGNORECASE)  # not Excel's words for no number
# '12:34:56.789 -> ' of the Arduino IDE, '12:34:56.789 > ' of PlatformIO, '[2025-01-31 12:34:56.789] ' of others
DATE = r"(?:\d{4}-\d{2}-\d{2}[ T]|\d{1,2}\.\d{1,2}\.\d{4} )?"
TIME = r"\d{1,2}:\d{2}:\d{2}(?:[.,:]\d+)?"
STAMPED = re.compile(rf"\s*\[?({DATE}{TIME})\s*(?:\]|->|>|\|)\s*")
LABELLED = re.compile(r"\s*([^\W\d]+[ _]?\d+)\s*[=:]\s*(?=[-+.\d])")  # 'ROW0=512,511', 'R0: 512 511'
LISTED = re.compile(r"[\[{(]+\s*[-+.\d]")  # '[512, 511],' of Python and JSON, '{512, 511},' of C
# 'Frame 3, t = 1250 ms', 'Frame 3 @ 1250 ms', 'Measurement Time(sec),0.120', 'time: 2025-01-31 12:00:01', 'millis=123'
TITLE_TIME = re.compile(
    r"(?:\b(?P<word>t|time|timestamp|elapsed|millis|micros|ms|us|zeit)\s*"
    r"(?:[\[(]\s*(?P<inner>[^\W\d_]+)\s*[\])]\s*[:=]?|[:=])\s*|@\s*(?=[\d.,]+\s*[mµu]?s\b))(?P<value>\d[\d.,]*)\s*(?P<unit>[mµu]?s(?:ec)?\b)?(?![\d:/-])"
    r"|(?P<stamp>\d{4}-\d{2}-\d{2}[T ]\d{1,2}:\d{2}(?::\d{2}(?:\.\d+)?)?(?:Z|[+-]\d{2}:?\d{2})?"
    r"|\b\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?)",
    re.IGNORECASE,
)
NUMBER = re.compile(r"\d+(?:[.,:]\d+)*")


class FieldLine(NamedTuple):
    """Nonempty line of a file.

    Attributes
    ----------
    number : int
        Number of the line in the file.
    texts : sequence of str
        Fields.
    stamp : str
        A terminal's time before the line, or ''.
    """

    number: int
    texts: Sequence[str]
    stamp: str = ""


@dataclass(frozen=True, eq=False)
class FieldLines:
    """Nonempty lines of a text or of a sheet, comments included.

    Attributes
    ----------
    source : str
        Name of the file or sheet.
    word : str
        'line' or 'row'.
    at : callable
        Function (line number, field or None) → place in the file.
    notes : tuple of str
        Sentences on the interpretation of the file.
    lines : sequence of FieldLine
    fields : array of str, shape (lines, width)
        Fields; '' beyond the end of a line.
    counts : array of int, shape (lines,)
        Number of fields.
    comment, blank : boolean array, shape (lines,)
        Whether a line is a comment, and whether an empty line precedes it.
    """

    source: str
    word: str
    at: Callable[[int, int | None], str]
    notes: tuple[str, ...]
    lines: Sequence[FieldLine]
    fields: NDArray[Any]
    counts: Index
    comment: NDArray[np.bool_]
    blank: NDArray[np.bool_]

    def called(self, line: int) -> str:
        """Return the name of a line: 'line 3'."""
        return f"{self.word} {self.lines[line].number}"


def field_lines(
    source: str, word: str, at: Callable[[int, int | None], str], notes: Iterable[str], lines: Iterable[FieldLine]
) -> FieldLines:
    """Return lines as a table. Raises InputError if it is too large."""
    read = list[FieldLine]()
    total = 0
    width = 0
    for line in lines:
        read.append(line)
        total = total + len(line.texts)
        width = max(width, len(line.texts))
        if max(total, len(read) * width // 2) > MAX_FIELDS:
            raise InputError(f"{at(line.number, None)}: more than {MAX_FIELDS} fields are not imported")
    fields = np.full((len(read), width), "", dtype=object)
    for number, line in enumerate(read):
        fields[number, : len(line.texts)] = line.texts
    counts = np.array([len(line.texts) for line in read], dtype=np.intp)
    comment = np.array([COMMENT.match(line.texts[0]) is not None for line in read], dtype=bool)
    blank = np.diff(np.array([0, *(line.number for line in read)])) > 1
    return FieldLines(source, word, at, tuple(notes), read, fields, counts, comment, blank)


def lines_of_text(path: Path) -> FieldLines:
    """Return the lines of a text file; the separator of fields is the sign that gives most numbers.

    Raises InputError with the line if the file is no text or too large, or if a quotation mark is not closed.
    """
    text, notes = _decoded(path)
    read: list[FieldLine] = []
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), 1):
        if len(line) > 1_000_000:
            raise InputError(f"{path}:{number}: longer than 1000000 characters, which no table is")
        stamped = STAMPED.match(line)
        content = line[stamped.end() :] if stamped else line.strip(" ")
        content = re.sub(r"[\[\]{}()]", " ", content) if LISTED.match(content) else content
        if labelled := LABELLED.match(content):  # the name becomes a field
            sign = next((sign for sign in DELIMITERS if sign in content[labelled.end() :]), " ")
            content = f"{labelled[1]}{sign}{content[labelled.end() :]}"
        if content.strip().strip(" \t;,"):
            read.append(FieldLine(number, [content], stamped[1] if stamped else ""))
    contents = [line.texts[0] for line in read if not COMMENT.match(line.texts[0])]
    if contents and 2 * sum(content.lstrip().startswith('{"') for content in contents) > len(contents):
        stamps = ", without the terminal's times" if any(line.stamp for line in read) else ""
        raise InputError(f"{path}:{read[0].number}: lines of JSON; save them as .jsonl{stamps}")
    delimiter = _delimiter(contents)
    aligned = delimiter == "\t" and _is_aligned(contents)
    if aligned:
        read = [line._replace(texts=[re.sub(r"\t+", "\t", line.texts[0]).strip("\t")]) for line in read]
    if any(delimiter in content.strip() for content in contents):
        notes.insert(0, f"fields separated by {'one or more tabs' if aligned else DELIMITERS[delimiter]}")
    notes += ["a terminal's time before the lines"] if any(line.stamp for line in read) else []

    def at(number: int, field: int | None) -> str:
        return f"{path}:{number}" + ("" if field is None else f":{field + 1}")

    split = (line._replace(texts=_split(at(line.number, None), line.texts[0], delimiter)) for line in read)
    lines = field_lines(str(path), "line", at, notes, split)
    if len(read) > 1 and not text.endswith(("\r", "\n")) and lines.counts[-1] < np.median(lines.counts):
        lines.fields[-1, lines.counts[-1] - 1] = ""  # the file ends within a line
        note = f"the last number of line {read[-1].number} is cut off and missing"
        return replace(lines, notes=(*lines.notes, note))
    return lines


def _decoded(path: Path) -> tuple[str, list[str]]:
    """Return the text of a file in UTF-8, or in UTF-16 by its mark or its zero bytes, and notes on the encoding."""
    data = path.read_bytes()
    if kind := next((kind for mark, kind in MARKS.items() if data.startswith(mark)), ""):
        raise InputError(f"{path}: no text table, but {kind}")
    count = max(data.count(b"\n"), data.count(b"\r"))
    if count > MAX_FIELDS:
        raise InputError(f"{path}: {count} lines, more than {MAX_FIELDS} are not imported")
    marks = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}
    encoding = marks.get(data[:2]) or ("utf-16-le" if data[1:2] == b"\0" else "utf-16-be" if data[:1] == b"\0" else "")
    data = data[: len(data) // 2 * 2] if encoding else data
    text = data.decode(encoding or "utf-8", errors="replace").removeprefix("\ufeff").replace("\0", DAMAGED)
    damaged = text.count(DAMAGED)
    if damaged and not encoding and not data.isascii() and WINDOWS_WORDS.sub(b"", data).isascii():
        return data.decode("cp1252", errors="replace"), ["Windows-1252"]
    if damaged > max(1, MAX_DAMAGED * len(text)):
        line = text.count("\n", 0, text.index(DAMAGED)) + 1
        wrong = f"{damaged} of {len(text)} bytes are no text"
        raise InputError(f"{path}:{line}: no text table ({wrong}; text is read in UTF-8 and UTF-16). {READ}")
    return text, ["UTF-16"] if encoding else []


def _delimiter(lines: Sequence[str]) -> str:
    """Return the sign that gives most numeric fields in the first lines; of equal signs the earlier in the list."""
    sample = "\n".join(lines[:SAMPLED_LINES])[:SAMPLED].split("\n")

    def numbers(sign: str) -> tuple[int, bool]:
        fields = [field.strip(' "') for line in sample for field in line.split(None if sign == " " else sign)]
        comma = has_decimal_comma(fields)
        read = sum(field != "" and number_of(field, comma=comma) is not None for field in fields)
        return read, any(sign in line for line in sample)

    return max(DELIMITERS, key=numbers)


def _is_aligned(lines: Sequence[str]) -> bool:
    """Return whether lines agree in their number of fields only if tabs that follow each other are one."""
    single = Counter(line.count("\t") for line in lines[:SAMPLED_LINES])
    joined = Counter(len(re.findall(r"\t+", line.strip("\t"))) for line in lines[:SAMPLED_LINES])
    return max(joined.values(), default=0) > max(single.values(), default=0)


def _split(place: str, line: str, delimiter: str) -> list[str]:
    """Return the fields of a line. Raises InputError with the place for a misplaced quotation mark."""
    if delimiter == " ":
        return line.split()
    if '"' not in line:
        return [text.strip() for text in line.split(delimiter)]
    try:
        (fields,) = csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True)
    except csv.Error as error:
        raise InputError(f"{place}: a quotation mark that is not closed, or within a field") from error
    return [text.strip() for text in fields]


def lines_of_sheets(path: Path, wanted: str | None) -> dict[str, FieldLines]:
    """Return the lines of every nonempty sheet, or of the wanted one, by name in the file's order.

    Sheets are read row by row, because a few bytes may claim 10¹⁰ cells. Raises
    InputError if the file is no readable .xlsx, has no such sheet, or has a sheet that is too large.
    """
    check_archive(path)
    with extra("tables"):
        import openpyxl  # takes 0.2 s
    with (
        reading(path),
        path.open("rb") as stream,  # openpyxl leaves a file open that it cannot read
        closing(openpyxl.load_workbook(stream, read_only=True, data_only=True)) as book,
    ):
        sheets = {str(sheet.title): sheet for sheet in book.worksheets}
        if wanted is not None and wanted not in sheets:
            raise InputError(f"{path}: no sheet '{wanted}'; there are {', '.join(sheets) or 'none'}")
        tables: dict[str, FieldLines] = {}
        for title in sheets if wanted is None else [wanted]:

            def at(number: int, field: int | None, title: str = title) -> str:
                letters = "" if field is None else openpyxl.utils.get_column_letter(field + 1)
                return f"{path}: {title}!{letters}{number}"

            rows = _rows_of_sheet(sheets[title])
            tables[title] = field_lines(f"{path}: sheet {title}", "row", at, [f"sheet {title}"], rows)
    return {title: lines for title, lines in tables.items() if lines.lines}


def _rows_of_sheet(sheet: Any) -> Iterator[FieldLine]:
    """Yield the nonempty rows without empty cells at their ends."""
    sheet.reset_dimensions()  # a file's own statement of its size may be wrong
    for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
        texts = [_text_of_cell(value) for value in row]
        while texts and not texts[-1]:
            texts.pop()
        if texts:
            yield FieldLine(number, texts)


def _text_of_cell(value: Any) -> str:
    """Return a cell as the text of a text file, with all digits of a number."""
    if isinstance(value, datetime.datetime) and value.time() == datetime.time():
        value = value.date()  # the time of day may be in the next cell
    return "" if value is None else str(value).strip().removesuffix(".0" if isinstance(value, float) else "")


@dataclass(frozen=True, eq=False)
class ReadingsTable:
    """Lines and columns of a file with readings.

    Attributes
    ----------
    source : FieldLines
        All lines of the file.
    lines : array of int
        Numbers of the lines in `source`.
    columns : array of int
        Numbers of their fields.
    fields : array of str, shape (lines, columns)
        Texts.
    values : array, shape (lines, columns)
        Numbers of the texts; NaN for other texts.
    words : boolean array, shape (lines, columns)
        Whether a text is neither a number nor a missing reading.
    comma : bool
        Whether numbers have a decimal comma.
    names : tuple of str
        Names of the columns; '' without a header.
    notes : tuple of str
        Sentences on the interpretation of the file.
    """

    source: FieldLines
    lines: Index
    columns: Index
    fields: NDArray[Any]
    values: Array
    words: NDArray[np.bool_]
    comma: bool
    names: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def width(self) -> int:
        """Number of fields of a line."""
        return len(self.columns)

    @cached_property
    def before(self) -> list[dict[str, str]]:
        """Texts between each line and the previous one, with their places such as 'line 3'; '' for a blank line."""
        between = []
        for last, line in pairwise([-1, *self.lines.tolist()]):
            blank = {"": ""} if self.source.blank[last + 1 : line + 1].any() else {}
            texts = {" ".join(self.source.fields[at]).strip(): self.source.called(at) for at in range(last + 1, line)}
            between.append(blank | texts)
        return between

    @cached_property
    def kinds(self) -> list[set[str]]:
        """Kinds of the texts between each line and the previous one; titles that differ in numbers only are equal."""
        return [set(map(kind_of, passed)) for passed in self.before]

    def place(self, line: int, field: int | None) -> str:
        """Return the place of a field in the file."""
        number = self.source.lines[self.lines[line]].number
        return self.source.at(number, None if field is None else int(self.columns[field]))

    def only(self, lines: Any = slice(None), columns: Any = slice(None)) -> "ReadingsTable":
        """Return the table with chosen lines and columns; other lines count as titles of the next line."""
        parts = {name: getattr(self, name)[lines][:, columns] for name in ("fields", "values", "words")}
        names = tuple(np.array(self.names, dtype=object)[columns])
        return replace(self, lines=self.lines[lines], columns=self.columns[columns], names=names, **parts)

    def frames(self, at: Sequence[Any], fields: Sequence[int], shape: Shape, timing: Timing, note: str) -> Frames:
        """Return the frames of the readings in given fields. Raises InputError if a reading is a word.

        Parameters
        ----------
        at : sequence of array
            Frame (-1: none), row and column of each reading, to be broadcast to (lines, fields).
        fields : sequence of int
            Fields of the readings.
        shape : tuple of int
            Rows and columns of the panel.
        timing : callable or None
            See `Frames`.
        note : str
            Note on the layout.
        """
        for field in fields:
            self.refuse(self.words[:, field], field, f"{{0!r}} is no number (field {field + 1} of the line)")
        index = np.arange(len(self.lines))[:, None] * self.width + np.array(fields)
        frame, row, column = (np.broadcast_to(part, index.shape) for part in at)
        check_count(self.source.source, (int(frame.max()) + 1) * shape[0] * shape[1])
        number = np.full((int(frame.max()) + 1, *shape), -1)
        chosen = frame >= 0
        number[frame[chosen], row[chosen], column[chosen]] = index[chosen]
        names = tuple(self.names[field] for field in fields)
        titles = [text for text in self.before[0] if text.split() != " ".join(self.names).split()]
        # Where the readings' own names are silent, titles and the quantities beside the cells speak.
        beside = (name for field, name in enumerate(self.names) if field not in fields and names_pressure(name))
        words = names if any(map(names_unit, names)) else (*filter(states_unit, titles), *beside)
        words = words or tuple(f"values [{unit}]" for unit in self.stated_pressures)

        def named(at: int) -> str:
            return self.source.source if at < 0 else self.place(*divmod(at, self.width))

        return Frames(self.values.ravel(), number, named, timing, (*self.notes, note), words)

    @property
    def stated_pressures(self) -> list[str]:
        """Units of pressure that lines without readings state."""
        others = np.setdiff1d(np.arange(len(self.source.lines)), self.lines)
        texts = dict.fromkeys(" ".join(self.source.lines[line].texts) for line in others.tolist())
        return [unit for text in texts if (unit := pressures_in(text))][:1]

    def refuse(self, bad: NDArray[np.bool_], field: int, why: str) -> None:
        """Raise InputError with the place of the first bad line; `why` is a template for the field's text."""
        for line in np.flatnonzero(bad).tolist():
            raise InputError(f"{self.place(line, field)}: {why.format(self.fields[line, field][:40] or 'nothing')}")

    def timing(self, columns: Sequence[int], lines: Sequence[int]) -> Timing:
        """Return the times of frames from columns (date and time of day may be two), otherwise from stamps."""
        if not columns:
            stamps = [self.source.lines[self.lines[line]].stamp for line in lines]
            return self._timing(stamps, "", lines, None, "the terminal's, ") if all(stamps) else None
        dates = [column for column in columns if role_of(self.names[column]) == "date"]
        chosen = [*dates[:1], *[column for column in columns if column not in dates][:1]]
        texts = [" ".join(self.fields[line, chosen]) for line in lines]
        name = self.names[chosen[-1]]
        return self._timing(texts, name, lines, chosen[-1], f"column {name!r} in " if name else "first field in ")

    def title_timing(self, begins: Sequence[int], title: str | None) -> Timing:
        """Return the times of frames from titles of a kind before each block; None if a block has none."""
        before = [self.before[line] for line in begins]
        time_texts = [" ".join(text for text in passed if title in (None, kind_of(text))) for passed in before]
        matches = [TITLE_TIME.search(text or " ".join(passed)) for text, passed in zip(time_texts, before, strict=True)]
        texts = [match["stamp"] or match["value"].rstrip(".,") for match in matches if match]
        if len(texts) < len(begins) or not matches[0]:
            return None
        name = matches[0]["inner"] or matches[0]["unit"] or matches[0]["word"] or ""
        # Titles may have a decimal comma where readings are whole numbers; '0,120' is no 120.
        comma = any(text.startswith("0,") or number_of(text, comma=False) is None for text in texts)
        comma = comma and not any(map(is_stamp, texts))
        return self._timing(texts, name, begins, None, "before each block in ", comma=comma)

    def _timing(
        self,
        texts: Sequence[str],
        name: str,
        lines: Sequence[int],
        field: int | None,
        origin: str,
        *,
        comma: bool = False,
    ) -> Timing:
        return lambda unit: clock_of(
            texts, name, lambda at: self.place(lines[at], field), comma=self.comma or comma, unit=unit
        ).read_from(origin)


def kind_of(text: str) -> str:
    """Return a line with '#' in place of its numbers, which is the same for the titles of all frames."""
    return NUMBER.sub("#", text)


def readings_table(source: FieldLines, layout: str | None = None) -> ReadingsTable:
    """Return the lines with readings, their header, and notes on omitted lines.

    `layout` contains names of the columns, separated by commas, in place of the file's. Raises InputError if there are
    no readings, if a line has more fields than the others, or if the layout has another number of columns.
    """
    fields = source.fields
    counts = source.counts
    comment = source.comment
    if fields.size == 0 or np.all(comment):
        raise InputError(f"{source.source}: holds no values")
    comma = has_decimal_comma([text for text in fields[~comment].ravel()[:SAMPLED] if text])
    broken = np.array([DAMAGED in text for text in fields.flat], dtype=bool).reshape(fields.shape)
    numbers = [np.nan if DAMAGED in text else number_of(text, comma=comma) for text in fields.flat]
    values = np.array(numbers, dtype=float).reshape(fields.shape)
    words = np.array([number is None for number in numbers], dtype=bool).reshape(fields.shape)
    # Lines with readings, and their width: the usual number of fields without empty ones at the end.
    data = _data_lines(source, words)
    often = Counter(counts[data].tolist())
    usual = max(often, key=lambda count: (often[count], count), default=0)
    # A damaged byte in a line with one field less was a separator: the fields on both sides of it are missing.
    joined = data & broken.any(axis=1) & (counts == usual - 1)
    if np.any(joined):
        fields, values, words, broken = (part.copy() for part in (fields, values, words, broken))
        for line in np.flatnonzero(joined).tolist():
            field = int(np.argmax(broken[line]))
            for part in (fields, values, words, broken):
                part[line, field + 1 :] = part[line, field:-1].copy()
    data &= ~broken.any(axis=1) | (counts == usual) | joined
    width = usual
    while width > 1 and np.all(fields[data & (counts == usual), width - 1] == ""):
        width -= 1
    # The header may widen the table; a repeated header, and lines cut at the beginning, are no readings.
    header = _header_line(fields, data, width)
    if header is not None:
        width = max(width, min(usual, 1 + int(np.flatnonzero(fields[header] != "")[-1])))
        differs = np.any(fields != fields[header], axis=1)  # a restarted board repeats the header
        data &= differs
    else:
        data[: int(np.argmax(data & (counts == usual)))] = False  # a terminal opened in the middle of a line
        differs = np.ones(len(data), dtype=bool)
    if not np.any(data):
        raise InputError(f"{source.source}: holds a header but no values")
    long = data & np.any(fields[:, width:] != "", axis=1)
    if np.any(long):
        line = int(np.argmax(long))
        usual_line = int(np.argmax(data & ~long))
        mismatch = f"{counts[line]} fields, where {source.called(usual_line)} has {width}"
        raise InputError(f"{source.at(source.lines[line].number, None)}: {mismatch}")
    notes = [note for note in [", ".join((*source.notes, *(["decimal commas"] if comma else [])))] if note]
    names, units = ([""] * width, False) if header is None else _names(fields[:, :width], header)
    if header is not None:
        differs[header - units] = False
        above = ", with the names of the line above" if units else ""
        of_records = source.lines[header].number == 0  # of records, whose names are no line
        notes.append(
            f"{source.word}s name their fields" if of_records else f"{source.called(header)} taken as header{above}"
        )
    damaged = data & broken.any(axis=1)
    if np.any(damaged):
        numbers_of_lines = [source.lines[line].number for line in np.flatnonzero(damaged).tolist()]
        notes.append(
            f"bytes that are no text: their fields in {source.word} {first_and_more(numbers_of_lines)} are missing"
        )
    excluded = np.flatnonzero(~data & differs & ~comment & np.any(fields != "", axis=1))
    if len(excluded):
        shown = " ".join(fields[excluded[0]]).strip()[:40]
        named = first_and_more([source.lines[line].number for line in excluded.tolist()])
        called = f"lines {named} (the first: {shown!r})" if len(excluded) > 1 else f"line {named} ({shown!r})"
        notes.append(f"left out: {called.replace('line', source.word)}, no readings or cut off")
    if layout is not None:
        names = [name.strip() for name in layout.split(",")]
        if len(names) != width:
            single = "" if len(names) > 1 else f", {layout!r}, which is no import format either"
            raise InputError(f"{source.source}: {width} columns, but `layout` names {len(names)}{single}")
    places = np.arange(len(data)), np.arange(fields.shape[1]), fields, values, words
    table = ReadingsTable(source, *places, comma, ("",) * fields.shape[1], tuple(notes)).only(data, slice(width))
    table = replace(table, names=tuple(names))
    skipped = [field for field, name in enumerate(names) if name == "-"] if layout is not None else []
    if not skipped:
        return table
    note = f"fields {first_and_more([field + 1 for field in skipped])} left out, as `layout` says"
    kept = [field for field in range(width) if field not in skipped]
    return replace(table.only(columns=kept), notes=(*notes, note))


def _names(fields: NDArray[Any], header: int) -> tuple[list[str], bool]:
    """Return the names of columns, and whether the header holds units only; the line above then holds the names."""
    names = [text.lstrip("#% ") for text in fields[header]]
    above = fields[header - 1] if header else np.full(len(names), "")
    named = not np.any((above == "") & (fields[header] != ""))
    units = named and all(parted(f"x {name}")[1] for name in names if name)
    return [f"{name} {unit}".strip() for name, unit in zip(above, names, strict=True)] if units else names, units


def _data_lines(source: FieldLines, words: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether a line has a number or a word for a missing one, and few other words, boolean (lines,)."""
    fields = source.fields
    filled = source.fields != ""
    strange = {text for text in set(fields[words].tolist()) if not is_stamp(text) and line_of(text) is None}
    foreign = np.zeros(len(fields), dtype=int)
    total = filled.sum(axis=1)
    np.add.at(foreign, np.nonzero(words)[0], [text in strange for text in fields[words]])
    few = ((foreign <= 1) & (2 * foreign < total)) | (4 * foreign < total)
    alone = source.counts.max() <= 2 or np.median(source.counts[~source.comment]) == 1
    few &= (source.counts > 1) | alone  # dashes or a number alone are titles, unless most lines are such
    return np.asarray(few & ~source.comment & (filled & ~words).any(axis=1))


def _header_line(fields: NDArray[Any], data: NDArray[np.bool_], width: int) -> int | None:
    """Return the header: the first data line if it names or counts the fields, or the line before it if that does."""
    first = int(np.argmax(data))
    following = fields[first + 1, 0] if first + 1 < len(fields) else ""
    if width > 4 and [*fields[first, :width]] == [*map(str, range(width))] and following != str(width):
        return first  # pandas names columns by numbers
    if _names_fields(fields[first]):
        return first
    names: list[int] = np.flatnonzero(fields[first - 1] != "").tolist() if first else []
    complete = width > 1 and len(names) >= width - 1 and names[-1] >= width - 1
    texts = [text for text in fields[first - 1] if text]
    named = all(number_of(text, comma=False) is None for text in texts) or _names_fields(fields[first - 1])
    return first - 1 if complete and named else None


def _names_fields(texts: Sequence[str]) -> bool:
    """Return whether texts are words, or an empty field, before or after the numbers 0, 1, 2 ... or 1, 2, 3 ..."""
    numbers = [text for text in texts if text.isdecimal()]
    words = [text for text in texts if text and not text.isdecimal()]
    counted = [list(map(str, range(start, start + len(numbers)))) for start in (0, 1)]
    plain = not any(text[0].isdigit() or text[0] in "-+." for text in words)
    return len(numbers) > 1 and numbers in counted and plain and (len(words) > 0 or texts[0] == "")
