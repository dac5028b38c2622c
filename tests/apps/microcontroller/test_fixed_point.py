"""The study of fixed point, and the conclusions on its page."""

import numpy as np
import pytest

from docs.studies.fixed_point import FixedPoint, deviations, frames_of


@pytest.fixture(scope="module")
def frames():
    return frames_of(8, 4, np.random.default_rng(5))


@pytest.mark.parametrize(("bits", "all_arrays"), [(31, True), (15, False)])
def test_fixed_point_products_hold_a_fifth_of_a_standard_deviation(frames, bits, all_arrays):
    assert max(deviations(frames, 8, FixedPoint(bits), all_arrays)) < 0.2


def test_sixteen_bits_everywhere_are_several_times_less_exact(frames):
    exact = np.median(deviations(frames, 8, FixedPoint(None), False))
    assert np.median(deviations(frames, 8, FixedPoint(15), True)) > 3 * exact


@pytest.mark.parametrize("bits", [15, 31])
def test_a_product_of_matrices_is_exact_to_its_block(bits):
    rng = np.random.default_rng(1)
    first, second = rng.standard_normal((6, 7)), rng.standard_normal((7, 5))
    product = FixedPoint(bits).matrix_product(first, second)
    error = np.abs(product - first @ second).max()
    assert 0 < error < 30 * 2.0**-bits * np.abs(first @ second).max()
