"""Memory of error bars: errors of the last estimate and of the baseline for the next frame.

Terms that compare a frame with the previous one, or with the unloaded panel, carry the errors of
these estimates into the next one. Small panels keep their covariance as a matrix, large ones keep
samples of the errors.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.panel.panel import Array


@dataclass(frozen=True, eq=False)
class DenseMemory:
    """Errors of log r of the last estimate and of the baseline, as matrices.

    The error bars of the next frame depend on these errors.

    Attributes
    ----------
    blocks : array, shape (2, 2, cells, cells)
        S₀, the joint covariance of the last estimate (0) and the baseline (1).
    """

    blocks: Array

    def resting(self) -> "DenseMemory":
        """Return the memory with the last estimate as the baseline."""
        return DenseMemory(np.broadcast_to(self.blocks[0, 0], self.blocks.shape))

    def shared(self) -> Array:
        """Return the covariance of the last estimate and the baseline, cell by cell, (cells,)."""
        return np.asarray(np.diag(self.blocks[0, 1]))

    def variance(self) -> Array:
        """Return the variance of the last estimate, (cells,)."""
        return np.asarray(np.diag(self.blocks[0, 0]))


@dataclass(frozen=True, eq=False)
class SampledMemory:
    """The same as samples.

    Attributes
    ----------
    samples : array, shape (2, samples, cells)
        Errors of the last estimate (0) and of the baseline (1).
    frames : int
        Number of frames so far, the seed of the next frame's noise.
    """

    samples: Array
    frames: int = 1

    def resting(self) -> "SampledMemory":
        """Return the memory with the last estimate as the baseline."""
        return replace(self, samples=self.samples[[0, 0]])

    def shared(self) -> Array:
        """Return the covariance of the last estimate and the baseline, cell by cell, (cells,)."""
        return np.asarray(np.mean(self.samples[0] * self.samples[1], axis=0))

    def variance(self) -> Array:
        """Return the variance of the last estimate, (cells,)."""
        return np.asarray(np.mean(self.samples[0] ** 2, axis=0))


Memory = DenseMemory | SampledMemory
