"""The best step of limited length where second derivatives are known and bend both ways."""

import numpy as np

from lampest.panel.panel import Array

ROUNDING = 1e-16
NEAR = 0.3  # of the logarithm of a shift


def within_reach(matrix: Array, slope: Array, reach: float) -> Array:
    """argmin slopeᵀs + ½ sᵀ·matrix·s over steps s of which no entry is larger than `reach`, nearly.

    s = −(matrix + μ)⁻¹ slope with the least μ that makes it short enough; the matrix may have any signature. A damping
    in proportion to the diagonal would forbid every step along a curvature of 10⁻¹⁰ of the largest one.
    Source: Moré & Sorensen, SIAM J. Sci. Stat. Comput. 4, 1983.
    """
    values, vectors = np.linalg.eigh(matrix)
    along = vectors.T @ slope
    size = float(np.abs(values).max()) or 1.0
    bend = values - min(values[0], 0.0)

    def step(log_shift: float) -> Array:
        found: Array = -vectors @ (along / (bend + np.exp(log_shift)))
        return found

    low, high = np.log(ROUNDING * size), np.log(size + float(np.abs(along).sum()) / reach)
    while high - low > NEAR:
        middle = (low + high) / 2
        if np.abs(step(middle)).max() > reach:
            low = middle
        else:
            high = middle
    return step(high)
