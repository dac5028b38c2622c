"""Matrices over the lines of a panel whose rows are tied to columns alone.

There are several values on every line.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lampest.panel.kirchhoff import bipartite_matrix
from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class LineBlocks:
    """Symmetric matrix with a block for values a and b of every line.

    The block is diag(d_ab) + [[0, A_ab], [A_abᵀ, 0]].

    Attributes
    ----------
    diagonal : array, shape (k, k, lines)
        d, symmetric in a and b.
    between : array, shape (k, k, rows, columns)
        A, symmetric in a and b.
    """

    diagonal: Array
    between: Array

    def __add__(self, other: "LineBlocks") -> "LineBlocks":
        return LineBlocks(self.diagonal + other.diagonal, self.between + other.between)

    def matrix(self) -> Array:
        """Return the matrix, (k·lines, k·lines)."""
        count, _, lines = self.diagonal.shape
        blocks = bipartite_matrix(self.diagonal, self.between)
        return blocks.transpose(0, 2, 1, 3).reshape(count * lines, count * lines)

    def inverse(self) -> Callable[[Array], Array]:
        """Return the product with the inverse, (k·lines,).

        The lines of the longer side are eliminated one by one, so that the cost is that of an
        inverse over the shorter side and of the entries of A. Raises LinAlgError if a pivot is
        singular, ValueError if one is not finite.
        """
        count = len(self.diagonal)
        rows, columns = self.between.shape[-2:]
        short = slice(rows)
        long = slice(rows, None)
        between = self.between
        if rows > columns:
            short = slice(rows, None)
            long = slice(rows)
            between = between.swapaxes(-1, -2)
        # E = A P⁻¹ with the pivots P of the eliminated lines, and the Schur complement S = D − E Aᵀ
        # of the others
        pivots = np.linalg.inv(np.asarray_chkfinite(self.diagonal[..., long].transpose(2, 0, 1)))
        eliminated = max(rows, columns)
        remaining = count * min(rows, columns)
        ties = between.transpose(0, 2, 3, 1).reshape(remaining, eliminated, count)
        shares = np.einsum("tlb,lbc->tlc", ties, pivots).reshape(remaining, eliminated * count)
        flat = ties.reshape(remaining, eliminated * count)
        schur = -shares @ flat.T
        blocks = schur.reshape(count, remaining // count, count, remaining // count)
        np.einsum("ajbj->abj", blocks)[...] += self.diagonal[..., short]
        within = np.linalg.inv(np.asarray_chkfinite(schur))

        def solve(values: Array) -> Array:
            on_lines = values.reshape(count, rows + columns)
            outer = on_lines[:, long].T
            solution = np.empty_like(on_lines)
            inner = within @ (on_lines[:, short].ravel() - shares @ outer.ravel())
            solution[:, short] = inner.reshape(count, -1)
            solution[:, long] = np.einsum(
                "lab,lb->al", pivots, outer - (inner @ flat).reshape(outer.shape)
            )
            return solution.ravel()

        return solve
