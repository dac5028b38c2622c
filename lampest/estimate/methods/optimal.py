"""Verified optima: the same cost, with node voltages as unknowns or eliminated."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Literal

from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.estimate.methods.method import Method
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene
from lampest.solvers.ipopt.formulations import FORMULATIONS
from lampest.solvers.ipopt.ipopt import Ipopt
from lampest.solvers.multistart import best_solution
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings, Solution, Solver

NODAL_CELLS, NODAL_PERIOD = 144, 0.5  # up to so many cells, and from so many seconds a frame, IPOPT keeps pace


@dataclass(frozen=True)
class OptimalMethod(Method):
    """argmin Σ weight·loss(residual) within the bounds, checked outside the solver that found it.

    joint : whether terms that compare frames solve the baseline together with the first frame (paper, equations 15 and
    21), rather than the baseline alone and the first frame against it.

    >>> lampest.Estimator((lampest.Misfit(),), lampest.OptimalMethod(kind="reduced")).method.kind
    'reduced'
    """

    optimum: ClassVar[bool] = True
    delays: ClassVar[bool] = True
    kind: Literal["per_pixel", "nodal", "reduced", "auto"] = "nodal"
    joint: bool = False

    def check_scene(self, scene: Scene) -> None:
        """Raise InputError where the formulation cannot say what the readout reads, or the panel is wired.

        Node voltages inside a wired panel would be unknowns, too.
        """
        if self.kind not in FORMULATIONS:
            return
        FORMULATIONS[self.kind].check(scene.circuit)
        if scene.wiring is not None:
            raise InputError(
                f"formulation: {self.kind} knows neither lines, contacts nor faults.joined_rows and joined_columns; "
                "take reduced"
            )

    def solver(self, cost: Cost, scene: Scene, settings: Settings, period: float) -> Solver:
        """per_pixel, nodal : IPOPT with node voltages as unknowns. reduced : Newton with potentials eliminated.

        auto : nodal on panels of up to 144 cells without wire with at most two frames a second, else reduced.
        """
        kind = self.kind
        if kind == "auto":
            slow = cost.panel.crossings <= NODAL_CELLS and period >= NODAL_PERIOD
            kind = "nodal" if slow and scene.wiring is None else "reduced"
        return _solver(cost, scene.circuit, kind, settings)

    def solution(self, solver: Solver, data: Data, previous: Array | None, prepared: Any) -> Solution:
        """The best optimum of all starts that a frame deserves; prepared : what that frame kept, or None."""
        return best_solution(solver, data, previous, prepared)

    def kept(self, solution: Solution, prepared: Any) -> Any:
        """The preconditioner of a single frame."""
        return solution.kept if solution.solved and len(solution.cell_resistance) == 1 else None


@lru_cache(maxsize=32)
def _solver(cost: Cost, readout: Readout, kind: str, settings: Settings) -> Solver:
    if kind in FORMULATIONS:
        return Ipopt(cost, readout, FORMULATIONS[kind], settings)
    return ProjectedNewton(cost, settings)
