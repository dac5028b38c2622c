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
from lampest.report.compare import data_error
from lampest.report.strongest import strongest_index
from lampest.report.words import digits, spanned
from lampest.runs.columns import FIGURES, Column
from lampest.runs.filling import named_result
from lampest.runs.results import CaseResult, write_results

if TYPE_CHECKING:
    from lampest.report.plots.plot import Figure, Plot
    from lampest.runs.case import DataFrame, Dataset

INTERNAL = {"of", "asked", "tared"}  # attributes that the package's own columns read


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

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__()} - INTERNAL)

    def fit_report(self) -> str:
        """Return a summary of the fit in sections: model, statistics, weights, cells of the strongest frame, warnings.

        Statistics are medians over the solved frames. χ² is the sum of squared residuals over their variances; its
        reduced value is near 1 where the scene and its noise explain the readings.

        >>> print(found.fit_report().splitlines()[0])
        [[Model]]
        """
        case, place = self.result(), strongest_index([self.result()])
        residual = np.sqrt(np.nanmean(data_error(case)[case.solved] ** 2)) if case.solved.any() else np.nan
        statistics = {
            "frames solved": f"{int(self.solved.sum())} of {len(self.steps)}",
            "readings": f"{int(case.valued.sum())} in {len(self.steps)} frames",
            "residual, rms": f"{digits(float(residual), 2)} % of the reading",
            "solve time": f"{_median(1000 * case.solve_time)} ms a frame",
        }
        if self.misfit:
            statistics["chi-square"] = _median(self.misfit["chi_square"])
            statistics["reduced chi-square"] = _median(self.misfit["chi_square"] / self.misfit["degrees_of_freedom"])
        cells = {
            "resistance": spanned(self.cell_resistance[place], "ohm"),
            "change": spanned(self.relative_change[place], "%"),
            "errors": case.error_words or "unknown",
        }
        sections = {
            "Model": [f"{self.recording.name}: {self.method}", f"first frame: {self.status[0]}"],
            "Fit Statistics": [f"{name:18} = {value}" for name, value in statistics.items()],
            "Weights": [f"{term}: {_median(weights)}" for term, weights in self.weights.items()],
            "Chosen Weights": list(filter(None, case.chosen_weights.split(", "))),
            f"Cells in frame {self.frame[place]} at {self.time[place]:g} s": [
                f"{n:18} = {text}" for n, text in cells.items()
            ],
            "Warnings": list(self.checks),
        }
        blocks = ((f"[[{title}]]", *(f"    {line}" for line in lines)) for title, lines in sections.items() if lines)
        return "\n".join(line for block in blocks for line in block)

    def _repr_html_(self) -> str:
        """Return the report and a picture of the strongest frame, for notebooks."""
        with extra():
            from lampest.report.plots.style import data_uri
        picture = f'<img alt="change of the cells" style="max-width: 100%" src="{data_uri(self.plot("change"))}">'
        return f'<pre style="line-height: 1.3">{escape(self.fit_report())}</pre>{picture}'

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
        """A matplotlib Figure: a kind that `plot --show` takes, such as `change` or `residuals`, or a Plot of your own.

        frame : index into the recording; None: the strongest one. Raises InputError where there is no such plot or
        frame, or nothing to draw.
        """
        with extra():
            from lampest.report.plots import picture  # matplotlib takes longer to load than a frame to solve

        return picture((self.result(),), kind, frame)


def _median(values: Array | None) -> str:
    """Return the median of the known values in digits, with their range where they differ."""
    known = np.zeros(0) if values is None else values[np.isfinite(values)]
    if not known.size:
        return "unknown"
    least, middle, largest = (digits(float(value)) for value in np.percentile(known, [0, 50, 100]))
    return middle if least == largest else f"{middle} ({least} to {largest})"
