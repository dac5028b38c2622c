"""Tail probabilities and intervals are those of their distributions."""

from math import comb, gamma

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest.posterior.interval import (
    MAX_DEVIATIONS,
    binomial_tail,
    chi_square_tail,
    largest_normal,
    largest_of,
    one_sided,
    student_two_sided,
)

ROUNDING = 1e-12  # relative: special functions keep 13 digits at these arguments
WIDTH = 40.0  # of an integral, in scales of the density: exp(−40) is beyond rounding
STEPS = 400_000  # of the integral
# Relative: a quantile of the sum is exact to a step, which is at most WIDTH/STEPS scales, and 95 %
# quantiles are at least 1.9 scales.
INTEGRATION = WIDTH / STEPS


@pytest.mark.parametrize("degrees", [0.5, 1, 2, 3.7, 10, 60])
def test_the_tail_of_chi_square_obeys_its_recursion(degrees: float) -> None:
    """Q(x, k + 2) = Q(x, k) + (x/2)^(k/2) exp(−x/2)/Γ(k/2 + 1), and Q(x, 2) = exp(−x/2)."""
    chi_square = np.random.default_rng(1).gamma(degrees / 2, 2.0, 50)
    half = chi_square / 2
    further = half ** (degrees / 2) * np.exp(-half) / gamma(degrees / 2 + 1)
    assert_allclose(
        chi_square_tail(chi_square, degrees + 2),
        chi_square_tail(chi_square, degrees) + further,
        rtol=ROUNDING,
    )
    assert_allclose(chi_square_tail(chi_square, 2.0), np.exp(-half), rtol=ROUNDING)


@pytest.mark.parametrize(("trials", "chance"), [(1, 0.5), (7, 0.1), (30, 0.95), (200, 0.01)])
def test_the_binomial_tail_is_the_sum_of_its_terms(trials: int, chance: float) -> None:
    terms = [
        comb(trials, count) * chance**count * (1 - chance) ** (trials - count)
        for count in range(trials + 1)
    ]
    for count in range(trials + 1):
        assert binomial_tail(count, trials, chance) == pytest.approx(
            sum(terms[count:]), rel=ROUNDING
        )


def test_students_interval_has_closed_forms_and_falls_to_that_of_a_normal_distribution() -> None:
    """Degrees 1: tan(0.475 π). Degrees 2: 2p/√(2 a (1 − a)) with p = 0.475, a = 0.975."""
    assert student_two_sided(1.0) == pytest.approx(np.tan(0.475 * np.pi), rel=ROUNDING)
    assert student_two_sided(2.0) == pytest.approx(0.95 / np.sqrt(2 * 0.975 * 0.025), rel=ROUNDING)
    sizes = [student_two_sided(degrees) for degrees in (1, 2, 5, 30, 1e3, 1e8)]
    normal = largest_normal(1, 0.05)
    assert np.all(np.diff(sizes) < 0) and sizes[-1] == pytest.approx(normal, rel=1e-7)


@pytest.mark.parametrize("deviations", [0.0, 0.1, 1.0, 8.0, 49.0])
def test_a_one_sided_interval_is_that_of_the_truncated_density(deviations: float) -> None:
    """Density ∝ exp(−slope·t − t²/(2·variance)) over t ≥ 0, for slope·√variance."""
    for variance in np.random.default_rng(2).uniform(0.2, 3.0, 3):
        slope = deviations / np.sqrt(variance)
        scale = np.sqrt(variance) / max(deviations, 1)
        t = np.linspace(0, WIDTH * scale, STEPS)
        density = np.exp(-slope * t - t**2 / (2 * variance))
        share = np.cumsum(density) / density.sum()
        mean = density @ t / density.sum()
        deviation = np.sqrt(density @ (t - mean) ** 2 / density.sum())
        assert_allclose(
            one_sided(slope, variance),
            (deviation, t[np.searchsorted(share, 0.95)]),
            rtol=INTEGRATION,
        )


def test_a_one_sided_interval_scales_and_is_continuous_where_its_tail_is_exponential() -> None:
    """Slope/c and variance·c² stretch it by c."""
    rng = np.random.default_rng(3)
    slope = rng.uniform(0, 9, 30)
    variance = rng.uniform(0.1, 4, 30)
    for factor in (1e-3, 7.0, 1e4):
        assert_allclose(
            one_sided(slope / factor, variance * factor**2),
            factor * np.array(one_sided(slope, variance)),
            rtol=1e-9,  # 1 − h(h − α) loses digits as 1/α²
        )
    near, far = (
        np.array(one_sided(MAX_DEVIATIONS * factor, 1.0)) for factor in (1 - 1e-9, 1 + 1e-9)
    )
    assert_allclose(near, far, rtol=3 / MAX_DEVIATIONS**2)  # next order of Mills' ratio


@pytest.mark.parametrize("count", [1, 20, 2400])
def test_the_bound_of_the_largest_of_normal_numbers_is_inverted(count: int) -> None:
    """Two-sided by one-sided: twice the bound of P(max x ≥ size) is the chance of max |x|."""
    for chance in (0.3, 0.01, 1e-9):
        assert 2 * largest_of(largest_normal(count, chance), count) == pytest.approx(
            chance, rel=1e-9
        )
    assert largest_of(-40.0, count) == 1
