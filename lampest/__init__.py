"""Cell resistances of passive resistive matrix sensors from readings with crosstalk.

    import lampest
    recording = lampest.Recording.load("data/lamprey_35mm.h5")
    found = lampest.reconstruct(recording, [lampest.Misfit(), lampest.Gradient(weight=1e-3)])
    found.cell_resistance  # (frames, rows, columns) ohm
    found.relative_change  # percent of the unloaded panel
    found.plot()

Names are loaded when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    __version__: str

    # The public names, once for editors, type checkers and `__getattr__`, which reads them from here.
    from lampest.cost.losses import Absolute as Absolute
    from lampest.cost.losses import Huber as Huber
    from lampest.cost.losses import Loss as Loss
    from lampest.cost.losses import Squared as Squared
    from lampest.cost.losses import Student as Student
    from lampest.cost.problem import Data as Data
    from lampest.cost.terms import Arrival as Arrival
    from lampest.cost.terms import CellResistance as CellResistance
    from lampest.cost.terms import Gradient as Gradient
    from lampest.cost.terms import GradientOfRelativeChange as GradientOfRelativeChange
    from lampest.cost.terms import LogGradient as LogGradient
    from lampest.cost.terms import LogRatio as LogRatio
    from lampest.cost.terms import Misfit as Misfit
    from lampest.cost.terms import RelativeChange as RelativeChange
    from lampest.cost.terms import State as State
    from lampest.cost.terms import Term as Term
    from lampest.cost.terms import TotalVariation as TotalVariation
    from lampest.cost.terms import TotalVariationOfChange as TotalVariationOfChange
    from lampest.cost.terms import term_types as term_types
    from lampest.estimate.advice import Suggestion as Suggestion
    from lampest.estimate.estimates import Estimates as Estimates
    from lampest.estimate.estimator import AutoWeight as AutoWeight
    from lampest.estimate.estimator import Bounds as Bounds
    from lampest.estimate.estimator import Estimator as Estimator
    from lampest.estimate.methods import MethodName
    from lampest.estimate.methods.approximate import LinearisedMethod as LinearisedMethod
    from lampest.estimate.methods.approximate import TruncatedMethod as TruncatedMethod
    from lampest.estimate.methods.approximate import UncorrectedMethod as UncorrectedMethod
    from lampest.estimate.methods.method import Method as Method
    from lampest.estimate.methods.method import OptimalMethod as OptimalMethod
    from lampest.estimate.methods.smoother import SmootherMethod as SmootherMethod
    from lampest.estimate.model_check import ModelCheck as ModelCheck
    from lampest.estimate.state import Step as Step
    from lampest.estimate.stream import Stream as Stream
    from lampest.files.errors import InputError as InputError
    from lampest.loads.pressure import Tare as Tare
    from lampest.loads.shapes import Block as Block
    from lampest.loads.shapes import OralDisc as OralDisc
    from lampest.loads.shapes import Ring as Ring
    from lampest.loads.shapes import Rod as Rod
    from lampest.loads.shapes import Shape as Shape
    from lampest.loads.shapes import SuctionCup as SuctionCup
    from lampest.panel.panel import Array as Array
    from lampest.panel.panel import Panel as Panel
    from lampest.panel.readouts import GroundedReadout as GroundedReadout
    from lampest.panel.readouts import LoadedColumnsReadout as LoadedColumnsReadout
    from lampest.panel.readouts import Readout as Readout
    from lampest.panel.readouts import TwoPointReadout as TwoPointReadout
    from lampest.panel.readouts import VirtualGroundReadout as VirtualGroundReadout
    from lampest.panel.readouts.driven import Diode as Diode
    from lampest.panel.readouts.floating import two_point_resistance as two_point_resistance
    from lampest.panel.readouts.wiring import ContactPrior as ContactPrior
    from lampest.panel.readouts.wiring import Contacts as Contacts
    from lampest.panel.readouts.wiring import Lines as Lines
    from lampest.panel.response import Film as Film
    from lampest.panel.response import PowerResponse as PowerResponse
    from lampest.panel.response import PublishedResponse as PublishedResponse
    from lampest.panel.response import TableResponse as TableResponse
    from lampest.panel.scene import Experiment as Experiment
    from lampest.panel.scene import Faults as Faults
    from lampest.panel.scene import MeasuredSubject as MeasuredSubject
    from lampest.panel.scene import Scene as Scene
    from lampest.panel.scene import SeriesPerLine as SeriesPerLine
    from lampest.panel.scene import Systematic as Systematic
    from lampest.panel.scene import Temperature as Temperature
    from lampest.panel.scene import Water as Water
    from lampest.panel.scene import read_scene as read_scene
    from lampest.recording import datasets as datasets
    from lampest.recording.foreign.arrays import Layout as Layout
    from lampest.recording.foreign.importing import import_file as import_file
    from lampest.recording.readings import Readings as Readings
    from lampest.recording.recording import MEASURED as MEASURED
    from lampest.recording.recording import UNLOADED as UNLOADED
    from lampest.recording.recording import Recording as Recording
    from lampest.recording.simulation import Cells as Cells
    from lampest.recording.simulation import Course as Course
    from lampest.recording.simulation import Simulation as Simulation
    from lampest.recording.simulation import Unmodelled as Unmodelled
    from lampest.recording.simulation import read_simulations as read_simulations
    from lampest.recording.simulation import simulate as simulate
    from lampest.report.compare import comparison as comparison
    from lampest.report.export import Export as Export
    from lampest.report.export import export_results as export_results
    from lampest.report.plots import plot_results as plot_results
    from lampest.report.plots.contours import CertaintyPlot as CertaintyPlot
    from lampest.report.plots.contours import ChangePlot as ChangePlot
    from lampest.report.plots.contours import ContourPlot as ContourPlot
    from lampest.report.plots.contours import Plot as Plot
    from lampest.report.plots.contours import PressurePlot as PressurePlot
    from lampest.report.plots.contours import ResidualPlot as ResidualPlot
    from lampest.report.plots.contours import ResistancePlot as ResistancePlot
    from lampest.report.plots.contours import SweepPlot as SweepPlot
    from lampest.report.reconstruction import Reconstruction as Reconstruction
    from lampest.runs.columns import Column as Column
    from lampest.runs.config import read_run as read_run
    from lampest.runs.results import CaseResult as CaseResult
    from lampest.runs.results import PublishedFigures as PublishedFigures
    from lampest.runs.results import Results as Results
    from lampest.runs.results import StepFigures as StepFigures
    from lampest.runs.results import read_results as read_results
    from lampest.runs.results import write_results as write_results
    from lampest.solvers.solution import Outcome as Outcome
    from lampest.solvers.solution import Settings as Settings
    from lampest.solvers.solution import Solution as Solution
    from lampest.solvers.solution import Solver as Solver
    from lampest.solvers.solution import Status as Status
    from lampest.solvers.solution import approximation as approximation
else:
    import ast
    from importlib import import_module
    from pathlib import Path

    _HOMES = {
        alias.name: node.module
        for node in ast.walk(ast.parse(Path(__file__).read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname == alias.name
    }
    __all__ = [*_HOMES, "reconstruct"]

    def __getattr__(name: str) -> object:
        if name == "__version__":
            return import_module("importlib.metadata").version("lampest")
        if name == "datasets":  # a module, and not yet an attribute of its room
            return import_module(f"{_HOMES[name]}.{name}")
        if name in _HOMES:
            with import_module("lampest.files.errors").extra():
                return getattr(import_module(_HOMES[name]), name)
        raise AttributeError(f"module 'lampest' has no attribute '{name}'")

    def __dir__() -> list[str]:
        return sorted([*__all__, "__all__", "__doc__", "__version__"])


def reconstruct(
    recording: Recording,
    terms: Sequence[Term] | None = None,
    *,
    formulation: MethodName | Method = "auto",
    solver: Settings | None = None,
    bounds: Bounds | None = None,
    error_bars: Literal["auto"] | bool = "auto",
    auto_weight: AutoWeight | None = None,
    tare: Tare | None = None,
    progress: bool | Callable[[int, int], None] = False,
) -> Reconstruction:
    """Estimate the cells of every measured frame, r̂ = argmin Σ weight·loss(residual) within the bounds.

    Parameters
    ----------
    recording : Recording
        Frames and scene, as `Recording.load`, `simulate` and `import_file` return them.
    terms : sequence of Term, or None
        Cost terms, such as [Misfit(), Gradient(weight=1e-3)]; a penalty without a weight has 'auto'. None stands for
        [Misfit(weighting="noise"), LogGradient()], with a plain misfit where the noise is unknown.
    formulation : str or Method
        Computation of the estimate: a word, or a method with its options such as TruncatedMethod(steps=4). 'auto':
        nodal or reduced, by the panel's size and the time between frames.
    solver : Settings, or None
        None stands for Settings().
    bounds : Bounds, or None
        None stands for Bounds().
    error_bars : 'auto' or bool
        'auto' computes them for panels of up to 600 cells whose noise is known.
    auto_weight : AutoWeight, or None
        None stands for AutoWeight().
    tare : Tare, or None
        When the zero of pressures is taken anew; None: never.
    progress : bool or callable
        True draws a bar with the numbers of finished and of all frames and the remaining time. A function is called
        after every frame with both numbers.

    Returns
    -------
    Reconstruction
        With arrays such as `cell_resistance`, (frames, rows, columns) ohm, and `relative_change`, percent.

    Raises
    ------
    InputError
        If an argument is of another type, or recording and estimator do not fit.

    Examples
    --------
    >>> found = lampest.reconstruct(recording, [lampest.Misfit(), lampest.Gradient(weight=1e-3)])
    >>> found.cell_resistance.shape
    (2, 2, 3)
    """
    from lampest.estimate.estimator import Estimator
    from lampest.estimate.objective import checked_terms
    from lampest.estimate.sequence import default_terms
    from lampest.report.reconstruction import Reconstruction

    options: dict[str, Any] = {"solver": solver, "bounds": bounds, "auto_weight": auto_weight, "tare": tare}
    estimator = Estimator(
        default_terms(recording) if terms is None else checked_terms(terms),
        formulation,
        error_bars=error_bars,
        **{name: value for name, value in options.items() if value is not None},
    )
    if progress is not True:
        return Reconstruction.of(recording, estimator, progress or (lambda done, frames: None))
    from lampest.cli.screen import progress as progress_bar

    with progress_bar("frames", counted=True) as on_frame:
        return Reconstruction.of(recording, estimator, on_frame)
