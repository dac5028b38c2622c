"""The public names, once.

Editors, type checkers and `lazy_loader` read them from here.
"""

import collections.abc
import typing

from .apps.foreign.arrays import Layout as Layout
from .apps.foreign.importing import import_file as import_file
from .cost.losses import Absolute as Absolute
from .cost.losses import Huber as Huber
from .cost.losses import Loss as Loss
from .cost.losses import Squared as Squared
from .cost.losses import Student as Student
from .cost.problem import Data as Data
from .cost.terms import Arrival as Arrival
from .cost.terms import CellResistance as CellResistance
from .cost.terms import Gradient as Gradient
from .cost.terms import GradientOfRelativeChange as GradientOfRelativeChange
from .cost.terms import LogGradient as LogGradient
from .cost.terms import LogRatio as LogRatio
from .cost.terms import Misfit as Misfit
from .cost.terms import RelativeChange as RelativeChange
from .cost.terms import State as State
from .cost.terms import Term as Term
from .cost.terms import TotalVariation as TotalVariation
from .cost.terms import TotalVariationOfChange as TotalVariationOfChange
from .cost.terms import Weight as Weight
from .cost.terms import term_types as term_types
from .estimate.estimates import Estimates as Estimates
from .estimate.estimator import Estimator as Estimator
from .estimate.estimator import Tare as Tare
from .estimate.estimator import Verify as Verify
from .estimate.methods import MethodName
from .estimate.methods.approximate import LinearisedMethod as LinearisedMethod
from .estimate.methods.approximate import TruncatedMethod as TruncatedMethod
from .estimate.methods.approximate import UncorrectedMethod as UncorrectedMethod
from .estimate.methods.method import Method as Method
from .estimate.methods.method import OptimalMethod as OptimalMethod
from .estimate.methods.smoother import SmootherMethod as SmootherMethod
from .estimate.own_program import OwnProgram as OwnProgram
from .estimate.own_program import program as program
from .estimate.own_solution import OwnSolution as OwnSolution
from .estimate.state import Step as Step
from .estimate.stream import Stream as Stream
from .estimate.weights import AutoWeight as AutoWeight
from .files.errors import InputError as InputError
from .formulation.constraints import EqualCells as EqualCells
from .formulation.constraints import KnownCells as KnownCells
from .formulation.constraints import ProgramPart as ProgramPart
from .formulation.constraints import part_types as part_types
from .inference.circuits.model_check import ModelCheck as ModelCheck
from .panel.circuit import Diode as Diode
from .panel.circuit import Ends as Ends
from .panel.circuit import Terminations as Terminations
from .panel.circuit import scanned as scanned
from .panel.conditions import Experiment as Experiment
from .panel.conditions import MeasuredSubject as MeasuredSubject
from .panel.conditions import Temperature as Temperature
from .panel.conditions import Water as Water
from .panel.effects import SharedEffect as SharedEffect
from .panel.effects.line_effect import LineEffect as LineEffect
from .panel.faults import Faults as Faults
from .panel.lines import SeriesPerLine as SeriesPerLine
from .panel.panel import Array as Array
from .panel.panel import Panel as Panel
from .panel.readouts import Readout as Readout
from .panel.readouts import TwoPointReadout as TwoPointReadout
from .panel.readouts.converter import Characteristic as Characteristic
from .panel.readouts.driven_readout import DrivenReadout as DrivenReadout
from .panel.readouts.floating import two_point_resistance as two_point_resistance
from .panel.readouts.grounded import GroundedReadout as GroundedReadout
from .panel.readouts.loaded_columns import LoadedColumnsReadout as LoadedColumnsReadout
from .panel.readouts.virtual_ground import VirtualGroundReadout as VirtualGroundReadout
from .panel.readouts.wiring import ContactPrior as ContactPrior
from .panel.readouts.wiring import Contacts as Contacts
from .panel.readouts.wiring import Lines as Lines
from .panel.readouts.wiring import NeighbourLeaks as NeighbourLeaks
from .panel.response import Film as Film
from .panel.response import PowerResponse as PowerResponse
from .panel.response import PublishedResponse as PublishedResponse
from .panel.response import TableResponse as TableResponse
from .panel.scene import Scene as Scene
from .panel.scene import read_scene as read_scene
from .panel.sizes import Systematic as Systematic
from .recording import datasets as datasets
from .recording.readings import Readings as Readings
from .recording.recording import MEASURED as MEASURED
from .recording.recording import UNLOADED as UNLOADED
from .recording.recording import Recording as Recording
from .recording.shapes import Block as Block
from .recording.shapes import OralDisc as OralDisc
from .recording.shapes import Ring as Ring
from .recording.shapes import Rod as Rod
from .recording.shapes import Shape as Shape
from .recording.shapes import SuctionCup as SuctionCup
from .recording.simulation import Cells as Cells
from .recording.simulation import Course as Course
from .recording.simulation import Simulation as Simulation
from .recording.simulation import Unmodelled as Unmodelled
from .recording.simulation import read_simulations as read_simulations
from .recording.simulation import simulate as simulate
from .report.compare import comparison as comparison
from .report.export import Export as Export
from .report.export import export_results as export_results
from .report.plots import plot_results as plot_results
from .report.plots.contours import CertaintyPlot as CertaintyPlot
from .report.plots.contours import ChangePlot as ChangePlot
from .report.plots.contours import ContourPlot as ContourPlot
from .report.plots.contours import Plot as Plot
from .report.plots.contours import PressurePlot as PressurePlot
from .report.plots.contours import ResidualPlot as ResidualPlot
from .report.plots.contours import ResistancePlot as ResistancePlot
from .report.plots.contours import SweepPlot as SweepPlot
from .report.reconstruction import Reconstruction as Reconstruction
from .runs.columns import Column as Column
from .runs.config import read_run as read_run
from .runs.results import CaseResult as CaseResult
from .runs.results import PublishedFigures as PublishedFigures
from .runs.results import Results as Results
from .runs.results import StepFigures as StepFigures
from .runs.results import read_results as read_results
from .runs.results import write_results as write_results
from .solvers.posed import Bounds as Bounds
from .solvers.solution import Outcome as Outcome
from .solvers.solution import Settings as Settings
from .solvers.solution import Solution as Solution
from .solvers.solution import Solver as Solver
from .solvers.solution import Status as Status
from .solvers.solution import approximation as approximation

__version__: str

def reconstruct(
    recording: Recording,
    terms: collections.abc.Sequence[Term] | None = None,
    *,
    formulation: MethodName | Method = "auto",
    solver: Settings | None = None,
    bounds: Bounds | None = None,
    error_bars: typing.Literal["auto"] | bool = "auto",
    auto_weight: AutoWeight | None = None,
    tare: Tare | None = None,
    verify: Verify | None = None,
    constraints: collections.abc.Sequence[ProgramPart] | None = None,
    progress: bool | collections.abc.Callable[[int, int], None] = False,
) -> Reconstruction: ...
