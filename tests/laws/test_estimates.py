"""Symmetries of costs and estimates of any panel."""

from typing import Any

import numpy as np
import pytest
from golden.numerics import LOSSES, options
from numpy.testing import assert_allclose

from lampest import (
    Array,
    Misfit,
    Panel,
    Recording,
    Scene,
    Term,
    reconstruct,
    two_point_resistance,
)
from lampest.cost.cost import Cost
from lampest.cost.given import Given
from lampest.cost.problem import Data, Evaluation
from lampest.cost.terms import term_types

VARIANTS = [
    pytest.param(term, words, id="-".join([kind, *words.values()]))
    for kind, term in term_types().items()
    for words in options(term)
]
ROUNDING = 1e-10
MIRRORS = {"upside down": np.s_[..., ::-1, :], "left to right": np.s_[..., :, ::-1]}
SHAPES = ((1, 4), (3, 4), (5, 2))
CONVERGED = 1e-6  # of log r, at which solves end


def random_cells(shape: tuple[int, ...], seed: int) -> Array:
    return np.asarray(3000 * np.exp(0.4 * np.random.default_rng(seed).standard_normal(shape)))


def evaluation_at(cost: Cost, cells: Array, *maps: Array) -> Evaluation:
    """A cost at cells, with maps of the other values that it is given."""
    measured, sigma, previous, baseline, deviation = maps
    given = Given(
        measured=measured,
        sigma=sigma,
        previous=previous,
        baseline=baseline,
        previous_deviation=deviation,
    )
    data = Data(given, measured / 10, measured * 1e3)
    return Evaluation.at(cost, data, cells)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("mirror", MIRRORS.values(), ids=MIRRORS)
@pytest.mark.parametrize(("term", "words"), VARIANTS)
def test_costs_of_a_mirrored_panel_are_equal(
    term: type[Term], words: dict[str, Any], mirror: Any, shape: tuple[int, int]
) -> None:
    cells = random_cells((1, *shape), 1)
    maps = [
        random_cells((1, *shape), 2),
        np.random.default_rng(3).uniform(1, 9, (1, *shape)),
        random_cells(shape, 4),
        random_cells(shape, 5),
        np.random.default_rng(6).uniform(0.05, 0.3, shape),
    ]
    cost = Cost(Panel(*shape), tuple(term(weight=0.7, loss=loss, **words) for loss in LOSSES), 1)
    original = evaluation_at(cost, cells, *maps)
    mirrored = evaluation_at(cost, cells[mirror], *(values[mirror] for values in maps))
    assert mirrored.costs == pytest.approx(original.costs, rel=ROUNDING)
    gradients = [at.log_gradient(np.zeros(len(at.nonsmooth))) for at in (original, mirrored)]
    assert_allclose(
        gradients[1],
        gradients[0][mirror],
        atol=ROUNDING * max(original.objective, np.max(np.abs(gradients[0]))),
    )


def recording_of(measured: Array) -> Recording:
    """A recording in ohm, the first frame unloaded."""
    frames, *shape = measured.shape
    role = np.array([0] + [1] * (frames - 1), dtype=np.uint8)
    return Recording(Scene(Panel(*shape)), measured, np.arange(float(frames)), role)


@pytest.mark.parametrize("shape", [(2, 3), (4, 4)])
def test_plain_estimates_follow_the_unit_and_the_order_of_lines_and_frames(
    shape: tuple[int, int],
) -> None:
    """Least squares without penalties: readings times a factor give cells times that factor."""
    rng = np.random.default_rng(shape)
    cells = random_cells((4, *shape), 7)
    measured = two_point_resistance(cells) * (1 + 0.003 * rng.standard_normal(cells.shape))

    def estimate(readings: Array) -> Array:
        return reconstruct(recording_of(readings), [Misfit()]).cell_resistance

    expected = estimate(measured)
    assert_allclose(estimate(2.5 * measured), 2.5 * expected, rtol=CONVERGED)
    lines = np.ix_(rng.permutation(shape[0]), rng.permutation(shape[1]))
    assert_allclose(estimate(measured[:, *lines]), expected[:, *lines], rtol=CONVERGED)
    frames = np.array([3, 1, 2])
    assert_allclose(estimate(measured[[0, *frames]]), expected[frames - 1], rtol=CONVERGED)
