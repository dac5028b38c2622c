"""Cells whose exact readings are the measured ones, on the logarithms of both.

The Levenberg–Marquardt method minimises ½ |log(y(u)/y)|² over u = log r on panels of up to
MAX_DENSE cells. Near a fold of the readings J is nearly singular, where undamped steps lead
nowhere. On larger panels a step of Newton's method solves J·p = log(y/y(u)) by GMRES with products
of J, and is shortened until the misfit falls.
"""

from collections.abc import Callable

import numpy as np
import scipy

from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.trust_region import backtracked

MAX_DENSE = 400  # cells whose Jacobian is factored
# Where no cells give the readings, the misfit falls by ever less: below 1 % an iteration it ends.
DAMPED = LevenbergMarquardt(evaluations=100, settled=1e-12, share=0.01, damping=0.1)
MAX_ITERATIONS = 20
MAX_PRODUCTS = 30
CONVERGED = 1e-3  # change of log r
MAX_STEP = 2.0  # of log r
MAX_LENGTHS = 8  # tried lengths of a step
SOLVED = 1e-2  # relative residual of a step's linear system


def matching_cells(
    network: Callable[[Array], Network], measured: Array, first: Array, least: Array, most: Array
) -> Array:
    """Return cells between two limits that reproduce the readings as well as possible.

    Shape (rows, columns), in ohm.

    Parameters
    ----------
    network : callable
        Solved network of cells (rows, columns) ohm.
    measured : array, shape (rows, columns)
        Positive readings; on panels of up to MAX_DENSE cells NaN does not count.
    first, least, most : array, shape (rows, columns)
        Cells of the first iteration, and the limits, ohm.
    """
    lower = np.log(least)
    upper = np.log(most)
    start = np.clip(np.log(first), lower, upper)
    solve = _by_matrix if measured.size <= MAX_DENSE else _by_products
    return np.exp(solve(network, measured, start, lower, upper))


def _by_matrix(
    network: Callable[[Array], Network], measured: Array, start: Array, lower: Array, upper: Array
) -> Array:
    """Return log cells by the Levenberg–Marquardt method."""
    counted = np.isfinite(measured)

    def model(position: Array) -> SumOfSquares:
        solved = network(np.exp(position.reshape(measured.shape)))
        reading = np.maximum(solved.reading(), np.finfo(float).tiny)
        residual = np.where(counted, np.log(reading / measured), 0.0)
        weight = np.where(counted, 1 / reading, 0.0)
        return SumOfSquares(residual.ravel(), solved.sensitivity() * weight.reshape(-1, 1))

    position, _ = DAMPED.minimum(model, start.ravel(), (lower.ravel(), upper.ravel()))
    return position.reshape(measured.shape)


def _by_products(
    network: Callable[[Array], Network], measured: Array, start: Array, low: Array, high: Array
) -> Array:
    """Return log cells by Newton's method with products of J."""

    def at(position: Array) -> tuple[Array, Network, Array, Array]:
        solved = network(np.exp(position))
        reading = solved.reading()
        misfit = np.log(measured / np.maximum(reading, np.finfo(float).tiny))
        return position, solved, reading, misfit

    def lower(length: float) -> tuple[Array, Network, Array, Array] | None:
        trial = at(np.clip(current + length * step, low, high))
        return trial if np.sum(trial[-1] ** 2) < np.sum(misfit**2) else None

    current, solved, reading, misfit = at(start)
    for _ in range(MAX_ITERATIONS):
        response = scipy.sparse.linalg.LinearOperator(
            (measured.size, measured.size),
            matvec=lambda step, solved=solved, reading=reading: (
                solved.forward(step.reshape(measured.shape)) / reading
            ).ravel(),
            dtype=float,
        )
        step, _ = scipy.sparse.linalg.gmres(
            response, misfit.ravel(), rtol=SOLVED, restart=MAX_PRODUCTS, maxiter=1
        )
        step = np.clip(step.reshape(measured.shape), -MAX_STEP, MAX_STEP)
        following = backtracked(lower, MAX_LENGTHS)
        if following is None:
            break
        change = np.abs(following[0] - current).max()
        current, solved, reading, misfit = following
        if change < CONVERGED:
            break
    return current
