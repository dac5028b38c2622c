"""A case as labelled arrays of xarray, and as a long table of pandas; xarray is optional."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import extra
from lampest.panel.scene import scene_text
from lampest.runs.columns import CELLS, FIGURES, FRAME, FRAMES, MAPS, TIME, Column

if TYPE_CHECKING:
    from pandas import DataFrame as DataFrame
    from xarray import Dataset as Dataset

    from lampest.runs.case import CaseResult


def dataset_of(case: CaseResult, columns: Sequence[Column]) -> Dataset:
    """Every column and figure of a case over time, row and column, with units and long names as in results files.

    Coordinates: time (s) and frame, row and column with y and x (mm). A cost, a weight or a number of a disc goes by
    its folder and its name: cost_misfit. Raises InputError where xarray is not installed.
    """
    with extra("xarray"):
        from xarray import Dataset
    variables: dict[str, Any] = {
        column.name: (column.axes, np.asarray(values), column.attributes)
        for column, values in _held(case, columns)
        if column not in (TIME, FRAME)
    }
    for folder in FIGURES:
        for name, values in getattr(case, folder.name).items():
            variables[f"{folder.folder}_{name}"] = FRAMES, values, _said(folder.units(name), folder.long_name(name))
    return Dataset(variables, _coordinates(case), about(case))


def table_of(case: CaseResult, columns: Sequence[Column]) -> DataFrame:
    """One line for every cell of every frame: time, frame, row, column, y and x in mm, then all columns of the case.

    What only a frame or only a cell has stands in each of its lines. Units are in `attrs["units"]`, by column.
    """
    from pandas import DataFrame  # takes 0.3 s

    held = dict(_held(case, columns))
    sizes = dict(zip(MAPS, case.measured.shape, strict=True))
    lines = {axis: _lines(np.arange(sizes[axis]), (axis,), sizes) for axis in CELLS}
    x, y = case.scene.panel.centres_mm()
    lines |= {"y": _lines(y, CELLS[:1], sizes), "x": _lines(x, CELLS[1:], sizes)}
    first = {column.name: _lines(held.pop(column), FRAMES, sizes) for column in (TIME, FRAME)} | lines
    table = DataFrame(first | {column.name: _lines(values, column.axes, sizes) for column, values in held.items()})
    table.attrs = about(case) | {
        "units": {column.name: column.units for column in (TIME, FRAME)}
        | {"y": "mm", "x": "mm"}
        | {column.name: column.units for column in held}
    }
    return table


def _held(case: CaseResult, columns: Sequence[Column]) -> list[tuple[Column, Any]]:
    """The columns that the case holds, in its readout's unit, with their values."""
    fitting = (column.of(case.scene.circuit) for column in columns)
    return [(column, values) for column in fitting if (values := case.column(column.name)) is not None]


def _lines(values: Any, axes: tuple[str, ...], sizes: Mapping[str, int]) -> NDArray[Any]:
    """Values over some of the axes, one for every cell of every frame, in that order."""
    shape = [sizes[axis] if axis in axes else 1 for axis in MAPS]
    return np.broadcast_to(np.reshape(values, shape), list(sizes.values())).ravel()


def _coordinates(case: CaseResult) -> dict[str, Any]:
    x, y = case.scene.panel.centres_mm()
    return {
        "time": (FRAMES, case.time, _said(TIME.units, TIME.long_name)),
        "frame": (FRAMES, case.frame, _said(FRAME.units, FRAME.long_name)),
        "row": ("row", np.arange(len(y)), _said("1", "row line")),
        "column": ("column", np.arange(len(x)), _said("1", "column line")),
        "y": ("row", y, _said("mm", "position of the row")),
        "x": ("column", x, _said("mm", "position of the column")),
    }


def _said(units: str, long_name: str) -> dict[str, str]:
    return {"units": units, "long_name": long_name}


def about(case: CaseResult) -> dict[str, Any]:
    """What is no column: names, the resolved case and the scene as YAML, sentences; texts all."""
    told = {
        "start_time": case.start_time,
        "baseline_status": case.baseline_status,
        "model_check": case.model_sentence,
        "noise_check": case.noise_sentence,
        "noise_learned": case.noise_learned,
        "film": case.film_sentence,
    }
    names = {"recording": case.recording, "estimator": case.estimator, "case_id": case.case_id}
    texts = {"case": case.case_yaml, "scene": scene_text(case.scene)}
    versions = {f"{library}_version": text for library, text in sorted(case.versions.items())}
    return names | texts | {name: text for name, text in told.items() if text} | versions
