"""Posterior of a number by its costs on a grid."""

import numpy as np
import pytest

from lampest.inference.number import MIN_ODDS, Number, is_significant, parabola, summed_out

VALUES = np.linspace(-2, 6, 81)
MEAN = 1.7
SD = 0.6


def test_the_posterior_of_a_parabola_of_costs_is_normal() -> None:
    number = Number.by_costs(VALUES, ((VALUES - MEAN) / SD) ** 2)
    assert number.mean == pytest.approx(MEAN, abs=1e-3)
    assert number.deviation == pytest.approx(SD, rel=0.01)
    assert number.mean_square == pytest.approx(MEAN**2 + SD**2, rel=0.01)
    assert number.gain == pytest.approx(((VALUES[0] - MEAN) / SD) ** 2, abs=0.01)


def test_a_number_is_not_surer_than_the_step_of_its_grid() -> None:
    coarse = np.array([0.0, 1.0, 4.0])
    number = Number.by_costs(coarse, 1e6 * (coarse - 1.0) ** 2)
    assert number.mean == 1.0
    assert number.deviation == pytest.approx(1 / np.sqrt(12))


def test_a_number_that_another_imitates_is_less_sure() -> None:
    """The data tell the sum of both; the other is N(0, 1)."""
    other = np.linspace(-5, 5, 101)
    costs = ((VALUES[:, None] + other - MEAN) / SD) ** 2 + other**2
    number = Number.by_costs(VALUES, costs)
    assert number.deviation == pytest.approx(np.hypot(SD, 1.0), rel=0.02)


def test_a_prior_of_zero_excludes_a_value_and_a_failed_one_has_no_odds() -> None:
    number = Number.by_costs(
        np.arange(3.0), np.array([0.0, np.inf, 0.0]), np.array([0.0, 1.0, 1.0])
    )
    np.testing.assert_allclose(number.odds, [0.0, 0.0, 1.0])


def test_equally_probable_numbers_are_summed_out() -> None:
    costs = np.array([[1.0, 2.0], [3.0, 0.5]])
    expected = -2 * np.log(np.exp(-costs / 2).sum(axis=0))
    np.testing.assert_allclose(summed_out(costs, axis=0), expected)


def test_a_parabola_has_its_vertex_between_the_values() -> None:
    values = np.linspace(0, 1, 5)
    least, deviation = parabola(values, ((values - 0.4) / 0.1) ** 2)
    assert least == pytest.approx(0.4) and deviation == pytest.approx(0.1)
    assert parabola(values, -values)[1] == np.inf


@pytest.mark.parametrize("deviation", [0.01, 0.1])
def test_a_number_is_significant_from_the_odds_of_its_posterior_on(deviation: float) -> None:
    """The odds are the mean likelihood under the prior over that of 0."""
    values = np.linspace(0, 1, 20001)

    def odds(mean: float) -> float:
        likelihood = np.exp(-(((values - mean) / deviation) ** 2) / 2)
        return float(likelihood.mean() / likelihood[0])

    for mean in np.linspace(0, 6, 31) * deviation:
        assert is_significant(float(mean), deviation, 1.0) == (odds(mean) > MIN_ODDS)
    assert not is_significant(0.0, 0.0, 1.0)
