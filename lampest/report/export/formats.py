"""Export formats: one long table (CSV, Parquet) and labelled arrays (MATLAB 5, Zarr)."""

import json
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path
from typing import Any, ClassVar
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError, extra
from lampest.report.compare import write_rows
from lampest.report.words import no_formula
from lampest.runs.case import CaseResult, Cases, all_columns
from lampest.runs.columns import CELLS, FRAMES, Column

MAX_SHEET_ROWS = 1_048_576  # of Excel
# Types of XML Schema by numpy's letter.
CSV_KINDS = {"f": "double", "i": "integer", "u": "integer", "b": "boolean"}
NAMES = ("recording", "estimator")
Values = np.ma.MaskedArray[Any, Any]
Table = Mapping[str, Values]  # name → values, masked where they are missing


@dataclass(frozen=True)
class Export(ABC):
    """An export format.

    Attributes
    ----------
    kind : str
        Name on the command line.
    suffix : str
        Suffix of the file.
    beside : str
        Suffix of a second file for metadata; '' for none.

    >>> from lampest.report.export.formats import CsvExport
    >>> issubclass(CsvExport, lampest.Export)
    True
    """

    kind: ClassVar[str]
    suffix: ClassVar[str]
    beside: ClassVar[str] = ""

    @abstractmethod
    def write(self, cases: Cases, name: str, path: Path, beside: Path | None) -> None:
        """Write the cases into the empty file `path`, and metadata into `beside`.

        `name` is the final name of `path`. Raises InputError for a missing library or cases that do
        not fit the format.
        """


class CsvExport(Export):
    """UTF-8, commas, one line of names; missing values are empty; see `no_formula`.

    Metadata are in a second file, in JSON by the recommendation
    https://www.w3.org/TR/tabular-metadata/: units, meanings, flags, and the configuration and scene
    of every case.
    """

    kind = "csv"
    suffix = ".csv"
    beside = "-metadata.json"

    def write(self, cases: Cases, name: str, path: Path, beside: Path | None) -> None:
        """Write the table and its metadata."""
        assert beside is not None
        tables, meanings = long_tables(cases)
        with path.open("w", encoding="utf-8", newline="") as file:
            write_rows(file, [meanings])
            for table in tables:
                lists = {column: values.tolist() for column, values in table.items()}
                known = (lists.get(column, repeat(None)) for column in meanings)
                write_rows(file, zip(*known, strict=False))  # the repeated ones have no end
        columns = [
            {
                "name": column,
                "datatype": CSV_KINDS.get(np.dtype(meaning.dtype).kind, "string"),
                "dc:description": meaning.long_name,
                "schema:unitText": meaning.units,
            }
            | ({"schema:valueReference": _words(meaning)} if meaning.flags else {})
            for column, meaning in meanings.items()
        ]
        content = {
            "@context": "http://www.w3.org/ns/csvw",
            "url": name,
            "tableSchema": {"columns": columns},
            "notes": [case.attributes for case in cases],
        }
        beside.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


class ExcelExport(Export):
    """A sheet for each case: the table, with a line of names.

    A sheet `columns` has units, meanings and flags.

    Raises InputError for a case of more lines than a sheet of Excel holds.
    """

    kind = "xlsx"
    suffix = ".xlsx"

    def write(self, cases: Cases, name: str, path: Path, beside: Path | None) -> None:
        """Write the book."""
        with extra("tables"):
            import openpyxl
        tables, meanings = long_tables(cases)
        longest = max(case.measured.size for case in cases)
        if longest >= MAX_SHEET_ROWS:
            limit = f"a sheet of Excel holds {MAX_SHEET_ROWS:,}"
            raise InputError(
                f"{name}: {longest:,} lines, and {limit}; export fewer frames, or parquet"
            )
        book = openpyxl.Workbook(write_only=True)
        about_columns = book.create_sheet("columns")
        about_columns.append(["column", "unit", "meaning", "values"])
        for column, meaning in meanings.items():
            flags = ", ".join(f"{value}: {word}" for value, word in _words(meaning).items())
            about_columns.append([column, meaning.units, meaning.long_name, flags])
        for number, (case, table) in enumerate(zip(cases, tables, strict=True), 1):
            title = re.sub(r"[\[\]:*?/\\']", "_", f"{number} {case.recording} {case.estimator}")
            sheet = book.create_sheet(title[:31])
            sheet.append(list(table))
            for values in zip(*(column.tolist() for column in table.values()), strict=True):
                # Infinite numbers are words.
                cells = (f"{value}" if value in (np.inf, -np.inf) else value for value in values)
                sheet.append(list(map(no_formula, cells)))
        book.save(path)


class ParquetExport(Export):
    """The table with its types; units, meanings and flags are metadata of the columns.

    The metadata of the schema hold the cases as JSON under `lampest`.
    """

    kind = "parquet"
    suffix = ".parquet"

    def write(self, cases: Cases, name: str, path: Path, beside: Path | None) -> None:
        """Write the table."""
        with extra("export"):
            import pyarrow
            from pyarrow import parquet
        tables, meanings = long_tables(cases)
        parts = [
            pyarrow.table(
                {
                    column: pyarrow.array(values.data, mask=np.ma.getmaskarray(values))
                    for column, values in columns.items()
                }
            )
            for columns in tables
        ]
        table = pyarrow.concat_tables(parts, promote_options="default")
        fields = []
        for field in table.schema:
            meaning = meanings[field.name]
            about = {"units": meaning.units, "long_name": meaning.long_name}
            about |= {"flags": json.dumps(_words(meaning))} if meaning.flags else {}
            fields.append(field.with_metadata(about))
        known = {b"lampest": json.dumps([case.attributes for case in cases]).encode()}
        parquet.write_table(table.cast(pyarrow.schema(fields, known)), path, compression="zstd")


def _words(meaning: Column) -> dict[str, str]:
    """Return value → word of a flag."""
    return {str(value): word for value, word in meaning.flags}


def long_tables(cases: Cases) -> tuple[list[Table], dict[str, Column]]:
    """Return a table of each case, with a line for every cell of every frame.

    Names end in their unit: time_s, x_mm, cell_resistance_ohm; those of counts, flags and texts
    have none. So readings in ohm and in volt are two columns. Whole numbers stay whole numbers
    where some are missing.

    Returns
    -------
    tables : list of dict
        Masked arrays of each case by the names of the columns.
    meanings : dict of str to Column
        Unit and meaning of every column, by name.
    """
    dtypes = {
        column.label: np.dtype(column.dtype) for column in all_columns() if column.dtype is not str
    }
    tables = list[Table]()
    meanings = {word: Column(word, FRAMES, "1", f"name of the {word}", dtype=str) for word in NAMES}
    for case in cases:
        table = {
            word: np.ma.masked_array(np.full(case.measured.size, getattr(case, word), object))
            for word in NAMES
        }
        for label, column in case.long_columns().items():
            name = label if column.units == "1" else f"{label}_{column.units}"
            values = np.asarray(column.values)
            missing = values != values  # NaN
            dtype = dtypes.get(label, values.dtype)
            filled = np.where(missing, 0, values) if missing.any() else values
            table[name] = np.ma.masked_array(filled.astype(dtype), missing)
            meanings[name] = replace(column, dtype=dtype.type)
        tables.append(table)
    return tables, meanings


class MatlabExport(Export):
    """`cases{1}.cell_resistance` is frames × rows × columns.

    `cases{1}.units.cell_resistance` is 'ohm'. `long_name` contains the meanings in words,
    `flags.open_cell.values` and `.meanings` the values of a flag with their meanings, and `y` and
    `x` the positions in mm of the lines in `row` and `column`. Texts of frames are cell arrays.
    """

    kind = "mat"
    suffix = ".mat"

    def write(self, cases: Cases, name: str, path: Path, beside: Path | None) -> None:
        """Write a cell array of structs, since cases may hold different columns."""
        from scipy.io import savemat
        from scipy.io.matlab import MatWriteError

        held = {"cases": _cells([_struct(case) for case in cases]).reshape(1, -1)}
        try:
            with path.open("wb") as file:
                savemat(file, held, long_field_names=True, do_compression=True, oned_as="column")
        except (ValueError, MatWriteError) as error:
            raise InputError(f"{name}: does not fit a MATLAB 5 file ({error})") from error


def _struct(case: CaseResult) -> dict[str, Any]:
    """Return a case as a struct of MATLAB: texts, values, places, units, meanings and flags."""
    held = case.variables()
    places = case.coordinates
    columns = held | places
    flags = {
        name: {
            "values": np.array([value for value, _ in column.flags]),
            "meanings": _cells([word for _, word in column.flags]),
        }
        for name, column in columns.items()
        if column.flags
    }
    values = {
        name: _cells(column.values) if column.dtype is str else column.stored
        for name, column in held.items()
    }
    return {
        **case.attributes,
        **values,
        **{name: column.values for name, column in places.items()},
        "units": {name: column.units for name, column in columns.items() if name not in CELLS},
        "long_name": {name: column.long_name for name, column in held.items()},
        "flags": flags,
    }


def _cells(values: Sequence[Any]) -> NDArray[Any]:
    """Return a MATLAB cell array of shape (items, 1)."""
    cells = np.empty((len(values), 1), dtype=np.object_)
    cells[:, 0] = [*values]
    return cells


class ZarrExport(Export):
    """Groups recording/estimator, as `xarray.open_datatree` reads them.

    The call is `xarray.open_datatree(zarr.storage.ZipStore(path), engine="zarr")`. Version 2 of the
    format, which every library for zarr reads; one zip archive, because a folder of thousands of
    files cannot appear whole.
    """

    kind = "zarr"
    suffix = ".zarr.zip"

    def write(self, cases: Cases, name: str, path: Path, beside: Path | None) -> None:
        """Write the zip archive."""
        with extra("export"):
            from xarray import DataTree
            from zarr.storage import MemoryStore
        tree = DataTree.from_dict(
            {f"/{case.recording}/{case.estimator}": case.to_xarray() for case in cases}
        )
        # Zarr writes some keys several times, and an archive would keep them all.
        held: dict[str, Any] = {}
        tree.to_zarr(MemoryStore(held), mode="w", zarr_format=2)
        with ZipFile(path, "w") as archive:
            for key in sorted(held):
                archive.writestr(ZipInfo(key), held[key].to_bytes())


def write_parquet(
    path: Path, columns: Mapping[str, Sequence[object]], meanings: Mapping[str, str]
) -> None:
    """Write columns of plain values, None where there is none, with meanings.

    Raises InputError without pyarrow.
    """
    with extra("export"):
        import pyarrow
        from pyarrow import parquet
    table = pyarrow.table({name: list(values) for name, values in columns.items()})
    fields = [field.with_metadata({"long_name": meanings[field.name]}) for field in table.schema]
    parquet.write_table(table.cast(pyarrow.schema(fields)), path, compression="zstd")


def write_matlab(path: Path, name: str, columns: Mapping[str, Sequence[object]]) -> None:
    """Write columns of plain values as a structure of MATLAB 5; None is NaN, or '' among words."""
    from scipy.io import savemat

    arrays = {}
    for column, values in columns.items():
        words = any(isinstance(value, str) for value in values)
        blank = "" if words else np.nan
        known = [blank if value is None else value for value in values]
        arrays[column] = np.array(known, dtype=object if words else float)[:, None]
    savemat(path, {name: arrays})
