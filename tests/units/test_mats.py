"""Random mats: every solver against the truth. Readings come from a network that is assembled here, node by node."""

from collections.abc import Callable

import numpy as np
import pytest

from docs.studies.mats import LEAST_S, MOST_S, PUBLISHED, MatAnswer, Mats, MatSolve, solved_mats, table
from lampest.solvers.solution import Settings

SIDES = (6, 16)
FINE = {"fixed_point": 1e-5, "krylov_fine": 1e-8, "least_squares": 1e-6}


def two_point(conductance: np.ndarray) -> np.ndarray:
    """Volts per ampere between every row and every column, one injection at a time, the last column grounded."""
    rows, columns = conductance.shape
    nodes = np.zeros((rows + columns, rows + columns))
    for row in range(rows):
        for column in range(columns):
            pair = np.ix_((row, rows + column), (row, rows + column))
            nodes[pair] += conductance[row, column] * np.array([[1, -1], [-1, 1]])
    readings = np.empty(conductance.shape)
    for row in range(rows):
        for column in range(columns):
            current = np.zeros(rows + columns)
            current[row], current[rows + column] = 1, -1
            volts = np.append(np.linalg.solve(nodes[:-1, :-1], current[:-1]), 0)
            readings[row, column] = volts[row] - volts[rows + column]
    return readings


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", PUBLISHED)
def test_published_solvers_find_mats_that_are_read_exactly(name: str, side: int) -> None:
    conductance = np.random.default_rng(side).uniform(1e-3, MOST_S, (side, side))
    answer = PUBLISHED[name](two_point(conductance))
    assert answer.converged and answer.evaluations > answer.iterations > 0
    np.testing.assert_allclose(answer.conductance, conductance, rtol=FINE.get(name, 2e-2))
    if name == "krylov":  # as published it stops at 6 µS in every reading
        assert np.abs(1 / two_point(answer.conductance) - 1 / two_point(conductance)).max() < 6e-6


@pytest.fixture(scope="module")
def solves() -> list[MatSolve]:
    return list(solved_mats(Mats(sides=SIDES, draws=2, noise_percent=(0, 1)), seed=3, settings=Settings()))


@pytest.mark.slow
def test_ours_and_theirs_stand_side_by_side_on_the_same_mats(solves: list[MatSolve]) -> None:
    names = ["reduced", "scipy_exact", *PUBLISHED]
    assert [(one.side, one.noise_percent, one.draw, one.solver) for one in solves] == [
        (side, noise, draw, name) for side in SIDES for noise in (0, 1) for draw in (0, 1) for name in names
    ]
    for one in solves:
        assert one.seconds > 0 and one.inverse_s > 0 and one.cell_error <= one.worst_cell_error
        assert (one.evaluations is None) == (one.solver in ("reduced", "scipy_exact"))
        if one.noise_percent == 0:
            assert one.converged and one.negative == 0
            assert one.reading_error < 1e-2 and one.cell_error < 1e-2, one
            assert one.solver == "krylov" or one.cell_error < 1e-5, one
    noisy = [one.cell_error for one in solves if one.side == 6 and one.noise_percent == 1 and one.draw == 0]
    assert min(noisy) > 0.1  # what noise leaves of the cells is the same for all that end
    np.testing.assert_allclose(noisy, noisy[0], rtol=0.3)


@pytest.mark.slow
def test_table_has_a_line_for_every_solver(solves: list[MatSolve]) -> None:
    lines = table(solves).splitlines()
    assert len(lines) == 2 + len(SIDES) * 2 * 6
    assert lines[2].startswith("| 6 × 6 | 0 % | reduced |")


@pytest.mark.slow
def test_newton_krylov_knows_no_bounds(solves: list[MatSolve]) -> None:
    noisy = [one for one in solves if one.side == 16 and one.noise_percent == 1]
    assert any(one.negative for one in noisy if one.solver == "krylov_fine")
    assert not any(one.negative for one in noisy if one.solver in ("reduced", "fixed_point", "least_squares"))


def test_a_fixed_point_that_does_not_settle_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    fixed_point: Callable[[np.ndarray], MatAnswer] = PUBLISHED["fixed_point"]
    monkeypatch.setattr("docs.studies.mats.MOST_STEPS", 3)
    answer = fixed_point(two_point(np.full((4, 4), LEAST_S)))
    assert (answer.converged, answer.iterations) == (False, 3)
