"""Solution of an own program: its status, error bars, multipliers and sensitivities.

A check outside of IPOPT recomputes the conditions of an optimum. Unknowns move along the active
constraints, in the directions Z that these leave. With the Lagrangian L = φ + λᵀg,

    Zᵀ ∇²L Z > 0                          a minimum, and no saddle
    cov(x) = Z (½ Zᵀ ∇²L Z)⁻¹ Zᵀ          the covariance, where φ = −2 ln p
    Zᵀ ∇²L dx = −Zᵀ ∂(∇L)/∂p dp           sensitivities to p, with A dx = −∂g/∂p dp

A is the Jacobian of the active constraints. Source: Nocedal & Wright, Numerical Optimization, 2006,
sections 12.5 and 16.2; Fiacco, Introduction to Sensitivity and Stability Analysis, 1983.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import casadi
import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.formulation.instance import Instance, ProgramResult, on_bounds
from lampest.formulation.ipopt import Interface
from lampest.panel.compiled import CasadiOwner, guarded
from lampest.panel.panel import Array
from lampest.solvers.by_ipopt import STATUS
from lampest.solvers.certificate import ROUNDING, Definiteness, Modes
from lampest.solvers.solution import OPTIMA, VERIFIED, Status

SLOPE_ROUNDING = 1e-10  # of the unit of costs: a slope that may be the rounding of its parts
# Lengths, in units of the program, at which the cost beside a flat point is looked at.
PROBES = (1.0, 0.1, 0.01)
# Of the multiplier that the curvature alone would make: a larger one holds its unknown at a bound.
CLEAR = 10.0
SAME_PLACE = 1e-9  # violation of the equations that a probe may cause


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions in which the active constraints leave the unknowns.

    Attributes
    ----------
    held : boolean array, shape (unknowns,)
        Unknowns that a bound holds.
    follows : boolean array, shape (unknowns,)
        Voltages, which follow the other unknowns by the balance of currents.
    active : boolean array, shape (constraints,)
        Equations, and inequalities at a limit.
    leading : array, shape (unknowns, m)
        A column for each unknown that neither is held nor follows, with the voltages that follow.
    rows : array, shape (active constraints beside the balance, m)
        Jacobian of the other active constraints by the leading unknowns.
    basis : array, shape (unknowns, n)
        Z.
    """

    held: NDArray[np.bool_]
    follows: NDArray[np.bool_]
    active: NDArray[np.bool_]
    leading: Array
    rows: Array
    basis: Array


@dataclass(frozen=True, eq=False)
class OwnSolution(CasadiOwner):
    """Solution of an own program; NaN where it is no optimum.

    Attributes
    ----------
    instance : Instance
    result : ProgramResult
    unsolved : Status or None
        Why nothing was solved.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> terms = [lampest.Misfit(), lampest.Gradient(weight=1e-3)]
    >>> solved = lampest.program(recording, terms).solve()
    >>> solved.status
    'local optimum verified'
    """

    instance: Instance
    result: ProgramResult
    unsolved: Status | None = None

    @cached_property
    def status(self) -> str:
        """Outcome in a sentence, as `Status` has them."""
        return self._status.value

    @cached_property
    def _status(self) -> Status:
        """Status by the first order, then by the second along the active constraints."""
        if self.unsolved is not None:
            return self.unsolved
        ended = STATUS.get(self.result.status, Status.BREAKDOWN)
        if ended is not Status.OPTIMUM:
            return ended
        if not self.optimality_error <= VERIFIED:
            return Status.UNVERIFIED
        modes = self._modes
        if modes is None:
            return Status.ROUNDED
        if modes.definiteness is Definiteness.INDEFINITE:
            return Status.SADDLE
        if modes.definiteness is Definiteness.UNDETERMINED:
            return self._status_of_plateau(modes)
        step = np.abs(self._directions.basis @ modes.step(self._slope))
        short = np.all(step <= VERIFIED * np.maximum(np.abs(self.result.unknown), 1.0))
        return Status.OPTIMUM if short else Status.FAINT

    def _status_of_plateau(self, modes: Modes) -> Status:
        """Return the status of a point with directions of no curvature.

        No cost falls along a plateau. A slope counts beyond the millionth part of the slopes that
        cancel in it.
        """
        gradient, jacobian, _ = self._derivatives
        basis = self._directions.basis
        slopes = np.abs(gradient) + abs(jacobian).T @ np.abs(self.result.of_equations)
        limit = SLOPE_ROUNDING + VERIFIED * (np.abs(basis).T @ slopes)
        if np.any(np.abs(modes.undetermined(self._slope)) > limit):
            return Status.UNBOUNDED
        return Status.SADDLE if self._falls(modes) else Status.FLAT

    @property
    def solved(self) -> bool:
        """Whether this is an optimum."""
        return self._status in OPTIMA

    @property
    def ended(self) -> bool:
        """Whether IPOPT ended at what it takes for an optimum."""
        return self.unsolved is None and STATUS.get(self.result.status) is Status.OPTIMUM

    @property
    def settled(self) -> bool:
        """Whether this is a strict minimum to the digits of double precision."""
        return self._status is Status.OPTIMUM

    def from_here(self, interface: Interface) -> "OwnSolution":
        """Return the solution of an interface that begins at this one, with its multipliers."""
        instance = replace(self.instance, start=self.result.unknown)
        result = interface.minimise(instance, instance.multipliers_of(self.result))
        iterations = self.iterations + result.iterations
        return replace(self, result=replace(result, iterations=iterations))

    def improves(self, other: "OwnSolution") -> bool:
        """Return whether this solution fulfils the conditions of an optimum better than another."""
        if self.settled or not self.ended:
            return self.settled
        return self.optimality_error < other.optimality_error

    @property
    def iterations(self) -> int:
        """Iterations of IPOPT."""
        return self.result.iterations

    @property
    def objective(self) -> float:
        """Cost φ, own costs included; NaN where nothing was solved."""
        return self._cost * self.instance.cost_scale if self.solved else float("nan")

    @property
    def cell_resistance(self) -> Array:
        """Cells, (frames, rows, columns) ohm; NaN where nothing was solved."""
        cells = self.instance.cells_of(self.result)
        return cells if self.solved else np.full_like(cells, np.nan)

    def __getitem__(self, name: str) -> Array:
        """Return an own unknown, (size,); NaN where nothing was solved.

        Raises InputError for an unknown name.
        """
        self._check_name(name)
        values = self.instance.program.unknown.named(self.result.unknown)[name]
        return values if self.solved else np.full_like(values, np.nan)

    @property
    def cell_resistance_errors(self) -> Array:
        """Standard deviations of the cells, (frames, rows, columns) ohm.

        A cell at a bound has zero, an undetermined one infinity. The misfit must be weighted by the
        noise for these numbers to have a meaning.
        """
        conductance = self.instance.scale / self.instance.cells_of(self.result)
        relative = self._deviations("conductance").reshape(self.instance.shape) / conductance
        return np.asarray(self.cell_resistance * relative)

    def errors(self, name: str) -> Array:
        """Return the standard deviations of an own unknown, (size,); infinite if undetermined.

        Raises InputError for an unknown name.
        """
        self._check_name(name)
        return self._deviations(name)

    @cached_property
    def optimality_error(self) -> float:
        """Largest deviation from the conditions of the first order, in units of the program.

        These are x = Π(x − ∇L) over the bounds of the unknowns, and g = Π(g + λ) over the limits of
        the constraints, with λ in the units of the Jacobian's rows. All derivatives are evaluated
        anew, outside of IPOPT.
        """
        gradient, jacobian, _ = self._derivatives
        multiplier = self.result.of_equations
        x = self.result.unknown
        instance = self.instance
        projected = np.clip(x - gradient - jacobian.T @ multiplier, instance.lower, instance.upper)
        size = np.maximum(np.abs(jacobian).max(axis=1).toarray().ravel(), 1.0)
        low, high = (limit / size for limit in instance.equations)
        values = self._equations / size
        kept = np.clip(values + multiplier * size, low, high)
        return float(max(np.abs(x - projected).max(), np.abs(values - kept).max(initial=0.0)))

    def _check_name(self, name: str) -> None:
        """Raise InputError unless the program has an own unknown of this name."""
        own = self.instance.program.own
        if name not in own:
            raise InputError(
                f"the program has no own unknown {name}; it has {', '.join(own) or 'none'}"
            )

    @cached_property
    @guarded
    def _values(self) -> Callable[[Array], tuple[float, Array]]:
        """Function x → cost φ/cost_scale, and constraints (constraints,)."""
        nlp = self.instance.program.nlp
        function = casadi.Function("values", [nlp["x"], nlp["p"]], [nlp["f"], nlp["g"]])

        @guarded
        def values(unknown: Array) -> tuple[float, Array]:
            cost, equations = function(unknown, self.instance.parameter)
            return float(cost), np.asarray(equations).ravel()

        return values

    @property
    def _cost(self) -> float:
        """φ/cost_scale."""
        return self._values(self.result.unknown)[0]

    @property
    def _equations(self) -> Array:
        """Values of all constraints, (constraints,)."""
        return self._values(self.result.unknown)[1]

    @cached_property
    @guarded
    def _derivatives(self) -> tuple[Array, scipy.sparse.csc_array, scipy.sparse.csc_array]:
        """∇f (unknowns,), J (constraints, unknowns), and ∇²L (unknowns, unknowns)."""
        program = self.instance.program
        x = self.result.unknown
        p = self.instance.parameter
        nlp = program.nlp
        at = [nlp["x"], nlp["p"]]
        outputs = [casadi.gradient(nlp["f"], nlp["x"]), casadi.jacobian(nlp["g"], nlp["x"])]
        gradient, jacobian = casadi.Function("first", at, outputs)(x, p)
        upper = scipy.sparse.csc_array(
            program.hessian()(x, p, 1.0, self.result.of_equations).sparse()
        )
        hessian = upper + scipy.sparse.triu(upper, 1).T
        return (
            np.asarray(gradient).ravel(),
            scipy.sparse.csc_array(jacobian.sparse()),
            scipy.sparse.csc_array(hessian),
        )

    @cached_property
    def _directions(self) -> Directions:
        """Directions along the active constraints.

        Unknowns at a bound stay, voltages follow the cells by the balance of currents, and the
        other active constraints leave the null space of their rows.
        """
        _, jacobian, hessian = self._derivatives
        instance = self.instance
        program = instance.program
        x = self.result.unknown
        names = np.repeat([*program.unknown.sizes], [*program.unknown.sizes.values()])
        follows = np.isin(names, [*program.networks[0].voltages])
        balance = program.equation.sizes["balance"]
        by_voltage = scipy.sparse.linalg.splu(jacobian[:balance, follows])
        leads = np.flatnonzero(~follows)
        leading = np.zeros((len(x), len(leads)))
        leading[leads, np.arange(len(leads))] = 1.0
        leading[follows] = -by_voltage.solve(jacobian[:balance, leads].toarray())
        # A multiplier that a move off the bound by its distance would make holds nothing.
        curvature = np.zeros(len(x))
        curvature[leads] = np.sum(leading * (hessian @ leading), axis=0)
        held = _held(
            x,
            self.result.of_bounds / np.maximum(CLEAR * np.abs(curvature), SLOPE_ROUNDING),
            (instance.lower, instance.upper),
        )
        # Of p and q, the smaller one is at its bound: their sum costs.
        place = int(np.argmax(names == "split"))
        for part in program.lowered:
            for side in part.split[:1]:
                first = place + np.arange(side.shape[0])
                second = first + side.shape[0]
                held[np.where(x[first] < x[second], first, second)] = True
                place += 2 * side.shape[0]
        leading = leading[:, ~held[leads]]
        active = _held(self._equations, self.result.of_equations, instance.equations)
        rows = jacobian[balance + np.flatnonzero(active[balance:])] @ leading
        size = np.linalg.norm(rows, axis=1, keepdims=True)
        basis = leading
        if len(rows):
            basis = leading @ scipy.linalg.null_space(rows / np.where(size > 0, size, 1.0))
        return Directions(held, follows, active, leading, rows, basis)

    @cached_property
    def _slope(self) -> Array:
        """Gradient Zᵀ ∇L along the constraints, (n,)."""
        gradient, jacobian, _ = self._derivatives
        basis = self._directions.basis
        return np.asarray(basis.T @ (gradient + jacobian.T @ self.result.of_equations))

    @cached_property
    def _modes(self) -> Modes | None:
        """Modes of the curvature Zᵀ ∇²L Z; None where it is beyond double precision."""
        _, _, hessian = self._derivatives
        basis = self._directions.basis
        size = np.abs(basis)
        # Diagonal entries of which the rounding errors of the sums are a share of ROUNDING
        least = np.finfo(float).eps / ROUNDING * np.sum(size * (abs(hessian) @ size), axis=0)
        least = np.maximum(least, np.finfo(float).tiny)
        return Modes.of(basis.T @ (hessian @ basis), least)

    def _falls(self, modes: Modes) -> bool:
        """Return whether the cost falls along a direction of no curvature.

        Only points within the constraints count, to first order.
        """
        x = self.result.unknown
        cost, equations = self._values(x)
        flat = self._directions.basis @ (modes.vectors[:, ~modes.solid] / modes.size[:, None])
        for along in flat.T / np.abs(flat).max(axis=0)[:, None]:
            for length in PROBES:
                for step in (length * along, -length * along):
                    inside = np.clip(x + step, self.instance.lower, self.instance.upper)
                    lower, moved = self._values(inside)
                    near = np.abs(moved - equations).max(initial=0.0) <= SAME_PLACE
                    if near and lower < cost - SLOPE_ROUNDING:
                        return True
        return False

    @cached_property
    def _spread(self) -> tuple[Array, Array]:
        """Factor W of the covariance, cov(x) = W Wᵀ, and the undetermined directions.

        Returns
        -------
        factor : array, shape (unknowns, n)
        undetermined : array, shape (unknowns, m)
        """
        modes = self._modes
        assert modes is not None
        directions = self._directions.basis @ (modes.vectors / modes.size[:, None])
        # f = φ/cost_scale, and φ = χ²: the posterior is exp(−φ/2)
        curvature = modes.values[modes.solid] * (self.instance.cost_scale / 2)
        return directions[:, modes.solid] / np.sqrt(curvature), directions[:, ~modes.solid]

    def _deviations(self, name: str) -> Array:
        """Return the standard deviations of one block of unknowns, in the program's unit."""
        places = self.instance.program.unknown.named(
            np.arange(len(self.result.unknown), dtype=float)
        )
        chosen = places[name].astype(int)
        if not self.solved:
            return np.full(len(chosen), np.nan)
        factor, undetermined = (part[chosen] for part in self._spread)
        deviations = np.sqrt(np.sum(factor**2, axis=1))
        return np.where(_reaches(undetermined, self._spread[1]), np.inf, deviations)


def _reaches(chosen: Array, directions: Array) -> NDArray[np.bool_]:
    """Return which rows, (rows, m), move along any of m directions, (unknowns, m)."""
    size = np.abs(directions).max(axis=0, initial=0.0)
    return np.asarray(np.any(np.abs(chosen) > VERIFIED * size, axis=1))


def _held(value: Array, multiplier: Array, limits: tuple[Array, Array]) -> NDArray[np.bool_]:
    """Return which values a limit holds, see `on_bounds`; equal limits hold always."""
    low, high = limits
    at_limit = on_bounds(value, multiplier, low, high)
    return np.asarray((low == high) | (at_limit == low) | (at_limit == high))
