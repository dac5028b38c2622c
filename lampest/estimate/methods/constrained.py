"""Estimates with own parts of the program: a constrained optimum of every frame, by IPOPT."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.cost.terms import Term
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.own_program import OwnProgram
from lampest.estimate.own_solution import OwnSolution
from lampest.estimate.state import AnyState, Step
from lampest.files.errors import InputError
from lampest.files.levels import TWO_SIDED
from lampest.formulation.constraints import AnyPart, ProgramPart
from lampest.formulation.patterns import EXCITATIONS
from lampest.formulation.program import Program
from lampest.panel.compiled import guarded
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.readouts.wiring import Wiring
from lampest.panel.scene import Scene
from lampest.posterior.certainty import Certainty
from lampest.posterior.track import Bars
from lampest.recording.readings import Readings
from lampest.solvers.multistart import evaluated
from lampest.solvers.solution import Outcome, Settings, Solution, Solver, failure, solution_at


@dataclass(frozen=True)
class ConstrainedIpopt(Solver):
    """IPOPT on a program with own parts.

    Attributes
    ----------
    readout : Readout
    wiring : Wiring or None
    kind : {'nodal', 'per_pixel'}
    parts : tuple of ProgramPart
    start : OwnSolution or None
        Solution of the frame before, where the next one begins.
    """

    cells_alone = False

    readout: Readout
    wiring: Wiring | None
    kind: str
    parts: tuple[ProgramPart, ...]
    start: OwnSolution | None = None

    @property
    def name(self) -> str:
        """The solver in words."""
        return f"IPOPT {self.kind} with constraints"

    def prepare(self) -> None:
        """Build the program before the first solve."""
        self._symbols()

    def continued(self, carried: object) -> "ConstrainedIpopt":
        """Return the solver that begins at the solution of the frame before."""
        return replace(self, start=carried if isinstance(carried, OwnSolution) else None)

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from the frame before, or else, and where that fails, from `start`."""
        program = OwnProgram(self._symbols(), (start,), self.settings, self.kind)
        solved = program.solve(self.start)
        iterations = solved.iterations
        if self.start is not None and not solved.solved:
            solved = program.solve()
            iterations += solved.iterations
        dual = np.zeros(len(self.cost.slope))
        cells = solved.cell_resistance
        return Outcome(cells, dual, solved.verdict, iterations, carried=solved)

    def _symbols(self) -> Program:
        cost = self.cost.unweighted
        return _program(cost, self.readout, self.wiring, self.kind, self.parts)


@guarded
@lru_cache(maxsize=8)
def _program(
    cost: Cost,
    readout: Readout,
    wiring: Wiring | None,
    kind: str,
    parts: tuple[ProgramPart, ...],
) -> Program:
    """Return the program of a frame with own parts; a process builds it once."""
    program = Program.build(cost, readout, wiring, kind)
    for part in parts:
        program = part.add_to(program)
    return program


@dataclass(frozen=True)
class ConstrainedMethod(Method):
    """The optimum of the cells and own unknowns, subject to own constraints.

    They hold for every solve, that of the unloaded panel included. Error bars are those of noise
    along the constraints, independent between frames; errors that the scene names beside noise are
    not part of them.

    Attributes
    ----------
    kind : {'nodal', 'per_pixel'}
    parts : tuple of ProgramPart
    """

    optimum = True
    kind: Literal["nodal", "per_pixel"] = "nodal"
    parts: tuple[AnyPart, ...] = ()

    @classmethod
    def of(cls, method: Method, parts: tuple[AnyPart, ...]) -> "ConstrainedMethod":
        """Return the method for the parts of an estimator.

        Raises InputError where the formulation has no program.
        """
        if not isinstance(method, OptimalMethod) or method.kind == "reduced" or method.joint:
            raise InputError(
                f"constraints need formulation: {', '.join(EXCITATIONS)} or auto, of single frames"
            )
        return cls("per_pixel" if method.kind == "per_pixel" else "nodal", parts)

    def check(self, terms: tuple[Term, ...]) -> None:
        """Raise InputError where a term weighs the previous frame by its error bars."""
        if any(term.weighs_previous for term in terms):
            raise InputError("arrival cannot stand beside constraints")

    def check_scene(self, scene: Scene) -> None:
        """Raise InputError for a panel of modules."""
        if scene.panel.modules is not None:
            raise InputError("constraints need a panel of one network, not of modules")

    def solver(self, cost: Cost, scene: Scene, settings: Settings, period: float) -> Solver:
        """Return IPOPT for the program with own parts."""
        return ConstrainedIpopt(cost, settings, scene.circuit, scene.wiring, self.kind, self.parts)

    def solution(
        self, solver: Solver, data: Data, previous: Array | None, prepared: Any
    ) -> Solution:
        """Return the optimum that IPOPT reaches from the frame before, or from equal cells."""
        start = evaluated(solver.cost, data, data.uniform_start)
        outcome = solver.continued(prepared).solve(data, start)
        solved = outcome.carried
        assert isinstance(solved, OwnSolution)
        solution = failure(solver.cost, data, outcome.status, np.nan, outcome)
        if solved.solved:
            at = evaluated(solver.cost, data, outcome.cell_resistance)
            solution = solution_at(at, solved.optimality_error, outcome, outcome.status)
            reading = solved.value("reading").reshape(solution.reading.shape)
            solution = replace(solution, objective=solved.objective, reading=reading, dual=None)
        return replace(solution, solver=solver.name)

    def prepared_by(self, solution: Solution, prepared: Any) -> Any:
        """Return the solution where the next frame begins."""
        return solution.carried if solution.solved else prepared

    def begin(self, state: AnyState) -> AnyState:
        """Return the state with its baseline, and the error bars of that."""
        state = super().begin(state)
        assert state.baseline is not None
        bars = _bars(state.baseline)
        if state.track is None or bars is None:
            return state
        return replace(state, track=replace(state.track, baseline=bars.frame))

    def after(self, state: AnyState, step: Step, readings: Readings) -> tuple[AnyState, Step]:
        """Update the state by a solved frame, with error bars along the constraints."""
        bars = None if state.track is None else _bars(step)
        if bars is not None and state.track is not None and state.track.baseline is not None:
            change = bars.frame.less(state.track.baseline, shared=np.zeros(1))
            bars = replace(bars, change=change)
        return super().after(state, replace(step, bars=bars), readings)

    def verified(
        self, state: AnyState, readings: Readings, after: AnyState, step: Step
    ) -> tuple[AnyState, Step]:
        """Return the step unchanged: the witness knows no constraints."""
        return after, step


def _bars(step: Step) -> Bars | None:
    """Return the error bars of a solve along its constraints; None where nothing was solved."""
    solved = step.solution.carried
    at = step.solution.at
    if at is None or not isinstance(solved, OwnSolution):
        return None
    shape = at.cell_resistance.shape[1:]
    deviation, of_reading = (
        np.sqrt(np.diag(solved.covariance(name))).reshape(shape)
        for name in ("log_cell_resistance", "reading")
    )
    # Averaging kernel: the estimate's derivative by the cells that are read
    by_reading = solved.sensitivity(of="log_cell_resistance", to="measured")
    kernel = by_reading @ at.networks[0].sensitivity()
    certainty = Certainty(
        deviation,
        below=TWO_SIDED * deviation,
        above=TWO_SIDED * deviation,
        resolution=np.diag(kernel).reshape(shape),
        data_share=kernel.sum(axis=1).reshape(shape),
        common=np.zeros(shape),
    )
    return Bars(certainty, None, of_reading)
