"""Effect of errors that estimates share on cells at a bound, and the intervals of such cells.

The error of a cell at a bound is not Gaussian: the distance of the cell from its bound has a normal
distribution that is truncated at 0. An error of all readings may move a cell off its bound; the
cell then counts as free.
"""

import numpy as np

from lampest.panel.panel import Array, Numbers
from lampest.posterior.covariance import DenseErrors
from lampest.posterior.interval import one_sided
from lampest.posterior.linear import IGNORANCE, positive_inverse


def active_bounds(
    errors: DenseErrors, rows: Array, previous: Array
) -> tuple[Array, Numbers, Array, Array]:
    """Return the effect of shared errors z on the free cells, and intervals of those at a bound.

    The distance t_c of a cell from its bound is distributed as N(−slope·v, v + |a|²) truncated to
    t_c ≥ 0, with v its variance among the free cells and a the effect of z on it. If |a| > slope·v,
    the cell is released and moves with the free cells. For an open cell t_c is the conductance, in
    units of a typical cell's.

    `rows`, (data rows, n), is the effect of z on the data, `previous`, (2, cells, n), that on log r
    of the last estimate and of the baseline.

    Returns
    -------
    answer : array, shape (free, n)
        Effect of z on log r of the free cells.
    cells : array of int, shape (k,)
    below, above : array, shape (k,)
        Numbers of the cells at a bound, and extent of their 95 % intervals, in log r.

    Raises numpy.linalg.LinAlgError if the cost is flat.
    """
    model = errors.model
    free = model.free
    cells = np.flatnonzero(model.at_lower | model.at_upper)
    # Unknowns: u of cells inside and at a lower bound, relative conductance at an upper bound.
    resistance = model.cells.ravel()
    typical = np.exp(np.log(resistance)[free].mean()) if len(free) else 1.0
    stretch = np.where(model.at_upper, np.maximum(resistance / typical, 1.0), 1.0)
    # X = (√Ω J; √Ω Z) with A = Xᵀ X, and its change Y with z, whose effect is A⁻¹ Xᵀ Y
    data = np.sqrt(model.data_curvature)[:, None]
    penalties = np.sqrt(model.penalty_curvature)[:, None]
    slopes = np.vstack([errors.sensitivity * data, model.penalty_jacobian.toarray() * penalties])
    slopes = slopes * stretch
    changes = np.vstack([rows * data, -model.carried(previous) * penalties])
    # Each cell at a bound alone: Schur complement, variance v, slope of −log density, and effect a
    # of z.
    of_held = slopes[:, cells]
    of_free = slopes[:, free]
    across = errors.inverse @ (of_free.T @ of_held)
    complement = np.sum(of_held**2, axis=0) - np.sum((of_free.T @ of_held) * across, axis=0)
    precision = np.maximum(complement, IGNORANCE * model.scale)
    variance = model.scale / precision
    slope = np.abs(model.gradient[cells]) * stretch[cells] / (2 * model.scale)
    answer = ((of_held - of_free @ across).T @ changes) / precision[:, None]
    # Cells whose bound z overcomes: solve again with the free ones.
    released = np.sqrt(np.sum(answer**2, axis=1)) > slope * variance
    unbounded = slopes[:, np.concatenate([free, cells[released]])]
    matrix = unbounded.T @ unbounded
    matrix[np.diag_indices(len(matrix))] += IGNORANCE * model.scale
    joint = positive_inverse(matrix) @ (unbounded.T @ changes)
    answer[released] = joint[len(free) :]
    # 95 % quantile of the truncated normal distribution, converted to log r for open cells.
    total = variance + np.sum(answer**2, axis=1)
    reach = one_sided(slope * variance / total, total)[1]
    below = np.where(model.at_upper[cells], np.log1p(stretch[cells] * reach), 0.0)
    above = np.where(model.at_upper[cells], np.inf, reach)
    return joint[: len(free)], cells, below, above
