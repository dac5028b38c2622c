"""All cases as one long table: CSV with its columns explained in a file beside it, and Parquet."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lampest.files.errors import extra
from lampest.report.export.export import Export
from lampest.report.words import no_formula
from lampest.runs.case import CaseResult, about, places_of, series_of
from lampest.runs.columns import FRAMES, Series
from lampest.runs.held import all_columns

if TYPE_CHECKING:
    from lampest.runs.case import DataFrame

# numpy's whole numbers → those of pandas that may be missing.
WHOLE = {"int8": "Int8", "uint8": "UInt8", "int64": "Int64", "bool": "boolean"}
CSV_KINDS = {"f": "double", "i": "integer", "u": "integer", "b": "boolean"}  # of XML Schema, by numpy's letter


class CsvExport(Export):
    """UTF-8, commas, one line of names; missing values are empty; see `no_formula`.

    Beside it stands what a table cannot hold, in JSON by the recommendation https://www.w3.org/TR/tabular-metadata/:
    units, meanings, flags, and for every case its configuration and its scene.
    """

    kind: ClassVar[str] = "csv"
    suffix: ClassVar[str] = ".csv"
    beside: ClassVar[str] = "-metadata.json"

    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """Write the table and its metadata."""
        assert beside is not None
        table, meanings = long_table(cases)
        texts = {name: table[name].map(no_formula) for name in table if table[name].dtype.kind == "O"}
        table.assign(**texts).to_csv(path, index=False, lineterminator="\n", encoding="utf-8")
        columns: list[dict[str, Any]] = []
        for column, meaning in meanings.items():
            kind = CSV_KINDS.get(table[column].dtype.kind, "string")
            known = {"dc:description": meaning.long_name, "schema:unitText": meaning.units}
            flags = {"schema:valueReference": _words(meaning)} if meaning.flags else {}
            columns.append({"name": column, "datatype": kind} | known | flags)
        head = {"@context": "http://www.w3.org/ns/csvw", "url": name, "tableSchema": {"columns": columns}}
        content = head | {"notes": [about(case) for case in cases]}
        beside.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


class ParquetExport(Export):
    """The table with its types; units, meanings and flags stand in every column's metadata.

    The schema's metadata has the cases as JSON under `lampest`.
    """

    kind: ClassVar[str] = "parquet"
    suffix: ClassVar[str] = ".parquet"

    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """Write the table."""
        with extra("export"):
            import pyarrow
            from pyarrow import parquet
        frame, meanings = long_table(cases)
        table = pyarrow.Table.from_pandas(frame, preserve_index=False)
        fields = []
        for field in table.schema:
            meaning = meanings[field.name]
            flags = {"flags": json.dumps(_words(meaning))} if meaning.flags else {}
            fields.append(field.with_metadata({"units": meaning.units, "long_name": meaning.long_name} | flags))
        known = {**table.schema.metadata, b"lampest": json.dumps([about(case) for case in cases]).encode()}
        parquet.write_table(table.cast(pyarrow.schema(fields, known)), path, compression="zstd")


def _words(meaning: Series) -> dict[str, str]:
    """Value → word of a flag."""
    return {str(value): word for value, word in meaning.flags}


def long_table(cases: Sequence[CaseResult]) -> tuple["DataFrame", Mapping[str, Series]]:
    """One line for every cell of every frame of every case, with recording and estimator, and its columns' meanings.

    Names end in their unit: time_s, x_mm, cell_resistance_ohm; those of counts, flags and texts have none. So readings
    in ohm and in volt are two columns. What a case does not hold is missing; whole numbers stay whole numbers.
    """
    from pandas import concat

    tables: list[DataFrame] = []
    meanings: dict[str, Series] = {}
    for case in cases:
        table = case.to_dataframe()
        table.attrs, known = {}, places_of(case) | series_of(case, all_columns())
        for place, (word, text) in enumerate((("recording", case.recording), ("estimator", case.estimator))):
            table.insert(place, word, text)
            known[word] = Series(word, FRAMES, None, "1", f"name of the {word}")
        kinds = {name: kind.name for name, kind in table.dtypes.items()}
        kinds |= {column.label: np.dtype(column.dtype).name for column in all_columns() if column.label in kinds}
        whole = {name: WHOLE[kind] for name, kind in kinds.items() if kind in WHOLE}
        names = {name: name if known[name].units == "1" else f"{name}_{known[name].units}" for name in table.columns}
        meanings |= {names[name]: known[name] for name in table.columns}
        tables.append(table.astype(whole).rename(columns=names))
    return concat(tables, ignore_index=True), meanings
