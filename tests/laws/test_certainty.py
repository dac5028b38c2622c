"""Arithmetic of intervals: how far they reach at bounds, with further errors, and by conductance."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.testing import assert_allclose

from lampest.posterior.certainty import Certainty


def test_an_interval_ends_at_the_bounds_but_for_the_noise_of_the_reading() -> None:
    """Cells of 100 Ω ± 10 %: free, near the lower and the upper bound, between two that are one, and held at either."""
    cells = np.full((1, 1, 6), 100.0)
    lower, upper = np.log([[[50.0, 99.0, 50.0, 100.0, 100.0, 50.0]], [[500.0, 500.0, 101.0, 100.0, 500.0, 100.0]]])
    data = SimpleNamespace(log_bounds=(lower, upper), sigma=np.full((1, 1, 6), 0.5), measured=cells)
    at = SimpleNamespace(cell_resistance=cells, position=np.log(cells), data=data)
    held = np.arange(6) == np.array([[4], [5]])
    model: Any = SimpleNamespace(at=at, free=np.arange(4), at_lower=held[0], at_upper=held[1], scale=0.5)
    model.gradient = np.full(6, 1e5)  # so steep that the density is exponential, with the slope 1e5
    shares = np.full(4, 0.7), np.full(4, 0.91)
    found = Certainty.of(model, (np.full(4, 0.01), np.full(4, 0.0036)), shares, lambda cells: np.ones(len(cells)))
    reach, noise, tail = 0.1959964, 1.959964 * 0.005, -np.log(0.05) / 1e5
    assert_allclose(found.deviation, [[[*[0.1] * 4, 1e-5, np.inf]]])
    assert_allclose(found.own[..., :4], 0.08)
    assert_allclose(found.below, [[[reach, np.log(100 / 99) + noise, reach, noise, noise, tail]]], rtol=1e-6)
    assert_allclose(found.above, [[[reach, reach, np.inf, reach, tail, np.inf]]], rtol=1e-6)
    assert_allclose((found.resolution, found.data_share), np.multiply.outer([0.7, 0.91], [[[1, 1, 1, 1, 0, 0]]]))
