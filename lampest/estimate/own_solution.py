"""Solution of an own program: its status, error bars, multipliers and sensitivities.

A check outside of IPOPT recomputes the conditions of an optimum. Unknowns move along the active
constraints, in the directions Z that these leave. With the Lagrangian L = φ + λᵀg,

    Zᵀ ∇²L Z > 0                          a minimum, and no saddle
    cov(x) = Z (½ Zᵀ ∇²L Z)⁻¹ Zᵀ          the covariance, where φ = −2 ln p
    Zᵀ ∇²L dx = −Zᵀ ∂(∇L)/∂p dp           sensitivities to p, with A dx = −∂g/∂p dp

A is the Jacobian of the active constraints. Source: Nocedal & Wright, Numerical Optimization, 2006,
sections 12.5 and 16.2; Fiacco, Introduction to Sensitivity and Stability Analysis, 1983.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise, product

import casadi
import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg

from lampest.estimate.own_directions import SLOPE_ROUNDING, Directions
from lampest.files.errors import InputError, counted
from lampest.formulation.instance import Instance, ProgramResult
from lampest.formulation.ipopt import Interface
from lampest.formulation.program import CELL_BOUNDS, Program
from lampest.panel.compiled import SymbolsOwner, guarded
from lampest.panel.panel import Array, Mask
from lampest.solvers.by_ipopt import STATUS
from lampest.solvers.certificate import ROUNDING, Definiteness, Modes
from lampest.solvers.solution import OPTIMA, VERIFIED, Status

# Lengths, in units of the program, at which the cost beside a flat point is looked at.
PROBES = (1.0, 0.1, 0.01)
SAME_PLACE = 1e-9  # violation of the equations that a probe may cause
# Optimality error of a settled solution. Between a bound that holds a cell by as much and the next
# point IPOPT has not decided, so that own numbers and cells put on bounds disagree.
SETTLED = 1e-8


@dataclass(frozen=True, eq=False)
class OwnSolution(SymbolsOwner):
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

    def __repr__(self) -> str:
        """Return the solution as a table: status, cost, and its unknowns by name."""
        lines = [f"{self.status}; {counted(self.iterations, 'iteration')} of IPOPT"]
        if not self.solved:
            return lines[0]
        lines[0] += f"; cost {self.objective:.6g}"
        values = {"cell_resistance [ohm]": (self.cell_resistance, self.cell_resistance_errors)}
        values |= {name: (self[name], self.errors(name)) for name in self.instance.program.own}
        for name, (value, error) in values.items():
            spread = f"{np.median(error):.3g}"
            text = f"{value.min():.6g} to {value.max():.6g}"
            text = f"{value.item():.6g}" if value.size == 1 else text
            lines.append(f"    {name:<24}{value.size:>6}  {text} ± {spread}")
        for name, multiplier in self.multipliers.items():
            largest = np.abs(multiplier).max(initial=0.0)
            line = f"    λ of {name:<19}{multiplier.size:>6}  at most {largest:.4g}"
            lines += [line] * bool(multiplier.size)
        return "\n".join(lines)

    @cached_property
    def status(self) -> str:
        """Outcome in a sentence, as `Status` has them."""
        return self.verdict.value

    @cached_property
    def verdict(self) -> Status:
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
        basis = self._directions.basis
        if modes.definiteness is not Definiteness.UNDETERMINED:
            step = np.abs(basis @ modes.step(self._slope))
            short = np.all(step <= VERIFIED * np.maximum(np.abs(self.result.unknown), 1.0))
            return Status.OPTIMUM if short else Status.FAINT
        # No cost falls along a plateau. A slope counts beyond the millionth part of the slopes that
        # cancel in it.
        gradient, jacobian, _ = self._derivatives
        slopes = np.abs(gradient) + abs(jacobian).T @ np.abs(self.result.of_equations)
        limit = SLOPE_ROUNDING + VERIFIED * (np.abs(basis).T @ slopes)
        if np.any(np.abs(modes.undetermined(self._slope)) > limit):
            return Status.UNBOUNDED
        return Status.SADDLE if self._falls() else Status.FLAT

    @property
    def solved(self) -> bool:
        """Whether this is an optimum."""
        return self.verdict in OPTIMA

    @property
    def ended(self) -> bool:
        """Whether IPOPT ended at what it takes for an optimum."""
        return self.unsolved is None and STATUS.get(self.result.status) is Status.OPTIMUM

    @property
    def settled(self) -> bool:
        """Whether this is a strict minimum to the digits of double precision."""
        return self.verdict is Status.OPTIMUM and self.optimality_error <= SETTLED

    def refined(self, interface: Interface) -> "OwnSolution":
        """Return the solution that a fine solve reaches from this one, if it is better."""
        if not self.ended or self.settled:
            return self
        instance = replace(self.instance, start=self.result.unknown)
        result = interface.minimise(instance, instance.multipliers_of(self.result), fine=True)
        finer = self.ended_at(result)
        weaker = self.verdict is Status.OPTIMUM and finer.verdict is not Status.OPTIMUM
        nearer = finer.ended and finer.optimality_error < self.optimality_error
        return finer if finer.settled or (nearer and not weaker) else self

    def ended_at(self, result: ProgramResult) -> "OwnSolution":
        """Return the solution with a further result, and the iterations of both."""
        iterations = self.iterations + result.iterations
        return replace(self, result=replace(result, iterations=iterations))

    @property
    def iterations(self) -> int:
        """Iterations of IPOPT."""
        return self.result.iterations

    @property
    def objective(self) -> float:
        """Cost φ, own costs included; NaN where nothing was solved."""
        cost, _ = self._values(self.result.unknown)
        return cost * self.instance.cost_scale if self.solved else float("nan")

    @property
    def cell_resistance(self) -> Array:
        """Cells, (frames, rows, columns) ohm; NaN where nothing was solved."""
        return self._if_solved(self.instance.cells_of(self.result))

    def __getitem__(self, name: str) -> Array:
        """Return an own unknown, (size,); NaN where nothing was solved.

        Raises InputError for an unknown name.
        """
        self._check_name(name)
        return self.value(name).ravel()

    @property
    def cell_resistance_errors(self) -> Array:
        """Standard deviations of the cells, (frames, rows, columns) ohm.

        A cell at a bound has zero, an undetermined one infinity. The misfit must be weighted by the
        noise for these numbers to have a meaning.
        """
        return self._deviations("cell_resistance").reshape(self.instance.shape)

    def value(self, of: str | casadi.SX) -> Array:
        """Return the value of an expression of the program's symbols, or of a name, of its shape.

        Values are NaN where nothing was solved. The names are those of `covariance`.
        Raises InputError for another name, and for symbols of another program.
        """
        return self._if_solved(self._evaluated(self._function(of, ""))[0])

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

    @property
    def history(self) -> dict[str, Array]:
        """IPOPT's table of iterations by its own names, such as `inf_pr`, `inf_du` and `mu`."""
        return {name: np.asarray(values) for name, values in self.result.history.items()}

    @property
    def multipliers(self) -> dict[str, Array]:
        """Multipliers λ of the constraints by name, (rows,), φ for each unit of the constraint.

        Those of 'balance' are (frames, equations). A limit that is raised by a small amount d
        changes the least cost by −λ·d: λ is positive at an upper limit. NaN where nothing was
        solved.
        """
        named = self.instance.program.equation.named(
            self._if_solved(self.result.of_equations * self.instance.cost_scale)
        )
        named["balance"] = named["balance"].reshape(self.instance.shape[0], -1)
        return named

    @property
    def bound_multipliers(self) -> dict[str, Array]:
        """Multipliers of the bounds of the unknowns by name, (size,), φ for each unit of `places`.

        They are positive at an upper bound, negative at a lower one.
        """
        column = self.result.of_bounds * self.instance.cost_scale / self._units
        return self.instance.program.unknown.named(self._if_solved(column))

    @cached_property
    def places(self) -> dict[str, slice]:
        """Rows of each unknown in `hessian`, by name.

        Conductances are in siemens, frame by frame and row by row; voltages in volt or V/A; own
        unknowns in their unit.
        """
        sizes = self.instance.program.unknown.sizes
        ends = pairwise(np.cumsum([0, *sizes.values()]).tolist())
        return {name: slice(*rows) for name, rows in zip(sizes, ends, strict=True)}

    @property
    def hessian(self) -> scipy.sparse.csc_array:
        """∇²L of the Lagrangian L = φ + λᵀg by the unknowns in the units of `places`, (n, n).

        NaN where nothing was solved.
        """
        units = scipy.sparse.diags_array(self._if_solved(1 / self._units))
        curvature = units @ self._derivatives[2] @ units
        return scipy.sparse.csc_array(curvature * self.instance.cost_scale)

    def covariance(self, of: str | casadi.SX = "cell_resistance") -> Array:
        """Return the covariance of unknowns, or of any expression of them, (size, size).

        Rows and columns of what the program leaves undetermined are infinite. The misfit must be
        weighted by the noise for the numbers to have a meaning.

        Parameters
        ----------
        of : str or casadi.SX, shape (size, 1)
            'cell_resistance' in ohm, its logarithm 'log_cell_resistance', 'conductance' in siemens,
            the modelled 'reading', a voltage, or an own unknown; or an expression of the program's
            symbols.

        Raises InputError for another name.
        """
        _, outer, _ = self._evaluated(self._function(of, ""))
        if not self.solved:
            return np.full((len(outer), len(outer)), np.nan)
        factor = outer @ self._spread[0]
        free = self._free(outer)
        return np.where(free[:, None] | free, np.inf, factor @ factor.T)

    def sensitivity(self, *, of: str | casadi.SX = "cell_resistance", to: str) -> Array:
        """Return the derivative of the solution by what was given, (size of `of`, size of `to`).

        Everything else that was given is held: a reading moves neither its standard deviation nor a
        bound. Constraints and bounds that hold go on to hold. NaN where nothing was solved, and for
        what the program leaves undetermined.

        Parameters
        ----------
        of : str or casadi.SX, shape (size, 1)
            As in `covariance`.
        to : str
            'measured' or another array that the terms read, in its unit, frame by frame and row by
            row; 'weights' of the terms; 'lower' or 'upper' bounds of the cells, in ohm; or the name
            of an own constraint, for its limit that holds.

        Raises InputError for another name.
        """
        count = self._size_of(to)
        _, outer, explicit = self._evaluated(self._function(of, to))
        if not self.solved:
            return np.full((len(outer), count), np.nan)
        total = outer @ self._moved(to, count)
        if explicit.shape[1]:
            total += explicit
        return np.where(self._free(outer)[:, None], np.nan, total)

    @guarded
    def _function(self, of: str | casadi.SX, to: str) -> casadi.Function:
        """Return the function (x, p) → value, slopes by x, and by a parameter.

        Raises InputError for a name that is no unknown.
        """
        program = self.instance.program
        if not isinstance(of, str):
            return _with_slopes(program, program.expression("the expression", of), to)
        if of not in program.quantities:
            names = ", ".join(program.quantities)
            raise InputError(f"the program has no unknown {of}; it has {names}")
        return _slopes_by_name(program, of, to)

    @guarded
    def _evaluated(self, function: casadi.Function, *more: Array) -> list[Array]:
        """Return the results of a function of x, p and further arguments, as arrays."""
        results = function(self.result.unknown, self.instance.parameter, *more)
        return list(map(np.asarray, results))

    def _size_of(self, to: str) -> int:
        """Return the number of entries of what a sensitivity is taken to.

        Raises InputError for another name.
        """
        program = self.instance.program
        given = (*dict(program.given.named()), "weights")
        sizes = {name: program.parameter.sizes[name] for name in given}
        sizes |= dict.fromkeys(CELL_BOUNDS, program.unknown.sizes["conductance"])
        sizes |= {name: program.equation.sizes[name] for name in program.own_constraints}
        if to not in sizes:
            raise InputError(f"there is no sensitivity to {to}; there is one to {', '.join(sizes)}")
        return sizes[to]

    def _moved(self, to: str, count: int) -> Array:
        """Return dx/dp of the unknowns, (unknowns, parameters).

        With A dx = b along the active constraints, dx = dx₀ + Z w, where dx₀ is any solution of
        them, and Zᵀ∇²L Z w = −Zᵀ(∂∇L/∂p + ∇²L dx₀).
        """
        instance = self.instance
        program = instance.program
        modes = self._modes
        assert modes is not None
        directions = self._directions
        _, jacobian, hessian = self._derivatives
        # ∂(∇L)/∂p, the change of the constraints' right sides, and that of held unknowns
        slopes: Array = np.zeros((len(self.result.unknown), count))
        limits: Array = np.zeros((len(self.result.of_equations), count))
        moved = np.zeros_like(slopes)
        if to in program.parameter.symbols:
            forces = _forces_by(program, to)
            slopes, by_equation = self._evaluated(forces, self.result.of_equations)
            limits = -by_equation
        elif to in program.own_constraints:
            rows = program.equation.named(np.arange(len(limits), dtype=float))[to].astype(int)
            limits[rows, np.arange(count)] = 1.0
        else:  # g = s/r at the bound that holds it
            place = self.places["conductance"]
            bounds = instance.lower[place], instance.upper[place]
            other, limit = bounds if to == "lower" else bounds[::-1]
            value = self.result.unknown[place]
            nearer = np.abs(value - limit) < np.abs(value - other)
            held = directions.held[place] & nearer
            moved[place] = np.diag(np.where(held, -(limit**2) / instance.scale, 0.0))
        balance = program.equation.sizes["balance"]
        follows = directions.follows
        by_voltage = scipy.sparse.linalg.splu(jacobian[:balance, follows])
        moved[follows] = by_voltage.solve((limits - jacobian @ moved)[:balance])
        own = balance + np.flatnonzero(directions.active[balance:])
        if len(own):
            missing = (limits - jacobian @ moved)[own]
            moved += directions.leading @ np.linalg.lstsq(directions.rows, missing)[0]
        basis = directions.basis
        force = basis.T @ (slopes + hessian @ moved)
        return moved + basis @ modes.step(force)

    def _if_solved(self, values: Array) -> Array:
        """Return values, NaN where nothing was solved."""
        return values if self.solved else np.full_like(values, np.nan)

    @cached_property
    @guarded
    def _units(self) -> Array:
        """Unit of each unknown of the program in those of `places`, (unknowns,)."""
        program = self.instance.program
        natural = casadi.vertcat(*(program.quantities[name] for name in program.unknown.sizes))
        units = casadi.Function("units", [program.nlp["x"], program.nlp["p"]], [natural])
        return np.asarray(units(1.0, self.instance.parameter)).ravel()

    def _check_name(self, name: str) -> None:
        """Raise InputError unless the program has an own unknown of this name."""
        own = self.instance.program.own
        if name not in own:
            raise InputError(
                f"the program has no own unknown {name}; it has {', '.join(own) or 'none'}"
            )

    @guarded
    def _values(self, unknown: Array) -> tuple[float, Array]:
        """Return the cost φ/cost_scale, and the constraints (constraints,), at unknowns x."""
        derivatives = self.instance.program.derivatives
        arguments = unknown, self.instance.parameter
        cost, _ = derivatives["grad_f"](*arguments)
        equations, _ = derivatives["jac_g"](*arguments)
        return float(cost), np.asarray(equations).ravel()

    @property
    def _equations(self) -> Array:
        """Values of all constraints, (constraints,)."""
        return self._values(self.result.unknown)[1]

    @cached_property
    @guarded
    def _derivatives(self) -> tuple[Array, scipy.sparse.csc_array, scipy.sparse.csc_array]:
        """∇f (unknowns,), J (constraints, unknowns), and ∇²L (unknowns, unknowns)."""
        derivatives = self.instance.program.derivatives
        arguments = self.result.unknown, self.instance.parameter
        _, gradient = derivatives["grad_f"](*arguments)
        _, jacobian = derivatives["jac_g"](*arguments)
        upper = scipy.sparse.csc_array(
            derivatives["hess_lag"](*arguments, 1.0, self.result.of_equations).sparse()
        )
        hessian = upper + scipy.sparse.triu(upper, 1).T
        return (
            np.asarray(gradient).ravel(),
            scipy.sparse.csc_array(jacobian.sparse()),
            scipy.sparse.csc_array(hessian),
        )

    @cached_property
    def _directions(self) -> Directions:
        """Directions along the active constraints."""
        _, jacobian, hessian = self._derivatives
        return Directions.of(self.instance, self.result, self._equations, jacobian, hessian)

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

    def _falls(self) -> bool:
        """Return whether the cost falls along a direction of no curvature.

        Only points within the constraints count, to first order.
        """
        x = self.result.unknown
        cost, equations = self._values(x)
        flat = self._spread[1]
        along = flat.T / np.abs(flat).max(axis=0)[:, None]
        for direction, length, side in product(along, PROBES, (1, -1)):
            step = side * length * direction
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

    def _deviations(self, of: str) -> Array:
        """Return the standard deviations of a quantity, (size,), as `covariance` has them."""
        return np.sqrt(np.diag(self.covariance(of)))

    def _free(self, outer: Array) -> Mask:
        """Return which rows of a quantity move, beyond rounding, along undetermined directions.

        `outer` are the derivatives of the quantity by the unknowns, (size, unknowns).
        """
        undetermined = self._spread[1]
        largest = np.abs(undetermined).max(axis=0, initial=0.0)
        size = np.abs(outer).sum(axis=1, keepdims=True) * largest
        return np.asarray(np.any(np.abs(outer @ undetermined) > VERIFIED * size, axis=1))


def _with_slopes(program: Program, expression: casadi.SX, to: str) -> casadi.Function:
    """Return the function (x, p) → expression, and its derivatives by x and by a parameter."""
    nlp = program.nlp
    given = program.parameter.symbols.get(to, casadi.SX(0, 1))
    outputs = [
        expression,
        *(casadi.jacobian(casadi.vec(expression), by) for by in (nlp["x"], given)),
    ]
    return casadi.Function("slopes", [nlp["x"], nlp["p"]], list(map(casadi.densify, outputs)))


@lru_cache(maxsize=32)
def _slopes_by_name(program: Program, of: str, to: str) -> casadi.Function:
    """Return `_with_slopes` of a quantity; it is built once for the frames of a recording."""
    return _with_slopes(program, program.quantities[of], to)


@guarded
@lru_cache(maxsize=32)
def _forces_by(program: Program, to: str) -> casadi.Function:
    """Return the function (x, p, λ) → ∂(∇L)/∂q and ∂g/∂q, by a parameter q."""
    nlp = program.nlp
    symbol = program.parameter.symbols[to]
    multiplier = casadi.SX.sym("multiplier", nlp["g"].shape[0])
    lagrangian = nlp["f"] + casadi.dot(multiplier, nlp["g"])
    slopes = casadi.gradient(lagrangian, nlp["x"])
    outputs = [casadi.densify(casadi.jacobian(value, symbol)) for value in (slopes, nlp["g"])]
    return casadi.Function("forces", [nlp["x"], nlp["p"], multiplier], outputs)
