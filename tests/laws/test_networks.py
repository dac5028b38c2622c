"""Bounds and symmetries of the readings of any panel."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import (
    Array,
    DrivenReadout,
    GroundedReadout,
    LoadedColumnsReadout,
    TwoPointReadout,
    VirtualGroundReadout,
    two_point_resistance,
)
from lampest.panel.difference_network import wire_responses
from lampest.panel.equation import equation_of
from lampest.panel.joined_network import JoinedNetwork
from lampest.panel.network import Network, SolvedNetwork
from lampest.panel.panel import EachModule, Modules
from lampest.panel.readouts.floating import grounding
from lampest.panel.readouts.ladder import Ladder
from lampest.panel.readouts.two_point import ModulesReadout
from lampest.panel.readouts.wiring import Lines, Wiring

SHAPES = ((1, 1), (1, 7), (4, 3), (5, 6), (9, 2))
every_shape = pytest.mark.parametrize("shape", SHAPES)
# Relative; rounding of float64, 2e-16, grows with the contrast of the cells, here three decades.
ROUNDING = 1e-10
READOUTS = {
    "two-point": TwoPointReadout(),
    "loaded": LoadedColumnsReadout(drive_ohm=90.0, load_ohm=3e3),
    "pulled down": LoadedColumnsReadout(polarity="down", drive_ohm=90.0),
    "one sensed": GroundedReadout(sense="one", drive_ohm=50.0, sense_ohm=40.0),
    "grounded": GroundedReadout(sense_ohm=40.0),
    "amplifiers": VirtualGroundReadout(drive_ohm=30.0, sense_ohm=20.0),
    "held": DrivenReadout(idle_ohm=0.0, idle_load_ohm=0.0, drive_ohm=60.0, load_ohm=3e3),
    "idle resistors": DrivenReadout(idle_ohm=3e3, idle_load_ohm=2e3, drive_ohm=60.0),
}
every_readout = pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)


def random_cells(shape: tuple[int, int], seed: int = 0) -> Array:
    """Cells in ohm, log-uniform over three decades around 3 kilohm."""
    rng = np.random.default_rng([seed, *shape])
    return np.asarray(3000 * 10 ** rng.uniform(-1.5, 1.5, shape))


def readings_of(readout: Any, cells: Array) -> Array:
    return np.asarray(readout.network(cells, readout.ties(cells), None).reading())


@every_shape
def test_resistances_between_lines_are_a_metric(shape: tuple[int, int]) -> None:
    """R_jk ≤ r_jk, and R_jk ≤ R_jq + R_pq + R_pk (Klein & Randić, J. Math. Chem. 12, 1993)."""
    cells = random_cells(shape)
    resistance = two_point_resistance(cells)
    of_rows = np.min(resistance[:, None, :] + resistance[None, :, :], axis=2)
    of_paths = np.min(of_rows[:, :, None] + resistance[None, :, :], axis=1)
    assert np.all(resistance <= (1 + ROUNDING) * np.minimum(of_paths, cells))


@every_shape
def test_resistances_over_cells_sum_to_the_number_of_lines_less_one(
    shape: tuple[int, int],
) -> None:
    """Foster's theorem, Σ R/r = lines − 1."""
    cells = random_cells(shape)
    shares = two_point_resistance(cells) / cells
    assert np.sum(shares) == pytest.approx(sum(shape) - 1, rel=ROUNDING)


@every_shape
def test_the_response_of_a_reading_to_another_cell_is_reciprocal(shape: tuple[int, int]) -> None:
    """∂R_m/∂ln r_n = D_mn²/r_n with symmetric transfer resistances D, and Σ_n ∂R_m/∂ln r_n = R_m.

    The sum is Euler's theorem for a function of degree one (Rayleigh's monotonicity: no summand is
    negative).
    """
    cells = random_cells(shape)
    network = SolvedNetwork.floating(1 / cells, grounding(two_point_resistance(cells)))
    sensitivity = network.sensitivity()
    squares = sensitivity * cells.ravel()
    assert_allclose(squares, squares.T, rtol=ROUNDING, atol=ROUNDING * np.max(squares))
    assert_allclose(np.sum(sensitivity, axis=1), network.reading().ravel(), rtol=ROUNDING)
    assert np.all(sensitivity >= 0)


@every_shape
@every_readout
def test_readings_do_not_depend_on_the_order_of_lines(readout: Any, shape: tuple[int, int]) -> None:
    cells = random_cells(shape)
    rng = np.random.default_rng(1)
    order = np.ix_(rng.permutation(shape[0]), rng.permutation(shape[1]))
    assert_allclose(
        readings_of(readout, cells[order]), readings_of(readout, cells)[order], rtol=ROUNDING
    )


@every_shape
@every_readout
def test_rows_and_columns_are_exchangeable(readout: Any, shape: tuple[int, int]) -> None:
    exchanged = (
        replace(readout, driven="columns" if readout.driven == "rows" else "rows")
        if hasattr(readout, "driven")
        else readout
    )
    cells = random_cells(shape)
    assert_allclose(readings_of(exchanged, cells.T).T, readings_of(readout, cells), rtol=ROUNDING)


@every_shape
@every_readout
def test_readings_move_one_way_with_every_cell(readout: Any, shape: tuple[int, int]) -> None:
    cells = random_cells(shape)
    own = readout.network(cells, readout.ties(cells), None).own_response()
    assert np.all(own != 0) and len(np.unique(np.sign(own))) == 1


def test_shorts_keep_their_digits_where_lines_are_held() -> None:
    """J·p equals the sum over cells of D_ac D_bc g_c p_c, which takes differences first."""
    readout = DrivenReadout(drive_ohm=50.0, idle_ohm=0.0, load_ohm=1e3)
    cells = 3000 * np.exp(0.5 * np.random.default_rng(3).standard_normal((5, 6)))
    cells[1, 2] = 0.01
    cells[3, 4] = 0.01
    step = np.random.default_rng(4).standard_normal(cells.shape)
    network = readout.network(cells, readout.ties(cells))
    assert isinstance(network, SolvedNetwork)
    differences = network.potential_differences
    summed = (differences * (step / cells).ravel()) @ differences.T
    expected = network.read_change(network.entries(summed))
    largest = np.abs(expected).max()
    assert_allclose(network.forward(step), expected, rtol=0, atol=1e-14 * largest)


@pytest.mark.parametrize("modules", [(1, 1), (2, 1), (1, 3)])
def test_an_image_of_modules_has_the_readings_of_each(modules: tuple[int, int]) -> None:
    layout = Modules(*modules, EachModule(3, 4))
    readout = ModulesReadout(layout=layout)
    cells = 3000 * np.exp(np.random.default_rng(5).standard_normal(layout.shape))
    step, weights = np.random.default_rng(6).standard_normal((2, *layout.shape))
    single = TwoPointReadout()
    networks = [single.network(part, single.ties(part)) for part in layout.split(cells)]

    def image(of_module: Callable[[int], Any]) -> Any:
        return layout.joined(np.stack([of_module(number) for number in range(layout.count)]))

    def all_of(network: Network) -> list[Any]:
        second = network.second_order(weights)
        products = second.products(step)
        wire = np.moveaxis(wire_responses(network, Lines()), 0, -1)
        dense = network.sensitivity() @ step.ravel(), second.matrix() @ step.ravel()
        return [network.reading(), network.adjoint(weights), *products, *dense, wire]

    together = all_of(readout.network(cells, readout.ties(cells)))
    one_by_one = all_of(JoinedNetwork.of(cells, networks, layout))
    for first, second in zip(together, one_by_one, strict=True):
        assert_allclose(first, second, rtol=ROUNDING, atol=ROUNDING * np.abs(second).max())
    assert_allclose(together[0], image(lambda number: networks[number].reading()), rtol=ROUNDING)
    moved = image(lambda number: networks[number].forward(layout.split(step)[number]))
    assert_allclose(together[2], moved, rtol=ROUNDING, atol=ROUNDING * np.abs(moved).max())


@pytest.mark.parametrize(
    "ends",
    [{}, {"load_volt": 1.2, "idle_load_ohm": 4e3, "idle_load_volt": 0.3}],
    ids=["loads", "potentials"],
)
@pytest.mark.parametrize(
    "groups",
    [
        {"driven_groups": ((1, None, 0, 2), (None, 3, 4), (None, 5, None, 6))},
        {"groups": ((0, None, 2), (3, 1))},
        {"driven_groups": ((0, 1, 2, 3), (4, 5, 6)), "groups": ((0, 1), (None, 2, 3))},
    ],
    ids=["driven", "sensed", "both"],
)
def test_addresses_of_multiplexers_are_one_network(ends: Any, groups: Any) -> None:
    readout = DrivenReadout(
        **{"drive_ohm": 95.0, "load_ohm": 1e4, "idle_load_ohm": np.inf, **ends, **groups}
    )
    cells = random_cells((7, 4))
    step, weights = np.random.default_rng(7).standard_normal((2, *cells.shape))
    ties = readout.ties(cells)
    equation = equation_of(readout, *cells.shape)
    excited = equation.excitations(ties)
    alone = [
        SolvedNetwork.tied(cells, tie, readout, None if excited is None else excited[number])
        for number, tie in enumerate(ties)
    ]
    leak = np.zeros((11, 1))
    leak[:2, 0] = 1.0, -1.0

    def all_of(network: Network) -> list[Any]:
        second = network.second_order(weights)
        leaking = network.leaking(leak, 1e-4)
        return [
            network.reading(),
            network.adjoint(weights),
            network.own_response(),
            network.sensitivity(),
            second.adjoint(),
            *second.products(step),
            second.matrix(),
            leaking.forward(step),
        ]

    network = readout.network(cells, ties)
    assert isinstance(network, JoinedNetwork)
    assert len(network.parts) == 1
    one_by_one = JoinedNetwork.of(cells, alone, equation.read_at > 0)
    for first, second in zip(all_of(network), all_of(one_by_one), strict=True):
        assert_allclose(first, second, rtol=0, atol=1e-13 * np.abs(second).max())


def test_addresses_share_the_factor_of_their_wire(monkeypatch: pytest.MonkeyPatch) -> None:
    readout = GroundedReadout(groups=((0, 1), (2, None)))
    cells = random_cells((4, 3))
    ties = readout.ties(cells)
    assert len(ties) > 1
    factored = []
    factor = Ladder.of
    monkeypatch.setattr(Ladder, "of", lambda *given: factored.append(0) or factor(*given))
    assert isinstance(readout.network(cells, ties, Wiring(Lines(1.0, 2.0))), JoinedNetwork)
    assert len(factored) == 1
