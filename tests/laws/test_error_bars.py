"""Error bars obey the rules of variances."""

from dataclasses import fields
from typing import Literal

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import (
    Array,
    Estimator,
    LogGradient,
    Misfit,
    Panel,
    Readings,
    Scene,
    Term,
    two_point_resistance,
)
from lampest.cost.given import Background
from lampest.posterior.certainty import Certainty
from lampest.posterior.covariance import DenseErrors
from lampest.posterior.linear import IGNORANCE, LinearModel
from lampest.solvers.multistart import evaluated

SHAPES = ((1, 5), (4, 3), (5, 6))
every_shape = pytest.mark.parametrize("shape", SHAPES)
ROUNDING = 1e-9  # relative: float64 times the condition of the normal matrix, below 1e6
Weighting = Literal["plain", "noise"]
PENALTY = LogGradient(weight=3e4)  # about as informative as the readings


def variances(
    shape: tuple[int, int], sigma: Array, *penalties: Term, weighting: Weighting = "noise"
) -> Array:
    """Variances of log r of equal cells, which the readings and the penalties fit exactly."""
    scene = Scene(Panel(*shape))
    cells = np.full((1, *shape), 2500.0)
    estimator = Estimator((Misfit(weighting=weighting), *penalties), "reduced")
    readings = Readings.of(scene, two_point_resistance(cells), sigma[None])
    data = estimator.data(readings, Background(scene))
    at = evaluated(estimator.cost(scene, 1), data, cells)
    return DenseErrors(LinearModel(at, np.zeros(0))).variance


def noise_of(shape: tuple[int, int]) -> Array:
    return np.asarray(np.random.default_rng(shape).uniform(1.0, 20.0, shape))


@every_shape
def test_error_bars_are_proportional_to_the_noise(shape: tuple[int, int]) -> None:
    """With a penalty, too, if its weight falls as the squared noise grows."""
    sigma = noise_of(shape)
    for factor in (0.1, 3.0):
        weaker = LogGradient(weight=PENALTY.weight / factor**2)
        for penalties, scaled in (((), ()), ((PENALTY,), (weaker,))):
            variance = variances(shape, sigma, *penalties)
            # The prior precision of log r does not scale; it takes off its product with the
            # largest eigenvalue of the covariance, which is less than the sum of the variances.
            of_prior = IGNORANCE * max(factor, 1) ** 2 * variance.sum()
            assert_allclose(
                variances(shape, factor * sigma, *scaled),
                factor**2 * variance,
                rtol=of_prior + ROUNDING,
            )


@every_shape
def test_as_many_readings_as_cells_give_equal_error_bars_by_any_weighting(
    shape: tuple[int, int],
) -> None:
    """Without penalties, J⁻¹ diag(σ²) J⁻ᵀ."""
    sigma = noise_of(shape)
    variance = variances(shape, sigma)
    of_prior = IGNORANCE * np.max(sigma) ** 2 / np.min(sigma) ** 2 * variance.sum()
    assert_allclose(variances(shape, sigma, weighting="plain"), variance, rtol=of_prior + ROUNDING)


@every_shape
def test_more_information_never_widens_an_error_bar(shape: tuple[int, int]) -> None:
    """More precise readings, a penalty, and a stronger one; any of them narrows some."""
    sigma = noise_of(shape)
    rng = np.random.default_rng(1)
    precise = np.where(rng.random(shape) < 0.5, 0.3, 1.0)
    precise[0, 0] = 0.3
    stronger = LogGradient(weight=3 * PENALTY.weight)
    for sharper, wider in (
        (variances(shape, precise * sigma), variances(shape, sigma)),
        (variances(shape, precise * sigma, PENALTY), variances(shape, sigma, PENALTY)),
        (variances(shape, sigma, PENALTY), variances(shape, sigma)),
        (variances(shape, sigma, stronger), variances(shape, sigma, PENALTY)),
    ):
        assert np.all(sharper <= (1 + ROUNDING) * wider) and np.min(sharper / wider) < 0.9


@every_shape
def test_the_mean_of_frames_is_as_precise_as_their_number_allows(shape: tuple[int, int]) -> None:
    """σ/√n of n frames in any order; the mean of means of equal parts is the mean of all."""
    rng = np.random.default_rng(shape)
    value = rng.uniform(900, 1100, (12, *shape))
    sigma = np.broadcast_to(noise_of(shape), value.shape)

    def mean_of(frames: Array) -> Readings:
        readings = Readings.of(Scene(Panel(*shape)), value[frames], sigma[frames])
        return readings.mean()

    everything = mean_of(np.arange(12))
    for count in (1, 3, 12):
        assert_allclose(mean_of(np.arange(count)).sigma, sigma[0] / np.sqrt(count), rtol=ROUNDING)
    shuffled = mean_of(rng.permutation(12))
    assert_allclose(shuffled.value, everything.value, rtol=ROUNDING)
    parts = [mean_of(frames).value for frames in np.arange(12).reshape(3, 4)]
    assert_allclose(np.mean(parts, axis=0), everything.value, rtol=ROUNDING)


def certainty_of(rng: np.random.Generator, shape: tuple[int, ...]) -> Certainty:
    parts = rng.uniform(0.1, 2.0, (6, *shape))
    return Certainty(*parts[:5], 0.9 * np.minimum(parts[0], parts[5]))


@pytest.mark.parametrize("shape", [(1, 2, 3), (3, 4, 4)])
def test_further_independent_errors_add_up_in_any_order(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(shape)
    certainty = certainty_of(rng, shape)
    first, second = (rng.standard_normal((np.prod(shape), count)) for count in (1, 4))
    unchanged = certainty.widened(np.zeros((np.prod(shape), 2)))
    orders = (
        certainty.widened(first).widened(second),
        certainty.widened(second).widened(first),
        certainty.widened(np.hstack([first, second])),
    )
    for field in fields(Certainty):
        before, after, *reorderings = (getattr(each, field.name) for each in (certainty, *orders))
        assert_allclose(getattr(unchanged, field.name), before, rtol=ROUNDING)
        for reordered in reorderings:
            assert_allclose(reordered, after, rtol=ROUNDING)
    added = np.sum(np.hstack([first, second]) ** 2, axis=1).reshape(shape)
    assert_allclose(orders[0].deviation ** 2 - certainty.deviation**2, added, rtol=ROUNDING)
    assert np.all(orders[0].common <= orders[0].deviation)


@pytest.mark.parametrize("shape", [(1, 2, 3), (3, 4, 4)])
def test_the_interval_of_a_change_is_mirrored_with_its_sign(shape: tuple[int, ...]) -> None:
    """The change from b to a reaches as far above as that back below; shared errors cancel."""
    rng = np.random.default_rng(shape)
    frame = certainty_of(rng, shape)
    baseline = certainty_of(rng, shape)
    shared = rng.uniform(0, 0.2, shape) * np.minimum(frame.deviation, baseline.deviation) ** 2
    forth = frame.less(baseline, shared)
    back = baseline.less(frame, shared)
    assert_allclose(forth.deviation, back.deviation, rtol=ROUNDING)
    assert_allclose(forth.below, back.above, rtol=ROUNDING)
    assert_allclose(forth.above, back.below, rtol=ROUNDING)
    assert_allclose(
        forth.deviation**2 + 2 * shared, frame.deviation**2 + baseline.deviation**2, rtol=ROUNDING
    )
    itself = frame.less(frame, frame.deviation**2, frame.common**2)
    assert_allclose([itself.deviation, itself.common], 0, atol=1e-7)  # root of rounding
