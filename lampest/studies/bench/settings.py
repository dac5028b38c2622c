"""A benchmark's YAML file, and the recordings that it makes for every size."""

from dataclasses import dataclass, field
from typing import Literal

from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import MethodName
from lampest.files.typed import Configuration, check_range
from lampest.loads.shapes import AnyShape, Rod
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.wiring import Lines
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.pressure import Course
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.solvers.solution import Settings
from lampest.studies.methods import (
    BREATHING,
    LARGEST_SIDE,
    Shape,
    Sizes,
    SquaredMethod,
    check_sides,
    lamprey_mouth,
    paper_methods,
    shapes_of,
)

SERIES_OHM = 140  # two multiplexer channels, as in the shipped scenes
SOLVERS = ("reduced", "nodal", "scipy_exact", "scipy_difference", "scipy_lbfgsb")
# Places as shares of the panel's width and height, and masses in g: rods of 40 mm press with 2 to 9 kPa.
RODS = ((0.3, 0.3, 680.0), (0.7, 0.35, 300.0), (0.4, 0.75, 1200.0))


def loads(number: int, shape: Shape) -> tuple[tuple[AnyShape, ...], Course]:
    """What touches the panel in recording `number`, and when; recordings 0, 1, 2 differ, then they come again.

    0 : a mouth over a third of the shorter side, sucking ever harder, breathing. 1 : three rods that stand. 2 : a mouth
    of 35 mm that presses ever harder, then sucks, beside a rod.
    """
    pitch = Panel(*shape).pitch_mm
    height, width = (pitch * (side - 1) for side in shape)
    rods = tuple(
        Rod(kind="rod", centre_mm=(right * width, down * height), diameter_mm=40, mass_g=mass)
        for right, down, mass in RODS
    )
    third = lamprey_mouth((0.49 * width, 0.51 * height), 0.35 * pitch * min(shape))
    growing = Course(start_s=-0.4, approach_s=2, attachment_s=2, breathing_hz=1.15, breathing_depth=0.1)
    beside = (lamprey_mouth((0.6 * width, 0.55 * height)), rods[0])
    return (((third,), BREATHING), (rods, Course()), (beside, growing))[number % 3]


@dataclass(frozen=True)
class BenchLimits(Configuration):
    """The largest side, max(rows, columns), at which a solver is run; 0: not at all.

    scipy_exact, scipy_difference : scipy's trf with the closed-form Jacobian, and with finite differences.
    scipy_lbfgsb : scipy's L-BFGS-B with the closed-form gradient.
    joint : no solver, but the first pair of relative methods: on larger panels their first frame starts from a baseline
    that was solved alone.
    """

    reduced: int = LARGEST_SIDE
    nodal: int = 16
    scipy_exact: int = 16
    scipy_difference: int = 10
    scipy_lbfgsb: int = 10
    joint: int = 10


@dataclass(frozen=True)
class BenchFile(Configuration):
    """What is compared.

    Parameters
    ----------
    sizes : sides of square panels, or [rows, columns].
    estimators : methods by name, their terms as in a run's file; the paper's five by default.
    recordings : simulated recordings of every panel, each with loads and noise of its own.
    frames, repeats : frames after the first, solved in sequence, and how often each is solved by every solver.
    budget_s : no solve is begun that would probably not end within so many seconds; what is left out is named.
    seed, readout, unmodelled : of the simulated recordings, as in a simulation's file.
    lines : of their scenes; nodal does not know wire and is left out then.
    solver : tolerance and iterations, the same for all.
    limits : the largest side for each solver.
    memory : sides of panels on which the peak memory of a fresh process is measured.

    Raises ValueError where a number is out of range.
    """

    schema: Literal[1]
    sizes: Sizes
    estimators: dict[str, SquaredMethod] = field(default_factory=lambda: paper_methods(SquaredMethod))
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

    def __post_init__(self) -> None:
        if not self.sizes or not self.estimators:
            raise ValueError("sizes and estimators must hold at least one")
        check_sides(self.shapes, 2, LARGEST_SIDE)
        check_range("a panel's side", self.memory, 2, LARGEST_SIDE)
        for rows, columns in self.shapes:
            if not self.solvers((rows, columns)):
                raise ValueError(f"limits leave no solver for {rows} × {columns}")
        for name in ("recordings", "frames", "repeats"):
            check_range(name, getattr(self, name), 1, 1000)
        check_range("budget_s", self.budget_s, 1e-3, 30 * 86400)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """(rows, columns) of every panel."""
        return shapes_of(self.sizes)

    def solvers(self, shape: Shape) -> tuple[str, ...]:
        """The names of the solvers that run on a panel."""
        wired = self.lines is not None and self.lines.resist
        names = tuple(name for name in SOLVERS if not (wired and name == "nodal"))
        return tuple(name for name in names if max(shape) <= getattr(self.limits, name))

    def estimator(self, name: str, formulation: MethodName = "reduced") -> Estimator:
        """A method in a formulation."""
        return Estimator(self.estimators[name].parts, formulation, self.solver)

    def recording(self, shape: Shape, number: int = 0) -> Recording:
        """One of the recordings of a panel, its loads those of `loads`; 3 unloaded frames."""
        touching, course = loads(number, shape)
        scene = Scene(Panel(*shape), self.readout, SERIES_OHM, lines=self.lines)
        return simulate(
            Simulation(
                1,
                self.seed + number,
                scene,
                frames=self.frames + 1,
                loads=touching,
                course=course,
                unmodelled=self.unmodelled,
            ),
            f"{shape[0]}x{shape[1]}",
        )
