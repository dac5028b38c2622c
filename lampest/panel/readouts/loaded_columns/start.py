"""Where a search begins with loaded columns: cells that satisfy Kirchhoff's law at the voltages that were read.

While line i is driven, sensed line j stands at v_ij, which is read, and the driven one at a potential that follows from
its current I_i = Σ_j v_ij/Rs_j. Only the floating lines' potentials w_r are unknown: w_r Σ_j g_rj = Σ_j g_rj v_ij.
Given those, Σ_r g_rj (w_r − v_ij) = v_ij/Rs_j is linear in the cells of one sensed line. Both in turn converge to the
cells that reproduce the readings.
"""

import numpy as np

from lampest.panel.panel import Array

MOST_ROUNDS = 40
SETTLED = 1e-3  # of log g: a start need not be better
# Of the naive divider's conductance: a cell that noise sends beyond is begun where its reading still answers to it.
LEAST, LARGEST = 0.02, 1e3


def kirchhoff_start(voltage: Array, load: Array, potential: Array) -> Array:
    """g (driven, sensed) siemens from v (driven, sensed), Rs (sensed) ohm and the driven lines' potentials (driven).

    A start, not an estimate: it stops after MOST_ROUNDS, and cells are held to LEAST and LARGEST of the naive ones.
    """
    current: Array = voltage / load
    driven = np.maximum(potential, voltage.max(axis=1) * (1 + 1e-6))
    naive = current / (driven[:, None] - voltage)
    conductance: Array = naive
    for _ in range(MOST_ROUNDS):
        before, conductance = conductance, _round(conductance, voltage, current, driven)
        conductance = np.clip(conductance, LEAST * naive, LARGEST * naive)
        if np.abs(np.log(conductance / before)).max() < SETTLED:
            break
    return conductance


def _round(conductance: Array, voltage: Array, current: Array, driven: Array) -> Array:
    """One round: floating potentials from the cells, then the cells of every sensed line from those."""
    lines = len(driven)
    floating = (voltage @ conductance.T) / conductance.sum(axis=1)  # (pattern, line)
    floating[np.diag_indices(lines)] = driven
    system = floating[None] - voltage.T[:, :, None]  # (sensed, pattern, line)
    return np.asarray(np.linalg.solve(system, current.T[:, :, None])[:, :, 0].T)
