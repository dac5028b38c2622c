"""Errors of an estimate whose penalty expects less scatter than films have.

Films scatter by s from cell to cell. Where noise hides this scatter, the chosen weight of a penalty
of differences follows the coarse pattern of the panel alone. It then expects neighbours that are
more alike than those of films, and the prior covariance P⁻¹ of the penalty is less than s² I in
some directions.
"""

import numpy as np

from lampest.panel.panel import Array
from lampest.posterior.covariance import DenseErrors


def answer_to_scatter(errors: DenseErrors, scatter: float) -> Array:
    """Return the effect on log r of the scatter that the penalties do not expect, (free, cells).

    With P = Σ ω_k v_k v_kᵀ the precision of the penalties on the cells of a frame, the scatter
    beyond them is Σ v_k w_k, w_k ~ N(0, max(s² − 1/ω_k, 0)). It is the same in all frames. The
    estimate follows it but for A⁻¹ Zᵀ Ω (Z + Z₀) w. Penalties that compare frames are not violated.

    Parameters
    ----------
    errors : DenseErrors
    scatter : float
        s, of log r.
    """
    model = errors.model
    cells = model.cells[0].size
    frames = model.cells.size // cells
    jacobian = model.penalty_jacobian
    of_frame = jacobian[:, -cells:].toarray()
    curvature = model.penalty_curvature[:, None]
    precision, basis = np.linalg.eigh(of_frame.T @ (curvature / model.scale * of_frame))
    expected = 1 / np.maximum(precision, np.finfo(float).tiny)
    root = basis * np.sqrt(np.maximum(scatter**2 - expected, 0.0))
    violated = jacobian @ np.tile(root, (frames, 1)) + model.carried(np.stack([root, root]))
    return -errors.solved((jacobian.T @ (curvature * violated))[model.free])
