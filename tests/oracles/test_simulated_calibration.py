"""Error bars of cells drawn from a penalty's prior are calibrated, with a known weight and with a chosen one."""

import numpy as np
import pytest

from docs.studies.simulated_calibration import PRIORS, SETTINGS, calibration, prior_root, uniform_tail

DRAWS = 40


def test_uniform_values_lie_within_their_bands_and_others_do_not() -> None:
    rng = np.random.default_rng(1)
    tails = [uniform_tail(rng.uniform(size=50)) for _ in range(60)]
    assert 0 <= np.mean(np.array(tails) < 0.05) < 0.15 and np.median(tails) > 0.25
    assert uniform_tail(rng.uniform(size=100) ** 2) < 0.01, "biased"
    assert uniform_tail(0.5 + 0.4 * (rng.uniform(size=100) - 0.5)) < 0.01, "bars that are too wide"
    assert uniform_tail(np.round(rng.uniform(size=100))) < 0.01, "bars that are too narrow"


@pytest.mark.parametrize("name", PRIORS)
def test_draws_have_the_prior_that_the_penalty_implies(name: str) -> None:
    """E λ Σ x² = rank."""
    root = prior_root(PRIORS[name])
    assert root.shape == (36, 35) and np.allclose(root.sum(axis=0), 0, atol=1e-8)
    if name == "log_gradient":
        steps = np.diff(root.reshape(6, 6, 35), axis=0), np.diff(root.reshape(6, 6, 35), axis=1)
        assert sum(float(np.sum(step**2)) for step in steps) == pytest.approx(35)


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [False, True], ids=["known", "chosen"])
@pytest.mark.parametrize("level", SETTINGS)
@pytest.mark.parametrize("name", PRIORS)
def test_intervals_hold_draws_of_the_prior_as_often_as_they_say(name: str, level: str, chosen: bool) -> None:
    """Of 1,440 cells; where the weight is chosen and noise large, 40 draws are 40 weights."""
    found = calibration(PRIORS[name], *SETTINGS[level], chosen, DRAWS, 7)
    half, most, nearly_all = found.coverage
    if chosen:
        assert 0.42 < half < 0.62 and 0.72 < most < 0.93 and nearly_all > 0.88
        assert np.quantile(found.weights, 0.1) < 2 and np.quantile(found.weights, 0.9) > 0.5
    else:
        assert abs(half - 0.5) < 0.05 and abs(most - 0.8) < 0.04 and abs(nearly_all - 0.95) < 0.02
        assert np.allclose(found.weights, 1)
    assert min(found.uniformity) > 1e-3
