"""Variance of the residuals that an absolute loss holds at 0.

A weight of least risk holds residuals at 0 that are not, and says nothing on their size. Most of
them are those of cells that stand still, and their variance is far below that of all residuals.
Readings show it. With p = B b + N n, B the plateaus and N their complement, the residuals held at
0 are x = Z N n ~ N(0, v). The plateaus are free, and their part of the readings is projected off.
Then

    J N → V,   Vᵀ Zᵀ Z V = 1,   Vᵀ Jᵀ J V = Λ,   t = Vᵀ Jᵀ y ~ N(0, Λ + Λ² (v + c))

in units of the noise, c the variance of the residuals by the errors of the previous frame and of
the baseline. v is the median of its posterior; the prior of σ₀²/(σ₀² + v) is uniform between 0 and
1.
Source: Daniels, Canadian J. Statistics 27, 1999 (the uniform shrinkage prior).
"""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.linalg import eigh, null_space

from lampest.files.errors import BROKEN
from lampest.panel.panel import Array
from lampest.posterior.covariance import DenseErrors

POINTS = 60  # of the grid of ln v
DECADES = 4.0  # of v, below and above σ₀²
NEGLIGIBLE = 1e-12  # share of the largest λ below which readings show nothing


def with_held_variance(errors: DenseErrors) -> DenseErrors:
    """Return errors whose model knows the variance of the residuals held at 0.

    The errors are the same where the data show no variance, or several terms have absolute losses.
    """
    model = errors.model
    numbers = np.unique(model.penalty_term[model.absolute])
    shown = [number for number, _ in model.shown_variances()]
    if len(numbers) != 1 or shown != numbers.tolist() or not model.held.any():
        return errors
    with suppress(*BROKEN):
        return replace(errors, model=replace(model, held_variance=_held_variance(errors)))
    return errors


def _held_variance(errors: DenseErrors) -> float:
    """Return v. Raises numpy.linalg.LinAlgError where readings do not show it."""
    model = errors.model
    size = np.sqrt(model.data_curvature / model.scale)
    jacobian = errors.jacobian * size[:, None]
    readings = -model.residual * size
    plateaus = model.plateaus[model.free].toarray()
    along, _ = np.linalg.qr(jacobian @ plateaus)
    across = null_space(plateaus.T) if plateaus.size else np.eye(len(model.free))
    moving = (jacobian - along @ (along.T @ jacobian)) @ across
    rows = model.penalty_jacobian.tocsr()[model.held]
    residuals = rows[:, model.free] @ across
    stiffness, basis = eigh(moving.T @ moving, residuals.T @ residuals)
    seen = stiffness > NEGLIGIBLE * stiffness.max(initial=0.0)
    precision = stiffness[seen]
    squares = (basis.T @ (moving.T @ (readings - along @ (along.T @ readings))))[seen] ** 2
    inherited = _inherited(errors, (residuals @ basis)[:, seen])
    usual = 1 / float(np.mean(precision))
    variances = usual * np.logspace(-DECADES, DECADES, POINTS)
    total = precision + precision**2 * (variances[:, None] + inherited)
    shrinkage = usual / (usual + variances)
    cost = np.sum(squares / total + np.log(total), axis=1)
    density = shrinkage * (1 - shrinkage) * np.exp((cost.min() - cost) / 2)
    share = np.cumsum(density)
    return float(variances[np.searchsorted(share, share[-1] / 2)])


def _inherited(errors: DenseErrors, directions: Array) -> Array:
    """Return c of directions (held rows, n) of the residuals, (n,)."""
    variance = np.zeros(directions.shape[1])
    if errors.before is None:
        return variance
    jacobians = [known.tocsr()[errors.model.held] for known in errors.model.known_jacobians]
    effects = [np.asarray((known.T @ directions).T) for known in jacobians]
    for row, first in enumerate(effects):
        for column, second in enumerate(effects):
            variance += np.sum((first @ errors.before.blocks[row, column]) * second, axis=1)
    return variance
