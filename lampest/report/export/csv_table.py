"""CSV: a line for every cell of every frame, its columns explained beside it as CSV on the Web has them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lampest.report.export.export import Export
from lampest.report.export.table import Meaning, long_table
from lampest.runs.case import CaseResult
from lampest.runs.labelled import about

if TYPE_CHECKING:
    from lampest.runs.labelled import DataFrame

KINDS = {"f": "double", "i": "integer", "u": "integer", "b": "boolean"}


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
        told = {
            "@context": "http://www.w3.org/ns/csvw",
            "url": name,
            "tableSchema": {"columns": [_column(name, table, meanings) for name in table.columns]},
            "notes": [about(case) for case in cases],
        }
        beside.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


def _column(name: str, table: "DataFrame", meanings: Mapping[str, Meaning]) -> dict[str, Any]:
    meaning = meanings[name]
    told = {
        "name": name,
        "datatype": KINDS.get(table[name].dtype.kind, "string"),
        "dc:description": meaning.long_name,
        "schema:unitText": meaning.units,
    }
    words = {str(value): word for value, word in meaning.flags}
    return told | ({"schema:valueReference": words} if words else {})
