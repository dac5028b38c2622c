"""Approximations with a fixed amount of work: closed form, linearisation, truncated Newton method.

Source: Kelley, Iterative Methods for Linear and Nonlinear Equations, 1995, section 5.4 (chord
method).
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from lampest.cost.problem import Data
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.state import AnyState
from lampest.files.errors import BROKEN
from lampest.panel.panel import Array
from lampest.panel.trust_region import steihaug
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.multistart import evaluated
from lampest.solvers.preconditioners import preconditioner
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Outcome, Settings, Solution, Solver, Status, approximation

# Relative residual of conjugate gradients: lines dominate single cells in the quadratic model, and
# 1e-2 does not resolve the change of a single cell.
ACCURACY = 1e-5
MAX_STEP = 3.0  # of log r: a factor of 20


@dataclass(frozen=True)
class UncorrectedMethod(Method):
    """Closed forms without any solve.

    Attributes
    ----------
    kind : {'naive', 'scaled'}
        'naive': each reading as if its cell were alone, r = R_m for two-point readings, otherwise
        the voltage divider. 'scaled': each reading as if all cells were equal, r = R_m·MN/(M + N −
        1) for two-point readings.

    >>> lampest.UncorrectedMethod().kind
    'naive'
    """

    kind: Literal["naive", "scaled"] = "naive"

    def solution(
        self, solver: Solver, data: Data, previous: Array | None, prepared: Any
    ) -> Solution:
        """Return the closed form within the bounds."""
        cells = data.apparent_resistance if self.kind == "naive" else data.uniform_start
        cells = np.clip(cells, data.lower, data.upper)
        dual = np.zeros(len(solver.cost.slope))
        outcome = Outcome(cells, dual, Status.APPROXIMATE, 0)
        return approximation(solver.cost, data, outcome)


@dataclass(frozen=True)
class TruncatedMethod(Method):
    """The first `steps` Newton steps of the reduced formulation from the previous frame.

    Raises ValueError unless there is at least one step.

    >>> lampest.TruncatedMethod().kind
    'truncated'
    """

    kind: Literal["truncated"] = "truncated"
    steps: int = 2

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError("steps must be at least 1")

    def solution(
        self, solver: Solver, data: Data, previous: Array | None, prepared: Any
    ) -> Solution:
        """Return the point after the last step."""
        start = evaluated(solver.cost, data, data.uniform_start if previous is None else previous)
        newton = ProjectedNewton(solver.cost, Settings(max_iterations=self.steps))
        return approximation(solver.cost, data, newton.solve(data, start))


@dataclass(frozen=True)
class LinearisedMethod(Method):
    """One Newton step from the baseline, log r = log r_b − H_b⁻¹ ∇φ(r_b).

    There is one factor for the whole recording.

    >>> lampest.LinearisedMethod().kind
    'linearised'
    """

    kind: Literal["linearised"] = "linearised"

    def begin(self, state: AnyState) -> AnyState:
        """Return the state with its baseline and the factor of H_b.

        A failed baseline has no factor.
        """
        start = OptimalMethod("reduced").begin(state)
        if start.previous is None:
            return start
        background = replace(state.background, previous=start.previous)
        data = state.estimator.data(state.resting.alone(), background)
        cost = state.estimator.cost(state.scene, 1, partial=data.partial)
        with suppress(*BROKEN):
            at = evaluated(cost, data, start.previous[None])
            hessian = Hessian(at, Smoothing.start(at))
            free = np.ones(len(hessian.gradient), dtype=bool)
            # With Cholesky's factor one step of conjugate gradients is enough.
            precondition = preconditioner(hessian, free).over(free, at.cell_resistance)

            def inverse(slope: Array) -> Array:
                return -steihaug(hessian.product, precondition, slope, ACCURACY).step

            return replace(start, prepared=(at, inverse))
        return start

    def solution(
        self, solver: Solver, data: Data, previous: Array | None, prepared: Any
    ) -> Solution:
        """Return the point after the step, of which |log r| is at most `MAX_STEP`.

        If there is no factor, the solution is the optimum.
        """
        if prepared is not None:
            with suppress(*BROKEN):
                baseline, inverse = prepared
                at = replace(baseline, cost=solver.cost, data=data)
                smoothing = Smoothing.start(at)
                # −H_b⁻¹ ∇φ(r_b), with the gradient of the frame's cost at the baseline's cells
                step = np.clip(-inverse(Hessian(at, smoothing).gradient), -MAX_STEP, MAX_STEP)
                cells = at.cell_resistance * np.exp(step).reshape(at.cell_resistance.shape)
                dual = smoothing.slope(at.nonsmooth)
                outcome = Outcome(cells, dual, Status.APPROXIMATE, 1)
                return approximation(solver.cost, data, outcome)
        return OptimalMethod("reduced").solution(solver, data, previous, None)
