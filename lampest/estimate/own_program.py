"""The program of some frames, to which a notebook adds unknowns and constraints.

    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=10.0)]
    program = lampest.program(recording, terms)
    program = program.subject_to("equal", program.cells()[0, 3] - program.cells()[0, 4])
    solved = program.solve()
    solved.cell_resistance, solved.cell_resistance_errors

IPOPT solves it from the uniform start. A check outside of IPOPT recomputes the optimality
conditions, and error bars are those of the program's own Hessian on the plane of its equations:

    cov(x) = Z (½ Zᵀ ∇²L Z)⁻¹ Zᵀ

with the Lagrangian L of φ, and a basis Z of the directions along the active constraints, over the
unknowns that no bound holds. The definiteness of Zᵀ ∇²L Z distinguishes a minimum from a saddle.
Source: Nocedal & Wright, Numerical Optimization, 2006, sections 12.5 and 16.2.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi
import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

from lampest.cost.given import Background
from lampest.cost.problem import Evaluation
from lampest.cost.terms import Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.method import OptimalMethod
from lampest.files.errors import InputError
from lampest.formulation.circuit import Circuit
from lampest.formulation.instance import Instance, ProgramResult, on_bounds
from lampest.formulation.ipopt import Interface, Limits
from lampest.formulation.patterns import EXCITATIONS
from lampest.formulation.program import Program
from lampest.inference.prepared import Prepared
from lampest.panel.compiled import SymbolsOwner, guarded
from lampest.panel.panel import Array
from lampest.posterior.linear import positive_inverse
from lampest.recording.recording import UNLOADED, Recording
from lampest.solvers.by_ipopt import ACCURACY, STATUS
from lampest.solvers.certificate import ROUNDING, Definiteness, newton_step
from lampest.solvers.multistart import evaluated
from lampest.solvers.posed import Bounds
from lampest.solvers.solution import OPTIMA, VERIFIED, Settings, Status


@dataclass(frozen=True, eq=False)
class OwnProgram(SymbolsOwner):
    """Program of some frames of a recording.

    `with_…` and `subject_to` return a program with one more part.

    Attributes
    ----------
    symbols : Program
        The symbols: cells, voltages, readings, parameters.
    evaluations : tuple of Evaluation
        Costs of the frames at their starts.
    circuits : tuple of Circuit
    settings : Settings

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> terms = [lampest.Misfit(), lampest.Gradient(weight=1e-3)]
    >>> program = lampest.program(recording, terms, frames=[2, 3])
    >>> program.cells(1).shape
    (2, 3)
    """

    symbols: Program
    evaluations: tuple[Evaluation, ...]
    circuits: tuple[Circuit, ...]
    settings: Settings
    formulation: str = "nodal"

    def cells(self, frame: int = 0) -> casadi.SX:
        """Return the cells of one frame in ohm, (rows, columns) symbols."""
        return self.symbols.cells(frame)

    @property
    def reading(self) -> casadi.SX:
        """Readings y = h(V) of all frames, (cells, frames) in the readout's unit."""
        return self.symbols.reading

    def with_unknown(self, name: str, **about: Any) -> "tuple[OwnProgram, casadi.SX]":
        """Return the program with a further unknown, and its symbol.

        The arguments are those of `Program.with_unknown`.

        Raises InputError if the name is taken, or a number is out of range.
        """
        symbols, unknown = self.symbols.with_unknown(name, **about)
        return replace(self, symbols=symbols), unknown

    def with_reading(self, changed: Callable[[casadi.SX], Any]) -> "OwnProgram":
        """Return the program whose terms read changed(y).

        Raises InputError if the result has another shape.
        """
        return replace(self, symbols=self.symbols.with_reading(changed))

    def with_cost(self, added: Any) -> "OwnProgram":
        """Return the program with a further cost, one number in the unit of φ.

        Raises InputError for another shape.
        """
        return replace(self, symbols=self.symbols.with_cost(added))

    def subject_to(
        self, name: str, expression: Any, lower: float = 0.0, upper: float | None = None
    ) -> "OwnProgram":
        """Return the program with a constraint lower ≤ expression ≤ upper.

        Without an upper limit the constraint is the equation expression = lower.

        Raises InputError if the name is taken, or the expression is no column, or no function of
        the unknowns.
        """
        return replace(self, symbols=self.symbols.subject_to(name, expression, lower, upper))

    @guarded
    def solve(self) -> "OwnSolution":
        """Solve by IPOPT, and check the result; a failed solve does not raise."""
        tolerance = ACCURACY * self.settings.tolerance
        interface = Interface.of(
            self.symbols, Limits(tolerance, self.settings.max_iterations), scaled=True
        )
        instance = Instance.of(
            self.symbols, self.circuits, EXCITATIONS[self.formulation], self.evaluations
        )
        return OwnSolution(instance, interface, interface.minimise(instance))


@dataclass(frozen=True, eq=False)
class OwnSolution(SymbolsOwner):
    """Solution of an own program; NaN where it is no optimum.

    Attributes
    ----------
    instance : Instance
    interface : Interface
    result : ProgramResult

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
    interface: Interface
    result: ProgramResult

    @cached_property
    def status(self) -> str:
        """Outcome in a sentence, as `Status` has them."""
        return self._status.value

    @cached_property
    def _status(self) -> Status:
        """Status by the first order, then by the second along the active constraints."""
        ended = STATUS.get(self.result.status, Status.BREAKDOWN)
        if ended is not Status.OPTIMUM:
            return ended
        if not self.optimality_error <= VERIFIED:
            return Status.UNVERIFIED
        if self._definiteness is Definiteness.INDEFINITE:
            return Status.SADDLE
        flat = self._definiteness is Definiteness.UNDETERMINED
        return Status.FLAT if flat else Status.OPTIMUM

    @property
    def solved(self) -> bool:
        """Whether this is an optimum."""
        return self._status in OPTIMA

    @property
    def iterations(self) -> int:
        """Iterations of IPOPT."""
        return self.result.iterations

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

        A cell at a bound has zero, a program on a plateau infinity. The misfit must be weighted by
        the noise for these numbers to have a meaning.
        """
        conductance = self.instance.scale / self.instance.cells_of(self.result)
        relative = self._deviations("conductance").reshape(self.instance.shape) / conductance
        return np.asarray(self.cell_resistance * relative)

    def errors(self, name: str) -> Array:
        """Return the standard deviations of an own unknown, (size,); infinite on a plateau.

        Raises InputError for an unknown name.
        """
        self._check_name(name)
        return self._deviations(name)

    @cached_property
    def optimality_error(self) -> float:
        """Largest of |x − Π(x − ∇ₓ(f + λᵀg))| and of the violation of the equations.

        The unit is that of the program. All derivatives are evaluated anew, outside of IPOPT.
        """
        gradient, jacobian, _ = self._derivatives
        x = self.result.unknown
        instance = self.instance
        slope = gradient + jacobian.T @ self.result.of_equations
        projected = np.clip(x - slope, instance.lower, instance.upper)
        values = self._equations
        low, high = instance.equations
        violation = np.maximum(np.maximum(low - values, values - high), 0.0)
        size = np.maximum(np.abs(jacobian).max(axis=1).toarray().ravel(), 1.0)
        return float(max(np.abs(x - projected).max(), (violation / size).max(initial=0.0)))

    def _check_name(self, name: str) -> None:
        """Raise InputError unless the program has an own unknown of this name."""
        own = self.instance.program.own
        if name not in own:
            raise InputError(
                f"the program has no own unknown {name}; it has {', '.join(own) or 'none'}"
            )

    @cached_property
    @guarded
    def _equations(self) -> Array:
        """Values of all constraints, (constraints,)."""
        nlp = self.instance.program.nlp
        values = casadi.Function("g", [nlp["x"], nlp["p"]], [nlp["g"]])(
            self.result.unknown, self.instance.parameter
        )
        return np.asarray(values).ravel()

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
    def _directions(self) -> Array:
        """Basis Z of the directions along the active constraints, (unknowns, n).

        Unknowns at a bound stay, voltages follow the cells by the balance of currents, and the
        other active constraints leave the null space of their rows.
        """
        _, jacobian, _ = self._derivatives
        instance = self.instance
        program = instance.program
        x = self.result.unknown
        names = np.repeat([*program.unknown.sizes], [*program.unknown.sizes.values()])
        follows = np.isin(names, [*program.networks[0].voltages])
        at_bound = _held(x, self.result.of_bounds, instance.lower, instance.upper)
        # Of p and q, the smaller one is at its bound: their sum costs.
        place = int(np.argmax(names == "split"))
        for part in program.lowered:
            for side in part.split[:1]:
                first = place + np.arange(side.shape[0])
                second = first + side.shape[0]
                at_bound[np.where(x[first] < x[second], first, second)] = True
                place += 2 * side.shape[0]
        leads = np.flatnonzero(~at_bound & ~follows)
        balance = program.equation.sizes["balance"]
        by_voltage = scipy.sparse.linalg.splu(jacobian[:balance, follows])
        directions = np.zeros((len(x), len(leads)))
        directions[leads, np.arange(len(leads))] = 1.0
        directions[follows] = -by_voltage.solve(jacobian[:balance, leads].toarray())
        active = _held(self._equations, self.result.of_equations, *instance.equations)
        rows = jacobian[balance + np.flatnonzero(active[balance:])] @ directions
        size = np.linalg.norm(rows, axis=1, keepdims=True)
        if len(rows):
            directions = directions @ scipy.linalg.null_space(rows / np.where(size > 0, size, 1.0))
        return directions

    @cached_property
    def _curvature(self) -> Array:
        """Curvature Zᵀ ∇²L Z of the Lagrangian along the constraints, (n, n)."""
        _, _, hessian = self._derivatives
        return np.asarray(self._directions.T @ (hessian @ self._directions))

    @cached_property
    def _definiteness(self) -> Definiteness:
        """Definiteness of the curvature, by the certificate of every solver."""
        gradient, jacobian, hessian = self._derivatives
        slope = self._directions.T @ (gradient + jacobian.T @ self.result.of_equations)
        size = np.abs(self._directions)
        # Diagonal entries of which the rounding errors of the sums are a share of ROUNDING
        least = np.finfo(float).eps / ROUNDING * np.sum(size * (abs(hessian) @ size), axis=0)
        least = np.maximum(least, np.finfo(float).tiny)
        return newton_step(self._curvature, slope, least)[0]

    def _deviations(self, name: str) -> Array:
        """Return the standard deviations of one block of unknowns, in its unit."""
        places = self.instance.program.unknown.named(
            np.arange(len(self.result.unknown), dtype=float)
        )
        chosen = places[name].astype(int)
        if not self.solved:
            return np.full(len(chosen), np.nan)
        try:
            # f = φ/cost_scale, and φ = χ²: the posterior is exp(−φ/2)
            covariance = positive_inverse(self._curvature * (self.instance.cost_scale / 2))
        except np.linalg.LinAlgError:
            return np.full(len(chosen), np.inf)
        along = self._directions[chosen]
        return np.asarray(np.sqrt(np.sum((along @ covariance) * along, axis=1)))


def _held(value: Array, multiplier: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Return which values a limit holds, see `on_bounds`; equal limits hold always."""
    at_limit = on_bounds(value, multiplier, low, high)
    return np.asarray((low == high) | (at_limit == low) | (at_limit == high))


def program(
    recording: Recording,
    terms: Sequence[Term],
    *,
    frames: Sequence[int] | None = None,
    formulation: str = "nodal",
    bounds: Bounds | None = None,
    solver: Settings | None = None,
) -> OwnProgram:
    """Return the program of some frames, to which unknowns and constraints can be added.

    Parameters
    ----------
    recording : Recording
    terms : sequence of Term
        Terms with weights. Those that compare frames compare with the mean of the unloaded frames.
    frames : sequence of int, optional
        Indices into the recording; by default the first measured frame.
    formulation : {'nodal', 'per_pixel'}
    bounds : Bounds, optional
    solver : Settings, optional

    Raises
    ------
    InputError
        If `terms` is no sequence of terms, a weight is open, a frame does not exist, or the
        formulation has another name.

    Examples
    --------
    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> terms = [lampest.Misfit(), lampest.Gradient(weight=1e-3)]
    >>> program = lampest.program(recording, terms)
    >>> program.subject_to("equal", program.cells()[0, 0] - program.cells()[1, 2]).solve().solved
    True
    """
    estimator = _checked_estimator(terms, formulation, bounds or Bounds(), solver or Settings())
    prepared = Prepared.of(recording)
    scene = prepared.recording.scene
    readings = prepared.noise.readings
    chosen = _chosen_frames(prepared.recording, frames)
    background = Background(scene)
    if estimator.relative:
        resting = readings[prepared.recording.role == UNLOADED].mean()
        unloaded = scene.circuit.uniform_start(resting.value)
        background = Background(scene, previous=unloaded, baseline=unloaded)
    evaluations = []
    for frame in chosen:
        data = estimator.data(readings[frame].alone(), background)
        cost = estimator.cost(scene, 1, partial=readings.partial)
        evaluations.append(evaluated(cost, data, data.uniform_start))
    circuits = Circuit.of_readout(scene.circuit, scene.panel.shape, scene.wiring)
    symbols = Program.build(
        cost, scene.circuit, circuits, EXCITATIONS[formulation], blocks=len(chosen)
    )
    return OwnProgram(symbols, tuple(evaluations), circuits, estimator.solver, formulation)


def _checked_estimator(
    terms: Sequence[Term], formulation: str, bounds: Bounds, solver: Settings
) -> Estimator:
    """Return the estimator of an own program.

    Raises InputError for another formulation, for terms that are no sequence, and for open weights.
    """
    if formulation not in EXCITATIONS:
        raise InputError(
            f"formulation must be one of {', '.join(EXCITATIONS)} "
            f"for an own program, not {formulation}"
        )
    if isinstance(terms, str) or not isinstance(terms, Sequence):
        raise InputError(f"terms must be a sequence of terms, not {terms!r}")
    method = OptimalMethod("per_pixel" if formulation == "per_pixel" else "nodal")
    estimator = Estimator(tuple(terms), method, solver=solver, bounds=bounds, error_bars=False)
    if estimator.automatic:
        raise InputError("an own program needs terms with weights, not weight: auto")
    return estimator


def _chosen_frames(recording: Recording, frames: Sequence[int] | None) -> list[int]:
    """Return the frames of a program, by default the first measured one.

    Raises InputError if one does not exist.
    """
    if frames is None:
        return [int(recording.measured_frames()[0])]
    for frame in frames:
        if not 0 <= frame < len(recording.role):
            raise InputError(
                f"the recording has frames 0 to {len(recording.role) - 1}, not {frame}"
            )
    return list(frames)
