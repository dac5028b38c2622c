"""Statistics of the report against closed forms and brute force."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter
from support import invented_case

from lampest.apps.page.compared import (
    Batch,
    advise,
    comparison_of,
    mean_interval,
    positive_mean_interval,
    predicted,
    ratio_interval,
)
from lampest.apps.page.page import disagreements
from lampest.runs.results import CaseResult

SHAPE = (4, 3, 3)
DRAWS = 2000
# Three standard errors of the share of these draws that 95 % intervals contain.
COVERAGE_ERROR = 0.015
SERIES = 200
# 95 % less, and 49 % (of intervals a third as wide) plus, three standard errors of the share.
MIN_HELD = 0.9
MAX_HELD_BY_NARROW = 0.6
MEAN_SQUARE_ERROR = 0.03  # relative: two standard deviations of the mean of 10,000 squares, √(2/n)


@pytest.mark.parametrize("count", [2, 3, 10, 30])
def test_intervals_of_a_mean_contain_it(count: int) -> None:
    rng = np.random.default_rng(1)
    held = 0
    for values in rng.standard_normal((DRAWS, count)):
        interval = mean_interval(values, count)
        assert (
            interval.value == pytest.approx(values.mean())
            and interval.lower < interval.value < interval.upper
        )
        held += interval.lower <= 0 <= interval.upper
    assert 0.95 - COVERAGE_ERROR <= held / DRAWS <= 0.95 + COVERAGE_ERROR
    assert mean_interval(values[:1], 1).upper == np.inf


def test_an_interval_of_an_error_ends_above_zero() -> None:
    """On the logarithmic scale its ends are equally far, and the usual ones of a sure mean."""
    wide = positive_mean_interval(np.array([1.0, 11.0]), 2)
    assert 0 < wide.lower < wide.value < wide.upper
    assert wide.value / wide.lower == pytest.approx(wide.upper / wide.value)
    sure = np.array([10.0, 10.01, 9.99])
    narrow = mean_interval(sure, 3)
    assert positive_mean_interval(sure, 3).lower == pytest.approx(narrow.lower, rel=1e-4)
    assert positive_mean_interval(np.zeros(3), 3).value == 0


def test_an_interval_of_a_ratio_of_errors_ends_above_zero_and_holds_the_ratio() -> None:
    """The paired ratio of units of very different size is precise, unlike their difference."""
    references = np.array([0.1, 1.0, 10.0])
    sure = ratio_interval(2.0 * references, references, 3)
    assert (sure.lower, sure.value, sure.upper) == pytest.approx((2, 2, 2))
    wide = ratio_interval(np.array([1.0, 11.0]), np.array([3.0, 2.0]), 2)
    assert 0 < wide.lower < 1 < wide.upper and wide.value == pytest.approx(12 / 5)
    rng = np.random.default_rng(2)
    held = 0
    for logs in 0.2 * rng.standard_normal((DRAWS, 2, 6)):
        interval = ratio_interval(*np.exp(logs), 6)
        held += interval.lower <= 1 <= interval.upper
    assert 0.95 - COVERAGE_ERROR <= held / DRAWS <= 0.95 + COVERAGE_ERROR


def test_the_advice_says_that_two_recordings_are_few() -> None:
    for count in (2, 3):
        cases = [
            dataclasses.replace(
                invented_case(estimator, shape=SHAPE),
                recording=f"day {number}",
                measured=invented_case(estimator, shape=SHAPE).measured + number,
            )
            for number in range(count)
            for estimator in ("A", "B")
        ]
        batch = Batch.of(("results.h5",), cases)
        warnings = advise(batch, comparison_of(batch)).warnings
        assert any("2 recordings are few" in warning for warning in warnings) == (count == 2)


def test_parts_widen_the_interval_of_correlated_frames() -> None:
    """For x_t = 0.8 x_{t−1} + e the mean varies 1.8/0.2 = 9 times as much."""
    held = np.zeros(2)
    for noise in np.random.default_rng(3).standard_normal((SERIES, 300)):
        series = lfilter([1.0], [1.0, -0.8], noise)[100:]
        intervals = [mean_interval(series, parts) for parts in (5, 200)]
        held += [interval.lower <= 0 <= interval.upper for interval in intervals]
    assert held[0] > MIN_HELD * SERIES and held[1] < MAX_HELD_BY_NARROW * SERIES


def with_change(estimator: str, change: float, below: float, above: float) -> CaseResult:
    case = invented_case(estimator, shape=SHAPE)
    values = np.full(SHAPE, change)
    ends = {"relative_change_lower": values - below, "relative_change_upper": values + above}
    return dataclasses.replace(case, relative_change=values, **ends)


def test_estimates_differ_where_their_joint_interval_excludes_zero() -> None:
    """Two normal errors of 3 and 4: the difference has 5."""
    for change, expected in ((1.96 * 5 + 0.01, True), (1.96 * 5 - 0.01, False)):
        pair = disagreements(
            [
                with_change("A", change, 1.96 * 3, 1.96 * 3),
                with_change("B", 0.0, 1.96 * 4, 1.96 * 4),
            ]
        )
        assert (
            np.all(np.isfinite(pair[0].significant) == expected) and pair[0].share == 100 * expected
        )
    facing = [with_change("A", 6.0, 3.0, 1e6), with_change("B", 0.0, 1e6, 4.0)]
    assert disagreements(facing)[0].share == 100 and disagreements(facing[::-1])[0].share == 100
    assert np.all(disagreements(facing[::-1])[0].significant == -6)
    assert (
        disagreements([with_change("A", 6.0, 3.0, np.inf), with_change("B", 0.0, 1.0, np.inf)])[
            0
        ].share
        == 0
    )
    assert disagreements([invented_case("A"), with_change("B", 0.0, 1.0, 1.0)]) == ()


def test_the_prediction_error_is_the_deviation_of_fresh_readings() -> None:
    """For the model s·y, E|fresh − model|² = 1 + s² + (1 − s)²·signal, in units of the noise."""
    rng = np.random.default_rng(5)
    shape = (400, 5, 5)
    signal = 0.7 * rng.standard_normal(shape) + 50
    readings, fresh = (signal + rng.standard_normal(shape) for _ in range(2))
    case = invented_case(shape=shape, truth=False)
    for share in (0.2, 0.5, 1.0):
        model = 50 + share * (readings - 50)
        known = dataclasses.replace(
            case,
            measured=readings,
            sigma=np.ones(shape),
            reading_model=model,
            resolution=np.full(shape, share),
        )
        expected = 1 + share**2 + (1 - share) ** 2 * 0.49
        assert np.mean(predicted(known)) == pytest.approx(expected, rel=MEAN_SQUARE_ERROR)
        assert np.mean((fresh - model) ** 2) == pytest.approx(expected, rel=MEAN_SQUARE_ERROR)
        # Outliers do not decide.
        far = predicted(dataclasses.replace(known, reading_model=model + 100))
        assert np.all(far == 25 + 2 * share)
