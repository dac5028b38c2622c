"""All cases as one long table: CSV with its columns explained in a file beside it, and Parquet."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lampest.files.errors import extra
from lampest.report.export.export import Export
from lampest.runs.case import CaseResult, about
from lampest.runs.columns import all_columns

if TYPE_CHECKING:
    from lampest.runs.case import DataFrame

# numpy's whole numbers → those of pandas that may be missing.
WHOLE = {"int8": "Int8", "uint8": "UInt8", "int64": "Int64", "bool": "boolean"}
CSV_KINDS = {"f": "double", "i": "integer", "u": "integer", "b": "boolean"}  # of XML Schema, by numpy's letter


@dataclass(frozen=True)
class Meaning:
    """What a column of the table means; flags : what each of its values means, where they are no amounts."""

    units: str
    long_name: str
    flags: tuple[tuple[int, str], ...] = ()

    @property
    def words(self) -> dict[str, str]:
        """Value → word of a flag."""
        return {str(value): word for value, word in self.flags}


LINES = {
    "recording": Meaning("1", "name of the recording"),
    "estimator": Meaning("1", "name of the estimator"),
    "row": Meaning("1", "row line"),
    "column": Meaning("1", "column line"),
    "y": Meaning("mm", "position of the row"),
    "x": Meaning("mm", "position of the column"),
}


class CsvExport(Export):
    """UTF-8, commas, one line of names; missing values are empty.

    Beside it stands what a table cannot hold, in JSON by the recommendation https://www.w3.org/TR/tabular-metadata/:
    units, meanings, flags, and for every case its configuration and its scene.
    """

    kind: ClassVar[str] = "csv"
    suffix: ClassVar[str] = ".csv"
    beside: ClassVar[str] = "-metadata.json"

    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """The table; what it means."""
        assert beside is not None
        table, meanings = long_table(cases)
        table.to_csv(path, index=False, lineterminator="\n", encoding="utf-8")
        columns: list[dict[str, Any]] = [
            {
                "name": name,
                "datatype": CSV_KINDS.get(table[name].dtype.kind, "string"),
                "dc:description": meanings[name].long_name,
                "schema:unitText": meanings[name].units,
            }
            | ({"schema:valueReference": meanings[name].words} if meanings[name].flags else {})
            for name in table.columns
        ]
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
        """The table."""
        with extra("export"):
            import pyarrow
            from pyarrow import parquet
        frame, meanings = long_table(cases)
        table = pyarrow.Table.from_pandas(frame, preserve_index=False)
        fields = []
        for field in table.schema:
            meaning = meanings[field.name]
            flags = {"flags": json.dumps(meaning.words)} if meaning.flags else {}
            fields.append(field.with_metadata({"units": meaning.units, "long_name": meaning.long_name} | flags))
        known = {**table.schema.metadata, b"lampest": json.dumps([about(case) for case in cases]).encode()}
        parquet.write_table(table.cast(pyarrow.schema(fields, known)), path, compression="zstd")


def long_table(cases: Sequence[CaseResult]) -> tuple["DataFrame", Mapping[str, Meaning]]:
    """One line for every cell of every frame of every case, with recording and estimator, and its columns' meanings.

    Names end in their unit: time_s, x_mm, cell_resistance_ohm; those of counts, flags and texts have none. So readings
    in ohm and in volt are two columns. What a case does not hold is missing; whole numbers stay whole numbers.
    """
    from pandas import concat

    tables: list[DataFrame] = []
    meanings: dict[str, Meaning] = {}
    for case in cases:
        columns = [column.of(case.scene.circuit) for column in all_columns()]
        known = LINES | {one.label: Meaning(one.units, one.long_name, one.flags) for one in columns}
        kinds = {one.label: np.dtype(one.dtype).name for one in columns}
        table = case.to_dataframe()
        table.attrs = {}
        table.insert(0, "recording", case.recording)
        table.insert(1, "estimator", case.estimator)
        kinds = {name: kinds.get(name, kind.name) for name, kind in table.dtypes.items()}
        whole = {name: WHOLE[kind] for name, kind in kinds.items() if kind in WHOLE}
        names = {name: with_unit(name, known[name].units) for name in table.columns}
        meanings |= {names[name]: known[name] for name in table.columns}
        tables.append(table.astype(whole).rename(columns=names))
    return concat(tables, ignore_index=True), meanings


def with_unit(name: str, unit: str) -> str:
    """The name of a column with its unit behind it, none for pure numbers."""
    return name if unit == "1" else f"{name}_{unit}"
