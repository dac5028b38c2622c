"""Squares BᵀDB of sparse rows B of few entries each, without sparse products."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from lampest.panel.panel import Array, Numbers


@dataclass(frozen=True, eq=False)
class SparseRows:
    """Rows B, (rows, columns), whose pairs of entries are listed once."""

    rows: sparse.csr_array

    def square(self, weight: Array) -> Array:
        """Return BᵀDB, dense (columns, columns), for diagonal weights D (rows,)."""
        if self._crowded is not None:
            return np.asarray((self._crowded * weight[:, None]).T @ self._crowded)
        place, row, product = self._pairs
        size = self.rows.shape[1]
        summed = np.bincount(place, product * weight[row], size * size)
        return np.asarray(summed, dtype=float).reshape(size, size)

    @cached_property
    def _crowded(self) -> Array | None:
        """B, dense, where its rows have more pairs of entries than BᵀDB has entries."""
        counts = np.diff(self.rows.indptr).astype(float)
        few = counts @ counts <= self.rows.shape[1] ** 2
        return None if few else np.asarray(self.rows.toarray())

    @cached_property
    def _pairs(self) -> tuple[Numbers, Numbers, Array]:
        """Places in BᵀDB of all pairs of entries of a row, their rows, and their products."""
        rows = self.rows
        counts = np.diff(rows.indptr)
        partners = np.repeat(counts, counts)
        first = np.repeat(np.arange(rows.nnz), partners)
        begin = np.repeat(np.repeat(rows.indptr[:-1], counts), partners)
        second = begin + np.arange(len(first)) - np.repeat(np.cumsum(partners) - partners, partners)
        row = np.repeat(np.arange(rows.shape[0]), counts)[first]
        place = rows.indices[first].astype(np.intp) * rows.shape[1] + rows.indices[second]
        return place, row, rows.data[first] * rows.data[second]
