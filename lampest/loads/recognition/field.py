"""What no shape explains: a field of changes of any form, whose evidence competes with that of shapes.

x = ln r/r0 is Gaussian, each cell's σ that of one of four states, neighbours alike. Cells are marginalised about the
most probable x; the states are chosen from x and paid for as a Potts field pays (docs/theory/recognition.md).
"""

import numpy as np
from numpy.typing import NDArray

from lampest.loads.recognition.candidates import FIELD
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.observation import (
    SUSPICIOUS,
    Explained,
    MostProbable,
    Observation,
    Whitening,
    outliers,
)
from lampest.loads.recognition.search import cell_map
from lampest.panel.panel import Array

SD = np.array([0.005, 0.08, 0.4, 1.6])  # of ln r/r0 where nothing is, at half a kPa, a few kPa, tens; assumptions


def field_fit(frame: Observation) -> tuple[Fit, Observation]:
    """(the most probable field with its evidence, the frame without the outliers that it shows)."""
    fit, found = _of_two_maps(frame)
    if fit.chi2 < SUSPICIOUS * frame.measured.size:
        return fit, frame
    calm = frame.without(outliers(Whitening(found.root), found.apart))
    return max((fit, frame), (_of_two_maps(calm)[0], calm), key=lambda pair: pair[0].evidence)


def _of_two_maps(frame: Observation) -> tuple[Fit, MostProbable]:
    """The field with the states that a map of the cells shows, or with those that the field itself shows."""
    one = _with_states(frame, cell_map(frame))
    return max(one, _with_states(frame, one[0].change), key=lambda pair: pair[0].evidence)


def prior(frame: Observation, sd: Array) -> Array:
    """The covariance of ln r/r0 of cells with these standard deviations, partly alike in neighbours, (cells, cells)."""
    errors = frame.baseline.model_errors
    shared = errors.common + errors.near
    return np.asarray(np.outer(sd, sd) * ((1 - shared) * np.eye(sd.size) + shared * frame.baseline.near))


def _with_states(frame: Observation, start: Array) -> tuple[Fit, MostProbable]:
    """The most probable field with the states that ln r/r0 (rows, columns) shows, from there."""
    of_cells = states(start)
    found = frame.cells(start, prior(frame, SD[of_cells].ravel()))
    change, whitening = found.state.reshape(start.shape), Whitening(found.root)
    edges = np.hypot(*np.gradient(change, frame.baseline.scene.panel.pitch_mm))
    errors, left = whitening @ found.apart, frame.residual(change)
    cost = float(errors @ errors) / 2
    misfit = Whitening(np.linalg.cholesky(frame.covariance(change))) @ left
    fit = Fit(
        candidate=FIELD,
        parameters=np.zeros(0),
        covariance=np.zeros((0, 0)),
        explained=Explained(change, edges, np.zeros_like(change)),
        residual=left,
        slopes=np.zeros((change.size, 0)),
        chi2=float(misfit @ misfit),
        cost=cost,
        volume=whitening.volume,
        evidence=-cost - whitening.volume - paid(of_cells),
        scatter=0.0,
        steps=0,
    )
    return fit, found


def states(change: Array) -> NDArray[np.intp]:
    """0 to 3 for quiet to strongly changed cells: by their own change and that of their neighbours."""
    square = np.pad(change**2, 1, mode="edge")
    beside = square[:-2, 1:-1] + square[2:, 1:-1] + square[1:-1, :-2] + square[1:-1, 2:]
    limits = np.sqrt(SD[1:] * SD[:-1])
    return np.asarray(np.digitize(np.sqrt(0.6 * square[1:-1, 1:-1] + 0.1 * beside), limits))


def paid(of_cells: NDArray[np.intp]) -> float:
    """−ln P of the states: 1 for a pair of unlike neighbours, an assumption, and what makes the sum of all P one."""
    unlike = np.count_nonzero(np.diff(of_cells, axis=0)) + np.count_nonzero(np.diff(of_cells, axis=1))
    return float(unlike + np.log1p(3 * np.exp(-4)) * of_cells.size)
