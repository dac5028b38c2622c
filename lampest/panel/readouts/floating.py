"""Floating lines with two-point readings: ground, convex start of a solve, star-mesh elimination.

The readings are R = Z_jj + Z_kk − 2 Z_jk. ∂R_i/∂u_c = g_c D_ic² with the transfer resistances D =
BᵀZB. As D is symmetric, one operator serves as forward and as adjoint product.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from lampest.files.typed import typed
from lampest.panel.kirchhoff import Stencil, line_sums, log_determinant
from lampest.panel.network import SolvedNetwork
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.trust_region import (
    DENSE_CELLS,
    SUFFICIENT_DECREASE,
    backtracked,
    restricted,
    steihaug,
)

MAX_ITERATIONS = 30  # 6 suffice from the uniform start at 10 × 10 to 32 × 32 without noise
MAX_LENGTHS = 20  # tried lengths of a step; smaller ones change the cost by rounding
# Of a step's equation; near the minimum the relative misfit, for quadratic convergence.
MAX_RESIDUAL = 0.05
MIN_DECREASE_SHARE = 1e-12  # of ⟨R_m, g⟩: a smaller decrease is rounding
BOUND_ROUNDING = 1e-12  # of a bound: a conductance within it is at the bound
# Relative misfit of any reading at convergence; Newton's steps double the correct digits.
MAX_RELATIVE_MISFIT = 1e-9


def grounding(two_point_resistance: Array, parts: Numbers | None = None) -> Array:
    """Return ties to ground, (…, rows + columns) siemens, for two-point resistances.

    The resistances are (…, rows, columns) ohm. The line with the largest Σ 1/R gets a conductance
    of that size, all others none. A tie at a single line carries no current, so that potential
    differences are those of the paper's equation (5). `parts`, (lines,), contains the number of
    each line's part of a single panel; every part has its own ground. None: one part.
    """
    total = line_sums(1 / two_point_resistance)
    tie = np.zeros_like(total)
    parts = np.zeros(total.shape[-1], dtype=np.intp) if parts is None else parts
    for part in np.unique(parts):
        ground = np.where(parts == part, total, -1.0).argmax(axis=-1)[..., None]
        np.put_along_axis(tie, ground, np.take_along_axis(total, ground, axis=-1), axis=-1)
    return tie


def uniform_factor(rows: int, columns: int) -> float:
    """Return R/r = (M + N − 1)/(MN) of a panel with equal cells."""
    return (rows + columns - 1) / (rows * columns)


def convex_start(measured: Array, limits: tuple[Array, Array], near: Array | None = None) -> Array:
    """Return the minimiser of a convex function, as cells (rows, columns) ohm.

    The function's gradient is the misfit. g* = argmin ⟨R_m, g⟩ − log det C(g) over g ≥ 1/r_upper of
    the cells that are not known, by damped, projected Newton steps. As R = ∇ log det C, attainable
    readings of these are reproduced, and the result is the solution of plain least squares. For
    other readings it is a start, not an estimate. Source: Foster's theorem and the concavity of log
    det (Boyd & Vandenberghe, Convex Optimization, 2004, section 3.1.5).

    Parameters
    ----------
    measured : array, shape (rows, columns)
        R_m in ohm.
    limits : tuple of two arrays, shape (rows, columns)
        Smallest and largest resistances, ohm; equal where a cell is known.
    near : array, shape (rows, columns), or None
        Estimate of an earlier frame, from which the iteration begins; None for R_m·MN/(M + N − 1).
    """
    first = measured / uniform_factor(*measured.shape) if near is None else near
    lower, upper = limits
    least = 1 / upper
    known = lower == upper
    conductance = np.where(known, least, np.maximum(1 / first, least))
    point = _ConvexPoint(measured, least, known, grounding(measured), conductance)
    for _ in range(MAX_ITERATIONS):
        if point.misfit < MAX_RELATIVE_MISFIT:
            break
        following = _lower_point(point)
        if following is None:
            break
        point = following
    return 1 / point.conductance


@dataclass(frozen=True, eq=False)
class _ConvexPoint:
    """The convex function of `convex_start` at conductances.

    Attributes
    ----------
    measured : array, shape (rows, columns)
        R_m in ohm.
    least : array, shape (rows, columns)
        1/r_upper in siemens.
    known : boolean array, shape (rows, columns)
        Whether a cell stays as it is.
    tie : array, shape (lines,)
        Ties to ground in siemens.
    conductance : array, shape (rows, columns)
        g in siemens.
    """

    measured: Array
    least: Array
    known: Mask
    tie: Array
    conductance: Array

    @cached_property
    def network(self) -> SolvedNetwork:
        """The solved network."""
        return SolvedNetwork.floating(self.conductance, self.tie)

    @property
    def scale(self) -> float:
        """⟨R_m, g⟩."""
        return float(np.sum(self.measured * self.conductance))

    @cached_property
    def value(self) -> float:
        """⟨R_m, g⟩ − log det C(g)."""
        return self.scale - log_determinant(self.conductance, self.tie)

    @cached_property
    def gradient(self) -> Array:
        """∇ = R_m − R, (rows, columns)."""
        return self.measured - self.network.reading()

    @cached_property
    def free(self) -> Mask:
        """Whether a cell is free to follow −∇, boolean (rows, columns)."""
        above = self.conductance > self.least * (1 + BOUND_ROUNDING)
        return ~self.known & (above | (self.gradient < 0))

    @cached_property
    def misfit(self) -> float:
        """Largest entry of ∇ over the free cells, relative to R_m."""
        relative = np.abs(self.gradient / self.measured)
        return float(np.max(relative, initial=0, where=self.free))


def _lower_point(point: _ConvexPoint) -> _ConvexPoint | None:
    """Return the point after a damped Newton step; None if no tried length is accepted.

    Backtracking line search, in which no conductance falls by more than a factor of ten: Armijo's
    condition; where the change is within rounding, the gradient must halve.
    """
    step = _step(point.network, point.gradient, point.free, min(MAX_RESIDUAL, point.misfit))
    rounding = MIN_DECREASE_SHARE * point.scale
    least = np.maximum(point.least, point.conductance / 10)

    def accepted(length: float) -> _ConvexPoint | None:
        trial = replace(point, conductance=np.maximum(point.conductance + length * step, least))
        predicted = float(np.sum(point.gradient * (trial.conductance - point.conductance)))
        falls = trial.value <= point.value + SUFFICIENT_DECREASE * predicted
        if falls or (trial.value <= point.value + rounding and trial.misfit <= point.misfit / 2):
            return trial
        return None

    return backtracked(accepted, MAX_LENGTHS)


def _step(network: SolvedNetwork, gradient: Array, free: Mask, accuracy: float) -> Array:
    """Return the Newton step −(D∘D)⁻¹ ∇ over the free cells, (rows, columns) siemens.

    (D∘D)·p = −(∂R/∂g)·p. `accuracy` is that of the step of a large panel, relative to the gradient.
    """
    step = np.zeros(gradient.shape)
    chosen = np.flatnonzero(free)
    if gradient.size <= DENSE_CELLS:
        transfer = network.transfer
        transfer = transfer if len(chosen) == free.size else transfer[np.ix_(chosen, chosen)]
        curvature = (transfer * transfer).T  # symmetric; the transpose has LAPACK's memory order
        _, solved, _ = scipy.linalg.lapack.dposv(curvature, -gradient[free], lower=1, overwrite_a=1)
        step[free] = solved
        return step
    # Large panels: conjugate gradients on (D∘D)·p with the stencil as preconditioner.
    stencil = Stencil.of(network.conductance, network.reading(), free)
    resistance = network.cell_resistance
    product, inverse = (
        restricted(linear, chosen, free.size)
        for linear in (
            lambda step: network.forward(step.reshape(free.shape) * resistance).ravel(),
            lambda residual: stencil.solve(residual.reshape(free.shape)).ravel(),
        )
    )
    step[free] = steihaug(product, inverse, gradient[free], accuracy).step
    return step


def common_step(measured: Array, expected: Array) -> float:
    """Return exp of the mean of the shortest half of log R_m/R, (readings,) each.

    A load on some lines does not affect it. Two-point resistances are homogeneous: a common factor
    of all cells is the factor of all readings. The result is 1 without readings. Source: Andrews
    et al., Robust Estimates of Location, 1972 (the shorth).
    """
    steps = np.sort(np.log(measured / expected))
    half = len(steps) // 2 + 1
    if half > len(steps):
        return 1.0
    first = int(np.argmin(steps[half - 1 :] - steps[: len(steps) - half + 1]))
    return float(np.exp(steps[first : first + half].mean()))


# Amplification of rounding that leaves 11 digits; usual panels have about 3·(rows + columns).
SAFE_CONDITION = 1e4


@typed
def two_point_resistance(cell_resistance: Array) -> Array:
    """Return the two-point resistances R = f(r) of a panel in ohm.

    Shape (rows, columns) or (frames, rows, columns). Input and result have the same shape.

    At least ten digits of every entry are correct. Open cells and shorts are allowed; see
    `exact_two_point_resistance`. Raises ValueError if a cell is negative or NaN. Source: paper,
    equations (5)-(10).

    >>> import numpy as np
    >>> lampest.two_point_resistance(np.full((2, 2), 1000.0)).round(6)
    array([[750., 750.],
           [750., 750.]])
    """
    if cell_resistance.ndim == 3:
        return np.stack([two_point_resistance(frame) for frame in cell_resistance])
    _check_cells(cell_resistance)
    with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
        network = SolvedNetwork.floating(1 / cell_resistance, grounding(cell_resistance))
        if condition(network) <= SAFE_CONDITION:
            return network.reading()
    return exact_two_point_resistance(cell_resistance)


def _check_cells(cell_resistance: Array) -> None:
    if not np.all(cell_resistance >= 0):
        raise ValueError("cell resistances must be zero or positive, and numbers")


def condition(network: SolvedNetwork) -> float:
    """Return Σ_l |L_ll Z_ll| over the lines, the amplification of the rounding of L in any reading.

    An error ε_l of L_ll changes bᵀZb by ε_l·v_l², v = Z·b, and v_l² ≤ Z_ll·bᵀZb. The sum is
    infinite or NaN for a broken inverse.
    """
    total = line_sums(network.conductance)
    return float(np.abs(total * network.potentials().diagonal()).sum())


def exact_two_point_resistance(cell_resistance: Array) -> Array:
    """Return R = f(r) with all but the last one or two digits correct in every entry.

    The digits hold for any contrast of the cells. Input and result are (rows, columns) or (frames,
    rows, columns) ohm. A cell of infinite resistance is open, one of zero resistance is a short.
    Lines without a connection have R = inf, lines that shorts connect have R = 0.

    Star–mesh elimination of a line s leaves w_ab + w_as·w_sb/Σ_c w_sc between the others, without a
    subtraction. The conductance between the last two lines is 1/R. All pairs are obtained by
    recursion: one half of the lines of a side is eliminated, and in a copy the other half. The cost
    is a small multiple of (rows + columns)³. Raises ValueError if a cell is negative or NaN.
    Source: Alfa, Xue, Ye, Mathematics of Computation 71 (2002), after Grassmann, Taksar, Heyman
    (1985).
    """
    _check_cells(cell_resistance)
    if cell_resistance.ndim == 3:
        return np.stack([exact_two_point_resistance(frame) for frame in cell_resistance])
    rows, columns = cell_resistance.shape
    resistance = np.empty((rows, columns))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        weights = np.zeros((1, rows + columns, rows + columns))
        weights[0, :rows, rows:] = 1 / cell_resistance
        weights[0, rows:, :rows] = weights[0, :rows, rows:].T
        between, row, column = _all_pairs(weights, rows)
        resistance[row, column] = 1 / between
    return resistance


def _all_pairs(weights: Array, rows: int) -> tuple[Array, Numbers, Numbers]:
    """Return the conductances between every row and every column, all other lines eliminated.

    Parameters
    ----------
    weights : array, shape (1, lines, lines)
        Conductances between lines, rows first.
    rows : int
        Number of rows.

    Returns
    -------
    conductance : array, shape (pairs,)
    row, column : array of int, shape (pairs,)
        Numbers of the two lines of each pair.
    """
    lines = np.arange(weights.shape[1])[None]
    first_column = rows
    shorted = bool(np.any(np.isinf(weights)))
    while weights.shape[1] > 2:
        columns = weights.shape[1] - rows
        first, size = (0, rows) if rows >= columns else (rows, columns)
        half = size - size // 2
        places = np.arange(first, first + size)
        opposite = np.setdiff1d(np.arange(rows + columns), places)
        # Both halves have the same size: for an odd number of lines, the middle one stays in both.
        parts = []
        for stay, go in ((places[:half], places[half:]), (places[-half:], places[:-half])):
            order = np.concatenate([stay, opposite, go] if first == 0 else [opposite, stay, go])
            parts.append((weights[:, order[:, None], order], lines[:, order]))
        weights = _without_last(
            np.concatenate([part for part, _ in parts]), size // 2, shorted=shorted
        )
        lines = np.concatenate([part for _, part in parts])[:, : weights.shape[1]]
        rows = half if first == 0 else rows
    return weights[:, 0, 1], lines[:, 0], lines[:, 1] - first_column


def _without_last(weights: Array, count: int, *, shorted: bool) -> Array:
    """Return the networks after star–mesh elimination of their last `count` lines.

    `weights` is overwritten.
    """
    for last in range(weights.shape[1] - 1, weights.shape[1] - 1 - count, -1):
        spokes = weights[:, last, :last]
        mesh = weights[:, :last, :last]
        # w_ab += w_as·w_sb/Σ_c w_sc
        total = spokes.sum(axis=1, keepdims=True)
        share = np.divide(spokes, total, out=np.zeros_like(spokes), where=total > 0)
        if not shorted:
            mesh += spokes[:, :, None] * share[:, None, :]
            continue
        # Shorts are the limit of one large conductance: all current of the line divides equally
        # among them.
        endless = np.isinf(spokes)
        among = endless / np.maximum(endless.sum(axis=1, keepdims=True), 1)
        share = np.where(np.isinf(total), among, share)
        gain = spokes[:, :, None] * share[:, None, :]
        mesh += np.fmax(gain, gain.transpose(0, 2, 1))
    return weights[:, : weights.shape[1] - count, : weights.shape[1] - count]
