"""Estimates for notebooks: with plots, files, labelled arrays and tables.

Each method imports the libraries that it needs; access to the cells loads none.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import extra
from lampest.panel.panel import Array
from lampest.recording.recording import Recording

if TYPE_CHECKING:
    from lampest.inference.circuits.model_check import ModelCheck
    from lampest.report.plots.contours import Axes, Figure, Plot
    from lampest.runs.case import CaseResult, DataFrame, Dataset
    from lampest.runs.columns import Column

INTERNAL = {"of", "tared"}  # attributes that the package's own columns read


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Estimates):
    """Estimated cell resistances of the measured frames of a recording.

    Arrays are those of `Estimates`: `cell_resistance` (frames, rows, columns) in ohm,
    `relative_change` in percent of the unloaded panel, `pressure` in kPa, each with `_errors`,
    `_lower` and `_upper`. `status` is the outcome of each solve.

    Methods take `name`, the name of the estimator in files and plots (by default its terms, `misfit
    + gradient`), and `columns`, your own columns. Methods raise InputError for an unfit name and
    for values that do not fit their column.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> estimate
    Reconstruction(mine: misfit, auto, 2 of 2 frames solved, the first: local optimum verified)
    """

    @classmethod
    def of(
        cls,
        recording: Recording,
        estimator: Estimator,
        on_frame: Callable[[int, int], None] = lambda done, frames: None,
    ) -> Self:
        """Solve every measured frame of a recording.

        `on_frame` receives the numbers of solved and of all frames. Raises InputError if estimator
        and recording do not fit.
        """
        estimates = reconstruct(
            recording, estimator, lambda done, frames, so_far: on_frame(done, frames)
        )
        return cls(**{field.name: getattr(estimates, field.name) for field in fields(estimates)})

    @property
    def weights(self) -> dict[str, Array]:
        """Penalty → λ (frames), given or chosen by the data."""
        from lampest.runs.content import weights_of

        return {term: weight for term, weight in weights_of(self).items() if term != "misfit"}

    @cached_property
    def model_check(self) -> "ModelCheck":
        """Verdict on the circuit, 'yes', 'doubtful' or 'no', with the evidence against it."""
        from lampest.audit.advice import verdict

        return verdict(self.circuit_check, self.prepared)

    @property
    def advice(self) -> tuple[str, ...]:
        """Suggestions of the recording beyond its scene, with evidence and the line to add.

        The first access computes the suggestions.

        >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
        >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
        >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
        >>> recording = lampest.simulate(of_rod, "mine")
        >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
        >>> estimate.advice
        ()
        """
        from lampest.audit.advice import Audit

        return Audit(self.prepared).lines

    def __dir__(self) -> list[str]:
        return list({*super().__dir__()} - INTERNAL)

    def fit_report(self) -> str:
        """Return a summary of the fit in sections.

        The sections are model, statistics, weights, cells of the strongest frame, warnings.
        Statistics are medians over the solved frames. χ² is the sum of squared residuals over their
        variances; its reduced value is near 1 where the scene and its noise explain the readings.

        >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
        >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
        >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
        >>> recording = lampest.simulate(of_rod, "mine")
        >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
        >>> print(estimate.fit_report().splitlines()[0])
        [[Model]]
        """
        from lampest.inference.estimated import estimated_lines
        from lampest.report.compare import data_error
        from lampest.report.strongest import strongest_index
        from lampest.report.words import digits, spanned

        case = self.result()
        place = strongest_index([case])
        errors = data_error(case)[case.solved]
        residual = float(np.sqrt(np.nanmean(errors**2))) if errors.size else np.nan
        statistics = {
            "frames solved": f"{self.solved.sum()} of {len(self.steps)}",
            "readings": f"{case.valued.sum()} in {len(self.steps)} frames",
            "residual, rms": f"{digits(residual, 2)} % of the reading",
            "solve time": f"{_median(1000 * case.solve_time)} ms a frame",
        }
        if self.misfit:
            chi_square = self.misfit["chi_square"]
            statistics["chi-square"] = _median(chi_square)
            reduced = chi_square / self.misfit["degrees_of_freedom"]
            statistics["reduced chi-square"] = _median(reduced)
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
            "Estimated": list(estimated_lines(self.noise.estimated)),
            "Warnings": list(self.checks),
        }
        return "\n".join(
            "\n    ".join((f"[[{title}]]", *lines)) for title, lines in sections.items() if lines
        )

    def _repr_html_(self) -> str:
        """Return the report and a picture of the strongest frame, for notebooks."""
        report = f'<pre style="line-height: 1.3">{escape(self.fit_report())}</pre>'
        if find_spec("matplotlib") is None:
            return report
        from lampest.report.plots.style import data_uri

        source = data_uri(self.plot("change"))
        return f'{report}<img alt="change of the cells" style="max-width: 100%" src="{source}">'

    def result(self, name: str | None = None, columns: "Sequence[Column]" = ()) -> "CaseResult":
        """Return the case for a results file; `write_results` writes several into one file."""
        from lampest.runs.filling import named_result

        return named_result(self, name, columns)

    def save(
        self, path: str | Path, name: str | None = None, columns: "Sequence[Column]" = ()
    ) -> None:
        """Write a results file atomically, for `read_results` and the commands.

        Raises InputError if the place cannot be written.
        """
        from lampest.runs.results import write_results

        write_results(path, [self.result(name, columns)], columns=columns)

    def to_xarray(self, columns: "Sequence[Column]" = ()) -> "Dataset":
        """Return an xarray.Dataset over time (s), row and column, with x and y in mm.

        Units are in `attrs`.

        Raises InputError if xarray is not installed.
        """
        return self.result(columns=columns).to_xarray(columns)

    def to_dataframe(self, columns: "Sequence[Column]" = ()) -> "DataFrame":
        """Return a pandas.DataFrame with a line for every cell of every frame.

        Units are in `attrs["units"]`.
        """
        return self.result(columns=columns).to_dataframe(columns)

    def plot(
        self,
        kind: "str | Plot" = "contours",
        frame: int | None = None,
        *,
        ax: "Axes | None" = None,
        figsize: tuple[float, float] | None = None,
        vmin: float | None = None,
        vmax: float | None = None,
    ) -> "Figure":
        """Return a Matplotlib figure of a kind, or of your own Plot.

        A kind is for example `change` or `residuals`.

        Parameters
        ----------
        kind : str or Plot
        frame : int, optional
            Index into the recording; by default a frame of strong change.
        ax : Axes, optional
            Axes into which the map of the estimate alone is drawn; by default a new figure with all
            maps.
        figsize : tuple of float, optional
            Width and height of a new figure in inches.
        vmin, vmax : float, optional
            Ends of the colour scale, in its unit.

        Raises
        ------
        InputError
            For an unknown kind or frame, and if there is nothing to draw.
        """
        with extra():
            # Matplotlib takes longer to load than a frame to solve.
            from lampest.report.plots import picture

        return picture((self.result(),), kind, frame, ax, figsize, vmin=vmin, vmax=vmax)


def _median(values: Array | None) -> str:
    from lampest.report.words import median_text

    return ("" if values is None else median_text(values)) or "unknown"
