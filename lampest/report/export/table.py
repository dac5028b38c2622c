"""All cases as one long table, and what its columns mean."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lampest.runs.case import CaseResult
from lampest.runs.columns import all_columns

if TYPE_CHECKING:
    from lampest.runs.labelled import DataFrame

# numpy's whole numbers → those of pandas that may be missing.
WHOLE = {"int8": "Int8", "uint8": "UInt8", "int64": "Int64", "bool": "boolean"}
LINES = {
    "recording": ("1", "name of the recording"),
    "estimator": ("1", "name of the estimator"),
    "row": ("1", "row line"),
    "column": ("1", "column line"),
    "y": ("mm", "position of the row"),
    "x": ("mm", "position of the column"),
}


@dataclass(frozen=True)
class Meaning:
    """What a column of the table means; flags : what each of its values does, where they are no amounts."""

    units: str
    long_name: str
    flags: tuple[tuple[int, str], ...] = ()


def long_table(cases: Sequence[CaseResult]) -> tuple["DataFrame", Mapping[str, Meaning]]:
    """One line for every cell of every frame of every case, with recording and estimator, and its columns' meanings.

    Names end in their unit: time_s, x_mm, cell_resistance_ohm; those of counts, flags and texts have none. So readings
    in ohm and in volt are two columns. What a case does not hold is missing; whole numbers stay whole numbers.
    """
    from pandas import concat

    tables: list[DataFrame] = []
    meanings: dict[str, Meaning] = {}
    for case in cases:
        known = _meanings(case)
        table = case.to_dataframe()
        table.attrs = {}
        table.insert(0, "recording", case.recording)
        table.insert(1, "estimator", case.estimator)
        whole = {name: WHOLE[kind.name] for name, kind in table.dtypes.items() if kind.name in WHOLE}
        names = {name: with_unit(name, known[name].units) for name in table.columns}
        meanings |= {names[name]: known[name] for name in table.columns}
        tables.append(table.astype(whole).rename(columns=names))
    return concat(tables, ignore_index=True), meanings


def with_unit(name: str, unit: str) -> str:
    """The name of a column with its unit behind it, none for pure numbers."""
    return name if unit == "1" else f"{name}_{unit}"


def _meanings(case: CaseResult) -> dict[str, Meaning]:
    columns = [column.of(case.scene.circuit) for column in all_columns()]
    return {name: Meaning(*words) for name, words in LINES.items()} | {
        column.name: Meaning(column.units, column.long_name, column.flags) for column in columns
    }
