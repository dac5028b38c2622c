"""The convex start: cells that reproduce attainable data exactly, found without local minima.

g* = argmin ⟨R_m, g⟩ − log det C(g) over g ≥ 1/r_upper. R = ∇ log det C, so without noise f(1/g*) = R_m and g* is the
answer of plain least squares; with noise it is a good place to begin. Source: Foster's theorem and the concavity of
log det (Boyd & Vandenberghe, Convex Optimization, 2004, section 3.1.5).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lampest.panel.conjugate import DENSE_UNKNOWNS, conjugate_gradients
from lampest.panel.network import Block
from lampest.panel.panel import Array
from lampest.panel.readouts.two_point.floating import FloatingNetwork, grounding, uniform_factor
from lampest.panel.readouts.two_point.stencil import Stencil

MOST_ITERATIONS = 30  # 6 suffice from the uniform start at 10 × 10 to 32 × 32 without noise
LEAST_LENGTH = 1e-6  # of a step: below, no length lowers the cost in double precision
REPRODUCED = 1e-9  # relative misfit of any reading; near a solution each step doubles the digits
DECREASE = 1e-4  # Armijo's share, as in Nocedal & Wright, Numerical Optimization, 2006, section 3.1
FITTED, ROUNDING = 1e-9, 1e-14  # relative misfit of a block's readings, and what double precision leaves of the cost
LENGTHS = tuple(0.5**power for power in range(20))  # down to LEAST_LENGTH


def convex_start(measured: Array, upper: Array, near: Array | None = None) -> Array:
    """Cell resistance (rows, columns) ohm from R_m (rows, columns) ohm by damped, projected Newton steps.

    Starts at `near`, an earlier frame's answer, or at R_m·MN/(M + N − 1). Stops when no reading is missed by more than
    REPRODUCED, relative, or after 30 steps; the result is a start, not an estimate, unless the readings are attainable:
    then it is what plain least squares seeks, with more digits.
    """
    tie = grounding(measured)
    least: Array = 1 / upper
    first = measured / uniform_factor(*measured.shape) if near is None else near
    conductance: Array = np.maximum(1 / first, least)
    value, network = _value(measured, conductance, tie)
    for _ in range(MOST_ITERATIONS):
        gradient = measured - network.reading()
        free = (conductance > least * (1 + 1e-12)) | (gradient < 0)
        if np.max(np.abs(gradient[free] / measured[free]), initial=0) < REPRODUCED:
            break
        step = _step(network, measured, gradient, free)
        length = 1.0
        while length > LEAST_LENGTH:
            trial = np.maximum(conductance + length * step, np.maximum(least, conductance / 10))
            trial_value, trial_network = _value(measured, trial, tie)
            if trial_value <= value + DECREASE * float(np.sum(gradient * (trial - conductance))):
                break
            length /= 2
        else:
            break
        conductance, value, network = trial, trial_value, trial_network
    start: Array = 1 / conductance
    return start


def _step(network: FloatingNetwork, measured: Array, gradient: Array, free: NDArray[np.bool_]) -> Array:
    """−(D∘D)⁻¹ ∇ on the free cells; (D∘D)·p = −(∂R/∂g)·p."""
    step = np.zeros(measured.shape)
    if measured.size <= DENSE_UNKNOWNS:
        chosen = np.flatnonzero(free)
        curvature = network.transfer[np.ix_(chosen, chosen)] ** 2
        step[free] = lapack.dposv(curvature, -gradient[free], lower=1)[1]
        return step

    def product(search: Array) -> Array:
        whole = np.zeros(measured.shape)
        whole[free] = search
        return -network.conductance_product(whole)[free]

    stencil = Stencil.of(network.conductance, network.reading(), free)

    def precondition(residual: Array) -> Array:
        whole = np.zeros(measured.shape)
        whole[free] = residual
        return stencil.solve(whole)[free]

    step[free], _ = conjugate_gradients(product, precondition, -gradient[free], 0.05)
    return step


def _value(measured: Array, conductance: Array, tie: Array) -> tuple[float, FloatingNetwork]:
    network = FloatingNetwork.solve(conductance, tie)
    return float(np.sum(measured * conductance) + network.log_determinant()), network


def fitted_block(
    network: FloatingNetwork, block: Block, measured: Array, least: Array, chosen: NDArray[np.bool_]
) -> FloatingNetwork:
    """The network with the block's cells such that they reproduce its chosen readings, as far as bounds allow.

    The same convex function over the block alone: measured, least : (rows, columns) of the block, ohm and siemens;
    chosen : the readings that count. Of one cell it is least where 1/R_m = 1/R + δg: δg stands beside all others.
    """

    def at(conductance: Array) -> tuple[float, FloatingNetwork]:
        there = inside.changed(everything, conductance)
        return float(np.sum(measured * conductance)) + there.log_determinant() - rest, there

    inside = network.within(block)
    if measured.size == 1:
        added = np.where(chosen, 1 / measured - 1 / inside.reading(), 0.0)
        return network.changed(block, np.maximum(inside.conductance + added, least))
    everything = (slice(None), slice(None))
    rest = inside.log_determinant()
    conductance = inside.conductance
    value, here = at(conductance)
    for _ in range(MOST_ITERATIONS):
        gradient = measured - here.reading()
        free = chosen & ((conductance > least * (1 + 1e-12)) | (gradient < 0))
        if np.max(np.abs(gradient[free] / measured[free]), initial=0) < FITTED:
            break
        numbers, step = np.flatnonzero(free), np.zeros(measured.shape)
        step[free] = np.linalg.solve(here.transfer[np.ix_(numbers, numbers)] ** 2, -gradient[free])
        for length in LENGTHS:
            trial = np.maximum(conductance + length * step, np.maximum(least, conductance / 10))
            trial_value, there = at(trial)
            promised = DECREASE * float(np.sum(gradient * (trial - conductance)))
            if trial_value <= value + promised + ROUNDING * abs(value):
                break
        else:
            break
        conductance, value, here = trial, trial_value, there
    return network.changed(block, conductance)
