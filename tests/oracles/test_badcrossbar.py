"""The wired network against badcrossbar: sources at one end of the rows, ground at one end of the columns.

Joksas & Mehonic, SoftwareX 12, 100617, 2020; MIT. It draws with cairo, which is not needed here and may be missing.
"""

import warnings
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array, TwoPointReadout
from lampest.panel.readouts.wiring import Lines, WiredNetwork, Wiring

with warnings.catch_warnings():  # it warns of what it cannot import
    import badcrossbar

SHAPES = ((1, 1), (1, 5), (4, 1), (5, 8), (9, 4), (16, 16))
WIRES = ((1.0, 1.0), (0.3, 20.0), (50.0, 0.02), (0.0, 3.0), (3.0, 0.0))


def cells_of(rows: int, columns: int) -> Array:
    return np.asarray(3000 * np.exp(np.random.default_rng(rows * columns).normal(size=(rows, columns))))


def network_of(cells: Array, lines: Lines, ties: Array) -> WiredNetwork:
    return WiredNetwork.solve(cells, ties, TwoPointReadout(), Wiring(lines))


def solved(cells: Array, row_ohm: float, column_ohm: float) -> Any:
    """With one volt at one row after the other."""
    return badcrossbar.compute(np.eye(len(cells)), cells, r_i_word_line=row_ohm, r_i_bit_line=column_ohm)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("ohm", WIRES)
def test_currents_and_voltages_are_badcrossbars(shape: tuple[int, int], ohm: tuple[float, float]) -> None:
    rows, columns = shape
    cells, theirs = cells_of(rows, columns), solved(cells_of(rows, columns), *ohm)
    ties = np.full(rows + columns, 1e-3)
    network = network_of(cells, Lines(*ohm), ties)
    # The impedances know of grounded terminals as well: Z⁻¹ − diag(t) are the currents into them.
    admittance = np.linalg.inv(network.potentials()) - np.diag(ties)
    assert_allclose(-admittance[rows:, :rows].T, np.reshape(theirs.currents.output, (rows, columns)), rtol=1e-10)
    through = network.potential_differences.T @ np.linalg.inv(network.potentials())[:, :rows]
    theirs_through = np.reshape(theirs.currents.device, (rows, columns, rows))
    assert_allclose(through.reshape(rows, columns, rows) / cells[..., None], theirs_through, rtol=1e-10, atol=1e-17)


def test_the_other_sides_are_mirror_images() -> None:
    """badcrossbar knows rows that enter at the left and columns that leave at the bottom; the others are turned."""
    cells = cells_of(5, 8)
    ties = np.full(13, 1e-3)
    theirs = np.reshape(solved(cells[::-1, ::-1], 2.0, 7.0).currents.output, (5, 8))[::-1, ::-1]
    network = network_of(cells, Lines(2.0, 7.0, "right", "top"), ties)
    admittance = np.linalg.inv(network.potentials()) - np.diag(ties)
    assert_allclose(-admittance[5:, :5].T, theirs, rtol=1e-10)
