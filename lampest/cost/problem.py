"""Data of a solve, cost and residuals at a point with derivatives, and the test of optimality."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from time import monotonic
from typing import cast

import casadi
import numpy as np
from scipy import sparse

from lampest.cost.cost import Cost
from lampest.cost.given import Given
from lampest.files.errors import BROKEN, brief
from lampest.files.typed import ReadOnlyArrays
from lampest.panel.compiled import Compiled, guarded, with_entries
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.readouts import Readout, TwoPointReadout
from lampest.panel.readouts.wiring import Wiring

ROUNDING = 1e-15  # relative rounding error of a residual: four last bits of double precision
NO_DUAL = np.zeros(0)  # dual variables of a cost without absolute losses
Panels = Numbers | int


@dataclass(frozen=True, eq=False)
class Data(ReadOnlyArrays):
    """Data of one solve, or of solves of many panels of one shape along a leading axis.

    Attributes
    ----------
    given : Given
        Readings, noise and earlier frames.
    lower, upper : array, shape (…, frames, rows, columns)
        Bounds in ohm.
    readout : Readout
    wiring : Wiring or None
        Circuit by which readings follow from cells.
    noise_known : bool
        Whether σ is known.
    until : float
        Time at which a solver stops, in s on the clock of `time.monotonic`.
    first : bool
        Whether no earlier frame was solved.
    parts : array of int, or None
        See `Scene.parts`.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> background = lampest.cost.given.Background(recording.scene)
    >>> data = estimate.estimator.data(recording.readings()[2], background)
    """

    given: Given
    lower: Array
    upper: Array
    readout: Readout = TwoPointReadout()
    wiring: Wiring | None = None
    noise_known: bool = False
    until: float = math.inf
    first: bool = False
    parts: Numbers | None = None

    def __repr__(self) -> str:
        """Return the object in one line, arrays by their shapes."""
        return brief(self)

    @property
    def panels(self) -> tuple[int, ...]:
        """Shape of the leading axis, (panels,); () of a single panel."""
        return self.measured.shape[:-3]

    def of_panels(self) -> "Data":
        """Return the data with each frame as a panel of its own."""
        sources = self.given.sources()
        named = {
            name: value[:, None] if sources[name].per_frame else value
            for name, value in self.given.named()
        }
        return replace(
            self,
            given=replace(self.given, **named),
            lower=self.lower[:, None],
            upper=self.upper[:, None],
        )

    def some(self, panels: Panels) -> "Data":
        """Return the data of the chosen panels, or of a single one by its number."""
        given = replace(self.given, **{name: value[panels] for name, value in self.given.named()})
        return replace(self, given=given, lower=self.lower[panels], upper=self.upper[panels])

    @cached_property
    def flat(self) -> dict[str, Array]:
        """Arrays (…, numbers) by name for compiled functions.

        `Source.absent` takes the place of absent fields.
        """
        shape = (*self.panels, self.lower[0].size)
        arrays = {
            name: np.full(shape, source.absent) for name, source in self.given.sources().items()
        }
        arrays |= dict(self.given.named())
        return {name: values.reshape(*self.panels, -1) for name, values in arrays.items()}

    def limited(self, seconds: float | None) -> "Data":
        """Return the data with a time limit in s from now on; None for no limit."""
        return self if seconds is None else replace(self, until=monotonic() + seconds)

    @property
    def overdue(self) -> bool:
        """Whether the time limit has passed."""
        return monotonic() > self.until

    @property
    def measured(self) -> Array:
        """Readings of the network, (frames, rows, columns), in the readout's unit."""
        return np.asarray(self.given.measured)

    @property
    def sigma(self) -> Array:
        """Standard deviations of the readings; ones if unknown."""
        return np.asarray(self.given.sigma)

    @property
    def plain(self) -> Mask:
        """Whether a reading is a value, neither one-sided nor missing nor a substitute.

        The array is boolean, (frames, rows, columns).
        """
        if not self.partial:
            return np.ones(self.measured.shape, dtype=bool)
        return np.asarray((self.given.side == 0) & (self.given.seen == 1))

    @property
    def deviation(self) -> Array:
        """Standard deviations σ of readings, and σ/seen of substitutes.

        The entries of missing readings are arbitrary.
        """
        if not self.partial:
            return self.sigma
        return self.sigma / np.where(self.given.seen > 0, self.given.seen, 1.0)

    @property
    def partial(self) -> bool:
        """Whether readings may be one-sided or missing."""
        return self.given.side is not None

    @cached_property
    def apparent_resistance(self) -> Array:
        """Apparent resistance, (frames, rows, columns) ohm; see `Readout.apparent_resistance`."""
        return self.readout.apparent_resistance(self.measured)

    @cached_property
    def uniform_start(self) -> Array:
        """Uniform start, (frames, rows, columns) ohm; see `Readout.uniform_start`."""
        return self.readout.uniform_start(self.measured)

    def start(self, near: Array | None = None) -> Array:
        """Return the readout's start of every frame, (frames, rows, columns) ohm.

        The start of two-point readings minimises a convex function of the cells whose gradient is
        their misfit. `near` is an estimate of the same shape at which the computation begins, or
        None. If the computation breaks down, the uniform start is returned.
        """
        places = [None] * len(self.measured) if near is None else list(near)
        limits = zip(self.lower, self.upper, strict=True)
        frames = zip(self.measured, limits, places, strict=True)
        with suppress(*BROKEN):
            return np.stack([self.readout.start(*frame) for frame in frames])
        return self.uniform_start

    def start_minimises(self, cost: Cost) -> bool:
        """Return whether the readout's start minimises a cost.

        The start minimises a cost of readings alone if the cells that reproduce them are unique.
        """
        return all(term.reads_measurement for term in cost.terms) and self.readout.two_point

    @cached_property
    def log_bounds(self) -> tuple[Array, Array]:
        """Logarithms of the bounds (lower, upper)."""
        return np.log(self.lower), np.log(self.upper)

    @cached_property
    def ties(self) -> Array:
        """Conductances of the lines to ground in siemens.

        The shape is (…, frames, lines), and (…, frames, modules, lines) for coupled modules.
        """
        if self.panels and self.parts is None:
            return self.readout.ties(self.measured)
        frames = self.measured.reshape(-1, *self.measured.shape[-2:])
        ties = np.stack([self.readout.ties(measured, self.parts) for measured in frames])
        return ties.reshape(*self.measured.shape[:-2], *ties.shape[1:])

    def network(self, frame: int, cell_resistance: Array) -> Network:
        """Return the solved network of one frame's cells (…, rows, columns) ohm."""
        ties = self.ties[:, frame] if self.panels else self.ties[frame]
        return self.readout.network(cell_resistance, ties, self.wiring)

    def networks(self, cell_resistance: Array) -> tuple[Network, ...]:
        """Return the solved network of every frame, for cells (…, frames, rows, columns) in ohm.

        The leading axis of the cells is the leading axis of every network.
        """
        frames = range(cell_resistance.shape[-3])
        return tuple(self.network(frame, cell_resistance[..., frame, :, :]) for frame in frames)


@lru_cache(maxsize=256)
def _mapped(function: Compiled, panels: int) -> Compiled:
    """Return a function for many panels at once, which is built once."""
    return function.mapped(panels)


@dataclass(frozen=True, eq=False)
class Evaluation(ReadOnlyArrays):
    """Cost φ and its derivatives at one point of one panel, or of each of many panels.

    Many panels are the leading axis of the arrays. Attributes with plural names are arrays over the
    panels; those with singular names are numbers of a single panel.

    Attributes
    ----------
    cost : Cost
    data : Data
    cell_resistance, reading : array, shape (…, frames, rows, columns)
        Cells r in ohm, and modelled readings y in the readout's unit.
    networks : tuple of Network
        Solved networks of the frames.
    own_weights : array, shape (…, terms), or None
        Weights of the terms for each panel; None for those of the cost.
    computed : array, or None
        Values of `first` where an evaluation of more panels has them.
    """

    cost: Cost
    data: Data
    cell_resistance: Array
    reading: Array
    networks: tuple[Network, ...]
    own_weights: Array | None = None
    computed: Array | None = None

    @classmethod
    def at(
        cls, cost: Cost, data: Data, cell_resistance: Array, own_weights: Array | None = None
    ) -> "Evaluation":
        """Solve the networks of cells (…, frames, rows, columns) ohm, and return the evaluation.

        Raises numpy.linalg.LinAlgError if a line is not connected.
        """
        networks = data.networks(cell_resistance)
        reading = np.stack([network.reading() for network in networks], axis=-3)
        return cls(cost, data, cell_resistance, reading, networks, own_weights)

    def elsewhere(self, cell_resistance: Array) -> "Evaluation":
        """Return the evaluation of the same cost and data at other cells."""
        return Evaluation.at(self.cost, self.data, cell_resistance, self.own_weights)

    def some(self, panels: Panels) -> "Evaluation":
        """Return the evaluation of the chosen panels, or of one by its number, with their costs."""
        networks = tuple(cast(SolvedNetwork, network).some(panels) for network in self.networks)
        return Evaluation(
            self.cost,
            self.data.some(panels),
            self.cell_resistance[panels],
            self.reading[panels],
            networks,
            self.weights[panels],
            self.first[panels],
        )

    @property
    def weights(self) -> Array:
        """Weights of the terms, (…, terms)."""
        return self.cost.weights if self.own_weights is None else self.own_weights

    def call(self, function: Compiled, dual: Array | None = None) -> Array:
        """Return the values of a compiled function at this point, (…, nonzeros).

        Duals of None are zeros.
        """
        panels = self.data.panels
        zeros = np.zeros(len(self.cost.slope))
        values = self.data.flat | {
            "cell_resistance": self.cell_resistance,
            "reading": self.reading,
            "weights": self.weights,
            "dual": zeros if dual is None else dual,  # costs with duals are solved panel by panel
        }
        called = _mapped(function, *panels) if panels else function
        return called(*(values[name] for name in function.names)).reshape(*panels, -1)

    @cached_property
    def first(self) -> Array:
        """Values of `CostFunctions.first` without duals.

        Costs of the terms at this point, their costs at y = 0, and the gradient by (r; y).
        """
        return self.call(self.cost.functions.first) if self.computed is None else self.computed

    @property
    def branch(self) -> Array:
        """Branch of every frame's panel, (…, frames); see `Network.branch`."""
        return np.stack([network.branch for network in self.networks], axis=-1)

    @property
    def costs(self) -> Array:
        """Costs weight · loss of the terms, summed over frames, (…, terms)."""
        return self.first[..., : len(self.cost.terms)]

    @cached_property
    def objectives(self) -> Array:
        """Cost φ of every panel, (…)."""
        return np.asarray(self.costs.sum(axis=-1))

    @cached_property
    def objective(self) -> float:
        """Cost φ of a single panel."""
        return float(self.objectives)

    def partials(self, dual: Array) -> tuple[Array, Array]:
        """Return the partial derivatives of the cost.

        Returns
        -------
        direct, through : array, shape (…, frames, rows, columns)
            ∂φ/∂r at fixed readings y, and ∂φ/∂y.
        """
        values = self.call(self.cost.functions.first, dual) if len(dual) else self.first
        # `first` = (costs of the terms, costs at y = 0, ∂φ/∂r, ∂φ/∂y)
        gradient = values[..., 2 * len(self.cost.terms) :].reshape(
            *self.data.panels, 2, *self.cell_resistance.shape[-3:]
        )
        return gradient[..., 0, :, :, :], gradient[..., 1, :, :, :]

    def log_gradient(self, dual: Array) -> Array:
        """Return ∂φ/∂u = r·∂φ/∂r + Jᵀ ∂φ/∂y, u = log r, (…, frames, rows, columns).

        Duals are clipped to |z| ≤ 1.
        """
        direct, through = self.partials(np.clip(dual, -1, 1))
        gradient = direct * self.cell_resistance
        for frame, network in enumerate(self.networks):
            # Jᵀ ∂φ/∂y by one product with the network of each frame
            gradient[..., frame, :, :] += network.adjoint(through[..., frame, :, :])
        return gradient

    @property
    def cell_costs(self) -> Array:
        """Mean cost φ of a cell if all readings were 0, (…)."""
        terms = len(self.cost.terms)
        cells = math.prod(self.cell_resistance.shape[-3:])
        return np.asarray(self.first[..., terms : 2 * terms].sum(axis=-1) / cells)

    @cached_property
    def cost_scales(self) -> Array:
        """Scale s of the cost in tests of optimality, (…): φ plus the mean φ of a cell at y = 0."""
        scale = self.cell_costs + self.objectives
        return np.where(scale == 0, 1.0, scale)

    @cached_property
    def cost_scale(self) -> float:
        """Scale of the cost of a single panel."""
        return float(self.cost_scales)

    @cached_property
    def nonsmooth(self) -> Array:
        """Residuals x with an absolute loss, (residuals,)."""
        return self.call(self.cost.functions.nonsmooth) if len(self.cost.slope) else np.zeros(0)

    @cached_property
    def last_bits(self) -> Array:
        """Rounding errors ε·(Σ |∂x/∂r|·r + Σ |∂x/∂y|·|y|) of residuals with an absolute loss.

        The shape is (residuals,).
        """
        rows, columns = self.cost.functions.nonsmooth_jacobian.pattern
        slopes = self.call(self.cost.functions.nonsmooth_jacobian)
        at = np.concatenate([self.cell_resistance.ravel(), self.reading.ravel()])
        return ROUNDING * np.bincount(rows, np.abs(slopes * at[columns]), len(self.nonsmooth))

    @property
    def rounding(self) -> float:
        """Rounding error of φ due to residuals with an absolute loss."""
        return float(np.sum(self.cost.slope * self.last_bits)) if len(self.cost.slope) else 0.0

    def dual_gap(self, dual: Array) -> float:
        """Return Σ weight·(|x| − z·x) over absolute losses, zero if z is a subgradient.

        Rounding of x is ignored.
        """
        # |x| − z·x is at least zero for |z| ≤ 1; differences within rounding count as zero.
        gap = np.abs(self.nonsmooth) - dual * self.nonsmooth - self.last_bits
        return float(np.sum(self.cost.slope * np.maximum(gap, 0.0)))

    def kkt_residual(self, dual: Array, log_gradient: Array | None = None) -> float:
        """Return max |u − Π(u − ∇φ/s)| plus the dual gap φ/s.

        The position is u = log r, Π projects onto the bounds, and s = `cost_scale`. The residual is
        zero where the first-order optimality conditions hold. `log_gradient` is ∂φ/∂u for these
        duals, if it is already computed.
        """
        gradient = self.log_gradient(dual) if log_gradient is None else log_gradient
        gap = self.dual_gap(np.clip(dual, -1, 1)) / self.cost_scale if len(dual) else 0.0
        return float(self.projected_gradients(gradient)) + gap

    def projected_gradients(self, log_gradient: Array) -> Array:
        """Return max |u − Π(u − ∇φ/s)| of every panel, (…).

        `log_gradient` is ∂φ/∂u, (…, frames, rows, columns).
        """
        lower, upper = self.data.log_bounds
        # Π(u − ∇φ/s): gradient step, projected onto the bounds
        target = self.position - log_gradient / self.cost_scales[..., None, None, None]
        distance = np.abs(self.position - np.minimum(np.maximum(target, lower), upper))
        return np.asarray(distance.max(axis=(-3, -2, -1)))

    @cached_property
    def position(self) -> Array:
        """Position u = log r, (…, frames, rows, columns)."""
        return np.log(self.cell_resistance)


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of the unweighted residuals x, as compiled functions of the inputs of `Evaluation`.

    Attributes
    ----------
    functions : mapping of str to Compiled
        'value': x; by the name of an input, the derivatives of x by it, sparse.
    term : array of int
        Number of the term of each row.
    """

    functions: Mapping[str, Compiled]
    term: Numbers

    def values(self, at: Evaluation) -> Array:
        """Return x at a point, (rows,)."""
        return at.call(self.functions["value"])

    def jacobian(self, name: str, at: Evaluation) -> sparse.csc_array:
        """Return the derivatives by an input at a point, (rows, unknowns) sparse."""
        function = self.functions[name]
        if not function.structure.nnz:
            return function.structure
        return with_entries(function.structure, at.call(function))


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of a cost.

    Attributes
    ----------
    data : Part
        Rows that depend on readings.
    penalties : Part
        All other rows.
    """

    data: Part
    penalties: Part


def residuals(cost: Cost) -> Residuals:
    """Return the residuals of a cost, compiled once for all weights."""
    return _residuals(cost.unweighted)


@guarded
@lru_cache(maxsize=64)
def _residuals(cost: Cost) -> Residuals:
    """Return the residuals of a cost with weights of one."""
    symbols = cost.symbols()
    inputs = symbols.inputs()
    pairs = cost.residuals(symbols)
    stacked = casadi.vertcat(*(part for _, part in pairs))
    term = np.concatenate([np.full(part.shape[0], number) for number, part in pairs])
    # Rows whose derivative by the readings has a structural nonzero are data.
    reads = set(casadi.jacobian_sparsity(stacked, inputs["reading"]).row())
    parts = []
    for data in (True, False):
        rows = [row for row in range(len(term)) if (row in reads) is data]
        outputs = {"value": casadi.densify(stacked[rows])} | {
            name: casadi.jacobian(stacked[rows], inputs[name])
            for name in ("cell_resistance", "reading", "previous", "baseline")
        }
        functions = {name: symbols.compiled(name, output) for name, output in outputs.items()}
        parts.append(Part(functions, term[rows]))
    return Residuals(*parts)
