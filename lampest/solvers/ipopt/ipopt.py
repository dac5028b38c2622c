"""Solver IPOPT with node voltages as unknowns.

Source: Wächter & Biegler, Mathematical Programming 106, 2006.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi
import numpy as np

from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.compiled import CasadiOwner, Compiled, guarded
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.solvers.ipopt.formulations import Formulation
from lampest.solvers.ipopt.program import Program
from lampest.solvers.solution import Outcome, Settings, Status

STATUS = {
    "Solve_Succeeded": Status.OPTIMUM,
    "Solved_To_Acceptable_Level": Status.OPTIMUM,
    "Search_Direction_Becomes_Too_Small": Status.OPTIMUM,
    "Maximum_Iterations_Exceeded": Status.ITERATIONS,
    "Maximum_WallTime_Exceeded": Status.TIME,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Invalid_Option": Status.UNAVAILABLE,
}
SPLIT_START = 0.01  # distance of p, q from their bound 0 at the start, in split units: IPOPT's default of bound_push
PUSH = 1e-9  # distance that IPOPT keeps from a bound, relative to max(bound, 1); far below the accuracy of a cell
# The start has its own multipliers (`Ipopt._multipliers`), from which IPOPT derives the adaptive barrier parameter.
WARM = {
    "warm_start_bound_push": PUSH,
    "warm_start_bound_frac": PUSH,
    "warm_start_mult_bound_push": 1e-15,  # times the distance to a bound, below any tolerance
    "warm_start_init_point": "yes",
    "mu_strategy": "adaptive",
}
# A start in the right minimum must not be pushed out of it: low barrier parameter, small distance to the bounds.
CLOSE_START = {"mu_init": 1e-7, "bound_mult_init_method": "mu-based", "bound_push": PUSH, "bound_frac": PUSH}
# MUMPS orders by approximate minimum degree (0), the fastest: see docs/studies/speed.md.
OPTIONS = {"mumps_pivot_order": 0, "bound_relax_factor": 0.0, "nlp_scaling_method": "none", "print_level": 0}


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds of the conductances.

    Attributes
    ----------
    low, high : array, shape (cells,)
        In units in which conductances are of order one.
    """

    low: Array
    high: Array

    def multipliers(self, conductance: Array, pull: Array, barrier: float) -> Array:
        """Return the bound multipliers z_high − z_low, (cells,).

        At an active bound this is the outward pull −∂φ/∂g, elsewhere it is barrier/distance.

        Parameters
        ----------
        conductance : array, shape (cells,)
        pull : array, shape (cells,)
            −∂φ/∂g.
        barrier : float
            Barrier parameter μ.
        """
        below, above = conductance - self.low, self.high - conductance
        on_low, on_high = below <= PUSH * np.maximum(self.low, 1), above <= PUSH * np.maximum(self.high, 1)
        inside = barrier / np.where(on_high, 1, above) - barrier / np.where(on_low, 1, below)
        return np.where(on_low, np.minimum(pull, 0), np.where(on_high, np.maximum(pull, 0), inside))

    def settled(self, conductance: Array, multiplier: Array) -> Array:
        """Return the conductances, put on a bound where its multiplier exceeds the distance to it, (cells,)."""
        lowered = np.where(-multiplier > conductance - self.low, self.low, conductance)
        return np.where(multiplier > self.high - conductance, self.high, lowered)


@dataclass(frozen=True)
class Ipopt:
    """Solver of one cost, readout and formulation on one panel shape; the program is built once and cached."""

    cost: Cost
    readout: Readout
    formulation: Formulation
    settings: Settings

    def prepare(self) -> None:
        """Build the program before the first solve."""
        _ = self._built

    def solve(self, data: Data, start: Evaluation) -> Outcome:
        """Minimise from `start`. A failed solve does not raise; the outcome's status states the failure."""
        if data.overdue:
            return Outcome(start.cell_resistance, np.zeros_like(self.cost.slope), Status.TIME, 0)
        # Units: resistances in s, the geometric mean of the apparent ones; split residuals in their largest.
        scale = float(np.exp(np.mean(np.log(data.apparent_resistance))))
        split = start.call(self.cost.functions.split)
        split_scale = max(float(np.abs(split).max(initial=0)), 1e-12)
        own: dict[str, Any] = {"ties": data.ties.ravel() * scale, "weights": self.cost.weights}
        own |= {"scale": scale, "cost_scale": start.cost_scale, "split_scale": split_scale}
        values = data.flat | own
        parameters = np.concatenate([np.atleast_1d(values[name]) for name in self._built.parameters])
        x0 = self._start(start, scale, split / split_scale)
        # Smaller cells than `Readout.nearly_shorted` do not change any reading.
        # Bounds of conductances s/r; potentials are free, p and q are at least 0.
        least = np.minimum(np.maximum(data.lower, data.readout.nearly_shorted(data.measured)), data.upper)
        limits = Limits(scale / data.upper.ravel(), scale / least.ravel())
        lbx, ubx = np.full(len(x0), -np.inf), np.full(len(x0), np.inf)
        lbx[: least.size], ubx[: least.size], lbx[len(x0) - 2 * len(split) :] = limits.low, limits.high, 0.0
        warm = {} if len(split) else self._multipliers(start, scale, x0, parameters, limits)
        # Solve from the start and its multipliers; then cells at bounds, and duals from the last multipliers.
        result, stats = self._built.minimise(x0=x0, p=parameters, lbg=0, ubg=0, lbx=lbx, ubx=ubx, **warm)
        conductance, multiplier = (result[name][: data.measured.size] for name in ("x", "lam_x"))
        with np.errstate(divide="ignore"):
            cells = scale / limits.settled(conductance, multiplier)
        multipliers = result["lam_g"]
        weights = np.maximum(self.cost.slope * split_scale / start.cost_scale, np.finfo(float).tiny)
        dual = multipliers[len(multipliers) - len(weights) :] / weights
        status = STATUS.get(stats["return_status"], Status.BREAKDOWN)
        return Outcome(cells.reshape(data.measured.shape), dual, status, int(stats["iter_count"]))

    def _start(self, start: Evaluation, scale: float, split: Array) -> Array:
        """Return x0 = (conductance, potentials, p, q) at the start; p and q are the parts of the split residuals."""
        conductance = scale / start.cell_resistance.ravel()
        potentials = [self.formulation.potentials(self.readout, network) / scale for network in start.networks]
        blocks = self.cost.functions.split_blocks
        parts = np.split(split, np.cumsum(blocks, dtype=int)[:-1])
        sides = [np.maximum(side, 0) + SPLIT_START for part in parts[: len(blocks)] for side in (part, -part)]
        return np.concatenate([conductance, *potentials, *sides])

    def _multipliers(
        self, start: Evaluation, scale: float, x0: Array, parameters: Array, limits: Limits
    ) -> dict[str, Array]:
        """Return IPOPT's initial multipliers by name: λ of the balance, for which voltages are stationary, and z.

        Empty if double precision does not suffice for λ.
        """
        slopes = np.split(self._built.slope(x0, parameters) / scale, len(start.networks))
        frames = zip(start.networks, start.data.ties, slopes, strict=True)
        try:
            balance = [self.formulation.multipliers(self.readout, *frame) for frame in frames]
        except np.linalg.LinAlgError:
            return {}
        gradient, conductance = start.log_gradient(np.zeros(0)), x0[: start.cell_resistance.size]
        # Barrier parameter: the gradient that a Newton step leaves (quadratic convergence), at most IPOPT's mu_init.
        barrier = min(float(start.projected_gradients(gradient)) ** 2, 0.1)
        pull = gradient.ravel() / (conductance * start.cost_scale)
        of_bounds = np.zeros(len(x0))
        of_bounds[: len(conductance)] = limits.multipliers(conductance, pull, barrier)
        return {"lam_x0": of_bounds, "lam_g0": np.concatenate(balance)}

    @cached_property
    def _built(self) -> "Built":
        return _built(self.cost.unweighted, self.readout, self.formulation, self.settings)


@dataclass(frozen=True, eq=False)
class Built(CasadiOwner):
    """Compiled program, for all weights of the terms.

    Attributes
    ----------
    solver : casadi.Function
        IPOPT's interface in CasADi.
    parameters : tuple of str
        Names of the parameters in their order.
    slope : Compiled
        ∂f/∂(potentials) of (x, p).
    """

    solver: casadi.Function
    parameters: tuple[str, ...]
    slope: Compiled

    @guarded
    def minimise(self, **arguments: Any) -> tuple[dict[str, Array], dict[str, Any]]:
        """Return (flat results by CasADi's names, statistics of the solve)."""
        results = self.solver(**arguments)
        return {name: np.asarray(value).ravel() for name, value in results.items()}, self.solver.stats()


@guarded
@lru_cache(maxsize=32)
def _built(cost: Cost, readout: Readout, formulation: Formulation, settings: Settings) -> Built:
    program = Program.build(cost, readout, formulation)
    limits = {"tol": settings.tolerance, "max_iter": settings.max_iterations, "sb": "yes"}
    limits |= {} if settings.time_limit_s is None else {"max_wall_time": settings.time_limit_s}
    several_minima = not readout.unique or any(term.needs_previous for term in cost.terms)
    begin = WARM if program.split.is_empty() else CLOSE_START if several_minima else {"mu_strategy": "adaptive"}
    options: dict[str, Any] = {"ipopt": OPTIONS | begin | limits, "hess_lag": program.hessian(), "print_time": False}
    solver = casadi.nlpsol("ipopt", "ipopt", program.nlp, options)
    return Built(solver, tuple(program.parameters), Compiled(program.slope()))
