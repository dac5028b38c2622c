"""What stands in series with two-point readings, line by line."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lampest.panel.panel import Array, Panel
from lampest.panel.readouts.lines import PerLine, check_resistors, per_line


@dataclass(frozen=True)
class SeriesPerLine:
    """What stands in series with every line: with a reading of row j and column k, rows[j] + columns[k].

    rows, columns : ohm, one number for each line, or one for all of a side. Raises ValueError where one is negative.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    rows: PerLine
    columns: PerLine

    def __post_init__(self) -> None:
        check_resistors("rows", self.rows, open_end=False)
        check_resistors("columns", self.columns, open_end=False)

    def ohm(self, panel: Panel) -> Array:
        """(rows, columns) ohm. Raises ValueError where a list has another length."""
        row = per_line("series_resistance_ohm.rows", self.rows, panel.rows)
        return np.asarray(row[:, None] + per_line("series_resistance_ohm.columns", self.columns, panel.columns))
