"""A benchmark's YAML file, and the recordings that it makes for every size."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

from lampest.cost.terms import CellResistance, Gradient, GradientOfRelativeChange, Misfit, RelativeChange, Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import MethodName
from lampest.files.document import read_document, validated
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.wiring import Lines
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.recording.simulation.unmodelled import Unmodelled
from lampest.runs.terms import FORBID, Terms, terms_of
from lampest.solvers.solution import Settings
from lampest.studies.bench.mats import Mats
from lampest.studies.bench.scenes import loads

LARGEST_SIDE = 1000
MOST = 1000
LONGEST_S = 30 * 86400.0
SERIES_OHM = 140  # two multiplexer channels, as in the shipped scenes
SOLVERS = ("reduced", "nodal", "scipy_exact", "scipy_difference", "scipy_lbfgsb")
PAPER: dict[str, tuple[Term, ...]] = {
    "LSM": (Misfit(),),
    "LSR-CR": (Misfit(), CellResistance(weight=1e-3)),
    "LSR-dCR": (Misfit(), RelativeChange(weight=10)),
    "LSR-gCR": (Misfit(), Gradient(weight=1e-3)),
    "LSR-gdCR": (Misfit(), GradientOfRelativeChange(weight=10)),
}


@dataclass(frozen=True)
class SquaredMethod:
    """The terms of one method. Raises ValueError without a term, or for a loss that is no least-squares problem."""

    __pydantic_config__: ClassVar[Any] = FORBID
    terms: Terms  # type: ignore[valid-type]

    def __post_init__(self) -> None:
        if not self.parts:
            raise ValueError("a method needs at least one term")
        if not all(term.loss.squared for term in self.parts):
            raise ValueError("only squared losses can be compared with a least-squares solver")

    @property
    def parts(self) -> tuple[Term, ...]:
        """The terms, in order."""
        return terms_of(self.terms)


def paper_methods() -> dict[str, SquaredMethod]:
    """The five methods of the paper with its weights."""
    return {name: SquaredMethod(Terms(**{term.kind: term for term in terms})) for name, terms in PAPER.items()}  # type: ignore[attr-defined]


@dataclass(frozen=True)
class BenchLimits:
    """The largest side, max(rows, columns), at which a solver is run; 0: not at all.

    scipy_exact, scipy_difference : scipy's trf with the closed-form Jacobian, and with finite differences.
    scipy_lbfgsb : scipy's L-BFGS-B with the closed-form gradient.
    joint : no solver, but the first pair of relative methods: on larger panels their first frame starts from a baseline
    that was solved alone.
    """

    __pydantic_config__: ClassVar[Any] = FORBID
    reduced: int = LARGEST_SIDE
    nodal: int = 16
    scipy_exact: int = 16
    scipy_difference: int = 10
    scipy_lbfgsb: int = 10
    joint: int = 10


@dataclass(frozen=True)
class BenchFile:
    """What is compared.

    Parameters
    ----------
    sizes : sides of square panels, or [rows, columns].
    estimators : methods by name, their terms as in a run's file; the paper's five by default.
    recordings : simulated recordings of every panel, each with loads and noise of its own.
    frames, repeats : frames after the first, solved in sequence, and how often each is solved by every solver.
    budget_s : no solve is begun that would probably not end within so many seconds; what is left out is told.
    seed, readout, unmodelled : of the simulated recordings, as in a simulation's file.
    lines : of their scenes; nodal does not know wire and is left out then.
    solver : tolerance and iterations, the same for all.
    limits : the largest side for each solver.
    memory : sides of panels on which the peak memory of a fresh process is measured.
    mats : random mats without bounds or penalties, for published solvers that know neither; absent: none.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = FORBID
    schema: Literal[1]
    sizes: tuple[int | tuple[int, int], ...]
    estimators: dict[str, SquaredMethod] = field(default_factory=paper_methods)
    recordings: int = 1
    frames: int = 4
    repeats: int = 3
    budget_s: float = 3600.0
    seed: int = 1
    readout: TwoPointReadout = TwoPointReadout(noise_lsb=0.7)
    unmodelled: Unmodelled = field(default_factory=Unmodelled)
    lines: Lines | None = None
    solver: Settings = Settings()
    limits: BenchLimits = BenchLimits()
    memory: tuple[int, ...] = ()
    mats: Mats | None = None

    def __post_init__(self) -> None:
        if not self.sizes or not self.estimators:
            raise ValueError("sizes and estimators must hold at least one")
        for side in (*self.memory, *(side for shape in self.shapes for side in shape)):
            if not 2 <= side <= LARGEST_SIDE:
                raise ValueError(f"a panel's side must lie between 2 and {LARGEST_SIDE}")
        if len(set(self.shapes)) < len(self.shapes):
            raise ValueError("sizes names a panel twice")
        for rows, columns in self.shapes:
            if not self.solvers((rows, columns)):
                raise ValueError(f"limits leave no solver for {rows} × {columns}")
        for name in ("recordings", "frames", "repeats"):
            if not 1 <= getattr(self, name) <= MOST:
                raise ValueError(f"{name} must lie between 1 and {MOST}")
        if not 0 < self.budget_s <= LONGEST_S:
            raise ValueError(f"budget_s must lie between 0 and {LONGEST_S:.0f}")

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """(rows, columns) of every panel."""
        return tuple((size, size) if isinstance(size, int) else size for size in self.sizes)

    def solvers(self, shape: tuple[int, int]) -> tuple[str, ...]:
        """The names of the solvers that run on a panel."""
        wired = self.lines is not None and self.lines.resist
        names = tuple(name for name in SOLVERS if not (wired and name == "nodal"))
        return tuple(name for name in names if max(shape) <= getattr(self.limits, name))

    def estimator(self, name: str, formulation: MethodName) -> Estimator:
        """A method in a formulation."""
        return Estimator(self.estimators[name].parts, formulation, self.solver)

    def recording(self, shape: tuple[int, int], number: int = 0) -> Recording:
        """One of the recordings of a panel, its loads those of `scenes.loads`; 3 unloaded frames."""
        touching, course = loads(number, shape)
        simulation = Simulation(
            1,
            self.seed + number,
            Scene(Panel(*shape), self.readout, SERIES_OHM, lines=self.lines),
            frames=self.frames + 1,
            loads=touching,
            course=course,
            unmodelled=self.unmodelled,
        )
        return simulate(simulation, f"{shape[0]}x{shape[1]}")


def read_bench(path: Path, settings: tuple[str, ...] = ()) -> BenchFile:
    """A benchmark's file. Raises InputError with line and column."""
    return cast(BenchFile, validated(read_document(path, settings), BenchFile))
