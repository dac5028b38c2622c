"""Matrices over the lines of a panel, inverted at the cost of the shorter side."""

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose

from lampest import (
    Misfit,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
    reconstruct,
    two_point_resistance,
)
from lampest.panel.kirchhoff import LineBlocks, laplacian, log_determinant

SHAPES = (1, 30), (30, 1), (4, 20), (20, 4), (6, 6)
NARROW = 1, 420  # beyond the cells up to which whole matrices are used
ROUNDING = 1e-12  # relative; blocks that differ by decades lose three digits


def blocks_of(shape: tuple[int, int], values: int) -> LineBlocks:
    """A regular matrix with blocks that differ by decades."""
    rng = np.random.default_rng([*shape, values])
    between = 10.0 ** rng.uniform(-2, 1, (values, values, *shape))
    diagonal = 10.0 ** rng.uniform(1, 3, (values, values, sum(shape)))
    return LineBlocks(diagonal + diagonal.swapaxes(0, 1), between + between.swapaxes(0, 1))


@pytest.mark.parametrize("values", [1, 2])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_inverse_by_blocks_equals_that_of_the_matrix(
    shape: tuple[int, int], values: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = blocks_of(shape, values)
    matrix = blocks.matrix()
    vector = np.random.default_rng(3).standard_normal(len(matrix))
    expected = np.linalg.solve(matrix, vector)
    assert_allclose(matrix, matrix.T)
    assert_allclose((blocks + blocks).matrix(), 2 * matrix)
    sizes = sizes_of_matrices(monkeypatch)
    assert_allclose(
        blocks.inverse()(vector),
        expected,
        rtol=1e3 * ROUNDING,
        atol=1e2 * ROUNDING * np.abs(expected).max(),
    )
    assert max(sizes) <= values * min(shape)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_determinant_equals_that_of_the_laplacian_with_ties(
    shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(4)
    conductance = 10.0 ** rng.uniform(-5, -2, shape)
    ties = 10.0 ** rng.uniform(-5, -2, sum(shape))
    expected = np.linalg.slogdet(laplacian(conductance) + np.diag(ties))[1]
    sizes = sizes_of_matrices(monkeypatch)
    assert log_determinant(conductance, ties) == pytest.approx(expected, rel=ROUNDING)
    assert max(sizes) <= min(shape)


def test_plain_least_squares_of_a_narrow_panel_inverts_no_matrix_of_its_longer_side(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """1 × 800 cells took 1.9 s, and 1 × 1600 12 s."""
    rng = np.random.default_rng(1)
    cells = rng.uniform(900, 2000, (2, *NARROW))
    read = two_point_resistance(cells) * (1 + 1e-4 * rng.standard_normal(cells.shape))
    scene = Scene(Panel(*NARROW), TwoPointReadout(noise_lsb=0.7))
    recording = Recording(scene, read, np.arange(2.0), np.array([0, 1], dtype=np.uint8))
    sizes = sizes_of_matrices(monkeypatch)
    assert reconstruct(recording, [Misfit(weighting="noise")]).status == ("local optimum verified",)
    assert max(sizes) <= 2


def sizes_of_matrices(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Record the sizes of all matrices whose inverse or determinant is computed from now on."""
    sizes = list[int]()
    for module, name in ((np.linalg, "inv"), (np.linalg, "slogdet"), (scipy.linalg, "inv")):
        compute = getattr(module, name)
        monkeypatch.setattr(
            module,
            name,
            lambda matrix, compute=compute: sizes.append(matrix.shape[-1]) or compute(matrix),
        )
    return sizes
