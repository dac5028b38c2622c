"""What no shape explains: a field of changes of any form, with an evidence of its own to compete with shapes.

x = ln r/r0 is Gaussian with mean zero. Every cell is quiet, changed faintly, changed or strongly changed; neighbours
tend to be alike. Cells are marginalised analytically about the most probable x. The map of the four is chosen from x,
twice, and paid for: ln P(map) = −PAIR · (unlike neighbours) − EACH · cells, the prior of a four-state Potts field.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from lampest.loads.recognition.candidates import UNKNOWN, Uniform
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.frame import Explained, Observation, Whitening
from lampest.panel.panel import Array

FIELD = Uniform(label=UNKNOWN, numbers={})
# Of ln r/r0 where nothing is, at half a kPa, at a few kPa, at tens of kPa or strong suction.
SD = np.array([0.005, 0.08, 0.4, 1.6])
LIMITS = np.array([0.03, 0.18, 0.8])  # between them: geometric means, a little above
PAIR, EACH = 1.0, 0.055  # alone among alike neighbours three states cost 4 · PAIR each: ln(1 + 3e⁻⁴) a cell in all
OWN = 0.6  # part of a cell's variance that it does not share with its neighbours
STEPS, STEP = 10, 1.5


def field_fit(frame: Observation, start: Array) -> Fit:
    """The most probable field from ln r/r0 = `start` (rows, columns), and its evidence."""
    states = _states(start)
    fit = _with_map(frame, start, states)
    again = _states(fit.change)
    other = fit if np.array_equal(states, again) else _with_map(frame, fit.change, again)
    return max(fit, other, key=lambda one: one.evidence)


def _with_map(frame: Observation, start: Array, states: NDArray[np.intp]) -> Fit:
    """The most probable field of which every cell's state is given."""
    change = start
    sd = SD[states].ravel()
    alike = frame.baseline.near
    prior = np.outer(sd, sd) * (OWN * np.eye(sd.size) + (1 - OWN) * alike)
    every = np.arange(sd.size)
    for _ in range(STEPS):
        residual, slope = frame.missed(change, every)
        covariance = frame.covariance(change)
        across = prior @ slope.T
        total = covariance + slope @ across
        factor = cho_factor(total, lower=True)
        innovation = residual + slope @ change.ravel()
        move = (across @ cho_solve(factor, innovation)).reshape(change.shape) - change
        change = change + np.clip(move, -STEP, STEP)
        if np.abs(move).max() < STEP / 10:
            break
    whitening = Whitening(np.tril(factor[0]))
    errors = whitening @ innovation
    cost = float(errors @ errors) / 2
    left = frame.missed(change, every)[0]
    misfit = Whitening(np.linalg.cholesky(covariance)) @ left
    return Fit(
        FIELD,
        np.zeros(0),
        np.zeros((0, 0)),
        Explained(change, np.zeros_like(change), np.zeros_like(change)),
        left,
        np.zeros((sd.size, 0)),
        float(misfit @ misfit),
        cost,
        whitening.volume,
        -cost - whitening.volume - _paid(states),
        0.0,
        STEPS,
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
