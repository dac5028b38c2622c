"""Second derivatives of the cost in u = log r, potentials eliminated: as a product, or as a matrix on small panels.

With the network's J = ∂y/∂u, e = ∂φ/∂y, N = diag(g)·Σ_i e_i ∂²y_i/∂g²·diag(g), and H the second derivatives of the
terms with respect to (r; y): ∇²φ = (diag r; J)ᵀ H (diag r; J) + N + diag(r ∂φ/∂r − Jᵀ e).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from lampest.cost.cost import Entries
from lampest.cost.problem import Evaluation
from lampest.panel.conjugate import DENSE_UNKNOWNS
from lampest.panel.network import Afar, SecondOrder
from lampest.panel.panel import Array
from lampest.solvers.newton.smoothing import Smoothing

# Frames that are solved jointly, a first frame and its baseline. Under a mouth pairs of 16 × 16 cells took three times
# as long by factors as by conjugate gradients in the ratios of their cells, of 24 × 24 five times.
DENSE_JOINT_UNKNOWNS = 300
# Kinks of absolute losses make second derivatives that conjugate gradients gropes along, and are taken exactly here.
DENSE_KINKED_UNKNOWNS = 600


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
        return np.concatenate([second.adjoint().ravel() for second in self._second_orders])

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
        """H, (2·frames·cells)² sparse; it is symmetric, so that its columns are its rows."""
        functions, size = self.at.cost.functions, 2 * self.at.cell_resistance.size
        matrix = sparse.csr_array((self._smooth_terms, *functions.hessian.by_columns), shape=(size, size))
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
        whole: Array = self._of_terms(step, change) + bent.ravel() + (self.direct - self.through) * step
        return whole

    def straight_product(self, step: Array) -> Array:
        """(diag r; J)ᵀ H (diag r; J)·p: what a change of r by r·p bends where readings follow it in proportion."""
        return self._of_terms(step, self.forward(step))

    def _of_terms(self, step: Array, change: Array) -> Array:
        cells = self.at.cell_resistance
        force = self.terms @ np.concatenate([cells.ravel() * step, change.ravel()])
        direct, through = np.split(force, 2)
        whole: Array = cells.ravel() * direct + self.adjoint(through.reshape(cells.shape))
        return whole

    @property
    def factored(self) -> bool:
        """Whether ∇²φ is made and factorised, rather than only multiplied with vectors."""
        cells = self.at.cell_resistance
        if self.at.data.factored:
            return True
        if len(cells) > 1:
            return bool(cells.size <= DENSE_JOINT_UNKNOWNS)
        return bool(cells.size <= (DENSE_KINKED_UNKNOWNS if len(self.at.cost.slope) else DENSE_UNKNOWNS))

    @property
    def paired(self) -> bool:
        """Whether there are two frames, too large to be factored."""
        return len(self.at.cell_resistance) == 2 and not self.factored

    @property
    def only_misfit(self) -> bool:
        """Whether nothing but the readings of one frame bends the cost."""
        cells, functions = self.at.cell_resistance, self.at.cost.functions
        rough = functions.rough_jacobian.pattern[1] < cells.size
        return len(cells) == 1 and not (len(functions.entries.cells) or rough.any())

    @cached_property
    def local(self) -> sparse.csr_array:
        """A sparse, positive stand-in for ∇²φ: the terms' part, and of J only what a cell does to its own reading."""
        cells = self.at.cell_resistance.ravel()
        scale = sparse.diags_array(cells)
        rest = self.own + self.bent_up
        return sparse.csr_array(scale @ self.terms[: len(cells), : len(cells)] @ scale + sparse.diags_array(rest))

    @property
    def own(self) -> Array:
        """What a cell's own reading bends."""
        response = np.stack([network.own_response() for network in self.at.networks]).ravel()
        return np.asarray(self.terms.diagonal()[response.size :] * response**2)

    @property
    def bent_up(self) -> Array:
        """What the change of variable adds to the diagonal, where that is positive."""
        return np.maximum(self.direct - self.through, 0)

    @property
    def afar(self) -> Afar:
        """What the readings of one frame bend, as the network looks from afar."""
        weight = self.terms.diagonal()[self.at.cell_resistance.size :].reshape(self.at.cell_resistance.shape)
        return self.at.networks[0].normal_from_afar(weight[0])

    @cached_property
    def matrix(self) -> Array:
        """∇²φ, dense (frames · cells)²."""
        count = self.at.cell_resistance.size
        jacobians = [network.sensitivity() for network in self.at.networks]
        matrix = block_diagonal([second.matrix() for second in self._second_orders])
        self._add_terms(matrix, jacobians)
        matrix.flat[:: count + 1] += self.direct - self.through
        return matrix

    def _add_terms(self, matrix: Array, jacobians: Sequence[Array]) -> None:
        """matrix += (diag r; J)ᵀ H (diag r; J), J by frames."""
        cells = self.at.cell_resistance.ravel()
        count = len(cells)
        entries, values = self._entries
        row, column = entries.at_cells
        matrix[row, column] += values[entries.cells] * cells[row] * cells[column]
        if entries.at_model is None:
            jacobian = block_diagonal(jacobians)
            matrix += jacobian.T @ (self.terms[count:, count:] @ jacobian)
        else:
            weight = np.zeros(count)
            weight[entries.at_model] = values[entries.model]
            for number, jacobian in enumerate(jacobians):
                span = slice(number * len(jacobian), (number + 1) * len(jacobian))
                matrix[span, span] += weighted_square(jacobian, weight[span])
        if entries.crossed:
            cross = cells[:, None] * (self.terms[:count, count:] @ block_diagonal(jacobians))
            matrix += cross + cross.T

    @property
    def _entries(self) -> tuple[Entries, Array]:
        """Where the nonzeros of H stand, and their values."""
        functions = self.at.cost.functions
        if not len(self.at.cost.slope):
            return functions.entries, self._smooth_terms
        matrix = sparse.coo_array(self.terms)
        return Entries.of(matrix.row, matrix.col, self.at.cell_resistance.size), matrix.data

    @cached_property
    def _smooth_terms(self) -> Array:
        return self.at.call(self.at.cost.functions.hessian, self.smoothing.dual)


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """Square blocks of equal size along the diagonal; one alone as it is."""
    if len(blocks) == 1:
        return blocks[0]
    size = len(blocks[0])
    matrix = np.zeros((len(blocks) * size, len(blocks) * size))
    for number, block in enumerate(blocks):
        span = slice(number * size, (number + 1) * size)
        matrix[span, span] = block
    return matrix


def weighted_square(matrix: Array, weight: Array) -> Array:
    """AᵀWA; a product of a matrix with its own transpose costs half."""
    if weight.min() < 0:
        return (matrix * weight[:, None]).T @ matrix
    scaled = matrix * np.sqrt(weight)[:, None]
    square: Array = scaled.T @ scaled
    return square
