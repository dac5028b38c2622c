"""What no shape explains: a field of changes of any form, with an evidence of its own to compete with shapes.

x = ln r/r0 is Gaussian with mean zero. Every cell is quiet, changed or strongly changed; neighbours tend to be alike.
Cells are marginalised analytically about the most probable x. The map of the three is chosen from x and paid for:
ln P(map) = −PAIR · (unlike neighbours) − EACH · cells, the prior of a three-state Potts field.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from lampest.loads.recognition.candidates import UNKNOWN, Uniform
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.frame import Explained, Observation, Whitening
from lampest.panel.panel import Array

FIELD = Uniform(label=UNKNOWN, numbers={})
SD = np.array([0.005, 0.4, 1.6])  # of ln r/r0 where nothing is, at a few kPa, at tens of kPa or strong suction
LIMITS = np.array([0.1, 0.8])  # between them: geometric means, a little above
PAIR, EACH = 1.0, 0.04  # alone among alike neighbours two states cost 4 · PAIR each: ln(1 + 2e⁻⁴) a cell in all
OWN = 0.6  # part of a cell's variance that it does not share with its neighbours
STEPS, STEP = 4, 1.5


def field_fit(frame: Observation, start: Array) -> Fit:
    """The most probable field from ln r/r0 = `start` (rows, columns), and its evidence."""
    change, states = start, _states(start)
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


def _states(change: Array) -> Array:
    """0, 1, 2 for quiet, changed and strongly changed cells: by their own change and that of their neighbours."""
    square = np.pad(change**2, 1, mode="edge")
    beside = square[:-2, 1:-1] + square[2:, 1:-1] + square[1:-1, :-2] + square[1:-1, 2:]
    return np.asarray(np.digitize(np.sqrt(0.6 * square[1:-1, 1:-1] + 0.1 * beside), LIMITS))


def _paid(states: Array) -> float:
    """−ln P of the map."""
    unlike = np.count_nonzero(np.diff(states, axis=0)) + np.count_nonzero(np.diff(states, axis=1))
    return PAIR * unlike + EACH * states.size
