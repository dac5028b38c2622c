"""What no shape explains: a field of changes of any form, with an evidence of its own to compete with shapes.

x = ln r/r0 is Gaussian with mean zero. Every cell is quiet, changed faintly, changed or strongly changed; neighbours
tend to be alike. Cells are marginalised analytically about the most probable x. The map of the four is chosen from x,
twice, and paid for: ln P(map) = −PAIR · (unlike neighbours) − EACH · cells, the prior of a four-state Potts field.
"""

import numpy as np
from numpy.typing import NDArray

from lampest.loads.recognition.candidates import UNKNOWN, Uniform
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.frame import NONE, SUSPICIOUS, Explained, Observation, Whitening, outliers, without
from lampest.loads.recognition.search import cell_map, gaussian_cells
from lampest.panel.panel import Array

FIELD = Uniform(label=UNKNOWN, numbers={})
# Of ln r/r0 where nothing is, at half a kPa, at a few kPa, at tens of kPa or strong suction.
SD = np.array([0.005, 0.08, 0.4, 1.6])
LIMITS = np.array([0.03, 0.18, 0.8])  # between them: geometric means, a little above
PAIR, EACH = 1.0, 0.055  # alone among alike neighbours three states cost 4 · PAIR each: ln(1 + 3e⁻⁴) a cell in all
OWN = 0.6  # part of a cell's variance that it does not share with its neighbours
STEPS = 10  # of Gauss and Newton


def field_fit(frame: Observation, *starts: Array) -> Fit:
    """The most probable field from some ln r/r0 (rows, columns), without outliers, and its evidence."""
    best = max((_of_two_maps(frame, start) for start in starts), key=lambda fit: fit.evidence)
    if best.chi2 < SUSPICIOUS * frame.measured.size:
        return best
    _, root, apart = gaussian_cells(frame, best.change, _prior(frame, _states(best.change)), 1)
    far = outliers(Whitening(root), apart)
    if not len(far):
        return best
    calm = without(frame, far)
    return max(best, _of_two_maps(calm, cell_map(calm)), key=lambda fit: fit.evidence)


def _of_two_maps(frame: Observation, start: Array) -> Fit:
    """The field with the map that a start shows, or with that which the field itself shows."""
    states = _states(start)
    fit = _with_map(frame, start, states)
    again = _states(fit.change)
    other = fit if np.array_equal(states, again) else _with_map(frame, fit.change, again)
    return max(fit, other, key=lambda one: one.evidence)


def _prior(frame: Observation, states: NDArray[np.intp]) -> Array:
    """The covariance of ln r/r0 where every cell's state is given, (cells, cells)."""
    sd = SD[states].ravel()
    return np.asarray(np.outer(sd, sd) * (OWN * np.eye(sd.size) + (1 - OWN) * frame.baseline.near))


def _with_map(frame: Observation, start: Array, states: NDArray[np.intp]) -> Fit:
    """The most probable field of which every cell's state is given."""
    change, root, apart = gaussian_cells(frame, start, _prior(frame, states), STEPS)
    whitening, nothing = Whitening(root), np.zeros_like(change)
    errors = whitening @ apart
    cost = float(errors @ errors) / 2
    left = frame.missed(change, NONE)[0]
    misfit = Whitening(np.linalg.cholesky(frame.covariance(change))) @ left
    return Fit(
        candidate=FIELD,
        parameters=np.zeros(0),
        covariance=np.zeros((0, 0)),
        explained=Explained(change, nothing, nothing),
        residual=left,
        slopes=np.zeros((change.size, 0)),
        chi2=float(misfit @ misfit),
        cost=cost,
        volume=whitening.volume,
        evidence=-cost - whitening.volume - _paid(states),
        scatter=0.0,
        steps=STEPS,
    )


def _states(change: Array) -> NDArray[np.intp]:
    """0 to 3 for quiet to strongly changed cells: by their own change and that of their neighbours."""
    square = np.pad(change**2, 1, mode="edge")
    beside = square[:-2, 1:-1] + square[2:, 1:-1] + square[1:-1, :-2] + square[1:-1, 2:]
    return np.asarray(np.digitize(np.sqrt(0.6 * square[1:-1, 1:-1] + 0.1 * beside), LIMITS))


def _paid(states: NDArray[np.intp]) -> float:
    """−ln P of the map."""
    unlike = np.count_nonzero(np.diff(states, axis=0)) + np.count_nonzero(np.diff(states, axis=1))
    return PAIR * unlike + EACH * states.size
