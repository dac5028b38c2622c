"""Every formulation says the same: its equations hold in a solved network and give its two-point resistance."""

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array, TwoPointReadout, two_point_resistance
from lampest.panel.readouts.floating import FloatingNetwork, grounding
from lampest.solvers.ipopt import FORMULATIONS

SHAPES = [(1, 1), (1, 4), (4, 1), (2, 2), (3, 5), (5, 3), (4, 4)]


def functions(kind: str, shape: tuple[int, int]) -> casadi.Function:
    """(conductance, tie, potentials) → (balance, two-point resistance, ∂balance/∂potentials)."""
    conductance, tie = casadi.SX.sym("conductance", *shape), casadi.SX.sym("tie", sum(shape))
    network = FORMULATIONS[kind].network(TwoPointReadout(), conductance, tie, casadi.SX(1), "test_")
    slope = casadi.jacobian(network.balance, network.potentials)
    arguments = [conductance, tie, network.potentials]
    return casadi.Function("formulation", arguments, [network.balance, network.reading, slope])


def solved(shape: tuple[int, int]) -> tuple[Array, Array, FloatingNetwork]:
    """Cells, a tie at some line, and the solved network, in units in which all are of order one."""
    cells = 10 ** np.random.default_rng(7).uniform(-0.5, 0.5, shape)
    tie = grounding(two_point_resistance(cells))
    return cells, tie, FloatingNetwork.solve(1 / cells, tie)


@pytest.mark.parametrize("kind", FORMULATIONS)
@pytest.mark.parametrize("shape", SHAPES)
def test_equations_hold_in_a_solved_network_and_multipliers_balance_any_slope(
    kind: str, shape: tuple[int, int]
) -> None:
    """∂φ/∂V + λᵀ ∂balance/∂V = 0, whatever φ is."""
    (cells, tie, network), form = solved(shape), FORMULATIONS[kind]
    potentials = form.potentials(TwoPointReadout(), network)
    balance, resistance, jacobian = (np.asarray(part) for part in functions(kind, shape)(1 / cells, tie, potentials))
    assert_allclose(balance, 0, atol=1e-12)
    assert_allclose(resistance.reshape(shape), network.reading(), rtol=1e-12)
    slope = np.random.default_rng(3).normal(size=len(potentials))
    assert_allclose(form.multipliers(TwoPointReadout(), network, tie, slope) @ jacobian, -slope, atol=1e-11)


@pytest.mark.parametrize("kind", FORMULATIONS)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_equations_leave_no_freedom(kind: str, shape: tuple[int, int]) -> None:
    """As many equations as potentials, linear and regular: solved for the potentials they give R = f(r)."""
    cells, tie, _ = solved(shape)
    function = functions(kind, shape)
    count = function.size1_in(2)
    constant, _, slope = (np.asarray(part) for part in function(1 / cells, tie, np.zeros(count)))
    potentials = np.linalg.solve(slope, -constant)
    _, resistance, slope_there = function(1 / cells, tie, potentials)
    assert_allclose(np.asarray(slope_there), slope, rtol=1e-14)
    assert_allclose(np.asarray(resistance).reshape(shape), two_point_resistance(cells), rtol=1e-11)
