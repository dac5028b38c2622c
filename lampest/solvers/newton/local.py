"""The inverse of a sparse stand-in for second derivatives."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from lampest.panel.conjugate import Linear
from lampest.panel.panel import Array


def local_inverse(local: sparse.csr_array, damping: Array, free: NDArray[np.intp]) -> Linear:
    """The inverse of what the terms and each cell's own reading say, on the free cells; sparse LU, symmetric order."""
    matrix = sparse.csr_array(local + sparse.diags_array(damping))[free][:, free]
    least = 1e-9 * np.abs(matrix.diagonal()).max(initial=1e-300)
    matrix = sparse.csc_array(matrix + sparse.diags_array(np.full(len(free), least)))
    if matrix.nnz == len(free):
        diagonal = matrix.diagonal()
        return lambda values: values / diagonal
    options = {"SymmetricMode": True}
    solve: Linear = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve
    return solve
