"""The convex start: cells that reproduce attainable data exactly, found without local minima.

g* = argmin ⟨R_m, g⟩ − log det C(g) over g ≥ 1/r_upper. R = ∇ log det C, so without noise f(1/g*) = R_m and g* is the
answer of plain least squares; with noise it is a good place to begin. Source: Foster's theorem and the concavity of
log det (Boyd & Vandenberghe, Convex Optimization, 2004, section 3.1.5).
"""

import numpy as np

from lampest.kirchhoff import Network, grounding, uniform_factor
from lampest.panel import Array

DENSE_CELLS = 1100
MOST_ITERATIONS = 30


def convex_start(measured: Array, upper: Array, tolerance: float = 1e-6) -> Array:
    """Cell resistance (rows, columns) ohm from R_m (rows, columns) ohm by damped, projected Newton steps.

    Stops when no reading is missed by more than the tolerance, relative, or after 30 steps; the result is a start, not
    an estimate. On panels of more than 1100 cells it is the uniform start R_m·MN/(M + N − 1).
    """
    tie = grounding(measured)
    least = 1 / upper
    conductance: Array = np.maximum(uniform_factor(*measured.shape) / measured, least)
    if measured.size > DENSE_CELLS:
        return 1 / conductance
    value, network = _value(measured, conductance, tie)
    for _ in range(MOST_ITERATIONS):
        gradient = measured - network.two_point_resistance()
        free = ((conductance > least * (1 + 1e-12)) | (gradient < 0)).ravel()
        if np.max(np.abs(gradient.ravel()[free] / measured.ravel()[free]), initial=0) < tolerance:
            break
        curvature = network.transfer()[np.ix_(free, free)] ** 2
        step = np.zeros(measured.size)
        step[free] = -np.linalg.solve(curvature, gradient.ravel()[free])
        length = 1.0
        while length > 1e-6:
            trial = np.maximum(conductance + length * step.reshape(measured.shape), np.maximum(least, conductance / 10))
            trial_value, trial_network = _value(measured, trial, tie)
            if trial_value <= value + 1e-4 * float(np.sum(gradient * (trial - conductance))):
                break
            length /= 2
        else:
            break
        conductance, value, network = trial, trial_value, trial_network
    return 1 / conductance


def _value(measured: Array, conductance: Array, tie: Array) -> tuple[float, Network]:
    network = Network.solve(conductance, tie)
    _, log_determinant = np.linalg.slogdet(network.impedance)
    return float(np.sum(measured * conductance) + log_determinant), network
