"""Second derivatives of the cost in u = log r, potentials eliminated: as a product, or as a matrix on small panels.

With the network's J = ∂y/∂u, e = ∂φ/∂y, N = diag(g)·Σ_i e_i ∂²y_i/∂g²·diag(g), and H the second derivatives of the
terms with respect to (r; y): ∇²φ = (diag r; J)ᵀ H (diag r; J) + N + diag(r ∂φ/∂r − Jᵀ e).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from lampest.cost.problem import Evaluation
from lampest.panel.network import SecondOrder
from lampest.panel.panel import Array
from lampest.solvers.newton.smoothing import Smoothing


@dataclass(frozen=True, eq=False)
class Curvature:
    """∇²φ at one point; vectors are flat (frames · cells). `smoothing` stands in for absolute losses."""

    at: Evaluation
    smoothing: Smoothing

    @cached_property
    def gradient(self) -> Array:
        """∇φ in u."""
        return self.direct + self.through

    @cached_property
    def _partials(self) -> tuple[Array, Array]:
        return self.at.partials(self.smoothing.slope(self.at.rough))

    @cached_property
    def direct(self) -> Array:
        """r·∂φ/∂r at fixed readings."""
        return (self.at.cell_resistance * self._partials[0]).ravel()

    @cached_property
    def through(self) -> Array:
        """Jᵀ·∂φ/∂y."""
        return self.adjoint(self.by_reading)

    @property
    def by_reading(self) -> Array:
        """∂φ/∂y, (frames, rows, columns)."""
        return self._partials[1]

    def forward(self, step: Array) -> Array:
        """J·p, the change of the readings, (frames, rows, columns)."""
        pairs = zip(self.at.networks, step.reshape(self.at.cell_resistance.shape), strict=True)
        return np.stack([network.forward(frame) for network, frame in pairs])

    def adjoint(self, weights: Array) -> Array:
        """Jᵀ·w, flat, for w (frames, rows, columns)."""
        pairs = zip(self.at.networks, weights, strict=True)
        return np.stack([network.adjoint(frame) for network, frame in pairs]).ravel()

    @cached_property
    def _second_orders(self) -> list[SecondOrder]:
        """N of every frame."""
        pairs = zip(self.at.networks, self.by_reading, strict=True)
        return [network.second_order(slope) for network, slope in pairs]

    @cached_property
    def terms(self) -> sparse.csr_array:
        """H, (2·frames·cells)² sparse."""
        functions, size = self.at.cost.functions, 2 * self.at.cell_resistance.size
        values = self.at.call(functions.hessian, self.smoothing.dual)
        matrix = sparse.csr_array((values, functions.hessian.pattern), shape=(size, size))
        if len(self.at.cost.slope):
            jacobian = self.smoothing.jacobian(self.at)
            weight = self.at.cost.slope * self.smoothing.stiffness(self.at.rough)
            matrix = matrix + jacobian.T @ (sparse.diags_array(weight) @ jacobian)
        return sparse.csr_array(matrix)

    def product(self, step: Array) -> Array:
        """∇²φ·p; costs 8 products of (rows, columns) with (columns, lines) matrices and no memory of cells²."""
        cells = self.at.cell_resistance
        change, bent = np.empty_like(cells), np.empty_like(cells)
        for frame, part in enumerate(step.reshape(cells.shape)):
            change[frame], bent[frame] = self._second_orders[frame].products(part)
        force = self.terms @ np.concatenate([cells.ravel() * step, change.ravel()])
        direct, through = np.split(force, 2)
        product = cells.ravel() * direct + self.adjoint(through.reshape(cells.shape))
        whole: Array = product + bent.ravel() + (self.direct - self.through) * step
        return whole

    @property
    def only_misfit(self) -> bool:
        """Whether nothing but the readings of one frame bends the cost."""
        frames, size = len(self.at.networks), self.at.cell_resistance.size
        return frames == 1 and self.terms[:size, :size].nnz == 0

    @cached_property
    def local(self) -> sparse.csr_array:
        """A sparse, positive stand-in for ∇²φ: the terms' part, and of J only what a cell does to its own reading."""
        cells = self.at.cell_resistance.ravel()
        scale = sparse.diags_array(cells)
        model = self.terms.diagonal()[len(cells) :]
        response = np.stack([network.own_response() for network in self.at.networks]).ravel()
        rest = model * response**2 + np.maximum(self.direct - self.through, 0)
        return sparse.csr_array(scale @ self.terms[: len(cells), : len(cells)] @ scale + sparse.diags_array(rest))

    @cached_property
    def matrix(self) -> Array:
        """∇²φ, dense (frames · cells)²."""
        cells = self.at.cell_resistance.ravel()
        count, size = len(cells), self.at.networks[0].conductance.size
        jacobian, matrix = np.zeros((count, count)), np.zeros((count, count))
        for frame, network in enumerate(self.at.networks):
            block = slice(frame * size, (frame + 1) * size)
            jacobian[block, block] = network.sensitivity()
            matrix[block, block] = self._second_orders[frame].matrix()
        self._add_terms(matrix, jacobian, cells)
        matrix[np.diag_indices(count)] += self.direct - self.through
        return matrix

    def _add_terms(self, matrix: Array, jacobian: Array, cells: Array) -> None:
        """matrix += (diag r; J)ᵀ H (diag r; J)."""
        count = len(cells)
        rows, columns, values = self._triplets
        own = (rows < count) & (columns < count)
        matrix[rows[own], columns[own]] += values[own] * cells[rows[own]] * cells[columns[own]]
        model = (rows >= count) & (columns >= count)
        if np.array_equal(rows[model], columns[model]):
            weight = np.zeros(count)
            weight[rows[model] - count] = values[model]
            matrix += (jacobian * weight[:, None]).T @ jacobian
        else:
            matrix += jacobian.T @ (self.terms[count:, count:] @ jacobian)
        if np.any((rows < count) & (columns >= count)):
            cross = cells[:, None] * (self.terms[:count, count:] @ jacobian)
            matrix += cross + cross.T

    @cached_property
    def _triplets(self) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
        """(rows, columns, values) of H."""
        functions = self.at.cost.functions
        if not len(self.at.cost.slope):
            return *functions.hessian.pattern, self.at.call(functions.hessian, self.smoothing.dual)
        matrix = sparse.coo_array(self.terms)
        return matrix.row, matrix.col, matrix.data
