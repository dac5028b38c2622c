"""Where a second minimum would lie: along the direction in which the cost bends far less than along any other.

A cell beside shorts, which its reading hardly shows, may stand at one of two values that explain all readings nearly
alike. Near both the cost is flat along that cell and those that make up for it, and along nothing else: on recordings
with an untold series resistance λ₁/λ₂ is 0.0 to 0.6 there, and 0.7 to 0.95 in frames with one minimum.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.panel.conjugate import Linear
from lampest.panel.panel import Array

SOFT = 0.6  # of the second smallest second derivative
FAR = 1.0  # of log r, of the cell that moves most: such minima were 0.5 to 1.2 apart
ROUNDS = 6  # of inverse iteration: a ratio of SOFT is told from 1 after three


def softest(solve: Linear, count: int) -> Array | None:
    """argmin vᵀHv over v (count) of length one, from `solve` = H⁻¹; None where another direction is nearly as soft.

    Costs 14 solves, or 4 to 8 where that is clear: with V what two vectors have become and T = VᵀH⁻¹V, an eigenvalue of
    H⁻¹ is within |H⁻¹V − VT| of each of T's, and its second one is at least T's.
    Source: Parlett, The Symmetric Eigenvalue Problem, 1998, sections 11.5 and 14 (residuals, subspace iteration).
    """
    numbers = np.arange(count) + 0.5
    image = solve(np.cos(np.outer(numbers, [1.0, 2.0])))  # any two that are not orthogonal to what is sought
    for _ in range(ROUNDS):
        vectors = np.linalg.qr(image)[0]
        image = solve(vectors)
        within = vectors.T @ image
        inverse, mixed = np.linalg.eigh(within)
        away = image - vectors @ within
        if inverse[0] > SOFT * (inverse[1] + np.sqrt(np.vdot(away, away))):
            return None
    return None if inverse[0] > SOFT * inverse[1] else np.asarray(vectors @ mixed[:, 1])


def either_side(position: Array, cells: NDArray[np.intp], along: Array) -> tuple[Array, Array]:
    """Cells exp(u ± v) ohm, the shape of `position` u, with v in proportion to `along`, which is over some cells."""
    step = np.zeros(position.size)
    step[cells] = FAR * along / np.abs(along).max()
    forth = step.reshape(position.shape)
    return np.exp(position + forth), np.exp(position - forth)
