"""IPOPT with node voltages as unknowns: formulations of the network, nonlinear program, and solver.

The unknowns of the program are conductances s/r (s: geometric mean of the measured resistances), potentials in units of
s, and parts p, q ≥ 0 of every residual whose loss is not smooth (`Loss.lowered`). The cost is divided by its size.
Derivatives are exact and sparse.
Source: Wächter & Biegler, Mathematical Programming 106, 2006.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import casadi
import numpy as np

from lampest.cost.cost import Cost, Symbols, lowered, program_groups, summands
from lampest.cost.problem import NO_DUAL, Data, Evaluation
from lampest.files.errors import InputError
from lampest.panel.compiled import CasadiOwner, Compiled, guarded
from lampest.panel.kirchhoff import current_balance
from lampest.panel.network import Network, reads_own
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout, TwoPointReadout
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
class NetworkSymbols:
    """Symbols of one frame's network.

    Attributes
    ----------
    potentials : casadi.SX, shape (n, 1)
        Node voltages for unit currents, the unknowns.
    balance : casadi.SX, shape (n, 1)
        Kirchhoff's current law; zero at a solution, bilinear in conductances and potentials.
    reading : casadi.SX, shape (cells, 1)
        Modelled readings, row-major, in the readout's unit.
    """

    potentials: casadi.SX
    balance: casadi.SX
    reading: casadi.SX


class Formulation(ABC):
    """Node voltages as decision variables, Kirchhoff's current law as constraints."""

    @abstractmethod
    def network(
        self, readout: Readout, conductance: casadi.SX, tie: casadi.SX, scale: casadi.SX, prefix: str
    ) -> NetworkSymbols:
        """Return variables and equations of one frame's network.

        Parameters
        ----------
        readout : Readout
        conductance : casadi.SX, shape (rows, columns)
            Conductances in 1/`scale`.
        tie : casadi.SX, shape (rows + columns, 1)
            Ties of the lines to ground in 1/`scale`.
        scale : casadi.SX
            Unit of resistances in ohm; potentials for unit currents have the same unit.
        prefix : str
            Begin of the names of the symbols.
        """

    @abstractmethod
    def potentials(self, readout: Readout, network: Network) -> Array:
        """Return the values of `NetworkSymbols.potentials` in a solved network, in ohm."""

    @abstractmethod
    def multipliers(self, readout: Readout, network: Network, tie: Array, slope: Array) -> Array:
        """Return the multipliers λ of `NetworkSymbols.balance` in a solved network, (n,).

        They solve ∂φ/∂V + λᵀ ∂balance/∂V = 0, V the `potentials`.

        Parameters
        ----------
        readout : Readout
        network : Network
        tie : array, shape (lines,)
            Ties to ground, siemens.
        slope : array, shape (n,)
            ∂φ/∂V, 1/ohm.

        Raises
        ------
        numpy.linalg.LinAlgError
            If double precision does not suffice.
        """

    def check(self, readout: Readout) -> None:  # noqa: B027 - most formulations know all readouts
        """Raise InputError for a readout that the formulation cannot express."""


@dataclass(frozen=True)
class Nodal(Formulation):
    """Nodal formulation: y_jk = h(Z_jj, Z_kk, Z_jk), column c of Z the potentials for a unit current into line c.

    The n lines of the shorter side are driven, the m others are far. Unknowns are half of the symmetric driven block
    of Z, the far-driven block, and the diagonal of the far block where the readout reads it: n(n + 1)/2 + mn + m.
    """

    kind: Literal["nodal"] = "nodal"

    def network(
        self, readout: Readout, conductance: casadi.SX, tie: casadi.SX, scale: casadi.SX, prefix: str
    ) -> NetworkSymbols:
        far, driven = sorted(conductance.shape, reverse=True)
        swapped = conductance.shape[0] < conductance.shape[1]
        cells = conductance.T if swapped else conductance
        ties = [casadi.diag(part) for part in casadi.vertsplit(tie, [0, conductance.shape[0], tie.shape[0]])]
        tie_far, tie_driven = _far_first(ties, conductance.shape)
        # Unknowns: Z_dd (upper half), Z_fd, and diag(Z_ff).
        half = casadi.SX.sym(f"{prefix}driven_driven", driven * (driven + 1) // 2)
        mixed = casadi.SX.sym(f"{prefix}far_driven", far * driven)
        far_far = casadi.SX.sym(f"{prefix}far_far", far)
        near_potential = casadi.triu2symm(casadi.SX(casadi.Sparsity.upper(driven), half))
        far_potential = casadi.reshape(mixed, driven, far).T

        # L·Z = 1: (far, driven) block zero, (driven, driven) block 1 by its lower half, diagonal of the far block 1
        from_far, from_driven = current_balance(cells, far_potential, near_potential)
        from_far += tie_far @ far_potential
        from_driven += tie_driven @ near_potential - casadi.DM.eye(driven)
        from_own, _ = current_balance(cells, casadi.diag(far_far), far_potential.T)
        own_balance = casadi.diag(from_own + tie_far @ casadi.diag(far_far)) - 1
        lower = casadi.vertcat(*(from_driven[line, : line + 1].T for line in range(driven)))

        # Z_jj and Z_kk of every cell in the order (rows, columns) of the readout
        of_far, of_driven = casadi.repmat(far_far, 1, driven), casadi.repmat(casadi.diag(near_potential).T, far, 1)
        entries = [of_driven.T, of_far.T, far_potential.T] if swapped else [of_far, of_driven, far_potential]
        inner, outer = (1, scale) if readout.homogeneous else (scale, 1)
        reading = outer * readout.reading(*(inner * entry for entry in entries))
        reads_far, _ = _far_first(reads_own(readout, *conductance.shape), conductance.shape)
        return NetworkSymbols(
            casadi.vertcat(half, mixed, *([far_far] if reads_far else [])),
            casadi.vertcat(lower, casadi.vec(from_far.T), *([own_balance] if reads_far else [])),
            casadi.vec(reading.T),
        )

    def potentials(self, readout: Readout, network: Network) -> Array:
        """Return half of the driven block, the far-driven block and, if read, the diagonal of the far block of Z."""
        impedance, shape = network.potentials(), network.conductance.shape
        far, driven = _far_first(np.split(np.arange(len(impedance)), [shape[0]]), shape)
        half = impedance[np.ix_(driven, driven)][np.tril_indices(len(driven))]
        far_far = np.diag(impedance)[far if _far_first(reads_own(readout, *shape), shape)[0] else []]
        return np.concatenate([half, impedance[np.ix_(far, driven)].ravel(), far_far])

    def multipliers(self, readout: Readout, network: Network, tie: Array, slope: Array) -> Array:
        """Return λ of the lower half of S·Z_d = 1, then λ of the far lines; S = Z_d⁻¹ is the Schur complement.

        F contains the slopes of φ in Z_d, including those through the far lines. The multipliers Λ of the driven lines
        solve SΛ + (SΛ)ᵀ = −F. With the Cholesky factor Z_d = HHᵀ this is triangular: H⁻¹ΛH + (H⁻¹ΛH)ᵀ = −HᵀFH.
        """
        impedance, shape = network.potentials(), network.conductance.shape
        far, driven = _far_first(np.split(np.arange(len(impedance)), [shape[0]]), shape)
        cells = network.conductance.T if shape[0] < shape[1] else network.conductance
        leaving = cells.sum(axis=1) + tie[far]
        rows, columns = np.tril_indices(len(driven))
        half, mixed, far_far = np.split(slope, [len(rows), len(rows) + cells.size])
        # F: slopes in Z_d, plus those in Z_fd and diag(Z_ff) through the balance of the far lines.
        through = mixed.reshape(cells.shape)
        if len(far_far):
            through = through + cells * (far_far / leaving)[:, None]
        slopes = (cells / leaving[:, None]).T @ through
        slopes[rows, columns] += half
        # Λ from H⁻¹ΛH = −(half of the diagonal, and the strict lower triangle, of HᵀFH)
        root = np.linalg.cholesky(impedance[np.ix_(driven, driven)])
        turned = root.T @ (slopes + slopes.T) @ root
        triangle = np.diag(turned.diagonal() / 2) - np.tril(turned)
        of_driven = np.linalg.solve(root.T, (root @ triangle).T).T
        # Multipliers of the far lines from the stationarity in Z_fd.
        of_far = (cells @ of_driven - through) / leaving[:, None]
        return np.concatenate([of_driven[rows, columns], of_far.ravel(), -far_far / leaving[: len(far_far)]])


def _far_first(sides: Any, shape: tuple[int, ...]) -> Any:
    """Return the pair (rows, columns) of values as (far, driven): the longer side is far."""
    return sides if shape[0] >= shape[1] else sides[::-1]


@dataclass(frozen=True)
class PerPixel(Formulation):
    """Per-pixel formulation of the paper, equations (5)-(9).

    R_jk = V_j − V^k while a unit current enters row j and leaves column k.
    """

    kind: Literal["per_pixel"] = "per_pixel"

    def check(self, readout: Readout) -> None:
        """Raise InputError for a readout other than two_point, whose patterns these are."""
        if not isinstance(readout, TwoPointReadout):
            raise InputError("formulation: per_pixel knows readout.kind: two_point only; nodal and reduced know all")

    def network(
        self, readout: Readout, conductance: casadi.SX, tie: casadi.SX, scale: casadi.SX, prefix: str
    ) -> NetworkSymbols:
        """Return (rows + columns)·cells voltages and as many current balances; see `Formulation.network`."""
        rows, columns = conductance.shape
        row_potential = casadi.SX.sym(f"{prefix}row", rows, rows * columns)
        column_potential = casadi.SX.sym(f"{prefix}column", columns, rows * columns)
        from_rows, from_columns = current_balance(conductance, row_potential, column_potential)
        # Unit currents of pattern c = (j, k), one column for each cell: into row j, out of column k.
        into_rows = casadi.kron(casadi.DM.eye(rows), casadi.DM.ones(1, columns))
        into_columns = casadi.kron(casadi.DM.ones(1, rows), casadi.DM.eye(columns))
        from_rows += casadi.diag(tie[:rows]) @ row_potential - into_rows
        from_columns += casadi.diag(tie[rows:]) @ column_potential + into_columns
        read = casadi.sum1(into_rows * row_potential) - casadi.sum1(into_columns * column_potential)
        return NetworkSymbols(
            casadi.vec(casadi.vertcat(row_potential, column_potential)),
            casadi.vec(casadi.vertcat(from_rows, from_columns)),
            scale * read.T,
        )

    def potentials(self, readout: Readout, network: Network) -> Array:
        rows, impedance = network.rows, network.potentials()
        pattern = impedance[:, :rows][:, :, None] - impedance[:, rows:][:, None, :]
        return pattern.reshape(len(impedance), -1).T.ravel()

    def multipliers(self, readout: Readout, network: Network, tie: Array, slope: Array) -> Array:
        """Return λ = −Z ∂φ/∂V, pattern by pattern; see `Formulation.multipliers`."""
        impedance = network.potentials()
        return -(slope.reshape(-1, len(impedance)) @ impedance).ravel()


FORMULATIONS: dict[str, Formulation] = {form.kind: form for form in (Nodal(), PerPixel())}


@dataclass(frozen=True, eq=False)
class Program:
    """Symbols of the nonlinear program with x = (conductance, potentials, split), g = (balance, split_balance) = 0.

    Attributes
    ----------
    split : casadi.SX
        Parts p and q of the residuals that enter through duals, then of the other split residuals, in units of
        `split_scale`.
    split_balance : casadi.SX
        Equations of the residuals that enter through duals; their multipliers are the last ones.
    parameters : mapping
        Name → symbol: the fields of `Given`, `ties` (lines, frames) in 1/s, `weights` of the terms, `scale` s in ohm,
        `cost_scale` (size of the cost) and `split_scale` (size of the split residuals).
    """

    conductance: casadi.SX
    potentials: casadi.SX
    split: casadi.SX
    balance: casadi.SX
    split_balance: casadi.SX
    objective: casadi.SX
    parameters: dict[str, casadi.SX]

    @property
    def unknown(self) -> casadi.SX:
        """Unknowns x as one column."""
        return casadi.vertcat(self.conductance, self.potentials, self.split)

    @property
    def parameter(self) -> casadi.SX:
        """All parameters as one column."""
        return casadi.vertcat(*(casadi.vec(symbol) for symbol in self.parameters.values()))

    @property
    def nlp(self) -> dict[str, casadi.SX]:
        """The program in the form of CasADi's solvers."""
        constraints = casadi.vertcat(self.balance, self.split_balance)
        return {"x": self.unknown, "p": self.parameter, "f": self.objective, "g": constraints}

    @classmethod
    def build(cls, cost: Cost, readout: Readout, formulation: Formulation) -> "Program":
        """Build the program of a cost, a readout and a formulation from symbolic matrices."""
        # Unknown conductances, parameters, and one network for each frame.
        given = cost.symbols().given
        rows, columns = cost.panel.shape
        tie = casadi.SX.sym("tie", rows + columns, cost.frames)
        scale, cost_scale, split_scale = (casadi.SX.sym(name) for name in ("scale", "cost_scale", "split_scale"))
        conductance = casadi.SX.sym("conductance", cost.panel.crossings, cost.frames)
        frames = [casadi.reshape(conductance[:, frame], columns, rows).T for frame in range(cost.frames)]
        networks = [
            formulation.network(readout, cells, tie[:, frame], scale, f"frame{frame}_")
            for frame, cells in enumerate(frames)
        ]
        reading = casadi.horzcat(*(network.reading for network in networks))
        # Objective: losses of the residuals, with non-smooth ones lowered to p, q ≥ 0 and equations.
        pairs = cost.residuals(Symbols(scale / conductance, reading, given))
        weights = casadi.SX.sym("weights", len(cost.terms))
        parts = [lowered(group, split_scale) for group in program_groups(summands(cost.terms, pairs, weights))]
        objective = sum((part.objective for part in parts), casadi.SX(0))
        empty = casadi.SX(0, 1)
        more = {"ties": tie, "weights": weights, "scale": scale, "cost_scale": cost_scale, "split_scale": split_scale}
        return cls(
            casadi.vec(conductance),
            casadi.vertcat(*(network.potentials for network in networks)),
            casadi.vertcat(empty, *(side for part in parts for side in part.split)),
            casadi.vertcat(*(network.balance for network in networks)),
            casadi.vertcat(empty, *(part.equation for part in parts if part.equation is not None)),
            objective / cost_scale,
            dict(given.named()) | more,
        )

    def slope(self) -> casadi.Function:
        """Return the function (x, p) → ∂f/∂(potentials), dense."""
        slope = casadi.densify(casadi.gradient(self.objective, self.potentials))
        return casadi.Function("slope", [self.unknown, self.parameter], [slope], ["x", "p"], ["slope"])

    def hessian(self) -> casadi.Function:
        """Return the function (x, p, σ, λ) → ∇²(σf + λᵀg), upper triangle, (x, x) sparse.

        The current balance is bilinear: its second derivatives are one block between conductances and potentials.
        """
        weight = casadi.SX.sym("weight")
        network_multiplier = casadi.SX.sym("network_multiplier", self.balance.shape[0])
        split_multiplier = casadi.SX.sym("split_multiplier", self.split_balance.shape[0])
        lagrangian = weight * self.objective + casadi.dot(split_multiplier, self.split_balance)
        full = casadi.jacobian(casadi.gradient(lagrangian, self.unknown), self.unknown, {"symmetric": True})
        slope = casadi.gradient(casadi.dot(network_multiplier, self.balance), self.potentials)
        block = casadi.jacobian(slope, self.conductance)
        potentials, conductances = block.shape
        upper = casadi.SX(*full.shape)
        upper[:conductances, conductances : conductances + potentials] = block.T
        arguments = [self.unknown, self.parameter, weight, casadi.vertcat(network_multiplier, split_multiplier)]
        names = ["x", "p", "lam_f", "lam_g"]
        return casadi.Function("nlp_hess_l", arguments, [casadi.triu(full) + upper], names, ["hess_gamma_x_x"])


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
        # Units: resistances in s, the geometric mean of the apparent ones; split residuals in the largest of the start
        # and of the apparent resistances, because a start at the baseline may leave none.
        scale = float(np.exp(np.mean(np.log(data.apparent_resistance))))
        split, apparent = (
            at.call(self.cost.functions.split) for at in (start, start.elsewhere(data.apparent_resistance))
        )
        split_scale = max(float(np.abs([split, apparent]).max(initial=0)), 1e-12)
        settings: dict[str, Any] = {"ties": data.ties.ravel() * scale, "weights": self.cost.weights}
        settings |= {"scale": scale, "cost_scale": start.cost_scale, "split_scale": split_scale}
        values = data.flat | settings
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
        gradient, conductance = start.log_gradient(NO_DUAL), x0[: start.cell_resistance.size]
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
