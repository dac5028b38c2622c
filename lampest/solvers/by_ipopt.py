"""Solver that gives the nonlinear program with node voltages to IPOPT.

IPOPT begins at the same starts as every other solver, and its solution is checked in the same way.
A frame that follows another begins where the sensitivity of the previous solution to the readings
leads: one linear solve, u − H⁻¹ ∇φ in log r, with an error of the second order (Zavala & Biegler,
Automatica 45, 2009). Initial voltages are those of these cells; initial multipliers are the final
ones of the previous frame.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import log
from typing import Any

import numpy as np

from lampest.cost.problem import Data, Evaluation
from lampest.formulation.instance import Instance, Multipliers, ProgramResult
from lampest.formulation.ipopt import Interface
from lampest.formulation.program import Program
from lampest.panel.compiled import guarded
from lampest.panel.readouts import Readout
from lampest.panel.readouts.wiring import Wiring
from lampest.panel.trust_region import backtracked
from lampest.solvers.bounds import MAX_LENGTHS, moved_by, within_bounds
from lampest.solvers.certificate import certificate
from lampest.solvers.check import sharp_hessian
from lampest.solvers.hessian import Hessian, weighted_square
from lampest.solvers.preconditioners import Cholesky
from lampest.solvers.solution import Outcome, Settings, Solver, Status

STATUS = {
    "Solve_Succeeded": Status.OPTIMUM,
    "Solved_To_Acceptable_Level": Status.OPTIMUM,
    "Search_Direction_Becomes_Too_Small": Status.OPTIMUM,
    "Maximum_Iterations_Exceeded": Status.ITERATIONS,
    "Maximum_WallTime_Exceeded": Status.TIME,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Not_Enough_Degrees_Of_Freedom": Status.OVERDETERMINED,
    "Diverging_Iterates": Status.UNBOUNDED,
    "Invalid_Option": Status.UNAVAILABLE,
}
# The unit of the objective is the cost of a cell at readings of zero; that of an optimum is decades
# smaller.
ACCURACY = 1e-4
MAX_FINE = 3  # fine solves of a start: one, and one more after each saddle
# Change of ln r; a frame whose cells change less stays in its valley, even where IPOPT corrects
# the inertia.
FAR = log(4.0)


@dataclass(frozen=True, eq=False)
class Ending:
    """End of a solve, where the next frame begins.

    Attributes
    ----------
    multipliers : Multipliers
    hessian : Hessian
        Second derivatives of the cost at the end.
    """

    multipliers: Multipliers
    hessian: Hessian

    def predicted(self, start: Evaluation) -> Evaluation:
        """Return the point to which the sensitivity to the readings leads from the end's cells.

        `start` has the cells of the end and the data of the next frame. The Hessian is that of the
        end, with the weights W that the next frame gives its readings in JᵀWJ: one that is read
        again counts, and one that is missing does not. The step is halved until the cost falls.
        `start` is returned itself where it does not fall, where the Hessian has no factor, and with
        absolute losses, whose duals change with the readings.
        """
        ended = self.hessian
        current = sharp_hessian(start, np.zeros(0))
        alike = current.position.shape == ended.position.shape
        if len(start.cost.slope) or not ended.dense or not alike:
            return start
        change = current.reading_weight - ended.reading_weight
        matrix = ended.matrix + weighted_square(ended.jacobian, change.ravel())
        free = np.flatnonzero(current.free)
        factor = Cholesky.of(start.cell_resistance, free, matrix)
        if factor is None:
            return start
        step = within_bounds(start, free, factor.solve(-current.gradient[free]))

        def lower(length: float) -> Evaluation | None:
            point = moved_by(start, length * step)
            return point if point is not None and point.objective < start.objective else None

        return backtracked(lower, MAX_LENGTHS) or start


@dataclass(frozen=True)
class Ipopt(Solver):
    """Solver of one cost, circuit and choice of patterns on one panel shape.

    The program is built once and cached.

    Attributes
    ----------
    cost : Cost
    settings : Settings
    readout : Readout
    wiring : Wiring or None
    patterns : {'nodal', 'per_pixel'}
    previous : Ending or None
        End of the frame before.
    """

    cells_alone = False

    readout: Readout
    wiring: Wiring | None
    patterns: str
    previous: Ending | None = None

    @property
    def name(self) -> str:
        """The solver in words."""
        return f"IPOPT {self.patterns}"

    def prepare(self) -> None:
        """Build the program, and IPOPT for cold starts, before the first solve."""
        _ = self._built().cold

    def continued(self, carried: object) -> "Ipopt":
        """Return the solver that begins at the end of the frame before."""
        return replace(self, previous=carried if isinstance(carried, Ending) else None)

    def cold(self) -> "Ipopt":
        """Return the solver without initial multipliers and with IPOPT's own barrier parameter."""
        return replace(self, previous=None)

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`.

        A failed solve does not raise; the outcome's status states the failure.
        """
        if data.overdue:
            return Outcome(start.cell_resistance, np.zeros_like(self.cost.slope), Status.TIME, 0)
        instance, result, iterations = self._minimised(start)
        status = STATUS.get(result.status, Status.BREAKDOWN)
        outcome = self._outcome(start, instance, result, status, iterations)
        for _ in range(MAX_FINE):
            verdict = outcome.certificate
            if verdict is None or outcome.at is None or verdict.settled:
                break
            # IPOPT goes on, from the lower point beside a saddle if there is one, in units of that
            # point
            multipliers = instance.multipliers_of(result)
            instance = self._instance(verdict.lower or outcome.at)
            result = self._built().minimise(instance, multipliers, fine=True)
            iterations += result.iterations
            fine = self._outcome(start, instance, result, status, iterations)
            if fine.at is None or fine.at.objective > outcome.at.objective:
                return replace(outcome, iterations=iterations)
            outcome = fine
            if verdict.lower is None:
                break
        return outcome

    def _instance(self, at: Evaluation) -> Instance:
        """Return the program's instance that begins at an evaluation."""
        return Instance.of(self._built().program, [at])

    def _outcome(
        self,
        start: Evaluation,
        instance: Instance,
        result: ProgramResult,
        status: Status,
        iterations: int,
    ) -> Outcome:
        """Return the outcome of a result, with the certificate of an optimum."""
        cells = instance.cells_of(result)
        dual = instance.duals_of(result, self.cost.slope)
        moved = np.abs(np.log(cells / start.cell_resistance)).max()
        convex = not (result.corrected and moved > FAR)
        outcome = Outcome(cells, dual, status, iterations, convex=convex)
        if status is not Status.OPTIMUM or not np.all(np.isfinite(cells)):
            return outcome
        at = start.elsewhere(np.clip(cells, start.data.lower, start.data.upper))
        hessian = sharp_hessian(at, dual)
        verdict = certificate(hessian)
        carried = Ending(instance.multipliers_of(result), hessian)
        return replace(outcome, at=at, certificate=verdict, carried=carried)

    def _minimised(self, start: Evaluation) -> tuple[Instance, ProgramResult, int]:
        """Return the instance that IPOPT solved, its result, and the iterations.

        The solve is warm where a frame precedes, and cold if that fails.
        """
        iterations = 0
        if self.previous is not None:
            warm = self._instance(self.previous.predicted(start))
            if len(self.previous.multipliers.of_bounds) == len(warm.start):
                result = self._built().minimise(warm, self.previous.multipliers)
                iterations = result.iterations
                if STATUS.get(result.status) is Status.OPTIMUM:
                    return warm, result, iterations
        instance = self._instance(start)
        result = self._built().minimise(instance)
        return instance, result, iterations + result.iterations

    def _built(self) -> Interface:
        """Return IPOPT's interface to the program, which is built once."""
        return _interface(replace(self, cost=self.cost.unweighted, previous=None))


def interface_to(program: Program, settings: Settings, **options: Any) -> Interface:
    """Return IPOPT's interface to a program, for the settings of a solver.

    The settings' own options of IPOPT take the place of the `options`.
    """
    if settings.time_limit_s is not None:
        options["max_wall_time"] = settings.time_limit_s
    if settings.ipopt is not None:
        options |= dict(settings.ipopt.own)
    return Interface(program, ACCURACY * settings.tolerance, settings.max_iterations, options)


@guarded
@lru_cache(maxsize=32)
def _interface(solver: Ipopt) -> Interface:
    """Return IPOPT for the program of a solver; each process compiles it once."""
    program = Program.build(solver.cost, solver.readout, solver.wiring, solver.patterns)
    return interface_to(program, solver.settings)
