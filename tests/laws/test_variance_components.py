"""Variance components follow the unit of the deviations and the order of frames and lines."""

from dataclasses import fields
from math import gamma

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array
from lampest.inference.variance_components import MIN_NOISE_SHARE, Scatter, posterior_size, scatter

SHAPES = ((3, 4, 5), (8, 6, 3), (20, 5, 4), (6, 1, 7))  # frames, lines, channels
every_shape = pytest.mark.parametrize("shape", SHAPES)
ROUNDING = 1e-9  # relative
SCALED = ("own", "gain", "gain_sd", "ripple_sd")  # components in the unit of the deviations


def deviations_of(shape: tuple[int, int, int]) -> tuple[Array, Array]:
    """Deviations with a gain, common ripple and ripple of lines; a tenth is missing."""
    frames, lines, channels = shape
    rng = np.random.default_rng(shape)
    loudness = rng.uniform(200, 900, (lines, channels))
    deviation = rng.standard_normal(shape)
    deviation += 0.01 * rng.standard_normal((frames, 1, 1)) * loudness
    deviation += 2 * rng.standard_normal((frames, 1, 1)) * np.sin(np.arange(channels))
    deviation += 3 * rng.standard_normal((frames, lines, 1))
    deviation -= deviation.mean(axis=0)
    deviation[rng.random(shape) < 0.1] = np.nan
    return deviation, loudness


def assert_equal_components(actual: Scatter, expected: Scatter, factor: float = 1.0) -> None:
    """Equal, or `factor` times as large; roots of covariances are compared as covariances."""
    for field in fields(Scatter):
        first, second = (getattr(each, field.name) for each in (actual, expected))
        if field.name.endswith("_ripple"):
            first, second = first @ first.T, factor**2 * second @ second.T
        elif field.name in SCALED:
            second = factor * second
        assert_allclose(
            first,
            second,
            rtol=ROUNDING,
            atol=ROUNDING * np.max(second, initial=0),
            err_msg=field.name,
        )


@every_shape
def test_components_follow_the_unit_of_the_deviations(shape: tuple[int, int, int]) -> None:
    deviation, loudness = deviations_of(shape)
    expected = scatter(deviation, loudness, shape[0] - 1)
    for factor in (0.01, 40.0):
        actual = scatter(factor * deviation, loudness, shape[0] - 1)
        assert_equal_components(actual, expected, factor)


@every_shape
def test_components_do_not_depend_on_the_order_of_frames_and_lines(
    shape: tuple[int, int, int],
) -> None:
    deviation, loudness = deviations_of(shape)
    rng = np.random.default_rng(1)
    frames = rng.permutation(shape[0])
    lines = rng.permutation(shape[1])
    assert_equal_components(
        scatter(deviation[np.ix_(frames, lines)], loudness[lines], shape[0] - 1),
        scatter(deviation, loudness, shape[0] - 1),
    )


@every_shape
def test_the_components_contain_the_whole_square_of_the_deviations(
    shape: tuple[int, int, int],
) -> None:
    """Without gain and common ripple: own noise and ripple of lines have the mean square."""
    deviation, loudness = deviations_of(shape)
    deviation = np.nan_to_num(deviation)
    components = scatter(deviation, loudness, shape[0] - 1, gain=False, ripple=False)
    degrees = (shape[0] - 1) * shape[1] * shape[2]
    assert components.own**2 == pytest.approx(np.sum(deviation**2) / degrees, rel=ROUNDING)
    assert components.line_ripple.size == components.common_ripple.size == 0


@pytest.mark.parametrize("freedom", [3, 10, 100])
def test_the_size_of_an_effect_without_noise_has_its_closed_form(freedom: int) -> None:
    """E[s] = √(Σ x²/2) Γ(n/2)/Γ((n + 1)/2); noise counts as at least MIN_NOISE_SHARE of it."""
    size, _ = posterior_size(7.0, freedom, 0.0)
    expected = np.sqrt(7.0 / 2) * gamma(freedom / 2) / gamma((freedom + 1) / 2)
    assert size == pytest.approx(expected, rel=3 * MIN_NOISE_SHARE**2)


@pytest.mark.parametrize("freedom", [1, 3, 30])
def test_the_size_of_an_effect_scales_and_grows_with_its_squares(freedom: int) -> None:
    """Squares and noise times c² give c times the size."""
    means = []
    for squares in np.geomspace(0.01, 1e6, 9) * freedom:
        size = np.array(posterior_size(squares, freedom, 1.0))
        for factor in (1e-3, 30.0):
            scaled = posterior_size(squares * factor**2, freedom, factor**2)
            assert_allclose(scaled, factor * size, rtol=ROUNDING)
        means.append(size[0])
    assert np.all(np.diff(means) >= -ROUNDING * np.array(means[1:]))


def test_noise_of_small_panels_has_no_ripple_of_lines() -> None:
    """What the largest variance leaves of 4 × 4 cells in three frames is small."""
    rng = np.random.default_rng(7)
    loudness = np.ones((4, 4))
    for _ in range(300):
        deviation = rng.standard_normal((3, 4, 4))
        deviation -= deviation.mean(axis=0)
        assert not scatter(deviation, loudness, 2).line_ripple.size
