"""The exact forward map against 50 digits of mpmath, and the fast one's word that it is safe."""

import time
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from lampest.panel.network import SolvedNetwork
from lampest.panel.panel import Array
from lampest.panel.readouts.floating import (
    SAFE_CONDITION,
    condition,
    exact_two_point_resistance,
    grounding,
    two_point_resistance,
)
from tests.netlist import in_digits

TEN_DIGITS = 1e-10
FOURTEEN_DIGITS = 1e-14
ROUNDING = 1e-13  # relative, of sums of positive numbers alone
# Of a thousand panels. Inverses that lose digits occur, and the condition finds them without
# sending most panels to the elimination; measured 65 wrong, 82 unsafe.
MIN_WRONG = 50
MAX_UNSAFE = 500
MAX_SECONDS = 2  # an elimination for every pair would take minutes
SHAPES = [(1, 1), (1, 9), (9, 1), (2, 2), (2, 32), (32, 2), (16, 16), (3, 5)]


def structured(
    shape: tuple[int, int], rng: np.random.Generator, decades: float
) -> Iterator[tuple[str, Array]]:
    """Panels around 3 kilohm with two levels that lie `decades` apart, each with its name."""
    rows, columns = shape
    large = 10.0**decades
    row = rng.integers(rows)
    column = rng.integers(columns)
    diagonal = np.arange(min(shape))
    usual = 3000 * np.exp(0.3 * rng.standard_normal(shape))

    def panel(place: object, factor: float) -> Array:
        cells = usual.copy()
        cells[place] *= factor
        return cells

    yield "open cell", panel((row, column), large)
    yield "open row", panel(row, large)
    yield "open column", panel((slice(None), column), large)
    yield "shorted cell", panel((row, column), 1 / large)
    yield "shorted row", panel(row, 1 / large)
    yield "shorted column", panel((slice(None), column), 1 / large)
    apart = np.add.outer(np.arange(rows) < rows // 2, np.arange(columns) < columns // 2) == 1
    yield "two clusters", panel(apart, large)
    yield (
        "clusters of two scales",
        panel(apart, large) * np.where(np.arange(rows) < rows // 2, 1, large)[:, None],
    )
    yield "checkerboard", panel(np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 1, large)
    yield "two values at random", panel(rng.random(shape) < 0.5, large)
    yield "log-uniform", 3000 * 10 ** rng.uniform(-decades / 2, decades / 2, shape)
    chain = usual * large
    chain[diagonal, diagonal] /= large
    chain[diagonal[1:], diagonal[:-1]] /= large**0.5
    yield "chain", chain
    milliohm = np.full(shape, 1e9)
    milliohm[diagonal, diagonal] = 1e-3
    yield "1 milliohm and 1 gigaohm", milliohm


def structured_panels(count: int, max_lines: float, seed: int) -> Iterator[tuple[str, Array]]:
    """Structured panels of up to `max_lines` lines a side, 0 to 15 decades."""
    rng = np.random.default_rng(seed)
    while count > 0:
        shape = (int(max_lines ** rng.uniform()), int(max_lines ** rng.uniform()))
        for name, cells in structured(shape, rng, rng.uniform(0, 15)):
            yield f"{name} {shape}", cells
            count -= 1


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_every_structured_panel_is_exact_to_fourteen_digits(shape: tuple[int, int]) -> None:
    for name, cells in structured(shape, np.random.default_rng(1), 15):
        assert_allclose(
            exact_two_point_resistance(cells), in_digits(cells), rtol=FOURTEEN_DIGITS, err_msg=name
        )


@pytest.mark.slow
def test_an_unsafe_inverse_is_noticed() -> None:
    """Wherever fewer than ten of 50 digits of the inverse are right, its condition says so."""
    unsafe = wrong = 0
    for name, cells in structured_panels(1000, 7, 4):
        expected = in_digits(cells)
        network = SolvedNetwork.floating(1 / cells, grounding(cells))
        worst = np.max(np.abs(network.reading() / expected - 1))
        unsafe += condition(network) > SAFE_CONDITION
        wrong += worst > TEN_DIGITS
        assert worst <= TEN_DIGITS or condition(network) > SAFE_CONDITION, name
        assert_allclose(two_point_resistance(cells), expected, rtol=TEN_DIGITS, err_msg=name)
    assert MIN_WRONG < wrong < unsafe < MAX_UNSAFE


def test_open_cells_leave_the_network() -> None:
    cells = np.random.default_rng(7).uniform(1e3, 1e4, (4, 5))
    cells[1, 2] = cells[3] = np.inf
    cells[3, 4] = 500.0
    expected = in_digits(np.where(np.isinf(cells), 1e300, cells))
    for resistance in (exact_two_point_resistance(cells), two_point_resistance(cells)):
        assert_allclose(resistance, expected, rtol=ROUNDING)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_unconnected_lines_have_infinite_resistance(scale: float) -> None:
    """Within the clusters all is as in their own panel."""
    rng = np.random.default_rng(8)
    first = rng.uniform(1e3, 1e4, (3, 4))
    second = rng.uniform(1e3, 1e4, (2, 3)) * scale
    cells = np.full((6, 7), np.inf)
    cells[:3, :4] = first
    cells[3:5, 4:] = second
    expected = np.full((6, 7), np.inf)
    expected[:3, :4] = in_digits(first)
    expected[3:5, 4:] = in_digits(second)
    rows = rng.permutation(6)
    columns = rng.permutation(7)
    for forward in (exact_two_point_resistance, two_point_resistance):
        assert_allclose(forward(cells[rows][:, columns]), expected[rows][:, columns], rtol=ROUNDING)
    assert_array_equal(two_point_resistance(np.full((3, 2), np.inf)), np.full((3, 2), np.inf))
    assert_array_equal(two_point_resistance(np.full((1, 1), np.inf)), [[np.inf]])


@pytest.mark.slow
def test_shorts_join_lines() -> None:
    """A cell of no resistance is the limit of ever smaller cells."""
    rng = np.random.default_rng(9)
    for _ in range(200):
        cells = rng.uniform(1e3, 1e4, (rng.integers(1, 6), rng.integers(1, 6)))
        short = rng.random(cells.shape) < rng.choice([0.1, 0.3, 0.6])
        cells[rng.random(cells.shape) < 0.2] = np.inf
        limit = exact_two_point_resistance(np.where(short, 1e-40, cells))
        resistance = exact_two_point_resistance(np.where(short, 0, cells))
        assert_array_equal(resistance == 0, limit < 1e-30)
        assert_allclose(resistance, np.where(limit < 1e-30, 0, limit), rtol=ROUNDING)
        assert_array_equal(two_point_resistance(np.where(short, 0, cells)) == 0, limit < 1e-30)


@pytest.mark.parametrize("wrong", [-1.0, np.nan, -np.inf])
def test_impossible_cells_are_refused(wrong: float) -> None:
    cells = np.full((2, 3), 3000.0)
    cells[1, 2] = wrong
    for forward in (exact_two_point_resistance, two_point_resistance):
        with pytest.raises(ValueError, match="zero or positive"):
            forward(cells)


@pytest.mark.slow
@pytest.mark.parametrize("decades", [0, 15])
def test_a_panel_of_hundred_by_hundred_keeps_its_digits(decades: float) -> None:
    """An elimination for every pair would take minutes."""
    for name, cells in structured((100, 100), np.random.default_rng(13), decades):
        begin = time.process_time()
        resistance = exact_two_point_resistance(cells)
        assert time.process_time() - begin < MAX_SECONDS, name
        assert np.all(np.isfinite(resistance) & (resistance > 0)), name
        assert np.sum(resistance / cells) == pytest.approx(sum(cells.shape) - 1, rel=10 * ROUNDING)
