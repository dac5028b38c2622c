"""Where a second minimum would lie: along the direction in which the cost bends far less than along any other.

A cell beside shorts, which its reading hardly shows, may stand at one of two values that explain all readings nearly
alike. Near both the cost is flat along that cell and those that make up for it, and along nothing else: on recordings
with an untold series resistance λ₁/λ₂ is 0.0 to 0.6 there, and 0.7 to 0.95 in frames with one minimum.
"""

import numpy as np

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array
from lampest.solvers.newton.directions import Factor

SOFT = 0.6  # of the second smallest second derivative
FAR = 1.0  # of log r, of the cell that moves most: such minima were 0.5 to 1.2 apart
ROUNDS = 6  # of inverse iteration: a ratio of SOFT is told from 1 after three


def along_softest(at: Evaluation, factor: Factor | None) -> tuple[Array, ...]:
    """Cells (frames, rows, columns) ohm, r·exp(±v) with v the softest direction; none where it is not alone soft.

    factor : of second derivatives near that point; without an exact one nothing is known. Costs 14 solves with it.
    Source: Parlett, The Symmetric Eigenvalue Problem, 1998, section 14 (subspace iteration).
    """
    if factor is None or not factor.exact or len(factor.cells) < 2 or factor.cell_resistance.shape != at.position.shape:
        return ()
    places = np.arange(len(factor.cells)) + 0.5
    vectors = np.cos(np.outer(places, [1.0, 2.0]))  # any two that are not orthogonal to what is sought
    for _ in range(ROUNDS):
        vectors = np.linalg.qr(factor.solve(vectors))[0]
    inverse, mixed = np.linalg.eigh(vectors.T @ factor.solve(vectors))
    if inverse[0] > SOFT * inverse[1]:
        return ()
    softest = vectors @ mixed[:, 1]
    step = np.zeros(at.position.size)
    step[factor.cells] = FAR * softest / np.abs(softest).max()
    return tuple(np.exp(at.position + sign * step.reshape(at.position.shape)) for sign in (1, -1))
