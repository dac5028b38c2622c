"""The convex start: cells that reproduce attainable data exactly, found without local minima.

g* = argmin ⟨R_m, g⟩ − log det C(g) over g ≥ 1/r_upper. R = ∇ log det C, so without noise f(1/g*) = R_m and g* is the
answer of plain least squares; with noise it is a good place to begin. Source: Foster's theorem and the concavity of
log det (Boyd & Vandenberghe, Convex Optimization, 2004, section 3.1.5).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lampest.panel.network import Block
from lampest.panel.panel import Array
from lampest.panel.readouts.two_point.floating import FloatingNetwork, Stencil, grounding, uniform_factor
from lampest.panel.trust_region import DENSE_CELLS, steihaug

MOST_ITERATIONS = 30  # 6 suffice from the uniform start at 10 × 10 to 32 × 32 without noise
LENGTHS = tuple(0.5**power for power in range(20))  # of a step: below, none lowers the cost in double precision
REPRODUCED = 1e-9  # relative misfit of any reading; near a solution each step doubles the digits
DECREASE = 1e-4  # Armijo's share, as in Nocedal & Wright, Numerical Optimization, 2006, section 3.1
ROUNDING = 1e-14  # what double precision leaves of a block's cost, relative
Evaluated = tuple[float, FloatingNetwork]  # the convex function and the network at some conductances


def convex_start(measured: Array, upper: Array, near: Array | None = None) -> Array:
    """Cell resistance (rows, columns) ohm from R_m (rows, columns) ohm by damped, projected Newton steps.

    Starts at `near`, an earlier frame's answer, or at R_m·MN/(M + N − 1). Stops when no reading is missed by more than
    REPRODUCED, relative, or after 30 steps; the result is a start, not an estimate, unless the readings are attainable:
    then it is what plain least squares seeks, with more digits.
    """
    tie = grounding(measured)
    first = measured / uniform_factor(*measured.shape) if near is None else near

    def at(conductance: Array) -> Evaluated:
        network = FloatingNetwork.solve(conductance, tie)
        return float(np.sum(measured * conductance) + network.log_determinant()), network

    least: Array = 1 / upper
    start: Array = 1 / _least_cost(at, measured, np.maximum(1 / first, least), least, np.ones(least.shape, dtype=bool))
    return start


def fitted_block(
    network: FloatingNetwork, block: Block, measured: Array, least: Array, chosen: NDArray[np.bool_]
) -> FloatingNetwork:
    """The network with the block's cells such that they reproduce its chosen readings, as far as bounds allow.

    The same convex function over the block alone: measured, least : (rows, columns) of the block, ohm and siemens;
    chosen : the readings that count. Of one cell it is least where 1/R_m = 1/R + δg: δg stands beside all others.
    """
    inside = network.within(block)
    if measured.size == 1:
        added = np.where(chosen, 1 / measured - 1 / inside.reading(), 0.0)
        return network.changed(block, np.maximum(inside.conductance + added, least))
    everything, rest = (slice(None), slice(None)), inside.log_determinant()

    def at(conductance: Array) -> Evaluated:
        there = inside.changed(everything, conductance)
        return float(np.sum(measured * conductance)) + there.log_determinant() - rest, there

    return network.changed(block, _least_cost(at, measured, inside.conductance, least, chosen, ROUNDING))


def _least_cost(
    at: Callable[[Array], Evaluated],
    measured: Array,
    conductance: Array,
    least: Array,
    chosen: NDArray[np.bool_],
    rounding: float = 0.0,
) -> Array:
    """Conductances (rows, columns) that minimise the convex function over the chosen cells, from those given.

    rounding : by how much of the function's size a step may raise it.
    """
    value, network = at(conductance)
    for _ in range(MOST_ITERATIONS):
        gradient = measured - network.reading()
        free = chosen & ((conductance > least * (1 + 1e-12)) | (gradient < 0))
        if np.max(np.abs(gradient[free] / measured[free]), initial=0) < REPRODUCED:
            break
        step = _step(network, gradient, free)
        for length in LENGTHS:
            trial = np.maximum(conductance + length * step, np.maximum(least, conductance / 10))
            trial_value, trial_network = at(trial)
            expected = DECREASE * float(np.sum(gradient * (trial - conductance)))
            if trial_value <= value + expected + rounding * abs(value):
                break
        else:
            break
        conductance, value, network = trial, trial_value, trial_network
    return conductance


def _step(network: FloatingNetwork, gradient: Array, free: NDArray[np.bool_]) -> Array:
    """−(D∘D)⁻¹ ∇ on the free cells; (D∘D)·p = −(∂R/∂g)·p."""
    step = np.zeros(gradient.shape)
    if gradient.size <= DENSE_CELLS:
        chosen = np.flatnonzero(free)
        transfer = network.transfer if len(chosen) == free.size else network.transfer[np.ix_(chosen, chosen)]
        curvature = (transfer * transfer).T  # symmetric, and in LAPACK's order
        step[free] = lapack.dposv(curvature, -gradient[free], lower=1, overwrite_a=1)[1]
        return step
    stencil = Stencil.of(network.conductance, network.reading(), free)

    def over_panel(linear: Callable[[Array], Array], values: Array) -> Array:
        whole = np.zeros(gradient.shape)
        whole[free] = values
        return linear(whole)[free]

    step[free] = steihaug(
        lambda search: -over_panel(network.conductance_product, search),
        lambda residual: over_panel(stencil.solve, residual),
        gradient[free],
        0.05,
    ).step
    return step
