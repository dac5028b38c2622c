"""Steps of the readings: a matched filter on the logarithm of all readings (Page, Biometrika 41, 1954, of one).

With ℓ the logarithms of a frame's readings, m their mean since the last step, W the root of the inverse covariance of a
panel at rest and t_k the whitened patterns of discs, ‖t_k‖ = 1, a step is where

    |t_kᵀ W (ℓ − m)| > STEP·v_k + tolerance_k ,

v_k the rms of the same number in frames without a load, of all patterns if that is more: so ripple and noise count that
nobody specified. What all cells share is free. ℓ is the median of three frames: an outlier lasts one.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from lampest.loads.recognition.observation import Observation
from lampest.loads.recognition.search import DiscSearch, unit
from lampest.panel.panel import Array

STEP = 6.0  # standard deviations: with some 1000 patterns normal noise passes them once in 10⁶ frames
FREE = 0.1  # σ of ln r and of ln y that all cells and all readings may share: temperature, waves, supply; an assumption


NEAR = 3.0  # pitches about a disc in which a load's pattern counts for it


@dataclass(frozen=True, eq=False)
class StepTest:
    """patterns : (discs, cells) t_kᵀ W. near : (discs, discs) which discs are near. whitening : W (cells, cells).

    drift : (discs) score of cells that drift by 1, each by itself. loud : (discs) v_k².
    """

    patterns: Array
    near: NDArray[np.bool_]
    whitening: Array
    drift: Array
    loud: Array

    @classmethod
    def of(cls, frame: Observation, search: DiscSearch, unloaded: Array) -> "StepTest":
        """About a panel at rest; frame : its readings with the noise of one frame. unloaded : (frames, cells) ln y."""
        value, cells = frame.measured.ravel(), frame.measured.size
        slope = frame.slope(np.zeros(frame.measured.shape)) / value[:, None]
        covariance = (
            np.diag((frame.sigma.ravel() / value) ** 2) + frame.baseline.model_errors.settled**2 * slope @ slope.T
        )
        shared = [FREE * slope.sum(axis=1, keepdims=True), FREE * np.ones((cells, 1))]
        shared += [] if frame.common is None else [frame.common / value[:, None]]
        columns = np.hstack(shared)
        root = cholesky(covariance + columns @ columns.T, lower=True)
        whitening = solve_triangular(root, np.eye(cells), lower=True)
        patterns = unit(whitening @ (search.readings(frame) / value[:, None])).T @ whitening
        x, y = search.places[search.faint].T / frame.baseline.scene.panel.pitch_mm
        near = np.hypot(x[:, None] - x, y[:, None] - y) < NEAR
        scores = (unloaded - np.log(value)) @ patterns.T
        spread = np.mean(scores**2) * len(scores) / (len(scores) - 1) if len(scores) > 1 else 1.0
        drift = np.linalg.norm(patterns @ slope, axis=1)
        return cls(patterns, near, whitening, drift, np.full(len(patterns), max(float(spread), 1.0)))

    def scores(self, change: Array) -> Array:
        """|t_kᵀ W δ| of a change of ln y (cells)."""
        return np.abs(self.patterns @ change)

    def sizes(self, change: Array) -> Array:
        """(discs) the largest score of a change within NEAR of each disc."""
        return np.asarray(np.where(self.near, self.scores(change), 0.0).max(axis=1))

    def least(self) -> Array:
        """(discs) scores beyond which something has happened."""
        return np.asarray(STEP * np.sqrt(np.maximum(self.loud, max(1.0, float(self.loud.mean())))))

    def heard(self, scores: Array, share: float) -> "StepTest":
        """After a frame without a load, which counts by this share."""
        return replace(self, loud=self.loud + share * (scores**2 - self.loud))
