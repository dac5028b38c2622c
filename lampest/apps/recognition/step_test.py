"""Detection of steps of the readings: loads that arrive, change or leave.

A matched filter compares a change of the logarithms of the readings with the change that a disc at
each place would cause. Errors of an unloaded panel are whitened first, so that drift and changes of
all cells are no steps.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csc_array

from lampest.apps.recognition.disc_search import DiscSearch
from lampest.apps.recognition.observation import Observation
from lampest.files.levels import OUTLIER_THRESHOLD
from lampest.panel.panel import Array

# Reach of a load about its place in pitches: half of the widest mouth, and a cell.
NEAR_PITCHES = 3.0


@dataclass(frozen=True, eq=False)
class StepTest:
    """Matched filter for steps, |t_kᵀ W δ| > OUTLIER_THRESHOLD·v_k of a change δ of ln y.

    W whitens the errors of an unloaded panel; changes that all cells share have a large variance
    and do not count.

    Attributes
    ----------
    templates : sparse array, shape (cells, discs)
        ln r/r0 under discs; t_k = W S · template has unit length, with S = d ln y/d ln r.
    filter : array, shape (cells, cells)
        (W S)ᵀ W.
    places : integer array, shape (discs,)
        Number of the place of each disc.
    near : boolean array, shape (places, places)
        Whether two places are within NEAR_PITCHES.
    whitening : array, shape (cells, cells)
        W.
    loud : array, shape (discs,)
        v_k², the mean square score in frames without a load, which includes unspecified ripple and
        noise.
    """

    templates: csc_array
    filter: Array
    places: NDArray[np.intp]
    near: NDArray[np.bool_]
    whitening: Array
    loud: Array

    @classmethod
    def of(cls, frame: Observation, search: DiscSearch, unloaded: Array) -> "StepTest":
        """Return the test about a panel at rest.

        Parameters
        ----------
        frame : Observation
            Unloaded readings with the noise of one frame.
        search : DiscSearch
        unloaded : array, shape (frames, cells)
            ln y of the unloaded frames.
        """
        value = frame.measured.ravel()
        cells = frame.measured.size
        slope = frame.slope() / value[:, None]
        errors = frame.baseline.model_errors
        # C = noise + drift S Sᵀ + common changes of all cells and of all readings; W = L⁻¹ of C = L
        # Lᵀ
        settled = errors.settled**2 * slope @ slope.T
        shared = [
            errors.swaying * slope.sum(axis=1, keepdims=True),
            errors.swaying * np.ones((cells, 1)),
        ]
        if frame.common is not None:
            shared.append(frame.common(frame.measured) / value[:, None])
        columns = np.hstack(shared)
        root = cholesky(
            np.diag((frame.sigma.ravel() / value) ** 2) + settled + columns @ columns.T, lower=True
        )
        whitening = solve_triangular(root, np.eye(cells), lower=True)
        response = whitening @ slope
        templates = search.matched(response)
        matched = response.T @ whitening
        places, place = np.unique(search.places, axis=0, return_inverse=True)
        x, y = places.T / frame.panel.pitch_mm
        near = np.hypot(x[:, None] - x, y[:, None] - y) < NEAR_PITCHES
        scores = (templates.T @ (matched @ unloaded.T)).T
        spreads = [np.mean((first - second) ** 2) / 2 for first, second in combinations(scores, 2)]
        # robust: an outlier frame is part of many pairs
        usual = np.quantile(spreads or [1.0], 0.25, method="lower")
        loud = np.full(len(place), max(float(usual), 1.0))
        return cls(templates, matched, place, near, whitening, loud)

    def scores(self, change: Array) -> Array:
        """Return |t_kᵀ W δ|, (discs,), of a change δ of ln y, (cells,)."""
        return np.asarray(np.abs(self.templates.T @ (self.filter @ change)))

    def sizes(self, change: Array) -> Array:
        """Return the largest score of a change within NEAR_PITCHES of each disc, (discs,)."""
        largest = np.zeros(len(self.near))
        np.maximum.at(largest, self.places, self.scores(change))
        return np.asarray(np.where(self.near, largest, 0.0).max(axis=1)[self.places])

    def least(self) -> Array:
        """Return the thresholds of the scores, OUTLIER_THRESHOLD·v_k, (discs,)."""
        return np.asarray(
            OUTLIER_THRESHOLD * np.sqrt(np.maximum(self.loud, max(1.0, float(self.loud.mean()))))
        )
