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
SHAPES = [(1, 1), (1, 6), (6, 1), (2, 2), (2, 7), (3, 5), (5, 3), (7, 7)]
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


def jacobian(cells: Array) -> Array:
    """∂R/∂r (cells, cells) from the transfer matrix."""
    return (network(cells).transfer / cells.ravel()) ** 2


def complex_step(cells: Array, cell: tuple[int, ...]) -> Array:
    """∂R/∂g of one cell, by an imaginary increment: no cancellation, hence exact to rounding."""
    step = 1e-30
    conductance = (1 / cells).astype(complex)
    conductance[cell] += 1j * step
    return np.asarray(FloatingNetwork.solve(conductance, grounding(cells)).reading().imag / step)


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
@QUICK
def test_a_panel_of_rank_one_has_its_closed_form(rows: int, columns: int, seed: int) -> None:
    """g = a_j·b_k: R = 1/(a_j B) + 1/(b_k A) − 1/(A B)."""
    rng = np.random.default_rng(seed)
    a, b = 10 ** rng.uniform(-1, 1, rows), 10 ** rng.uniform(-1, 1, columns)
    expected = 1 / (a[:, None] * b.sum()) + 1 / (b[None, :] * a.sum()) - 1 / (a.sum() * b.sum())
    assert_allclose(two_point_resistance(1 / np.outer(a, b)), expected, rtol=1e-11)


@pytest.mark.parametrize("columns", [1, 2, 3, 8])
def test_a_panel_of_two_rows_is_a_cell_beside_a_ladder(columns: int) -> None:
    """R_1k = r_1k ∥ (r_2k + 1/Σ_{q≠k} 1/(r_1q + r_2q))."""
    cells = random_panel((2, columns), 3)
    expected = np.empty((2, columns))
    for row in range(2):
        for column in range(columns):
            others = 1 / np.delete(cells.sum(axis=0), column)
            around = np.inf if columns == 1 else cells[1 - row, column] + 1 / others.sum()
            expected[row, column] = 1 / (1 / cells[row, column] + 1 / around)
    assert_allclose(two_point_resistance(cells), expected, rtol=1e-12)


@given(panels)
@QUICK
def test_conductance_times_resistance_adds_up_to_lines_minus_one_as_foster_proved(cells: Array) -> None:
    """Σ g R = M + N − 1."""
    assert np.sum(two_point_resistance(cells) / cells) == pytest.approx(sum(cells.shape) - 1, rel=1e-11)


@pytest.mark.parametrize("shape", [(1, 3), (2, 2), (3, 5), (6, 4)])
def test_resistances_are_the_gradient_of_the_log_determinant(shape: tuple[int, int]) -> None:
    """R = ∇_g log det C, C the Laplacian without one line; the derivative by an imaginary increment."""
    cells = random_panel(shape, 5)
    expected = np.empty(shape)
    for cell in np.ndindex(shape):
        conductance = (1 / cells).astype(complex)
        conductance[cell] += 1e-30j
        sign, _ = np.linalg.slogdet(laplacian(conductance)[1:, 1:])
        expected[cell] = np.angle(sign) / 1e-30
    assert_allclose(two_point_resistance(cells), expected, rtol=1e-11)


@given(panels)
@QUICK
def test_sensitivities_lie_between_zero_and_one_and_times_the_cells_give_the_resistances(cells: Array) -> None:
    """J r = R, since R is homogeneous of degree one."""
    sensitivity = jacobian(cells)
    assert np.min(sensitivity) >= 0 and np.max(sensitivity) <= 1 + 1e-12
    assert_allclose(sensitivity @ cells.ravel(), two_point_resistance(cells).ravel(), rtol=1e-10)


@pytest.mark.parametrize("shape", SHAPES)
def test_product_form_is_the_jacobian_is_the_derivative(shape: tuple[int, int]) -> None:
    cells = random_panel(shape, 6)
    solved = network(cells)
    expected = np.array([complex_step(cells, cell).ravel() for cell in np.ndindex(shape)])
    units = np.eye(cells.size).reshape(cells.size, *shape)
    products = np.array([-solved.forward(unit * cells).ravel() for unit in units])
    size = np.max(np.abs(expected))
    assert_allclose(products, expected, rtol=1e-9, atol=1e-12 * size)
    assert_allclose(-(solved.transfer**2), expected, rtol=1e-9, atol=1e-12 * size)


@given(panels, st.integers(0, 2**32 - 1))
@QUICK
def test_product_form_is_linear_and_its_own_transpose(cells: Array, seed: int) -> None:
    """Reciprocity, ∂R_i/∂g_l = ∂R_l/∂g_i: eᵀ(∂R/∂g)p = pᵀ(∂R/∂g)e."""
    solved = network(cells)
    e, p = np.random.default_rng(seed).standard_normal((2, *cells.shape))
    along_e, along_p = solved.forward(e * cells), solved.forward(p * cells)
    size = np.sqrt(np.sum(e**2) * np.sum(along_p**2))
    assert abs(np.sum(e * along_p) - np.sum(p * along_e)) < 1e-11 * size
    both = solved.forward((2 * e - 3 * p) * cells)
    assert_allclose(both, 2 * along_e - 3 * along_p, atol=1e-10 * np.max(np.abs([along_e, along_p])))


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


@given(panels)
@QUICK
def test_way_round_is_no_shorter(cells: Array) -> None:
    """R_jk ≤ R_jq + R_pq + R_pk: resistance distance is a metric."""
    resistance = two_point_resistance(cells)
    rows, columns = cells.shape
    j, p, q, k = np.ix_(range(rows), range(rows), range(columns), range(columns))
    round_trip = resistance[j, q] + resistance[p, q] + resistance[p, k]
    assert np.all(resistance[j, k] <= round_trip * (1 + 1e-12))


@given(panels, st.randoms(use_true_random=False))
@QUICK
def test_permuted_and_transposed_panels_have_permuted_and_transposed_resistances(cells: Array, random: object) -> None:
    rng = np.random.default_rng(random.randrange(2**32))
    rows, columns = (rng.permutation(size) for size in cells.shape)
    resistance = two_point_resistance(cells)
    assert_allclose(two_point_resistance(cells[rows][:, columns]), resistance[rows][:, columns], rtol=1e-11)
    assert_allclose(two_point_resistance(cells.T), resistance.T, rtol=1e-11)


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (6, 4)])
def test_the_jacobian_of_equal_cells_has_its_four_eigenvalues(shape: tuple[int, int]) -> None:
    """(M+N−1)/MN once; 1/N, M − 1 times; 1/M, N − 1 times; 2/MN, (M − 1)(N − 1) times."""
    m, n = shape
    expected = [(m + n - 1) / (m * n)] + [1 / n] * (m - 1) + [1 / m] * (n - 1) + [2 / (m * n)] * ((m - 1) * (n - 1))
    found = np.linalg.eigvalsh(jacobian(np.full(shape, 3050.0)))
    assert_allclose(found, np.sort(expected), rtol=1e-11)


def test_open_cell_is_no_cell() -> None:
    """2 × 2 without cell (0, 0): its place shows the other three in series, each other place its own cell alone."""
    cells = np.array([[1e200, 100.0], [20.0, 3.0]])
    assert_allclose(two_point_resistance(cells), [[123.0, 100.0], [20.0, 3.0]], rtol=1e-13)
    panel = random_panel((4, 5), 8)
    without = 1 / panel
    without[1, 2] = 0
    panel[1, 2] = 1e200
    assert_array_equal(two_point_resistance(panel), FloatingNetwork.solve(without, grounding(panel)).reading())


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
