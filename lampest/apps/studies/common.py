"""Common parts of studies.

The parts are methods, panels, a lamprey's mouth, timed frames, and clocks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from time import perf_counter, process_time
from timeit import Timer
from typing import Any, NamedTuple, TypeVar

import numpy as np

from lampest.apps.studies.study import column, named_values
from lampest.cost.terms import Term, term_types
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import MethodName
from lampest.estimate.methods.method import Method
from lampest.estimate.state import Step
from lampest.estimate.stream import Stream
from lampest.files.document import read_document, validated
from lampest.files.errors import InputError
from lampest.files.typed import Configuration, check_range
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.wiring import Lines
from lampest.panel.scene import Scene
from lampest.recording.datasets import folder as shipped_folder
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.shapes import AnyShape, OralDisc
from lampest.recording.simulation.file import read_simulations
from lampest.recording.simulation.simulation import Simulation
from lampest.recording.stored import joined
from lampest.runs.config import Terms, named_members
from lampest.solvers.posed import Bounds
from lampest.solvers.solution import STRICT, Settings

CONFIGS = shipped_folder() / "configs"
MAX_SIDE = 1000  # of a simulated panel
Shape = tuple[int, int]
Sizes = tuple[int | Shape, ...]  # sides of square panels, or [rows, columns]


@dataclass(frozen=True)
class StudyMethod(Configuration):
    """Terms and bounds of a method, as in a run file. Raises ValueError without a term."""

    terms: Terms  # type: ignore[valid-type]
    bounds: Bounds = Bounds()

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError("a method needs at least one term")

    @property
    def parts(self) -> tuple[Term, ...]:
        """Terms in order."""
        return named_members(self.terms, term_types())

    def estimator(
        self, formulation: MethodName | Method, solver: Settings, **options: Any
    ) -> Estimator:
        """Return the method in a formulation, with further options of an estimator."""
        return Estimator(self.parts, formulation, solver=solver, bounds=self.bounds, **options)


def paper_methods() -> dict[str, StudyMethod]:
    """Return the five methods of the paper with its weights.

    The methods are read from the shipped run of the paper's Table I.
    """
    run = read_document(CONFIGS / "table1.yaml")
    content = run.content["estimators"].items()
    return {name: validated(replace(run, content=entry), StudyMethod) for name, entry in content}


def shapes_of(sizes: Sizes) -> tuple[Shape, ...]:
    """Return (rows, columns) of every panel."""
    return tuple((size, size) if isinstance(size, int) else size for size in sizes)


def check_sides(shapes: Sequence[Shape], low: int, high: int) -> None:
    """Raise ValueError unless all rows and columns are in a range and all panels differ."""
    check_range("a panel's side", [side for shape in shapes for side in shape], low, high)
    if len(set(shapes)) < len(shapes):
        raise ValueError("sizes names a panel twice")


@cache
def shipped_lamprey() -> Simulation:
    """Return the shipped simulation of a lamprey that breathes.

    Circuit, mouth and course of studies are its own.
    """
    [(_, simulation)] = read_simulations(CONFIGS / "lamprey_35mm.yaml")
    return simulation


def lamprey_mouth(centre_mm: tuple[float, float], diameter_mm: float = 35.0) -> AnyShape:
    """Return the mouth of the shipped lamprey, 35 mm wide with a rim of 6 mm, scaled and moved."""
    [mouth] = shipped_lamprey().loads
    assert isinstance(mouth, OralDisc)
    rim_width_mm = diameter_mm * mouth.rim_width_mm / mouth.diameter_mm
    return replace(mouth, centre_mm=centre_mm, diameter_mm=diameter_mm, rim_width_mm=rim_width_mm)


def simple_scene(shape: Shape, readout: TwoPointReadout, lines: Lines | None = None) -> Scene:
    """Return a scene of a readout, with the series resistance of the shipped lamprey.

    Apart from the circuit, the scene states no effects.
    """
    return Scene(Panel(*shape), readout, shipped_lamprey().scene.series_resistance_ohm, lines=lines)


Result = TypeVar("Result")
MIN_GAP = 1e-12  # less is rounding


@dataclass(frozen=True, kw_only=True)
class TimedFrame:
    """One frame of a recording, solved in sequence with one method by one solver or formulation."""

    rows: int = column("1", "row lines")
    columns: int = column("1", "column lines")
    recording: str = column("1", "recording")
    method: str = column("1", "method")
    solver: str = column("1", "solver or formulation")
    frame: int = column("1", "frame in sequence, 0: the first")
    seconds: float = column("s", "time of the solve, wall or processor's, the least of all turns")
    objective: float = column("1", "cost, the same function for all solvers of a frame")
    gap: float = column(
        "1", "objective above the best of all solvers, relative; NaN: there was no other"
    )
    iterations: int = column("1", "iterations of the solver")
    solved: bool = column("1", "1: solved, 0: failed")
    status: str = column("1", "how the solve ended")

    @property
    def shape(self) -> Shape:
        """(rows, columns)."""
        return self.rows, self.columns

    @property
    def verified(self) -> bool:
        """Whether the optimum was verified."""
        return self.status in {strict.value for strict in STRICT}


class Pushed(NamedTuple):
    """Result of a frame pushed through a stream: next stream, step, seconds of the solve."""

    stream: Stream
    step: Step
    seconds: float

    @property
    def objective(self) -> float:
        """Final cost; infinite for a failed solve."""
        return self.step.solution.objective if self.step.solution.solved else np.inf


def pushed(stream: Stream, readings: Readings) -> Pushed:
    """Solve the readings of a frame, timed as by `clocked`."""
    (after, step), seconds = clocked(lambda: stream.push(readings))
    return Pushed(after, step, min(seconds, step.seconds))


def outcome(recording: Recording, step: Step) -> dict[str, Any]:
    """Return the fields of a frame's record that come from its recording and its step."""
    about = {"recording": recording.name, "status": step.status}
    panel = named_values(recording.scene.panel, "rows", "columns")
    return about | panel | named_values(step.solution, "iterations", "solved")


def clocked(call: Callable[[], Result]) -> tuple[Result, float]:
    """Call a function and measure its time.

    Returns
    -------
    result
        Result of the call.
    seconds : float
        The lesser of wall time and processor time.
    """
    wall = perf_counter()
    processor = process_time()
    result = call()
    return result, min(perf_counter() - wall, process_time() - processor)


def inverse_time(matrix: Array) -> float:
    """Return the processor's seconds of one dense inverse, the least of three measurements.

    Every measurement repeats the inverse for 1 ms or more.
    """
    count = max(1, 50_000 // matrix.size)
    return min(Timer(lambda: np.linalg.inv(matrix), timer=process_time).repeat(3, count)) / count


def first_frames(recording: Recording, count: int) -> Recording:
    """Return the unloaded and the first measured frames.

    Raises InputError with fewer than two measured ones.
    """
    measured = recording.measured_frames()[:count]
    if len(measured) < 2:
        raise InputError(f"{recording.name}: a trade-off needs at least two measured frames")
    chosen = recording.role == UNLOADED
    chosen[measured] = True
    return joined((recording,), chosen)
