"""Lines and fields of texts and sheets.

The module handles encoding, separators, comments, and a terminal's time before a line, but no
readings; `lampest.apps.foreign.table` finds the lines and columns that hold some.
"""

import datetime
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.apps.foreign.arrays import check_archive, reading
from lampest.apps.foreign.clocks import is_stamp
from lampest.apps.foreign.notation import MAX_LINE, SAMPLED_LINES, Notation, stamp_and_content
from lampest.apps.foreign.words import MAX_CUT, line_of
from lampest.files.errors import InputError, counted, extra
from lampest.panel.panel import Mask, Numbers

DAMAGED = "\ufffd"  # in place of a byte that no text holds
# Share of such bytes; a serial line loses one now and then, and binary files have many more. They
# are in more than a few lines: a board that starts at another rate damages the first ones alone.
MAX_DAMAGED = 0.01
# Letters of Western Europe in words, and µ and ° before a unit, in the single bytes that Excel
# writes on Windows.
WINDOWS_WORDS = re.compile(
    rb"(?<=[A-Za-z])[\xc0-\xff]+|(?<![\xc0-\xff])[\xc0-\xff]+(?=[A-Za-z])|(?<!\d)[\xb0\xb5](?=[A-Za-z])"
)
# First bytes of files that are no text.
PICKLE = "a pickle, which runs code when it is opened; save the array as .npy, .json or .csv"
MARKS = {bytes([0x80, protocol]): PICKLE for protocol in range(2, 6)} | {
    b"\x93NUMPY": "NumPy's format; name it .npy",
    b"PK\x03\x04": "a zip archive; "
    "name a workbook .xlsx, NumPy's arrays .npz, and unpack others first",
    b"\x89HDF": "HDF5; save the array as .npy. lampest's own recordings need no import",
    b"\xd0\xcf\x11\xe0": "an old Excel file; save it as .xlsx",
    b"\x1f\x8b": "compressed; unpack it first",
    b"PAR1": "Parquet; name it .parquet",
}
READ = (
    "Other kinds: .xlsx, .npy, .npz, .mat, .json, .jsonl, .parquet; "
    "`layout` names a layout of your own"
)
MAX_FIELDS = 10_000_000  # 50 bytes each in memory
MATRIX_ENDS = ("]]", "]],")
MIN_LINES = 20  # with fewer, chance makes the last number the shortest one
WRITTEN = re.compile(r"[-+.,]*\d[-+.,\d]*")  # a number
# Not Excel's words for no number.
COMMENT = re.compile(r"#(?!N/?A|DIV/0!|NUM!|VALUE!|REF!)|%|//", re.IGNORECASE)


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
    apart : bool
        Whether the brackets of a matrix end before the line.
    """

    number: int
    texts: Sequence[str]
    stamp: str = ""
    apart: bool = False


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
        Whether a line is a comment, and whether an empty line or the end of a matrix precedes it.
    padded : bool
        Whether empty fields at the end of a line are left out, as those of a sheet are.
    parts : int
        Number of parts that a sign, or names of lists, make of a line.
    """

    source: str
    word: str
    at: Callable[[int, int | None], str]
    notes: tuple[str, ...]
    lines: Sequence[FieldLine]
    fields: NDArray[Any]
    counts: Numbers
    comment: Mask
    blank: Mask
    padded: bool = False
    parts: int = 1

    def called(self, line: int) -> str:
        """Return the name of a line: 'line 3'."""
        return f"{self.word} {self.lines[line].number}"


def field_lines(
    source: str,
    word: str,
    at: Callable[[int, int | None], str],
    notes: Iterable[str],
    lines: Iterable[FieldLine],
    before: int = 0,
) -> FieldLines:
    """Return lines behind those `before` as a table. Raises InputError if it is too large."""
    read = list[FieldLine]()
    total = 0
    width = 0
    for line in lines:
        read.append(line)
        total += len(line.texts)
        width = max(width, len(line.texts))
        if max(total, len(read) * width // 2) > MAX_FIELDS:
            raise InputError(
                f"{at(line.number, None)}: more than {MAX_FIELDS} fields are not imported"
            )
    fields = np.full((len(read), width), "", dtype=object)
    for row, line in zip(fields, read, strict=True):
        row[: len(line.texts)] = line.texts
    counts = np.array([len(line.texts) for line in read], dtype=np.intp)
    comment = np.array([COMMENT.match(line.texts[0]) is not None for line in read], dtype=bool)
    apart = np.array([line.apart for line in read], dtype=bool)
    blank = apart | (np.diff([before, *(line.number for line in read)]) > 1)
    return FieldLines(source, word, at, tuple(notes), read, fields, counts, comment, blank)


def lines_of_text(path: Path, skip: int = 0) -> FieldLines:
    """Return the lines of a text file behind the first `skip` ones as fields.

    Their notation is the one that the lines show.

    A last line without its end is left out unless its last field is as long as any above it. A last
    line with its end is left out if its last number is shorter than all above it.

    Raises InputError with the line if the file is no text or too large.
    """
    text, notes = _decoded(path)
    texts = re.split(r"\r\n|\r|\n", text)
    notation = notation_of(texts[skip:])
    lines = field_lines_in(notation, texts[skip:], str(path), skip)
    if skip:
        notes.append(f"the first {counted(skip, 'line')} skipped")
    if any(line.stamp for line in lines.lines):
        notes.append("a terminal's time before the lines")
    remarks = tuple(filter(None, (notation.sentence, *notes)))
    lines = replace(lines, notes=remarks, parts=notation.parts)
    cut = _is_cut if texts[-1].strip() else _ends_in_a_cut_number
    if len(lines.lines) < 2 or not cut(lines):
        return lines
    note = f"left out: line {lines.lines[-1].number}, the last one, which is cut off"
    parts = ("lines", "fields", "counts", "comment", "blank")
    whole = {name: getattr(lines, name)[:-1] for name in parts}
    return replace(lines, notes=(*remarks, note), **whole)


def _is_cut(lines: FieldLines) -> bool:
    """Return whether the last line may be cut: shorter than usual, or its last field is."""
    if lines.lines[0].number == 0 and np.any(lines.fields[-1] == ""):  # names beside the values
        return True
    count = int(lines.counts[-1])
    usual = Counter(lines.counts.tolist()).most_common(1)[0][0]
    if count < usual:
        first, *others = lines.fields[-1, :count]
        begins = WRITTEN.fullmatch(first) or is_stamp(first) or (others and line_of(first))
        return bool(begins) and all(map(WRITTEN.fullmatch, others))
    column = lines.fields[lines.counts == usual, usual - 1]
    longest = max((len(text) for text in column[:-1] if WRITTEN.fullmatch(text)), default=0)
    return count == usual and 0 < len(column[-1]) < longest


def _ends_in_a_cut_number(lines: FieldLines) -> bool:
    """Return whether the last number of the last line is shorter than those of all other lines."""
    count = lines.counts[-1]
    if len(lines.lines) < MIN_LINES or count != np.median(lines.counts):
        return False
    column = lines.fields[lines.counts == count, count - 1]
    lengths = [len(text) for text in column if WRITTEN.fullmatch(text)]
    return bool(WRITTEN.fullmatch(column[-1])) and lengths[-1] < min(lengths[:-1], default=0)


def notation_of(texts: Iterable[str]) -> Notation:
    """Return the notation of lines."""
    contents = (stamp_and_content(line)[1] for line in texts if len(line) <= MAX_LINE)
    readings = (line for line in contents if _has_content(line) and not COMMENT.match(line))
    return Notation.of(list(islice(readings, SAMPLED_LINES)))


def _has_content(content: str) -> bool:
    return content.strip(" \t;,") != ""


def field_lines_in(
    notation: Notation, texts: Sequence[str], source: str, before: int = 0, *, header: bool = True
) -> FieldLines:
    """Return lines in a known notation as fields, numbered from the lines before them on.

    A `header` has the names that stand beside the values.

    Raises InputError with the line if it is too long, or if a quotation mark is not closed.
    """

    def at(number: int, field: int | None) -> str:
        return f"{source}:{number}" + ("" if field is None else f":{field + 1}")

    def read() -> Iterator[FieldLine]:
        if notation.names and header:
            yield FieldLine(0, notation.shown)
        closed = False
        for number, line in enumerate(texts, before + 1):
            if len(line) > MAX_LINE:
                raise InputError(
                    f"{at(number, None)}: longer than {MAX_LINE} characters, which no table is"
                )
            stamp, content = stamp_and_content(line)
            if _has_content(content):
                fields = notation.fields(at(number, None), content)
                yield FieldLine(number, fields, stamp, closed or content.startswith("[["))
                closed = content.endswith(MATRIX_ENDS)

    return field_lines(source, "line", at, (), read(), before)


def _decoded(path: Path) -> tuple[str, list[str]]:
    """Return the text of a file in UTF-8 or UTF-16, and notes on the encoding.

    UTF-16 is recognised by its mark or its zero bytes.
    """
    data = path.read_bytes()
    for mark, kind in MARKS.items():
        if data.startswith(mark):
            raise InputError(f"{path}: no text table, but {kind}")
    count = max(data.count(b"\n"), data.count(b"\r"))
    if count > MAX_FIELDS:
        raise InputError(f"{path}: {count} lines, more than {MAX_FIELDS} are not imported")
    encoding = "utf-8"
    if data[:2] == b"\xff\xfe" or data[1:2] == b"\0":
        encoding = "utf-16-le"
    elif data[:2] == b"\xfe\xff" or data[:1] == b"\0":
        encoding = "utf-16-be"
    wide = encoding != "utf-8"
    data = data[: len(data) // 2 * 2] if wide else data
    text = data.decode(encoding, errors="replace").removeprefix("\ufeff").replace("\0", DAMAGED)
    damaged = text.count(DAMAGED)
    if damaged and not wide and not data.isascii() and WINDOWS_WORDS.sub(b"", data).isascii():
        return data.decode("cp1252", errors="replace"), ["Windows-1252"]
    lines = re.split(r"\r\n|\r|\n", text)
    share = sum(DAMAGED in line for line in lines) / len(lines)
    if damaged > max(1, MAX_DAMAGED * len(text)) and share > MAX_CUT:
        line = text.count("\n", 0, text.index(DAMAGED)) + 1
        wrong = f"{damaged} of {len(text)} bytes are no text"
        raise InputError(
            f"{path}:{line}: no text table ({wrong}; text is read in UTF-8 and UTF-16). {READ}"
        )
    return text, ["UTF-16"] if wide else []


def lines_of_sheets(path: Path, name: str | None) -> dict[str, FieldLines]:
    """Return the lines of every nonempty sheet, or of the named one, by name in the file's order.

    Sheets are read row by row, because a few bytes may claim 10¹⁰ cells. Raises
    InputError if the file is no readable .xlsx, has no such sheet, or has a sheet that is too
    large.
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
        if name is not None and name not in sheets:
            raise InputError(f"{path}: no sheet '{name}'; there are {', '.join(sheets) or 'none'}")
        tables = {}
        for title in sheets if name is None else [name]:

            def at(number: int, field: int | None, title: str = title) -> str:
                letters = "" if field is None else openpyxl.utils.get_column_letter(field + 1)
                return f"{path}: {title}!{letters}{number}"

            rows = _rows_of_sheet(sheets[title])
            lines = field_lines(f"{path}: sheet {title}", "row", at, [f"sheet {title}"], rows)
            tables[title] = replace(lines, padded=True)
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
    text = "" if value is None else str(value).strip()
    return text.removesuffix(".0") if isinstance(value, float) else text
