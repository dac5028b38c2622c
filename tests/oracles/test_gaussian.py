"""The posterior of a Gaussian unknown, against the conditional of its joint distribution."""

import numpy as np
import pytest

from lampest.posterior.gaussian import (
    Conditioned,
    Information,
    forms_over_scales,
    posterior_covariance,
)
from lampest.posterior.linear import misfit_and_volume


@pytest.mark.parametrize("seed", range(5))
def test_both_forms_are_the_conditional_of_the_joint_distribution(seed: int) -> None:
    rng = np.random.default_rng(seed)
    unknowns, sets = 4, 3
    columns = [rng.standard_normal((count, unknowns)) for count in (6, 2, 5)]
    noises = [
        0.1 * np.eye(len(part)) + np.cov(rng.standard_normal((len(part), 9))) for part in columns
    ]
    stacked = np.vstack(columns)
    noise = np.zeros((len(stacked), len(stacked)))
    first = 0
    for part in noises:
        noise[first : first + len(part), first : first + len(part)] = part
        first += len(part)
    readings = rng.standard_normal(len(stacked))
    # joint covariance of (z, d); its precision has the conditional's in the block of z
    joint = np.block([[np.eye(unknowns), stacked.T], [stacked, stacked @ stacked.T + noise]])
    precision = np.linalg.inv(joint)
    covariance = np.linalg.inv(precision[:unknowns, :unknowns])
    mean = -covariance @ precision[:unknowns, unknowns:] @ readings
    conditioned = Conditioned.on(stacked, noise, np.eye(unknowns))
    np.testing.assert_allclose(conditioned.mean(readings), mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(conditioned.covariance, covariance, rtol=1e-9, atol=1e-12)
    parts = np.split(readings, np.cumsum([len(part) for part in columns])[:-1])
    assert len(parts) == sets
    weighted = [part.T @ np.linalg.inv(own) for part, own in zip(columns, noises, strict=True)]
    pairs = zip(weighted, columns, parts, strict=True)
    one, two, three = (Information(part @ own, part @ read) for part, own, read in pairs)
    together = one + two + three
    np.testing.assert_allclose(together.mean, mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(together.covariance, covariance, rtol=1e-9, atol=1e-12)
    half = together.share(0.5)
    np.testing.assert_allclose(half.precision, together.precision / 2)


@pytest.mark.parametrize("count", [1, 2, 9])
def test_forms_over_scales_are_those_of_the_inverse(count: int) -> None:
    rng = np.random.default_rng(count)
    root = rng.standard_normal((count, count + 1))
    vectors = rng.standard_normal((count, 2))
    scales = np.array([0.0, 0.1, 3.0])
    forms, volumes = forms_over_scales(root @ root.T, vectors, scales)
    for scale, form, volume in zip(scales, forms, volumes, strict=True):
        matrix = np.eye(count) + scale**2 * root @ root.T
        np.testing.assert_allclose(form, vectors.T @ np.linalg.solve(matrix, vectors), rtol=1e-10)
        assert volume == pytest.approx(np.linalg.slogdet(matrix)[1], abs=1e-12)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_the_misfit_and_the_volume_are_those_of_the_density(count: int) -> None:
    """All cells may have moved, so that none is left."""
    rng = np.random.default_rng(count)
    root = rng.standard_normal((count, count + 2))
    deviation = rng.standard_normal(count)
    misfit, volume = misfit_and_volume(root @ root.T, deviation)
    assert misfit == pytest.approx(deviation @ np.linalg.solve(root @ root.T, deviation))
    assert volume == pytest.approx(np.linalg.slogdet(root @ root.T)[1])


def test_the_covariance_given_precise_readings_keeps_its_digits_beside_a_wide_prior() -> None:
    """Of independent unknowns in turned readings P − P Aᵀ S⁻¹ A P was off by 11 %."""
    prior, noise = 9.0, 1e-14
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((8, 8)))[0]
    exact = np.eye(8) * prior * noise / (prior + noise)
    given = posterior_covariance(turned, noise * np.eye(8), np.full(8, prior))
    np.testing.assert_allclose(given, exact, rtol=1e-12, atol=1e-12 * noise)


def test_an_unknown_without_a_prior_variance_stays_known() -> None:
    """A singular P, and the covariance of the other form where that has all its digits."""
    random = np.random.default_rng(2)
    columns = random.standard_normal((5, 4))
    root = random.standard_normal((4, 2)) * np.array([[1.0], [0.0], [1.0], [1.0]])
    noise = np.diag(random.uniform(0.5, 2.0, 5))
    given = posterior_covariance(columns, noise, root @ root.T)
    other = Conditioned.on(columns, noise, root @ root.T).covariance
    np.testing.assert_allclose(given, other, atol=1e-13)
    np.testing.assert_allclose(given[1], 0.0, atol=1e-14)
