"""What a notebook gets: estimates that can be drawn, kept, and turned into labelled arrays and tables.

`Estimates` stands floors below, where neither results files nor pictures are known; what needs those is here.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import extra
from lampest.panel.panel import Array
from lampest.recording.recording import Recording
from lampest.report.info import shaded_map
from lampest.report.strongest import strongest_index
from lampest.runs.columns import FIGURES, Column
from lampest.runs.filling import named_result
from lampest.runs.results import CaseResult, write_results

if TYPE_CHECKING:
    from lampest.report.plots.plot import Figure, Plot
    from lampest.runs.case import DataFrame, Dataset


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Estimates):
    """Cell resistances of a recording's measured frames as arrays, as a file, as a table, and as pictures.

    Arrays are those of `Estimates`: `cell_resistance` (frames, rows, columns) ohm, `relative_change` in percent of the
    unloaded panel, `pressure` in kPa, each with `_errors`, `_lower` and `_upper`; `status` says how each frame ended.

    `name` is what files and pictures call the estimator; by default its terms, `misfit + gradient`. `columns` are those
    of your own, besides those of lampest and of installed packages. All methods that take them raise InputError where
    the name cannot stand in a file, or a column's values do not fit it.

    >>> found
    Reconstruction(mine: misfit, auto, 2 of 2 frames solved, the first: optimum verified)
    """

    @classmethod
    def of(
        cls,
        recording: Recording,
        estimator: Estimator,
        on_frame: Callable[[int, int], None] = lambda done, frames: None,
    ) -> Self:
        """Solve every measured frame of a recording. Raises InputError where the two do not fit.

        on_frame : called after every frame with the number of frames done, and of all.
        """
        estimates = reconstruct(recording, estimator, lambda done, frames, so_far: on_frame(done, frames))
        return cls(**{part.name: getattr(estimates, part.name) for part in fields(Estimates)})

    @property
    def weights(self) -> dict[str, Array]:
        """Term → (frames) λ of every penalty, the number that was given or the one that the data chose."""
        values: Mapping[str, Array] = next(folder for folder in FIGURES if folder.name == "weights").value(self)
        return {term: weight for term, weight in values.items() if term != "misfit"}

    def _repr_html_(self) -> str:
        """For notebooks: what was found, and a small map of the strongest frame."""
        place = strongest_index([self.result()])
        weights = [f"λ of {term}: {float(np.median(values)):.3g}" for term, values in self.weights.items()]
        where = f"change of the cells in frame {self.frame[place]} at {self.time[place]:g} s:"
        lines = "<br>".join(escape(line) for line in (repr(self), *weights, *self.checks, where))
        drawn = escape("\n".join(shaded_map(self.relative_change[place])))
        return f'<p>{lines}</p><pre style="line-height: 1">{drawn}</pre>'

    def result(self, name: str | None = None, columns: Sequence[Column] = ()) -> CaseResult:
        """The case that results files keep; several may go into one file with `write_results`."""
        return named_result(self, name, columns)

    def save(self, path: str | Path, name: str | None = None, columns: Sequence[Column] = ()) -> None:
        """Write a results file, whole or not at all; `read_results` reads it, and every command takes it.

        Raises InputError where the place cannot be written.
        """
        write_results(path, [self.result(name, columns)], columns=columns)

    def to_xarray(self, columns: Sequence[Column] = ()) -> "Dataset":
        """An xarray.Dataset over time (s), row and column, with x and y in mm; units in every variable's `attrs`.

        Raises InputError where xarray is not installed.
        """
        return self.result(columns=columns).to_xarray(columns)

    def to_dataframe(self, columns: Sequence[Column] = ()) -> "DataFrame":
        """A pandas.DataFrame of one line for every cell of every frame; units in `attrs["units"]`."""
        return self.result(columns=columns).to_dataframe(columns)

    def plot(self, kind: "str | Plot" = "contours", frame: int | None = None) -> "Figure":
        """A matplotlib Figure: `contours`, `certainty`, `pressure`, or a Plot of your own.

        frame : index into the recording; None: the strongest one. Raises InputError where there is no such plot or
        frame, or nothing to draw.
        """
        with extra():
            from lampest.report.plots import picture  # matplotlib takes longer to load than a frame to solve

        return picture((self.result(),), kind, frame)
