"""Squares of sparse rows B of few entries each: BᵀDB and diag(B M Bᵀ), without sparse products."""

import numpy as np
from scipy import sparse

from lampest.panel.panel import Array, Numbers


def squares(rows: sparse.csr_array, weight: Array) -> Array:
    """Return BᵀDB, dense (columns, columns), for rows B and diagonal weights D (rows,)."""
    size = rows.shape[1]
    if _crowded(rows):
        dense = rows.toarray()
        return np.asarray((dense * weight[:, None]).T @ dense)
    first, second, row = _pairs(rows)
    place = rows.indices[first].astype(np.intp) * size + rows.indices[second]
    entries = rows.data[first] * rows.data[second] * weight[row]
    summed = np.asarray(np.bincount(place, entries, size * size), dtype=float)
    return summed.reshape(size, size)


def quadratic_forms(rows: sparse.csr_array, matrix: Array) -> Array:
    """Return diag(B M Bᵀ), (rows,), for rows B and M dense (columns, columns)."""
    if _crowded(rows):
        return np.asarray(np.sum((rows @ matrix) * rows.toarray(), axis=1))
    first, second, row = _pairs(rows)
    middle = matrix[rows.indices[first], rows.indices[second]]
    entries = rows.data[first] * rows.data[second] * middle
    return np.asarray(np.bincount(row, entries, rows.shape[0]), dtype=float)


def _crowded(rows: sparse.csr_array) -> bool:
    """Return whether rows have more pairs of entries than BᵀDB has entries."""
    counts = np.diff(rows.indptr).astype(float)
    return bool(counts @ counts > rows.shape[1] ** 2)


def _pairs(rows: sparse.csr_array) -> tuple[Numbers, Numbers, Numbers]:
    """Return the numbers of both entries of all pairs within a row, and the number of the row."""
    counts = np.diff(rows.indptr)
    partners = np.repeat(counts, counts)
    first = np.repeat(np.arange(rows.nnz), partners)
    begin = np.repeat(np.repeat(rows.indptr[:-1], counts), partners)
    within = np.arange(len(first)) - np.repeat(np.cumsum(partners) - partners, partners)
    row = np.repeat(np.arange(rows.shape[0]), counts)[first]
    return first, begin + within, row
