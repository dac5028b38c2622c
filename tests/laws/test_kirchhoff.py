"""Identities that the two-point resistances of any matrix of cells obey."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from lampest import Array, two_point_resistance
from lampest.formulation.circuit import Circuit
from lampest.panel.kirchhoff import bipartite, current_balance, inverse_of, laplacian, line_sums
from lampest.panel.network import SolvedNetwork
from lampest.panel.panel import as_panels_have
from lampest.panel.readouts.floating import (
    MAX_RELATIVE_MISFIT,
    convex_start,
    grounding,
)

QUICK = settings(derandomize=True, deadline=None, max_examples=25, database=None)
# Relative; rounding of float64, 2e-16, grows with the contrast, here of two to three decades.
ROUNDING = 1e-11
MAX_SOLVES = 12  # quadratic convergence from a start within 0.1 decades; measured 7 to 9
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


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
@QUICK
def test_a_panel_of_rank_one_has_its_closed_form(rows: int, columns: int, seed: int) -> None:
    """g = a_j·b_k: R = 1/(a_j B) + 1/(b_k A) − 1/(A B)."""
    rng = np.random.default_rng(seed)
    a = 10 ** rng.uniform(-1, 1, rows)
    b = 10 ** rng.uniform(-1, 1, columns)
    expected = 1 / (a[:, None] * b.sum()) + 1 / (b[None, :] * a.sum()) - 1 / (a.sum() * b.sum())
    assert_allclose(two_point_resistance(1 / np.outer(a, b)), expected, rtol=ROUNDING)


def test_an_unconnected_line_is_an_error() -> None:
    conductance = 1 / random_panel((3, 4), 9)
    tie = grounding(1 / conductance)
    conductance[2] = 0
    tie[2] = 0
    tie[0] = 1.0
    with pytest.raises(np.linalg.LinAlgError):
        SolvedNetwork.floating(conductance, tie)


@given(panels)
@QUICK
def test_current_is_conserved_in_all_forms_of_the_law(cells: Array) -> None:
    """Equal potentials carry none."""
    conductance = 1 / cells
    rows, columns = cells.shape
    potentials = np.random.default_rng(2).standard_normal((rows + columns, 3))
    potentials[:, 0] = 1.0
    incidence = np.asarray(Circuit.of((rows, columns), None).incidence)
    balance = current_balance(incidence, conductance.reshape(-1, 1), potentials)
    size = 1e-13 * conductance.sum() * np.abs(potentials).max()
    assert_allclose(balance.sum(axis=0), 0, atol=size)
    assert_allclose(balance[:, 0], 0, atol=size)
    matrix = laplacian(conductance)
    assert_array_equal(matrix, matrix.T)
    injected = bipartite(line_sums(conductance), -conductance, potentials)
    assert_allclose(injected, balance, atol=size)
    assert_allclose(matrix @ potentials, balance, atol=size)


@given(panels)
@QUICK
def test_any_line_may_be_grounded(cells: Array) -> None:
    """Potential differences do not depend on the ground and its tie: paper, equation (5)."""
    resistance = two_point_resistance(cells)
    for line in range(sum(cells.shape)):
        tie = np.zeros(sum(cells.shape))
        tie[line] = 3 * np.max(1 / cells)
        assert_allclose(SolvedNetwork.floating(1 / cells, tie).reading(), resistance, rtol=ROUNDING)


def test_values_beyond_any_panel_become_zero_or_infinite() -> None:
    values = np.array([0.0, 1e-300, -1e-300, 5.0, 1e300, -1e300, np.inf])
    np.testing.assert_array_equal(as_panels_have(values), [0, 0, 0, 5, np.inf, -np.inf, np.inf])


@pytest.mark.parametrize("shape", [(1, 30), (30, 1), (3, 20), (20, 3), (5, 6, 2)])
def test_a_network_costs_the_inverse_of_its_shorter_side(
    shape: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The inverse is that of L + diag(t), and no matrix over all lines is inverted for it."""
    conductance = 10.0 ** np.random.default_rng(4).uniform(-5, -2, shape)
    ties = 10.0 ** np.random.default_rng(5).uniform(-5, -2, (*shape[:-2], shape[-2] + shape[-1]))
    inverse = np.linalg.inv(laplacian(conductance) + np.eye(ties.shape[-1]) * ties[..., None, :])
    invert = np.linalg.inv
    sizes = []
    monkeypatch.setattr(
        np.linalg, "inv", lambda matrix: sizes.append(matrix.shape[-1]) or invert(matrix)
    )
    assert_allclose(inverse_of(conductance, ties), inverse, rtol=ROUNDING)
    assert sizes == [min(shape[-2:])]


@pytest.mark.parametrize("shape", [(2, 150), (20, 20), (32, 32)])
def test_the_convex_start_of_large_panels_converges_quadratically(
    shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line search does not stall in the rounding of the values."""
    rng = np.random.default_rng(1)
    cells = 2000 * 10 ** rng.uniform(-0.3, 0.3, shape)
    near = cells * 10 ** rng.uniform(-0.1, 0.1, shape)
    near[: shape[0] // 2 + 1, : shape[1] // 2] *= 3
    measured = two_point_resistance(cells) * (1 + 1e-3 * rng.standard_normal(shape))
    solve = SolvedNetwork.floating
    solved = []
    monkeypatch.setattr(
        SolvedNetwork, "floating", lambda *network: solved.append(0) or solve(*network)
    )
    start = convex_start(measured, (np.full(shape, 1.0), np.full(shape, 1e7)), near)
    assert_allclose(two_point_resistance(start), measured, rtol=MAX_RELATIVE_MISFIT)
    assert len(solved) <= MAX_SOLVES
