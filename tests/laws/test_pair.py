"""Two large frames that are solved together: their steps are Newton's in conductances and in ratios of cells."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

from lampest import two_point_resistance
from lampest.cost.given import Background
from lampest.cost.losses import Squared
from lampest.cost.problem import Evaluation
from lampest.cost.terms import CellResistance, GradientOfRelativeChange, LogRatio, Misfit, RelativeChange, Term
from lampest.estimate.estimator import Estimator
from lampest.panel.conjugate import conjugate_gradients
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.levels import pair_inverse
from lampest.solvers.newton.pair import FramePair
from lampest.solvers.newton.smoothing import Smoothing

SHAPE, CELLS = (3, 4), 12
RATIOS: dict[str, tuple[Term, ...]] = {
    "change": (Misfit(), RelativeChange(weight=10)),
    "gradient of change": (Misfit(), CellResistance(weight=1e-3), GradientOfRelativeChange(weight=10)),
}
LOGARITHMS: tuple[Term, ...] = (Misfit(), LogRatio(weight=10, loss=Squared()))
PAIRS = RATIOS | {"log ratio": LOGARITHMS}


def loaded() -> Array:
    """Cells of a resting frame and of one in which some are loaded to an eighth, ohm."""
    cells = 1000 * np.exp(0.3 * np.random.default_rng(7).standard_normal((2, *SHAPE)))
    cells[1, 1:, 1:3] /= 8
    return cells


def evaluation(terms: tuple[Term, ...], cells: Array | None = None) -> Evaluation:
    """Somewhere off the optimum of frames of such cells."""
    generator, cells = np.random.default_rng(8), loaded() if cells is None else cells
    measured, readout = two_point_resistance(cells), TwoPointReadout()
    scene, seen = Scene(Panel(*cells.shape[1:]), readout), np.ones(measured.shape)
    estimator = Estimator(terms, formulation="reduced")
    data = estimator.data(Readings(measured, readout.sigma(measured), 0 * seen, seen), Background(scene))
    elsewhere = cells * np.exp(0.2 * generator.standard_normal(cells.shape))
    return Evaluation.at(estimator.cost(scene, 2, data.partial), data, elsewhere)


def pair(at: Evaluation, held: tuple[int, ...] = ()) -> FramePair:
    """Of all unknowns but those held."""
    free = np.ones(2 * CELLS, dtype=bool)
    free[list(held)] = False
    return FramePair(Curvature(at, Smoothing.start(at)), free)


def bends(value: Callable[[Array], float], step: Array) -> float:
    """d²/dt² of the value along t·step, by differences of fourth order."""
    width = 2e-3
    weights = {-2: -1 / 12, -1: 4 / 3, 0: -5 / 2, 1: 4 / 3, 2: -1 / 12}
    return sum(weight * value(share * width * step) for share, weight in weights.items()) / width**2


@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("held", [(), (0, 1, CELLS + 5, CELLS + 6)], ids=["all free", "some held"])
@pytest.mark.parametrize("alike", [False, True])
def test_second_derivatives_are_those_along_its_own_paths(name: str, held: tuple[int, ...], alike: bool) -> None:
    at = evaluation(PAIRS[name])
    at = at.elsewhere(loaded()[[0, 0]] * np.exp(np.linspace(-0.1, 0.1, 2 * CELLS)).reshape(2, *SHAPE)) if alike else at
    assert pair(at).alike is alike
    found = pair(at, held)
    for seed in range(3):
        step = np.where(found.free, 0.3 * np.random.default_rng(seed).standard_normal(2 * CELLS), 0.0)

        def along(moved: Array) -> float:
            return at.elsewhere(np.exp(at.position + found.change(moved).reshape(at.position.shape))).objective

        assert_allclose(float(step @ found.product(step)), bends(along, step), rtol=1e-5)


def test_squares_never_bend_down_where_second_derivatives_in_log_r_do() -> None:
    for terms in PAIRS.values():
        found = pair(evaluation(terms))
        columns = np.eye(2 * CELLS)
        squares = np.array([found.squares(column) for column in columns])
        assert_allclose(squares, squares.T, rtol=1e-9, atol=1e-9 * np.abs(squares).max())
        assert np.linalg.eigvalsh(squares)[0] > -1e-9 * np.abs(squares).max()
    plain = pair(evaluation(RATIOS["change"])).curvature
    assert np.linalg.eigvalsh(np.array([plain.product(column) for column in np.eye(2 * CELLS)]))[0] < 0


def test_a_step_is_straight_in_the_first_conductance_and_in_the_ratio() -> None:
    found = pair(evaluation(RATIOS["change"]).elsewhere(loaded()[[0, 0]]), held=(0, CELLS + 1))
    step = np.where(found.free, np.linspace(-0.4, 0.5, 2 * CELLS), 0.0)
    first, second = np.split(found.change(step), 2)
    whole = np.split(step, 2)
    assert_allclose(np.exp(-first), 1 - whole[0])
    assert_allclose(np.exp(second - first)[2:], 1 + (whole[1] - whole[0])[2:])
    assert_allclose([first[0], np.exp(second[0])], [0, 1 + whole[1][0]])
    assert second[1] == 0


def test_penalties_of_logarithms_keep_ratios_in_logarithms() -> None:
    found = pair(evaluation(LOGARITHMS).elsewhere(loaded()[[0, 0]]))
    step = np.linspace(-0.8, 0.8, 2 * CELLS)
    first, second = np.split(found.change(step), 2)
    assert_allclose(np.exp(-first), 1 - step[:CELLS])
    assert_allclose(second - first, step[CELLS:] - step[:CELLS])


@pytest.mark.parametrize("tied", [False, True], ids=["ratios", "levels too"])
def test_levels_are_eliminated_exactly(tied: bool) -> None:
    generator = np.random.default_rng(3)
    edges = sparse.random_array((20, CELLS), density=0.3, rng=generator)
    between = (edges.T @ edges).toarray()
    penalties = np.block([[between, -between], [-between, between]]) + tied * np.diag(np.ones(2 * CELLS))
    own, free = generator.uniform(0.1, 2, 2 * CELLS), np.ones(2 * CELLS, dtype=bool)
    free[[0, 1, 5, CELLS + 1, CELLS + 6]] = False

    def level(both: Array) -> Callable[[Array], Array]:
        return lambda values: np.where(both, values / (own[:CELLS] + own[CELLS:]), 0.0)

    solve = pair_inverse(sparse.csr_array(penalties), own, free, level)
    matrix = (penalties + np.diag(own))[np.ix_(free, free)]
    assert_allclose([matrix @ solve(one) for one in np.eye(len(matrix))], np.eye(len(matrix)), atol=1e-7)


def test_a_pair_takes_few_products_as_its_levels_are_seen_along_lines() -> None:
    cells = 1000 * np.exp(0.2 * np.random.default_rng(5).standard_normal((1, 20, 20)))
    cells = np.concatenate([cells, cells])
    cells[1, 5:9, 6:10] /= 4
    at = evaluation(RATIOS["change"], cells).elsewhere(cells[[0, 0]])
    found = FramePair(Curvature(at, Smoothing.start(at)), np.ones(cells.size, dtype=bool))
    products = 0

    def product(step: Array) -> Array:
        nonlocal products
        products += 1
        return found.squares(step)

    right = -found.curvature.gradient
    conjugate_gradients(product, lambda values: values / found.size, right, 1e-3)
    plain, products = products, 0
    inverse = found.inverse(np.zeros(cells.size))
    conjugate_gradients(product, inverse, right, 1e-3)
    assert 3 * products < plain
    image = inverse(right)
    other = np.random.default_rng(2).standard_normal(cells.size)
    assert right @ image > 0
    assert_allclose(other @ image, right @ inverse(other), rtol=1e-6)
