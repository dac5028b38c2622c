"""A panel of which all lines but two float, R = Z_jj + Z_kk − 2 Z_jk: its network, and the convex start of a search.

∂R_i/∂u_c = g_c D_ic² with D = BᵀZB, the transfer resistances: one operator is both forward and adjoint.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from lampest.panel.kirchhoff import bipartite_matrix, line_sums
from lampest.panel.network import Entries, Loading, Network, NormalByLines, Numbers, across, inverse_of
from lampest.panel.panel import Array
from lampest.panel.trust_region import DENSE_CELLS, SUFFICIENT_DECREASE, steihaug

# Of R²: smallest diagonal of the stencil, where the lines alone explain a cell's own response.
MIN_DIAGONAL_SHARE = 0.05
MAX_ITERATIONS = 30  # 6 suffice from the uniform start at 10 × 10 to 32 × 32 without noise
STEP_LENGTHS = tuple(0.5**power for power in range(20))  # of a step: below, none lowers the cost in double precision
MAX_RELATIVE_MISFIT = 1e-9  # relative misfit of any reading; near a solution each step doubles the digits


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
    """The readings are two-point resistances in ohm; many networks at once have leading axes."""

    @classmethod
    def solve(cls, conductance: Array, tie: Array) -> "FloatingNetwork":
        """Solve cells (rows, columns) siemens. Raises numpy.linalg.LinAlgError where a line is not connected."""
        with np.errstate(divide="ignore"):
            return cls(1 / conductance, conductance, inverse_of(conductance, tie))

    def some(self, numbers: Numbers | int) -> "FloatingNetwork":
        """Return some of many networks, or one of them."""
        return FloatingNetwork(self.cell_resistance[numbers], self.conductance[numbers], self._impedance[numbers])

    def read(self, entries: Entries) -> Array:
        """R_jk = Z_jj + Z_kk − 2 Z_jk."""
        return across(entries)

    @property
    def slopes(self) -> Entries:
        return np.ones((1, 1)), np.ones((1, 1)), np.full((1, 1), -2.0)

    def read_change(self, change: Entries) -> Array:
        return across(change)

    def loading(self, weights: Array) -> Loading:
        """W = L_w."""
        return line_sums(weights), -weights

    def sensitivity(self, cells: Numbers | None = None, readings: Numbers | None = None) -> Array:
        """D∘D·diag(g)."""
        if cells is None:
            transfer = self.transfer if readings is None else self.transfer[readings]
            response: Array = transfer * transfer
            response *= self.flat_conductance[..., None, :]
            return response
        every = np.arange(self.conductance.size) if readings is None else readings
        chosen: Array = self.between(self._impedance, cells, every) ** 2 * self.conductance.ravel()[cells]
        return chosen

    def own_response(self) -> Array:
        """R²·g: D_ii = R_i."""
        return self.reading() ** 2 / self.cell_resistance

    def normal_by_lines(self, weight: Array) -> NormalByLines:
        """Diagonal, rows and columns; see `square_by_lines`."""
        return square_by_lines(self.conductance, self.reading(), weight)


@dataclass(frozen=True, eq=False)
class Stencil:
    """(D∘D)⁻¹ as a preconditioner: (D∘D)_il ≈ 1/A_j² for cells of one row j, 1/B_k² of one column k, R_l² at i = l.

    A and B are the lines' total conductances. Inverted through one matrix of lines × lines (Woodbury).

    Attributes
    ----------
    diagonal : array, shape (rows, columns)
        1/d, zero at cells that are left out.
    inner : array
        (S⁻¹ + Uᵀ diag(1/d) U)⁻¹, (lines)², U with a column for every line and S its 1/A² or 1/B².
    """

    diagonal: Array
    inner: Array

    @classmethod
    def of(cls, conductance: Array, two_point_resistance: Array, free: NDArray[np.bool_]) -> "Stencil":
        """Return the stencil over the free cells of a network; all (rows, columns), siemens and ohm."""
        cells, lines = _parts(conductance, two_point_resistance)
        diagonal = np.where(free, 1 / cells, 0.0)
        return cls(diagonal, np.linalg.inv(np.diag(1 / lines) + bipartite_matrix(line_sums(diagonal), diagonal)))

    def solve(self, values: Array) -> Array:
        """(stencil of D∘D)⁻¹·x over the free cells, (rows, columns)."""
        first = self.diagonal * values
        lines = self.inner @ np.concatenate([first.sum(axis=1), first.sum(axis=0)])
        rows = len(first)
        solved: Array = first - self.diagonal * (lines[:rows, None] + lines[None, rows:])
        return solved


def square_by_lines(conductance: Array, two_point_resistance: Array, weight: Array) -> NormalByLines:
    """Return JᵀWJ with J = S·diag(g), S = diag(d) + U K Uᵀ the stencil of D∘D; w ≥ 0 (rows, columns).

    JᵀWJ = diag(g²d²w) + V M Vᵀ with V = [g·dwU, g·U], M = [[0, K], [K, K UᵀwU K]].
    conductance, two_point_resistance : (rows, columns) siemens and ohm.
    """
    cells, lines = _parts(conductance, two_point_resistance)
    heavy = conductance * cells * weight
    mixed = lines[:, None] * bipartite_matrix(line_sums(weight), weight) * lines
    inner = np.block([[np.zeros_like(mixed), np.diag(lines)], [np.diag(lines), mixed]])
    return NormalByLines(heavy * conductance * cells, np.stack([heavy, conductance]), inner)


def _parts(conductance: Array, two_point_resistance: Array) -> tuple[Array, Array]:
    """(d, K): the diagonal (rows, columns) of the stencil, and 1/A², 1/B² of the lines."""
    of_rows, of_columns = conductance.sum(axis=1) ** -2.0, conductance.sum(axis=0) ** -2.0
    square = two_point_resistance**2
    diagonal = np.maximum(square - of_rows[:, None] - of_columns, MIN_DIAGONAL_SHARE * square)
    return diagonal, np.concatenate([of_rows, of_columns])


def convex_start(measured: Array, upper: Array, near: Array | None = None) -> Array:
    """Cell resistance (rows, columns) ohm from R_m (rows, columns) ohm by damped, projected Newton steps.

    g* = argmin ⟨R_m, g⟩ − log det C(g) over g ≥ 1/r_upper, from `near`, an earlier frame's answer, or from
    R_m·MN/(M + N − 1). As R = ∇ log det C, attainable readings are reproduced, and the result is what plain least
    squares seeks; else it is a start, not an estimate. Source: Foster's theorem and the concavity of log det (Boyd &
    Vandenberghe, Convex Optimization, 2004, section 3.1.5).
    """
    tie, least = grounding(measured), 1 / upper

    def at(conductance: Array) -> tuple[float, FloatingNetwork]:
        network = FloatingNetwork.solve(conductance, tie)
        return float(np.sum(measured * conductance) + np.linalg.slogdet(network.potentials())[1]), network

    first = measured / uniform_factor(*measured.shape) if near is None else near
    conductance = np.maximum(1 / first, least)
    value, network = at(conductance)
    for _ in range(MAX_ITERATIONS):
        gradient = measured - network.reading()
        free = (conductance > least * (1 + 1e-12)) | (gradient < 0)
        if np.max(np.abs(gradient[free] / measured[free]), initial=0) < MAX_RELATIVE_MISFIT:
            break
        step = _step(network, gradient, free)
        for length in STEP_LENGTHS:
            trial = np.maximum(conductance + length * step, np.maximum(least, conductance / 10))
            trial_value, trial_network = at(trial)
            if trial_value <= value + SUFFICIENT_DECREASE * float(np.sum(gradient * (trial - conductance))):
                break
        else:
            break
        conductance, value, network = trial, trial_value, trial_network
    return np.asarray(1 / conductance)


def _step(network: FloatingNetwork, gradient: Array, free: NDArray[np.bool_]) -> Array:
    """−(D∘D)⁻¹ ∇ on the free cells; (D∘D)·p = −(∂R/∂g)·p."""
    step = np.zeros(gradient.shape)
    if gradient.size <= DENSE_CELLS:
        chosen = np.flatnonzero(free)
        transfer = network.transfer if len(chosen) == free.size else network.transfer[np.ix_(chosen, chosen)]
        curvature = (transfer * transfer).T  # symmetric, and in LAPACK's order
        step[free] = scipy.linalg.lapack.dposv(curvature, -gradient[free], lower=1, overwrite_a=1)[1]
        return step
    stencil = Stencil.of(network.conductance, network.reading(), free)

    def over_panel(linear: Callable[[Array], Array], values: Array) -> Array:
        whole = np.zeros(gradient.shape)
        whole[free] = values
        return linear(whole)[free]

    step[free] = steihaug(
        lambda search: over_panel(lambda whole: network.forward(whole * network.cell_resistance), search),
        lambda residual: over_panel(stencil.solve, residual),
        gradient[free],
        0.05,
    ).step
    return step
