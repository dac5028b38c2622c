"""What a method of estimation must say: how the cells of a frame follow from its data."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.solvers.newton.newton import Newton
from lampest.solvers.solution import Settings, Solution, Solver

if TYPE_CHECKING:
    from lampest.cost.terms import Term
    from lampest.estimate.step import Step
    from lampest.estimate.stream import Stream


@dataclass(frozen=True)
class Method(ABC):
    """How an estimate is computed; what `formulation:` names, by the bare word or with options.

    optimum : whether it ends at a verified optimum over the cells, which error bars are for. joint : whether a method
    that compares frames solves its baseline together with the first frame, as the paper does. delays : whether it keeps
    Ctrl-C itself where that would be taken for a failed evaluation, and not where only machine code runs. together :
    whether it needs all frames of a recording at once.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    optimum: ClassVar[bool] = False
    joint: ClassVar[bool] = False
    delays: ClassVar[bool] = False
    together: ClassVar[bool] = False

    if TYPE_CHECKING:

        @property
        def kind(self) -> str:
            """The word that names it."""

    def check(self, terms: "tuple[Term, ...]") -> None:  # noqa: B027 - most methods take any terms
        """Raise InputError where the method cannot minimise these terms."""

    def check_scene(self, scene: Scene) -> None:  # noqa: B027 - most methods know all that a network knows
        """Raise InputError where the method has no model of what the scene names, or cannot serve its readout."""

    def compares(self, terms: "tuple[Term, ...]") -> bool:
        """Whether an estimate with these terms needs the unloaded panel."""
        return any(term.needs_previous for term in terms)

    def solver(self, cost: Cost, scene: Scene, settings: Settings, period: float) -> Solver:
        """What minimises a cost on frames `period` seconds apart; built once per process and kept."""
        return Newton(cost, settings)

    def prepare(self, solver: Solver, data: Data, previous: Array | None) -> None:
        """Build what can be built before the first solve of its kind, so that no frame is charged for it."""
        solver.prepare()

    @abstractmethod
    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """The cells of a frame; previous : (1, rows, columns) ohm or None; prepared : what `begin` has prepared."""

    def guess(self, readout: Readout, measured: Array) -> Array:
        """What stands for the previous frame where there is none, the same shape, ohm."""
        return readout.uniform_start(measured)

    def kept(self, solution: Solution, prepared: Any) -> Any:
        """What is prepared for the next frame after a solution; by default what was prepared for this one."""
        return prepared

    def begin(self, stream: "Stream") -> "Stream":
        """The stream after its baseline, solved in the method's own way."""
        return stream.after_baseline()

    def push(self, stream: "Stream", readings: Readings) -> "tuple[Stream, Step]":
        """The stream after one frame's readings (rows, columns), and how they were solved."""
        return stream.after_frame(readings)

    def sequence(
        self, stream: "Stream", resting: Readings, readings: Readings, on_frame: Callable[[], None]
    ) -> "tuple[Stream, list[Step]]":
        """The stream after a whole recording's readings (frames, rows, columns), and how they were solved.

        resting : of the unloaded frames, of which the stream has the mean. on_frame : called after every frame.
        """
        steps = []
        for frame in range(len(readings.value)):
            stream, step = stream.push(readings[frame])
            steps.append(step)
            on_frame()
        return stream, steps
