"""The columns of results. To add one: write its `Column` into a file here, name it in COLUMNS.

A package adds columns by naming them in the entry point group `lampest.columns`, a script by handing them to
`case_result`, `write_results` and `read_results`. All of them are filled, checked, written and read alike.
"""

from collections.abc import Sequence

from lampest.files.errors import InputError
from lampest.files.typed import installed
from lampest.runs.columns.column import CELLS, FRAMES, MAPS, Column, Figures, of_steps
from lampest.runs.columns.shipped import CERTAINTY, ESTIMATE, FIGURES, FRAME, GIVEN, MEASURED, PRESSURE, TIME

__all__ = [
    "CELLS",
    "COLUMNS",
    "FIGURES",
    "FRAME",
    "FRAMES",
    "GIVEN",
    "MAPS",
    "MEASURED",
    "TIME",
    "Column",
    "Figures",
    "all_columns",
    "of_steps",
]
COLUMNS = (*GIVEN, *ESTIMATE, *CERTAINTY, *PRESSURE)


def all_columns(further: Sequence[Column] = ()) -> tuple[Column, ...]:
    """Those of lampest, those of installed packages, and further ones. Raises InputError where a name comes twice."""
    columns = (*COLUMNS, *installed("lampest.columns", Column), *further)
    for names in ([column.name for column in columns], [column.path for column in columns]):
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two columns of results are called {name}")
    return columns
