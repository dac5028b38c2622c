"""Derivatives of the cost in u = log r, potentials eliminated, as products and as a matrix.

With J = ∂y/∂u, e = ∂φ/∂y, N = diag(g)·Σ_i e_i ∂²y_i/∂g²·diag(g), T the second derivatives of the
terms by (r; y): ∇²φ = (diag r; J)ᵀ T (diag r; J) + N + diag(r ∂φ/∂r − Jᵀ e). Gauss–Newton's matrix
is JᵀWJ + PᵀKP, W = max(∂²φ/∂y², 0), P = ∂x/∂u of the penalties' residuals x, K = ρ'(x)/x of their
losses.

Absolute losses are those of an interior-point method: their duals z stay within |z| < 1. Σ w |x| is
the least Σ w t with t ± x ≥ 0. A barrier of parameter μ = w β, one for all rows, keeps both slacks
positive. With t eliminated, the loss is

    ψ(x) = t − β log(t/2β) − 2β,   t = β + √(β² + x²),   ψ'(x) = x/t

and with the duals as further unknowns, (1 − z²) x = 2β z, its second derivative is
(1 − z²)/(t + z x). After every step μ is a share of the mean complementarity, which is large while
duals are far from their residuals (`Iterate.sharpened`).
Source: Nocedal & Wright, Numerical Optimization, 2006, sections 10.3, 16.6 and 19.2; Wächter &
Biegler, Math. Program. 106, 2006, equations (7) and (8) (μ and the share of the way to the
boundary).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod

import numpy as np
from scipy import linalg, sparse

from lampest.cost.problem import Evaluation, Part, residuals
from lampest.panel.compiled import with_entries
from lampest.panel.network import SecondOrder
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.trust_region import DENSE_CELLS, MATRIX_CELLS
from lampest.solvers.bounds import free_cells

MAX_SHARE = 0.1  # of the mean complementarity: μ of the next step
TO_BOUNDARY = 0.99  # least share of the way to the first dual that reaches ±1
LEVEL_SHARE = 1e-3  # of the cost: w β of all rows at a start whose residuals are all zero


@dataclass(frozen=True, eq=False)
class Smoothing:
    """Smoothing of absolute losses; without such losses all arrays are empty.

    Attributes
    ----------
    width : array or float
        β of each row, or of all rows, in the unit of the residuals.
    dual : array
        Duals z of the rows, |z| < 1.
    """

    width: Array | float
    dual: Array

    def _size(self, residual: Array) -> Array:
        """Return t = β + √(β² + x²)."""
        return self.width + np.sqrt(self.width**2 + residual**2)

    def slope(self, residual: Array) -> Array:
        """Return ψ'(x) = x/t."""
        return residual / self._size(residual)

    def stiffness(self, residual: Array) -> Array:
        """Return the second derivative (1 − z²)/(t + z x) with the duals as unknowns."""
        return (1 - self.dual**2) / (self._size(residual) + self.dual * residual)

    def objective(self, at: Evaluation) -> float:
        """Return φ with ψ(x) in place of |x|."""
        if not len(at.nonsmooth):
            return at.objective
        squares = at.nonsmooth**2
        # s = t − 2β = x²/(√(x² + β²) + β), without cancellation; ψ = s − β log(1 + s/2β)
        excess = squares / (np.sqrt(squares + self.width**2) + self.width)
        smoothed = excess - self.width * np.log1p(excess / (2 * self.width))
        return float(
            np.delete(at.costs, np.unique(at.cost.functions.nonsmooth_terms)).sum()
            + at.cost.slope @ smoothed
        )

    @classmethod
    def start(cls, at: Evaluation) -> "Smoothing":
        """Return the smoothing of a first point: z = 0, and μ a tenth of the mean w |x|/2."""
        slope = at.cost.slope
        level = MAX_SHARE * float(slope @ np.abs(at.nonsmooth)) / 2
        level = (level or LEVEL_SHARE * at.cost_scale) / max(len(slope), 1)
        return cls(level / np.where(slope > 0, slope, level), np.zeros(len(slope)))

    def moved(self, before: Evaluation, after: Evaluation, change: Array) -> "Smoothing":
        """Return the smoothing after a step δu of log r, with `change` ∂x/∂u·δu.

        The duals are from their linearised equation, all along the share of it that keeps every
        one within ±1: duals cut one by one misjudge how near the others are to their optimum.
        Residuals that changed by `change` up to rounding count as changed by that: between narrow
        corners the last bits of x are many digits of z.
        """
        if not len(self.dual):
            return self
        linear = before.nonsmooth + change
        rounding = before.last_bits + after.last_bits
        exact = np.abs(after.nonsmooth - linear) <= rounding
        reached = np.where(exact, linear, after.nonsmooth)
        # z⁺ = z + ((1 − z²) x⁺ − 2β z)/(t + z x)
        size = self._size(before.nonsmooth) + self.dual * before.nonsmooth
        of_dual = ((1 - self.dual**2) * reached - 2 * self.width * self.dual) / size
        room = np.where(of_dual > 0, 1 - self.dual, 1 + self.dual)
        reach = np.min(room / np.maximum(np.abs(of_dual), np.finfo(float).tiny))
        share = max(TO_BOUNDARY, 1 - self.level(before) / before.cost_scale)
        return replace(self, dual=self.dual + min(1.0, share * reach) * of_dual)

    def centred(self, at: Evaluation) -> "Smoothing":
        """Return the smoothing with the duals z = ψ'(x)."""
        return replace(self, dual=self.slope(at.nonsmooth))

    def complementarity(self, at: Evaluation) -> float:
        """Return the mean of (t − z x)/2β over the rows, 1 where the duals are ψ'(x)."""
        size = self._size(at.nonsmooth)
        return float(np.mean((size - self.dual * at.nonsmooth) / (2 * self.width)))

    def level(self, at: Evaluation) -> float:
        """Return w β summed over the rows, the duality gap where the duals are ψ'(x)."""
        return float(at.cost.slope @ self.width)


@dataclass(frozen=True, eq=False)
class Hessian:
    """Gradient and Hessian of φ in u = log r at one point of one panel, or of each of many panels.

    Many panels are the leading axis of the arrays. Vectors are flat, (…, frames · cells). Products,
    and matrices over chosen cells, exist for a single panel only.

    Attributes
    ----------
    at : Evaluation
        Cost and residuals at the point.
    smoothing : Smoothing
        Differentiable replacement of the absolute losses.
    """

    at: Evaluation
    smoothing: Smoothing

    @cached_property
    def dense(self) -> bool:
        """Whether a matrix over the cells that can move is cheaper than products."""
        data = self.at.data
        size = self.cells.size
        if size <= DENSE_CELLS or size > MATRIX_CELLS:
            return size <= DENSE_CELLS
        # Absolute losses and joint pairs need many products, so a matrix pays off up to
        # MATRIX_CELLS.
        stiff = len(self.at.cost.slope) > 0 or len(self.at.networks) > 1
        return stiff or int(np.sum(data.lower < data.upper)) <= DENSE_CELLS

    @property
    def cells(self) -> Array:
        """Cells at the point, (…, frames, rows, columns) ohm."""
        return self.at.cell_resistance

    def elsewhere(self, position: Array) -> "Hessian":
        """Return the derivatives at another point u, (…, cells), clipped to the bounds.

        The cost must have no absolute losses. Raises numpy.linalg.LinAlgError where a line is not
        connected.
        """
        data = self.at.data
        cells = np.clip(np.exp(position).reshape(data.lower.shape), data.lower, data.upper)
        return replace(self, at=self.at.elsewhere(cells))

    def some(self, panels: Numbers) -> "Hessian":
        """Return the derivatives at the chosen panels."""
        return replace(self, at=self.at.some(panels))

    @property
    def position(self) -> Array:
        """The point u = log r, (…, cells)."""
        return self._flat(self.at.position)

    @cached_property
    def residual(self) -> Array:
        """Largest entry of the projected gradient relative to the cost's scale, (…)."""
        return self.at.projected_gradients(self.gradient.reshape(self.cells.shape))

    @cached_property
    def free(self) -> Mask:
        """Cells outside the active set of the bounds, boolean (…, cells)."""
        return free_cells(self.at, self.gradient)

    def _flat(self, maps: Array) -> Array:
        return maps.reshape(*self.at.data.panels, prod(maps.shape[len(self.at.data.panels) :]))

    @cached_property
    def gradient(self) -> Array:
        """∇φ in u: r·∂φ/∂r + Jᵀ·∂φ/∂y, (…, cells)."""
        return self.direct + self.through

    @cached_property
    def _partials(self) -> tuple[Array, Array]:
        return self.at.partials(self.smoothing.slope(self.at.nonsmooth))

    @cached_property
    def direct(self) -> Array:
        """Part of the gradient at fixed readings, r·∂φ/∂r, (…, cells)."""
        return self._flat(self.cells * self._partials[0])

    @cached_property
    def through(self) -> Array:
        """Part of the gradient through the readings, Jᵀ·∂φ/∂y, (…, cells)."""
        return np.concatenate(
            [self._flat(second.adjoint()) for second in self._second_orders], axis=-1
        )

    @property
    def by_reading(self) -> Array:
        """Derivative of the cost by the readings, ∂φ/∂y, (…, frames, rows, columns)."""
        return self._partials[1]

    def forward(self, step: Array) -> Array:
        """Return J·p, the change of the readings for a step p of u, flat.

        The change has the shape (frames, rows, columns).
        """
        pairs = zip(self.at.networks, step.reshape(self.cells.shape), strict=True)
        return np.stack([network.forward(frame) for network, frame in pairs])

    def adjoint(self, weights: Array) -> Array:
        """Return Jᵀ·w, flat, for weights w (frames, rows, columns)."""
        pairs = zip(self.at.networks, weights, strict=True)
        return np.concatenate([network.adjoint(frame).ravel() for network, frame in pairs])

    @cached_property
    def _second_orders(self) -> list[SecondOrder]:
        pairs = enumerate(self.at.networks)
        return [network.second_order(self.by_reading[..., frame, :, :]) for frame, network in pairs]

    @cached_property
    def terms(self) -> sparse.csc_array:
        """T without the stiffness of absolute losses, sparse (2·frames·cells, 2·frames·cells).

        T = terms + (∂x/∂(r; y))ᵀ diag(w·ψ'') (∂x/∂(r; y)), ψ the smoothed loss of residuals x.
        """
        return with_entries(self.at.cost.functions.hessian.structure, self._smooth_terms)

    @cached_property
    def _kinks(self) -> Array:
        """Weighted second derivatives w·ψ''(x) of the smoothed absolute losses, (residuals,)."""
        return self.at.cost.slope * self.smoothing.stiffness(self.at.nonsmooth)

    @cached_property
    def kinked(self) -> sparse.csc_array:
        """∂x/∂(r; y) of the residuals with absolute losses, sparse (residuals, 2·cells)."""
        function = self.at.cost.functions.nonsmooth_jacobian
        return with_entries(function.structure, self.at.call(function, self.smoothing.dual))

    def nonsmooth_change(self, step: Array) -> Array:
        """Return ∂x/∂u·δu of the residuals with absolute losses, (residuals,).

        The step δu (flat) is clipped to the bounds.
        """
        if not len(self.at.cost.slope):
            return np.zeros(0)
        step = np.clip(step, *(bound.ravel() - self.position for bound in self.at.data.log_bounds))
        move = np.concatenate([self.cells.ravel() * step, self.forward(step).ravel()])
        return np.asarray(self.kinked @ move)

    @cached_property
    def diagonal_of_terms(self) -> Array:
        """Diagonal of T, (2·frames·cells): cells, then readings."""
        numbers, places = self.at.cost.functions.entries.on_diagonal
        diagonal = np.zeros(2 * self.cells.size)
        diagonal[places] = self._smooth_terms[numbers]
        if len(self.at.cost.slope):
            diagonal += self.kinked.power(2).T @ self._kinks
        return diagonal

    @property
    def curvature(self) -> Array:
        """Second derivative of the cost by each reading, ∂²φ/∂y², flat."""
        return self.diagonal_of_terms[self.cells.size :]

    def product(self, step: Array) -> Array:
        """Return ∇²φ·p, flat.

        A product costs eight products of (rows, columns) with (columns, lines) matrices and never
        forms a matrix over the cells: sums of its large and small entries would lose digits where
        readings span decades.
        """
        cells = self.cells
        pairs = zip(self._second_orders, step.reshape(cells.shape), strict=True)
        changes, seconds = zip(*(order.products(frame) for order, frame in pairs), strict=True)
        # (diag r; J)ᵀ T (diag r; J)·p: T applied to the changes (δr; δy) = (r·p; J·p)
        move = np.concatenate([cells.ravel() * step, *(change.ravel() for change in changes)])
        force = self.terms @ move
        if len(self._kinks):
            force += self.kinked.T @ (self._kinks * (self.kinked @ move))
        through = self.adjoint(force[step.size :].reshape(cells.shape))
        # + N·p + diag(r ∂φ/∂r − Jᵀ ∂φ/∂y)·p
        own = np.concatenate([second.ravel() for second in seconds])
        force_of = cells.ravel() * force[: step.size] + through + own
        return np.asarray(force_of + (self.direct - self.through) * step)

    def gauss_newton_product(self, step: Array) -> Array:
        """Return the product with the Gauss–Newton matrix, (JᵀWJ + PᵀKP)·p, flat."""
        through = self.reading_weight * self.forward(step)
        return np.asarray(self.penalty_matrix @ step + self.adjoint(through))

    @cached_property
    def reading_weight(self) -> Array:
        """Weights W of the readings in the Gauss–Newton matrix, (frames, rows, columns).

        W = max(∂²φ/∂y², 0) for squared losses and ρ'(x)/x·(∂x/∂y)² for all others. The latter, the
        weights of iteratively reweighted least squares, are positive even beyond a loss's corner,
        where ρ'' is negative.
        """
        weight = np.maximum(self.curvature, 0.0)
        if not all(term.loss.squared for term in self.at.cost.terms if term.reads_measurement):
            part = residuals(self.at.cost).data
            # W_i = Σ_k (∂x_k/∂y_i)²·ρ'(x_k)/x_k
            weight = part.jacobian("reading", self.at).power(2).T @ self._stiffness(part)
        return weight.reshape(self.cells.shape)

    @cached_property
    def penalty_matrix(self) -> sparse.csr_array:
        """Part PᵀKP of the penalties in the Gauss–Newton matrix.

        The matrix is sparse and semidefinite, (frames·cells, frames·cells).
        """
        part = residuals(self.at.cost).penalties
        if not len(part.term):
            return sparse.csr_array((self.cells.size,) * 2)
        # P = ∂x/∂u = (∂x/∂r)·diag(r)
        slopes = by_log(part.jacobian("cell_resistance", self.at), self.cells)
        weight = self._stiffness(part)[slopes.indices]
        return sparse.csr_array(slopes.T @ with_entries(slopes, weight * slopes.data))

    def _stiffness(self, part: Part) -> Array:
        """Return weight·ρ'(x)/x of the residuals x of a part, (rows,).

        Absolute losses are smoothed.
        """
        cost = self.at.cost
        value = part.values(self.at)
        stiffness = np.zeros(len(value))
        for number, term in enumerate(cost.terms):
            rows = part.term == number
            if rows.any() and term.loss.enters == "dual":
                stiffness[rows] = self._kinks[cost.functions.nonsmooth_terms == number]
            elif rows.any():
                stiffness[rows] = 2 * self.at.weights[number] * term.loss.stiffness(value[rows])
        return stiffness

    @cached_property
    def only_data(self) -> bool:
        """Whether the second derivatives have no part at fixed readings.

        Costs of one frame without a penalty on its cells have none.
        """
        cells = self.cells
        functions = self.at.cost.functions
        absolute = functions.nonsmooth_jacobian.pattern[1] < cells.size
        return len(cells) == 1 and not (len(functions.entries.cells) or absolute.any())

    @cached_property
    def own_response(self) -> Array:
        """Diagonal of J, the response of each reading to its own cell, flat."""
        return np.concatenate([network.own_response().ravel() for network in self.at.networks])

    @property
    def own(self) -> Array:
        """Part W_c·J_cc² of each cell's own reading in the diagonal of JᵀWJ, flat."""
        return self.reading_weight.ravel() * self.own_response**2

    @cached_property
    def diagonal(self) -> Array:
        """Nonnegative estimate of the diagonal of ∇²φ from own readings and penalties, flat."""
        return np.asarray(self.own + self.penalty_matrix.diagonal())

    @cached_property
    def jacobian(self) -> Array:
        """J = ∂y/∂u, dense (…, frames · cells, frames · cells)."""
        return block_diagonal([network.sensitivity() for network in self.at.networks])

    @cached_property
    def matrix(self) -> Array:
        """The Hessian ∇²φ, dense (…, frames · cells, frames · cells)."""
        matrix = block_diagonal([second.matrix() for second in self._second_orders])
        jacobian = self.jacobian
        cells = self._flat(self.cells)
        count = cells.shape[-1]
        entries = self.at.cost.functions.entries
        values = self._smooth_terms
        # N + diag(r) T_rr diag(r)
        row, column = entries.at_cells
        scale = cells[..., row] * cells[..., column]
        matrix[..., row, column] += values[..., entries.cells] * scale
        # + Jᵀ T_yy J
        if entries.at_model is None:
            matrix += jacobian.T @ (self.terms[count:, count:] @ jacobian)
        else:
            weight = np.zeros_like(cells)
            weight[..., entries.at_model] = values[..., entries.model]
            matrix += weighted_square(jacobian, weight)
        if entries.crossed:
            # + diag(r) T_ry J and its transpose
            cross = cells[:, None] * (self.terms[:count, count:] @ jacobian)
            matrix += cross + cross.T
        if len(self.at.cost.slope):
            # + (∂x/∂u)ᵀ diag(w·ψ'') ∂x/∂u of the absolute losses
            by_cells = by_log(self.kinked[:, :count], self.cells)
            by_reading = self.kinked[:, count:]
            if by_reading.nnz:
                by_log_r = by_cells.toarray() + by_reading @ jacobian
                matrix += weighted_square(by_log_r, self._kinks)
            else:
                matrix += square_of_rows(sparse.csr_array(by_cells), self._kinks)
        # + diag(r ∂φ/∂r − Jᵀ ∂φ/∂y)
        np.einsum("...ii->...i", matrix)[...] += self.direct - self.through
        return matrix

    @cached_property
    def gauss_newton_matrix(self) -> Array:
        """The Gauss–Newton matrix JᵀWJ + PᵀKP, dense."""
        return np.asarray(
            weighted_square(self.jacobian, self.reading_weight.ravel())
            + self.penalty_matrix.toarray()
        )

    @cached_property
    def _smooth_terms(self) -> Array:
        slope = self.smoothing.slope(self.at.nonsmooth)
        return self.at.call(self.at.cost.functions.hessian, slope)


def by_log(jacobian: sparse.csc_array, cells: Array) -> sparse.csc_array:
    """Return ∂x/∂u = (∂x/∂r)·diag(r), sparse (rows, frames · cells)."""
    along = np.repeat(cells.ravel(), np.diff(jacobian.indptr))
    return with_entries(jacobian, jacobian.data * along)


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """Return the block-diagonal matrix of the blocks; a single block is returned unchanged."""
    return blocks[0] if len(blocks) == 1 else (linalg.block_diag(*blocks))


def square_of_rows(rows: sparse.csr_array, weight: Array) -> Array:
    """Return BᵀDB, dense (columns, columns), for sparse rows B and diagonal weights D (rows,)."""
    return np.asarray((rows.T @ (sparse.diags_array(weight) @ rows)).toarray())


def weighted_square(matrix: Array, weight: Array) -> Array:
    """Return AᵀWA, (…, cells, cells), for A (…, rows, cells) and diagonal weights W (…, rows)."""
    square = (matrix * weight[..., None]).swapaxes(-1, -2) @ matrix
    return square
