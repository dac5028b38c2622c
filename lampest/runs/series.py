"""What a case holds, each with its units and meaning, as files, labelled arrays, tables and exports have it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from lampest.files.hdf5 import ascii_array
from lampest.panel.scene import scene_text
from lampest.recording.recording import coordinates
from lampest.runs.columns import FIGURES, FRAMES, MAPS, Column

if TYPE_CHECKING:
    from lampest.runs.case import CaseResult


@dataclass(frozen=True, eq=False)
class Series:
    """One thing that a case holds, as files, labelled arrays, tables and exports have it.

    axes : time, row, column. values : an array over them, or texts. flags : what each value means where values are no
    amounts. shared : True for what was measured. path : of the dataset in its group.
    """

    name: str
    axes: tuple[str, ...]
    values: Any
    units: str
    long_name: str
    flags: tuple[tuple[int, str], ...] = ()
    shared: bool = False
    dtype: type[Any] = np.float64
    path: str = ""

    @property
    def stored(self) -> Any:
        """The values with texts in ASCII, and 0 and 1 for truth values."""
        if self.dtype is str:
            return ascii_array(self.values)
        return np.asarray(self.values).astype(np.uint8 if self.dtype is bool else self.dtype)

    @property
    def meaning(self) -> str:
        """The long name, with what each value of a flag means."""
        flags = "; ".join(f"{value}: {word.replace('_', ' ')}" for value, word in self.flags)
        return f"{self.long_name} ({flags})" if flags else self.long_name

    @property
    def attributes(self) -> dict[str, Any]:
        """Units, long name, and flags as the CF conventions have them (section 3.5)."""
        said = {"units": self.units, "long_name": self.long_name}
        if not self.flags:
            return said
        values = np.array([value for value, _ in self.flags], dtype=np.uint8 if self.dtype is bool else self.dtype)
        return said | {"flag_values": values, "flag_meanings": " ".join(word for _, word in self.flags)}


def series_of(case: CaseResult, columns: Sequence[Column], raw: bool = False) -> dict[str, Series]:
    """Every column and figure that the case holds, by name, in its readout's unit; a cost is called cost_misfit.

    raw : as files have it; otherwise a flag is NaN where a cell has no estimate.
    """
    held: dict[str, Series] = {}
    missing = np.isnan(case.cell_resistance)
    for column in (column.of(case.scene.circuit) for column in columns):
        if (values := case.column(column.name)) is not None:
            flagged, dtype = column.flags and column.axes == MAPS and not column.shared, column.dtype
            if flagged and not raw and missing.any():
                values, dtype = np.where(missing, np.nan, values), np.float64
            words = column.units, column.long_name, column.flags, column.shared, dtype, column.path
            held[column.label] = Series(column.label, column.axes, values, *words)
    for folder in FIGURES:
        for figure, values in getattr(case, folder.name).items():
            name, units, meaning = f"{folder.folder}_{figure}", folder.units(figure), folder.long_name(figure)
            held[name] = Series(name, FRAMES, values, units, meaning, path=f"{folder.folder}/{figure}")
    return held


def places_of(case: CaseResult) -> dict[str, Series]:
    """row and column, y and x in mm."""
    return {
        name: Series(name, along, values, units, words, dtype=values.dtype.type, path=name)
        for name, (along, values, units, words) in coordinates(case.scene.panel).items()
    }


def about(case: CaseResult) -> dict[str, Any]:
    """What is no column: names, the resolved case and the scene as YAML, sentences; texts all."""
    names = {"recording": case.recording, "estimator": case.estimator, "scene": scene_text(case.scene)}
    held = {name: getattr(case, field) for name, (field, _) in attributes_of(case).items()}
    texts = {name: text for name, text in held.items() if text and isinstance(text, str)}
    started = {"start_time": case.start_time} if case.start_time else {}
    return names | texts | started | {f"{library}_version": text for library, text in sorted(case.versions.items())}


def attributes_of(case: type[CaseResult] | CaseResult) -> dict[str, tuple[str, Any]]:
    """Attribute of an estimator's group → the field that it is, and its value where the attribute is not there."""
    named = ((item, item.metadata.get("attribute")) for item in fields(case))
    return {name: (item.name, item.default) for item, name in named if name}
