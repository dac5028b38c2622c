"""A field of changes of any form: cells that are quiet or changed, alike in neighbours, a Potts field."""

import numpy as np
from numpy.typing import NDArray

from lampest.loads.recognition.candidates import FIELD
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.observation import SUSPICIOUS, MostProbable, Observation, Whitening, outliers
from lampest.panel.panel import Array, Panel

SD = np.array([0.005, 0.08, 0.4, 1.6])  # of ln r/r0 where nothing is, at half a kPa, a few kPa, tens; assumptions


def field_fit(frame: Observation) -> tuple[Fit, Observation]:
    """Return (the most probable field with its evidence, the frame without the outliers that it shows).

    x = ln r/r0 is Gaussian, each cell's σ that of one of four states, neighbours alike. Cells are marginalised about
    the most probable x; the states are those of a map of the cells or of the field itself, and paid for as a Potts
    field pays.
    """
    fit, most_probable = _of_two_maps(frame)
    if fit.chi2 < SUSPICIOUS * frame.measured.size:
        return fit, frame
    calm = frame.without(outliers(Whitening(most_probable.root), most_probable.apart))
    return max((fit, frame), (_of_two_maps(calm)[0], calm), key=lambda pair: pair[0].evidence)


def _of_two_maps(frame: Observation) -> tuple[Fit, MostProbable]:
    first = _with_states(frame, frame.map)
    return max(first, _with_states(frame, first[0].change), key=lambda pair: pair[0].evidence)


def _with_states(frame: Observation, start: Array) -> tuple[Fit, MostProbable]:
    """Return the most probable field with the states that ln r/r0 (rows, columns) shows, from there."""
    panel, none = frame.baseline.scene.panel, np.zeros(0)
    of_cells = states(panel, start)
    most_probable = frame.cells(start, prior(frame, SD[of_cells].ravel()))
    change, whitening = most_probable.state.reshape(start.shape), Whitening(most_probable.root)
    errors, left = whitening @ most_probable.apart, frame.residual(change)
    misfit = Whitening(np.linalg.cholesky(frame.covariance(frame.slope(change)))) @ left
    cost = float(errors @ errors) / 2
    likely = float(misfit @ misfit), cost, whitening.volume, -cost - whitening.volume - paid(panel, of_cells)
    return Fit(FIELD, none, none.reshape(0, 0), change, none.reshape(0, change.size), left, *likely), most_probable


def prior(frame: Observation, sd: Array) -> Array:
    """Return the covariance of ln r/r0 of cells with these standard deviations, (cells, cells).

    Neighbours are partly alike.
    """
    shared = frame.baseline.model_errors.common + frame.baseline.model_errors.near
    return np.asarray(np.outer(sd, sd) * ((1 - shared) * np.eye(sd.size) + shared * frame.baseline.near))


def states(panel: Panel, change: Array) -> NDArray[np.intp]:
    """0 to 3 for quiet to strongly changed cells: by their own change and that of their neighbours."""
    square, (first, second, _) = change.ravel() ** 2, panel.neighbours
    cell, neighbour = np.concatenate([first, second]), np.concatenate([second, first])
    beside = np.bincount(cell, square[neighbour], square.size).astype(float)
    sides = np.bincount(cell, minlength=square.size)
    beside += np.maximum(4 - sides, 0) * square  # a cell at the border stands for its missing neighbours
    limits = np.sqrt(SD[1:] * SD[:-1])
    return np.asarray(np.digitize(np.sqrt(0.6 * square + 0.1 * beside), limits)).reshape(change.shape)


def paid(panel: Panel, of_cells: NDArray[np.intp]) -> float:
    """−ln P of the states: 1 for a pair of unlike neighbours, an assumption, and the normalising constant."""
    first, second, _ = panel.neighbours
    unlike = np.count_nonzero(of_cells.flat[first] != of_cells.flat[second])
    return float(unlike + np.log1p(3 * np.exp(-4)) * panel.present.sum())
