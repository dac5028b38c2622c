"""Parquet: the same table with its types; units, meanings and flags stand in every column's metadata."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from lampest.files.extras import extra
from lampest.report.export.export import Export
from lampest.report.export.table import Meaning, long_table
from lampest.runs.case import CaseResult
from lampest.runs.labelled import about


class ParquetExport(Export):
    """The schema's metadata has the cases as JSON under `lampest`."""

    kind: ClassVar[str] = "parquet"
    suffix: ClassVar[str] = ".parquet"

    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """The table."""
        with extra("export"):
            import pyarrow
            from pyarrow import parquet
        frame, meanings = long_table(cases)
        table = pyarrow.Table.from_pandas(frame, preserve_index=False)
        fields = [field.with_metadata(_told(meanings[field.name])) for field in table.schema]
        told = {**table.schema.metadata, b"lampest": json.dumps([about(case) for case in cases]).encode()}
        parquet.write_table(table.cast(pyarrow.schema(fields, told)), path, compression="zstd")


def _told(meaning: Meaning) -> dict[str, str]:
    words = json.dumps({str(value): word for value, word in meaning.flags})
    return {"units": meaning.units, "long_name": meaning.long_name} | ({"flags": words} if meaning.flags else {})
