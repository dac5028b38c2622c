"""Inverses of symmetric positive definite matrices by LAPACK, and the sweep operator.

The functions treat rounding errors and failures in one place for posterior covariances, normal
matrices and evidences alike.
"""

import numpy as np
from scipy.linalg import blas, lapack

from lampest.panel.panel import Array


def positive_inverse(matrix: Array) -> Array:
    """Return A⁻¹ from the upper triangle of A.

    Raises numpy.linalg.LinAlgError if A is not positive definite.
    """
    return inverse_and_volume(matrix)[0] if matrix.size else matrix


def inverse_and_volume(matrix: Array) -> tuple[Array, float]:
    """Return the inverse of a matrix A from its upper triangle, and its volume.

    Raises as `positive_inverse`.

    Returns
    -------
    inverse : array, shape of A
        A⁻¹.
    log_volume : float
        log det A⁻¹.
    """
    factor, failed = lapack.dpotrf(matrix)
    inverse, broken = lapack.dpotri(factor)
    if failed or broken or not np.all(np.isfinite(inverse)):
        raise np.linalg.LinAlgError("the cost is flat round the estimate")
    inverse = inverse + inverse.T  # its lower triangle is zero
    inverse[np.diag_indices(len(inverse))] /= 2
    return np.asarray(inverse), -2 * float(np.sum(np.log(np.diag(factor))))


def swept(table: Array, place: int) -> Array:
    """Return a table T, (n, m) with m ≥ n, swept by its diagonal entry t_pp.

    A table of rows in memory is overwritten.

        T ← T − t_·p t_p·/t_pp,   row and column p over |t_pp|,   t_pp ← −1/t_pp

    Source: Goodnight, The American Statistician 33, 1979 (the sweep operator).
    """
    pivot = table[place, place]
    row = table[place].copy()
    column = table[:, place].copy()
    # dger adds in place, in a fifth of the time of np.outer.
    table = blas.dger(-1 / pivot, row, column, a=table.T, overwrite_a=True).T
    table[place] = row / abs(pivot)
    table[:, place] = column / abs(pivot)
    table[place, place] = -1 / pivot
    return table
