"""Identities that the two-point resistances of any matrix of cells obey. Tolerances are those of mild contrast."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from lampest import Array, two_point_resistance
from lampest.panel.kirchhoff import current_balance, injected, laplacian
from lampest.panel.panel import as_panels_have
from lampest.panel.readouts.floating import FloatingNetwork, grounding

QUICK = settings(derandomize=True, deadline=None, max_examples=25, database=None)
panels = st.builds(
    lambda rows, columns, seed, decades: random_panel((rows, columns), seed, decades),
    st.integers(1, 7),
    st.integers(1, 7),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.2, 1.0, 3.0]),
)


def random_panel(shape: tuple[int, int], seed: int = 0, decades: float = 1.0) -> Array:
    """Cells log-uniform around 3 kilohm."""
    return 3000 * 10 ** np.random.default_rng(seed).uniform(-decades / 2, decades / 2, shape)


def network(cells: Array) -> FloatingNetwork:
    return FloatingNetwork.solve(1 / cells, grounding(cells))


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
@QUICK
def test_a_panel_of_rank_one_has_its_closed_form(rows: int, columns: int, seed: int) -> None:
    """g = a_j·b_k: R = 1/(a_j B) + 1/(b_k A) − 1/(A B)."""
    rng = np.random.default_rng(seed)
    a, b = 10 ** rng.uniform(-1, 1, rows), 10 ** rng.uniform(-1, 1, columns)
    expected = 1 / (a[:, None] * b.sum()) + 1 / (b[None, :] * a.sum()) - 1 / (a.sum() * b.sum())
    assert_allclose(two_point_resistance(1 / np.outer(a, b)), expected, rtol=1e-11)


@given(panels)
@QUICK
def test_conductance_times_resistance_adds_up_to_lines_minus_one_as_foster_proved(cells: Array) -> None:
    """Σ g R = M + N − 1."""
    assert np.sum(two_point_resistance(cells) / cells) == pytest.approx(sum(cells.shape) - 1, rel=1e-11)


@given(panels)
@QUICK
def test_sensitivities_lie_between_zero_and_one_and_add_up_to_the_resistances(cells: Array) -> None:
    """J·1 = R of J = ∂R/∂log r, since R is homogeneous of degree one."""
    sensitivity = network(cells).sensitivity()
    assert np.min(sensitivity) >= 0 and np.max(sensitivity / cells.ravel()) <= 1 + 1e-12
    assert_allclose(sensitivity.sum(axis=1), two_point_resistance(cells).ravel(), rtol=1e-10)


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (6, 4)])
def test_the_jacobian_of_equal_cells_has_its_four_eigenvalues(shape: tuple[int, int]) -> None:
    """(M+N−1)/MN once; 1/N, M − 1 times; 1/M, N − 1 times; 2/MN, (M − 1)(N − 1) times."""
    m, n = shape
    expected = [(m + n - 1) / (m * n)] + [1 / n] * (m - 1) + [1 / m] * (n - 1) + [2 / (m * n)] * ((m - 1) * (n - 1))
    values = np.linalg.eigvalsh(network(np.full(shape, 3050.0)).sensitivity() / 3050.0)
    assert_allclose(values, np.sort(expected), rtol=1e-11)


@given(panels)
@QUICK
def test_a_resistance_lies_between_its_cell_and_its_cell_beside_the_rest(cells: Array) -> None:
    """1/(g + ab/(a + b)) ≤ R ≤ r, a and b the rest of the row's and of the column's conductance."""
    conductance, resistance = 1 / cells, two_point_resistance(cells)
    row = conductance.sum(axis=1, keepdims=True) - conductance
    column = conductance.sum(axis=0, keepdims=True) - conductance
    with np.errstate(invalid="ignore"):
        around = np.where((row > 0) & (column > 0), row * column / (row + column), 0.0)
    assert np.all(resistance <= cells * (1 + 1e-12))
    assert np.all(resistance >= (1 - 1e-12) / (conductance + around))


@given(panels, st.randoms(use_true_random=False))
@QUICK
def test_permuted_and_transposed_panels_have_permuted_and_transposed_resistances(cells: Array, random: object) -> None:
    rng = np.random.default_rng(random.randrange(2**32))
    rows, columns = (rng.permutation(size) for size in cells.shape)
    resistance = two_point_resistance(cells)
    assert_allclose(two_point_resistance(cells[rows][:, columns]), resistance[rows][:, columns], rtol=1e-11)
    assert_allclose(two_point_resistance(cells.T), resistance.T, rtol=1e-11)


def test_unconnected_line_is_an_error() -> None:
    conductance = 1 / random_panel((3, 4), 9)
    tie = grounding(1 / conductance)
    conductance[2] = 0
    tie[2] = 0
    tie[0] = 1.0
    with pytest.raises(np.linalg.LinAlgError):
        FloatingNetwork.solve(conductance, tie)


@given(panels)
@QUICK
def test_current_is_conserved_in_all_forms_of_the_law(cells: Array) -> None:
    """Equal potentials carry none."""
    conductance, (rows, columns) = 1 / cells, cells.shape
    potentials = np.random.default_rng(2).standard_normal((rows + columns, 3))
    potentials[:, 0] = 1.0
    balance = np.vstack(current_balance(conductance, potentials[:rows], potentials[rows:]))
    size = 1e-13 * conductance.sum() * np.abs(potentials).max()
    assert_allclose(balance.sum(axis=0), 0, atol=size)
    assert_allclose(balance[:, 0], 0, atol=size)
    matrix = laplacian(conductance)
    assert_array_equal(matrix, matrix.T)
    assert_allclose(injected(conductance, potentials), balance, atol=size)
    assert_allclose(matrix @ potentials, balance, atol=size)


@given(panels)
@QUICK
def test_any_line_may_be_grounded(cells: Array) -> None:
    """Paper, equation (5): potential differences do not know which line is tied to ground, nor how well."""
    resistance = two_point_resistance(cells)
    for line in range(sum(cells.shape)):
        tie = np.zeros(sum(cells.shape))
        tie[line] = 3 * np.max(1 / cells)
        assert_allclose(FloatingNetwork.solve(1 / cells, tie).reading(), resistance, rtol=1e-10)


def test_numbers_beyond_any_panel_are_nothing_or_infinite() -> None:
    values = np.array([0.0, 1e-300, -1e-300, 5.0, 1e300, -1e300, np.inf])
    np.testing.assert_array_equal(as_panels_have(values), [0, 0, 0, 5, np.inf, -np.inf, np.inf])
