"""Sheets of Excel's .xlsx files as lines of fields."""

import datetime
import warnings
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files.errors import InputError
from lampest.recording.foreign.archive import check_archive
from lampest.recording.foreign.table import Rows

MOST_CELLS = 10_000_000


def sheets_of(path: Path, wanted: str | None) -> dict[str, Rows]:
    """Name → lines of every sheet that holds anything, or of the wanted one, in the file's order.

    Read row by row: pandas' reader fills a sheet up to its last corner, of which a few bytes may claim 10¹⁰ cells.
    Raises InputError where the file is no readable .xlsx, or has no such sheet.
    """
    check_archive(path, ".xlsx")
    with _workbook(path) as book:
        names = [str(sheet.title) for sheet in book.worksheets]
        if wanted is not None and wanted not in names:
            raise InputError(f"{path}: no sheet '{wanted}'; there are {', '.join(names) or 'none'}")
        chosen = [sheet for sheet in book.worksheets if wanted in (None, sheet.title)]
        sheets = {str(sheet.title): _rows(path, sheet) for sheet in chosen}
    return {name: rows for name, rows in sheets.items() if len(rows.counts)}


@contextmanager
def _workbook(path: Path) -> Iterator[Any]:
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


def _rows(path: Path, sheet: Any) -> Rows:
    """The rows that hold anything; what comes after the last value of a row counts for nothing."""
    sheet.reset_dimensions()  # what a file says of its size may be wrong
    lines: list[list[str]] = []
    numbers: list[int] = []
    cells = 0
    for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
        texts = [_text(value) for value in row]
        while texts and not texts[-1]:
            texts.pop()
        if texts:
            cells += len(texts)
            lines.append(texts)
            numbers.append(number)
        if cells > MOST_CELLS or number > MOST_CELLS:
            raise InputError(f"{path}: sheet {sheet.title}: more than {MOST_CELLS} values are not imported")
    width = max(map(len, lines), default=0)
    if len(lines) * width > 2 * MOST_CELLS:
        raise InputError(f"{path}: sheet {sheet.title}: {len(lines)} × {width} values are not imported")
    fields = np.full((len(lines), width), "", dtype=object)
    for line, texts in enumerate(lines):
        fields[line, : len(texts)] = texts

    def place(line: int, field: int | None) -> str:
        return f"{path}: {sheet.title}!{'' if field is None else _letters(field)}{numbers[line]}"

    return Rows(
        f"{path}: sheet {sheet.title}",
        fields,
        np.array([len(texts) for texts in lines], dtype=np.intp),
        np.array([texts[0].startswith(("#", "%")) and len(texts) == 1 for texts in lines], dtype=bool),
        np.diff(np.array([0, *numbers])) > 1,
        ("",) * len(lines),
        place,
        lambda line: f"row {numbers[line]}",
        (f"sheet {sheet.title}",),
    )


def _text(value: Any) -> str:
    """A cell as a text file would have it; all digits of a number."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value)
    if isinstance(value, float):
        return repr(value).removesuffix(".0")
    if isinstance(value, datetime.datetime):
        return value.isoformat(sep=" ")
    if isinstance(value, datetime.timedelta):
        return repr(value.total_seconds())
    return str(value).strip()


def _letters(field: int) -> str:
    """0 → A, 25 → Z, 26 → AA: what Excel calls a column."""
    letters = ""
    while field >= 0:
        letters, field = chr(ord("A") + field % 26) + letters, field // 26 - 1
    return letters
