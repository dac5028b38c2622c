"""A panel of which all lines but two float, R = Z_jj + Z_kk − 2 Z_jk: its network, and the convex start of a search.

∂R_i/∂u_c = g_c D_ic² with D = BᵀZB, the transfer resistances: one operator is both forward and adjoint.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lampest.panel.kirchhoff import injected, line_sums
from lampest.panel.network import Block, Network, NormalByLines, Numbers, SecondOrder, inverse_of
from lampest.panel.panel import Array
from lampest.panel.trust_region import DENSE_CELLS, steihaug

# of R²: where the lines alone explain a cell's own response, the stencil's diagonal must not vanish
LEAST_SHARE = 0.05
MOST_ITERATIONS = 30  # 6 suffice from the uniform start at 10 × 10 to 32 × 32 without noise
LENGTHS = tuple(0.5**power for power in range(20))  # of a step: below, none lowers the cost in double precision
REPRODUCED = 1e-9  # relative misfit of any reading; near a solution each step doubles the digits
DECREASE = 1e-4  # Armijo's share, as in Nocedal & Wright, Numerical Optimization, 2006, section 3.1


def grounding(two_point_resistance: Array, parts: Numbers | None = None) -> Array:
    """Tie to ground: the line with the largest Σ 1/R gets a conductance of that size, all others none.

    (…, rows, columns) ohm → (…, rows + columns) siemens; of one panel where there are parts. parts : (lines) of which
    each has its ground; None: all are one. A tie at a single line carries no current: potential differences are those
    of the paper's equation (5).
    """
    total = line_sums(1 / two_point_resistance)
    tie = np.zeros_like(total)
    if parts is None:
        ground = total.argmax(axis=-1)[..., None]
        np.put_along_axis(tie, ground, np.take_along_axis(total, ground, axis=-1), axis=-1)
        return tie
    grounds = [int(np.argmax(np.where(parts == part, total, -1.0))) for part in np.unique(parts)]
    tie[grounds] = total[grounds]
    return tie


def uniform_factor(rows: int, columns: int) -> float:
    """R/r = (M + N − 1)/(MN) on a panel of equal cells."""
    return (rows + columns - 1) / (rows * columns)


@dataclass(frozen=True, eq=False)
class FloatingNetwork(Network):
    """The readings are two-point resistances in ohm."""

    @classmethod
    def solve(cls, conductance: Array, tie: Array) -> "FloatingNetwork":
        """Of cells (rows, columns) siemens. Raises numpy.linalg.LinAlgError where a line is not connected."""
        with np.errstate(divide="ignore"):
            return cls(1 / conductance, conductance, inverse_of(conductance, tie))

    def reading(self) -> Array:
        """R_jk = Z_jj + Z_kk − 2 Z_jk."""
        return self._across(self._impedance)

    def conductance_product(self, weights: Array) -> Array:
        """(∂R/∂g)·w = −bᵀ Z L_w Z b = (∂R/∂g)ᵀ·w, (rows, columns), in (rows + columns)³ operations."""
        return -self._differences(self._impedance, injected(weights, self._impedance), symmetric=True)

    def forward(self, step: Array) -> Array:
        """−(∂R/∂g)·(g·p)."""
        return -self.conductance_product(step / self.cell_resistance)

    def adjoint(self, weights: Array) -> Array:
        """−g·(∂R/∂g)ᵀ·w."""
        return -self.conductance_product(weights) / self.cell_resistance

    @cached_property
    def transfer(self) -> Array:
        """D = BᵀZB (cells, cells) ohm."""
        return self._between_cells(self._impedance)

    def sensitivity(self, cells: Numbers | None = None, readings: Numbers | None = None) -> Array:
        """D∘D·diag(g)."""
        conductance = self.conductance.reshape(*self.conductance.shape[:-2], -1)
        if cells is None:
            transfer = self.transfer if readings is None else self.transfer[readings]
            response: Array = transfer * transfer
            response *= conductance[..., None, :]
            return response
        every = np.arange(conductance.size) if readings is None else readings
        chosen: Array = self.between(self._impedance, cells, every) ** 2 * conductance[cells]
        return chosen

    def between(self, matrix: Array, cells: Numbers, readings: Numbers | None = None) -> Array:
        """b_iᵀ K b_c of readings i (None: the cells) and cells c, given by their numbers; K (lines, lines)."""
        columns = self.conductance.shape[1]
        lines = matrix[:, cells // columns] - matrix[:, self.rows + cells % columns]
        read = cells if readings is None else readings
        return np.asarray(lines[read // columns] - lines[self.rows + read % columns])

    def own_response(self) -> Array:
        """R²·g: D_ii = R_i."""
        return self.reading() ** 2 / self.cell_resistance

    def second_order(self, weights: Array) -> SecondOrder:
        """With Z L_w Z."""
        return FloatingSecondOrder(self, self._impedance @ injected(weights, self._impedance))

    def normal_by_lines(self, weight: Array) -> NormalByLines:
        """Diagonal, rows and columns; see `square_by_lines`."""
        return square_by_lines(self.conductance, self.reading(), weight)

    def log_determinant(self) -> float:
        """log det Z."""
        return float(np.linalg.slogdet(self._impedance)[1])

    def within(self, block: Block) -> "FloatingNetwork":
        """What a block's lines show of the network between themselves; the cells of the block alone can be changed."""
        lines = self.lines_of(block)
        impedance = self._impedance[np.ix_(lines, lines)]
        return FloatingNetwork(self.cell_resistance[block], self.conductance[block], impedance)


@dataclass(frozen=True, eq=False)
class FloatingSecondOrder:
    """H at a network, with K = Z L_w Z (lines, lines)."""

    network: FloatingNetwork
    twice: Array

    def products(self, step: Array) -> tuple[Array, Array]:
        """(J·p, 2 g·bᵀ K L_{g·p} Z b)."""
        network = self.network
        currents = injected(step / network.cell_resistance, network._impedance)
        change = network._differences(network._impedance, currents, symmetric=True)
        return change, 2 * network._differences(self.twice, currents, symmetric=False) / network.cell_resistance

    def adjoint(self) -> Array:
        """g·bᵀ K b."""
        return self.network._across(self.twice) / self.network.cell_resistance

    def matrix(self, cells: Numbers | None = None) -> Array:
        """2 g (D ∘ BᵀKB) g."""
        network = self.network
        conductance = network.conductance.reshape(*network.conductance.shape[:-2], -1)
        if cells is not None:
            first, second = (network.between(matrix, cells) for matrix in (network._impedance, self.twice))
            some: Array = first * (2 * conductance[cells][:, None]) * second * conductance[cells]
            return some
        matrix: Array = network.transfer * (2 * conductance[..., None])
        matrix *= network._between_cells(self.twice)
        matrix *= conductance[..., None, :]
        return matrix


@dataclass(frozen=True, eq=False)
class Stencil:
    """(D∘D)⁻¹ as a preconditioner: (D∘D)_il ≈ 1/A_j² for cells of one row j, 1/B_k² of one column k, R_l² at i = l.

    A and B are the lines' total conductances. Inverted through one matrix of lines × lines (Woodbury). diagonal :
    (rows, columns) 1/d, zero at cells that are left out. inner : (S⁻¹ + Uᵀ diag(1/d) U)⁻¹, (lines)², U with a column
    for every line and S its 1/A² or 1/B².
    """

    diagonal: Array
    inner: Array

    @classmethod
    def of(cls, conductance: Array, two_point_resistance: Array, free: NDArray[np.bool_]) -> "Stencil":
        """The stencil over the free cells of a network; all (rows, columns), siemens and ohm."""
        cells, lines = _parts(conductance, two_point_resistance)
        diagonal = np.where(free, 1 / cells, 0.0)
        return cls(diagonal, np.linalg.inv(np.diag(1 / lines) + _between_lines(diagonal)))

    def solve(self, values: Array) -> Array:
        """(stencil of D∘D)⁻¹·x over the free cells, (rows, columns)."""
        first = self.diagonal * values
        lines = self.inner @ np.concatenate([first.sum(axis=1), first.sum(axis=0)])
        rows = len(first)
        solved: Array = first - self.diagonal * (lines[:rows, None] + lines[None, rows:])
        return solved


def square_by_lines(conductance: Array, two_point_resistance: Array, weight: Array) -> NormalByLines:
    """JᵀWJ with J = S·diag(g), S = diag(d) + U K Uᵀ the stencil of D∘D: diag(g²d²w) + V M Vᵀ, V = [g·dwU, g·U],
    M = [[0, K], [K, K UᵀwU K]]; w ≥ 0 (rows, columns).

    conductance, two_point_resistance : (rows, columns) siemens and ohm.
    """
    cells, lines = _parts(conductance, two_point_resistance)
    heavy = conductance * cells * weight
    mixed = lines[:, None] * _between_lines(weight) * lines
    inner = np.block([[np.zeros_like(mixed), np.diag(lines)], [np.diag(lines), mixed]])
    return NormalByLines(heavy * conductance * cells, np.stack([heavy, conductance]), inner)


def _parts(conductance: Array, two_point_resistance: Array) -> tuple[Array, Array]:
    """(d, K): the diagonal (rows, columns) of the stencil, and 1/A², 1/B² of the lines."""
    across, along = conductance.sum(axis=1) ** -2.0, conductance.sum(axis=0) ** -2.0
    square = two_point_resistance**2
    return np.maximum(square - across[:, None] - along, LEAST_SHARE * square), np.concatenate([across, along])


def _between_lines(values: Array) -> Array:
    """Uᵀ diag(x) U, (lines)², of x (rows, columns)."""
    rows, columns = values.shape
    matrix = np.zeros((rows + columns, rows + columns))
    matrix[:rows, rows:], matrix[rows:, :rows] = values, values.T
    matrix.flat[:: rows + columns + 1] = line_sums(values)
    return matrix


Evaluated = tuple[float, FloatingNetwork]  # the convex function and the network at some conductances


def convex_start(measured: Array, upper: Array, near: Array | None = None) -> Array:
    """Cell resistance (rows, columns) ohm from R_m (rows, columns) ohm by damped, projected Newton steps.

    g* = argmin ⟨R_m, g⟩ − log det C(g) over g ≥ 1/r_upper, from `near`, an earlier frame's answer, or from
    R_m·MN/(M + N − 1). As R = ∇ log det C, attainable readings are reproduced, and the result is what plain least
    squares seeks; else it is a start, not an estimate. Source: Foster's theorem and the concavity of log det (Boyd &
    Vandenberghe, Convex Optimization, 2004, section 3.1.5).
    """
    tie = grounding(measured)
    first = measured / uniform_factor(*measured.shape) if near is None else near

    def at(conductance: Array) -> Evaluated:
        network = FloatingNetwork.solve(conductance, tie)
        return float(np.sum(measured * conductance) + network.log_determinant()), network

    least: Array = 1 / upper
    start: Array = 1 / _least_cost(at, measured, np.maximum(1 / first, least), least, np.ones(least.shape, dtype=bool))
    return start


def fitted_block(
    network: FloatingNetwork, block: Block, measured: Array, least: Array, chosen: NDArray[np.bool_]
) -> FloatingNetwork:
    """The network with the block's cells such that they reproduce its chosen readings, as far as bounds allow.

    The same convex function over the block alone: measured, least : (rows, columns) of the block, ohm and siemens;
    chosen : the readings that count. Of one cell it is least where 1/R_m = 1/R + δg: δg stands beside all others.
    """
    inside = network.within(block)
    if measured.size == 1:
        added = np.where(chosen, 1 / measured - 1 / inside.reading(), 0.0)
        return network.changed(block, np.maximum(inside.conductance + added, least))
    everything, rest = (slice(None), slice(None)), inside.log_determinant()

    def at(conductance: Array) -> Evaluated:
        there = inside.changed(everything, conductance)
        return float(np.sum(measured * conductance)) + there.log_determinant() - rest, there

    return network.changed(block, _least_cost(at, measured, inside.conductance, least, chosen, rounding=1e-14))


def _least_cost(
    at: Callable[[Array], Evaluated],
    measured: Array,
    conductance: Array,
    least: Array,
    chosen: NDArray[np.bool_],
    rounding: float = 0.0,
) -> Array:
    """Conductances (rows, columns) that minimise the convex function over the chosen cells, from those given.

    rounding : by how much of the function's size a step may raise it.
    """
    value, network = at(conductance)
    for _ in range(MOST_ITERATIONS):
        gradient = measured - network.reading()
        free = chosen & ((conductance > least * (1 + 1e-12)) | (gradient < 0))
        if np.max(np.abs(gradient[free] / measured[free]), initial=0) < REPRODUCED:
            break
        step = _step(network, gradient, free)
        for length in LENGTHS:
            trial = np.maximum(conductance + length * step, np.maximum(least, conductance / 10))
            trial_value, trial_network = at(trial)
            expected = DECREASE * float(np.sum(gradient * (trial - conductance)))
            if trial_value <= value + expected + rounding * abs(value):
                break
        else:
            break
        conductance, value, network = trial, trial_value, trial_network
    return conductance


def _step(network: FloatingNetwork, gradient: Array, free: NDArray[np.bool_]) -> Array:
    """−(D∘D)⁻¹ ∇ on the free cells; (D∘D)·p = −(∂R/∂g)·p."""
    step = np.zeros(gradient.shape)
    if gradient.size <= DENSE_CELLS:
        chosen = np.flatnonzero(free)
        transfer = network.transfer if len(chosen) == free.size else network.transfer[np.ix_(chosen, chosen)]
        curvature = (transfer * transfer).T  # symmetric, and in LAPACK's order
        step[free] = lapack.dposv(curvature, -gradient[free], lower=1, overwrite_a=1)[1]
        return step
    stencil = Stencil.of(network.conductance, network.reading(), free)

    def over_panel(linear: Callable[[Array], Array], values: Array) -> Array:
        whole = np.zeros(gradient.shape)
        whole[free] = values
        return linear(whole)[free]

    step[free] = steihaug(
        lambda search: -over_panel(network.conductance_product, search),
        lambda residual: over_panel(stencil.solve, residual),
        gradient[free],
        0.05,
    ).step
    return step
