"""Two frames explained together, all cells but a few the same in both: the constrained fit behind a comparison.

What linear theory says of cells that readings hardly see is not to be trusted; here the network itself is asked.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

MOST_STEPS, MOST_HALVINGS, LONGEST_STEP = 60, 5, 1.0  # of log r; 4 to 8 steps suffice, some 40 with open lines
SETTLED = 0.1  # of χ²: a smaller gain changes no verdict
FIRMNESS = 1e-4  # 1/variance of a step: what no reading sees stays where it is


def joint_misfit(
    scene: Scene, pair: tuple[Readings, Readings], start: tuple[Array, Array], moved: NDArray[np.bool_]
) -> float:
    """min χ² of both frames over the cells of the first, a common factor, and those that moved in the second.

    pair : of one frame each; start : cells (rows, columns) ohm of each; moved : (rows, columns).
    """
    cells = _Cells(scene, pair, moved)
    unknowns = cells.first(*start)
    residual, jacobian = cells.linearised(unknowns)
    chi_square = float(residual @ residual)
    for _ in range(MOST_STEPS):
        system = jacobian.T @ jacobian
        system[np.diag_indices(len(system))] += FIRMNESS
        step = -np.linalg.solve(system, jacobian.T @ residual)
        step *= min(1.0, LONGEST_STEP / float(np.abs(step).max()))
        for halving in range(MOST_HALVINGS):
            there = unknowns + step * 0.5**halving
            missed, slope = cells.linearised(there)
            if float(missed @ missed) < chi_square:
                break
        else:
            break
        gained = chi_square - float(missed @ missed)
        unknowns, residual, jacobian, chi_square = there, missed, slope, chi_square - gained
        if gained < SETTLED:
            break
    return chi_square


class _Cells:
    """Unknowns (log r of the first frame, log of the common factor, log r of those that moved) → residuals of both."""

    def __init__(self, scene: Scene, pair: tuple[Readings, Readings], moved: NDArray[np.bool_]) -> None:
        self._circuit, self._pair, self._moved = scene.circuit, pair, moved
        self._ties = [scene.circuit.ties(one.value) for one in pair]

    def first(self, resting: Array, frame: Array) -> Array:
        """Where to begin."""
        factor = float(np.median(np.log(frame / resting)))
        return np.concatenate([np.log(resting).ravel(), [factor], np.log(frame[self._moved])])

    def linearised(self, unknowns: Array) -> tuple[Array, Array]:
        """(residuals/σ of both frames, their Jacobian)."""
        moved, size = self._moved.ravel(), self._moved.size
        resting, factor, free = np.split(unknowns, [size, size + 1])
        frame = np.where(moved, 0.0, resting + factor)
        frame[moved] = free
        residuals, slopes = zip(
            *(self._at(number, cells) for number, cells in enumerate((resting, frame))), strict=True
        )
        jacobian = np.zeros((2 * size, len(unknowns)))
        jacobian[:size, :size] = slopes[0]
        jacobian[size:, :size] = slopes[1] * ~moved
        jacobian[size:, size] = slopes[1][:, ~moved].sum(axis=1)
        jacobian[size:, size + 1 :] = slopes[1][:, moved]
        return np.concatenate(residuals), jacobian

    def _at(self, number: int, position: Array) -> tuple[Array, Array]:
        """Of one frame at log r (cells)."""
        readings = self._pair[number]
        assert readings.sigma is not None
        network = self._circuit.network(np.exp(position).reshape(self._moved.shape), self._ties[number])
        missed = (network.reading() - readings.value) / readings.sigma
        counted = (readings.seen > 0) & ((readings.side == 0) | (readings.side * missed < 0))
        weight = np.where(counted, 1 / readings.sigma, 0.0).ravel()
        return np.where(counted, missed, 0.0).ravel(), network.sensitivity() * weight[:, None]
