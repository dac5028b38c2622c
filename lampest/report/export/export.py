"""What a format for other programs is, and what of a case every format writes."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lampest.runs.case import CaseResult
from lampest.runs.columns import FIGURES, FRAMES, all_columns


@dataclass(frozen=True)
class Export(ABC):
    """One format.

    kind : the word that asks for it. suffix : of its files. beside : the suffix of a second file for what the first
    cannot hold; '' for none.

    >>> from lampest.report.export.tables import CsvExport
    >>> issubclass(CsvExport, lampest.Export)
    True
    """

    kind: ClassVar[str]
    suffix: ClassVar[str]
    beside: ClassVar[str] = ""

    @abstractmethod
    def write(self, cases: Sequence[CaseResult], name: str, path: Path, beside: Path | None) -> None:
        """Write the cases into the empty file `path`, and what that cannot hold into `beside`.

        name : that `path` will have once it is whole. Raises InputError where a library is missing, or the cases do not
        fit the format.
        """


@dataclass(frozen=True, eq=False)
class Series:
    """One thing that a case holds.

    axes : of `runs.columns`, time, row, column. values : an array over them, or a tuple of texts. flags : what each
    value means where values are no amounts. shared : True for what was measured.
    """

    name: str
    axes: tuple[str, ...]
    values: Any
    units: str
    long_name: str
    flags: tuple[tuple[int, str], ...] = ()
    shared: bool = False

    @property
    def is_text(self) -> bool:
        """Whether its values are texts."""
        return isinstance(self.values, tuple)

    @property
    def meaning(self) -> str:
        """The long name, with what each value of a flag means."""
        flags = "; ".join(f"{value}: {word.replace('_', ' ')}" for value, word in self.flags)
        return f"{self.long_name} ({flags})" if flags else self.long_name


def series_of(case: CaseResult) -> list[Series]:
    """Every column and figure that the case holds, in its readout's unit; a cost is called cost_misfit.

    Flags of cells without an estimate are NaN.
    """
    held = []
    for column in all_columns():
        values, column = case.shown(column), column.of(case.scene.circuit)
        if values is not None:
            missing = np.asarray(values).dtype.kind == "f"
            stored = tuple(values) if column.dtype is str else values if missing else column.stored(values)
            said = column.units, column.long_name, column.flags, column.shared
            held.append(Series(column.label, column.axes, stored, *said))
    return held + [
        Series(f"{folder.folder}_{name}", FRAMES, np.asarray(values), folder.units(name), folder.long_name(name))
        for folder in FIGURES
        for name, values in getattr(case, folder.name).items()
    ]
