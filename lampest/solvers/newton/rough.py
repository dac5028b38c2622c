"""What second derivatives of a large penalised panel look like from afar, inverted: for conjugate gradients.

Terms tie neighbours, readings all cells of a line: A = T + diag(c) + V M Vᵀ, T what the terms say, V two columns for
every line. T + diag(c) alone is factored, sparse; along V, where that is wrong by factors, A is inverted exactly
before and after (a coarse space in two levels): with Q = V (VᵀAV)⁻¹ Vᵀ, Q + (1 − QA) (T + diag(c))⁻¹ (1 − AQ). Without
the lines a step took three times as many products, and a hundred where readings are weighed by their noise.
Source: Nabben & Vuik, SIAM J. Numer. Anal. 42, 2004 (balancing); Woodbury's formula itself would ask for as many
solutions as V has columns.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from lampest.panel.conjugate import Linear
from lampest.panel.panel import Array
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.local import local_inverse

# What lines bend, over what cells and neighbours bend there: 10 to 3,000 where steps took a third of the products,
# 0.03 where as many.
QUARTILE, STRONG = 0.75, 1.0
ALIKE = 1e-10  # of a column's own square: columns that are alike on even panels are told apart by no more


@dataclass(frozen=True, eq=False)
class Rough:
    """solve : A⁻¹ by changes of r in ohm, over all cells. It knows nothing of how far cells have moved since."""

    solve: Linear

    @classmethod
    def of(cls, curvature: Curvature, bent: Array, lined: bool) -> "Rough":
        """At a point; bent : (cells) what is added to the diagonal by changes of log r. lined : whether lines count,
        where they bend much, in a single frame: that costs as much as a factor, and wears where cells move far.
        """
        cells = curvature.at.cell_resistance.ravel()
        terms = curvature.terms[: len(cells), : len(cells)]
        if not lined or terms.nnz == len(cells) or len(curvature.at.cell_resistance) > 1:
            return cls(_sparse_inverse(terms + sparse.diags_array((curvature.own + bent) / cells**2)))
        parts = curvature.afar
        local = sparse.csr_array(terms + sparse.diags_array((parts.own.ravel() + bent) / cells**2))
        across = _across(parts.along / curvature.at.cell_resistance)
        return cls(_lined(local, across, parts.mixed) or _sparse_inverse(local))

    def over(self, free: NDArray[np.intp], cells: Array) -> Linear:
        """By changes of log r of the free ones of the cells (cells) ohm."""
        whole = np.zeros(len(cells))

        def solve(values: Array) -> Array:
            whole[free] = values / cells[free]
            return np.asarray(self.solve(whole)[free] / cells[free])

        return solve


def _across(along: Array) -> sparse.csr_array:
    """V (cells, k·lines) of v (k, rows, columns); see `Afar`."""
    _, rows, columns = along.shape
    number = np.arange(rows * columns)
    places = np.concatenate([number // columns, rows + number % columns])
    ones = (np.ones(len(places)), (np.tile(number, 2), places))
    lines = sparse.csr_array(ones, shape=(len(number), rows + columns))
    empty = sparse.csr_array((len(number), 0))
    return sparse.csr_array(sparse.hstack([empty, *(sparse.diags_array(one.ravel()) @ lines for one in along)]))


def _sparse_inverse(local: sparse.csr_array) -> Linear:
    """Of a matrix whose diagonal may span many decades."""
    size = np.sqrt(np.maximum(np.abs(local.diagonal()), 1e-300))
    scale = sparse.diags_array(1 / size)
    solve = local_inverse(sparse.csr_array(scale @ local @ scale), np.zeros(len(size)), np.arange(len(size)))
    return lambda values: solve(values / size) / size


@dataclass(frozen=True, eq=False)
class _Lined:
    """local : T + diag(c), solve : its inverse. across : V, its columns of length one; mixed : M to match. coarse :
    (VᵀAV)⁻¹.
    """

    local: sparse.csr_array
    solve: Linear
    across: sparse.csr_array
    mixed: Array
    coarse: Array

    def __call__(self, values: Array) -> Array:
        """A⁻¹·x, nearly."""
        first = self._along(values)
        between = self.solve(values - self._product(first))
        return np.asarray(first + between - self._along(self._product(between)))

    def _along(self, values: Array) -> Array:
        """Q·x."""
        return np.asarray(self.across @ (self.coarse @ (self.across.T @ values)))

    def _product(self, values: Array) -> Array:
        """A·x."""
        return np.asarray(self.local @ values + self.across @ (self.mixed @ (self.across.T @ values)))


def _lined(local: sparse.csr_array, across: sparse.csr_array, mixed: Array) -> _Lined | None:
    """Of T + diag(c), V and M; None where three lines in four bend less than what they cross."""
    length = np.sqrt(np.maximum(across.multiply(across).sum(axis=0), 1e-300))
    unit = sparse.csr_array(across @ sparse.diags_array(1 / length))
    weighed, square = mixed * length[:, None] * length, (unit.T @ unit).toarray()
    crossed, lines = (unit.T @ (local @ unit)).toarray(), square @ weighed @ square
    if not len(lines) or np.quantile(lines.diagonal() / crossed.diagonal(), QUARTILE) < STRONG:
        return None
    seen = crossed + lines
    size = np.sqrt(np.maximum(np.abs(seen.diagonal()), 1e-300))
    seen = seen / size[:, None] / size
    seen.flat[:: len(seen) + 1] += ALIKE
    inverse = linalg.inv(seen) / size[:, None] / size
    return _Lined(local, _sparse_inverse(local), unit, weighed, (inverse + inverse.T) / 2)
