"""MATLAB 5: a struct for every case, read by MATLAB, Octave and scipy."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.report.export.export import Export
from lampest.runs.case import CaseResult
from lampest.runs.columns import FIGURES, all_columns
from lampest.runs.labelled import about

LONGEST_FIELD = 63  # signs, of MATLAB


class MatlabExport(Export):
    """`cases{1}.cell_resistance` is frames × rows × columns; `cases{1}.units.cell_resistance` says 'ohm'.

    `long_name` has the meanings in words; `flags.open_cell.values` and `.meanings` what the values of a flag say; `y`
    and `x` the positions of rows and columns in mm; texts of frames are cells of texts.
    """

    kind: ClassVar[str] = "mat"
    suffix: ClassVar[str] = ".mat"

    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """A cell of structs, for cases need not hold the same."""
        from scipy.io import savemat
        from scipy.io.matlab import MatWriteError

        try:
            with path.open("wb") as file:
                held = {"cases": _cells([_struct(case) for case in cases]).reshape(1, -1)}
                savemat(file, held, long_field_names=True, do_compression=True, oned_as="column")
        except (ValueError, MatWriteError) as error:
            raise InputError(f"{name}: does not fit a MATLAB 5 file ({error})") from error


def _struct(case: CaseResult) -> dict[str, Any]:
    columns = [column.of(case.scene.circuit) for column in all_columns() if case.column(column.name) is not None]
    x, y = case.scene.panel.centres_mm()
    values: dict[str, Any] = {
        column.name: _cells(case.column(column.name))
        if column.dtype is str
        else column.stored(case.column(column.name))
        for column in columns
    }
    units = {column.name: column.units for column in columns} | {"x": "mm", "y": "mm"}
    names = {column.name: column.long_name for column in columns}
    for folder in FIGURES:
        for name, figures in getattr(case, folder.name).items():
            called = f"{folder.folder}_{name}"
            values[called], units[called] = np.asarray(figures), folder.units(name)
            names[called] = folder.long_name(name)
    flags = {
        column.name: {
            "values": np.array([value for value, _ in column.flags]),
            "meanings": _cells([word for _, word in column.flags]),
        }
        for column in columns
        if column.flags
    }
    told: dict[str, Any] = {"x": x, "y": y, "units": units, "long_name": names, "flags": flags}
    return about(case) | values | told


def _cells(things: Sequence[Any]) -> NDArray[Any]:
    """(things, 1) a cell each, whatever they are."""
    cells = np.empty((len(things), 1), dtype=np.object_)
    for number, thing in enumerate(things):
        cells[number, 0] = thing
    return cells
