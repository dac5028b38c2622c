"""The pressure response: the published points, strictly falling, and its own inverse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lampest.loads.response import (
    RESPONSE_SD,
    TOLD_KPA,
    pressure_from_logarithm,
    pressure_from_ratio,
    pressure_from_relative_change,
    ratio_from_pressure,
    relative_change_from_pressure,
)

pressures = st.floats(-60, 500)


@pytest.mark.parametrize(
    ("pressure", "change"),
    [(-10, 6.54), (0, 0), (1, -0.192), (2.5, -0.48), (10, -0.6), (28, -0.888), (40, -0.94), (235, -0.98)],
)
def test_published_points(pressure: float, change: float) -> None:
    assert relative_change_from_pressure(pressure) == pytest.approx(change, abs=1e-12)


@given(pressures, st.floats(1e-6, 100))
def test_strictly_falling(pressure: float, step: float) -> None:
    assert ratio_from_pressure(pressure + step) < ratio_from_pressure(pressure)


@given(pressures)
def test_inverse(pressure: float) -> None:
    assert pressure_from_ratio(ratio_from_pressure(pressure)) == pytest.approx(pressure, abs=1e-9)
    assert pressure_from_relative_change(relative_change_from_pressure(pressure)) == pytest.approx(pressure, abs=1e-9)


@given(st.floats(1e-3, 1e6))
def test_inverse_from_the_other_side(ratio: float) -> None:
    assert ratio_from_pressure(pressure_from_ratio(ratio)) == pytest.approx(ratio, rel=1e-9)


def test_continuous_at_the_joints() -> None:
    joints = np.array([0.0, 2.5, 28.0, 40.0])
    np.testing.assert_allclose(ratio_from_pressure(joints - 1e-9), ratio_from_pressure(joints + 1e-9), rtol=1e-8)


def test_any_shape() -> None:
    assert ratio_from_pressure(np.zeros((2, 3, 4))).shape == (2, 3, 4)


@pytest.mark.parametrize("ratio", [0.0, -1.0, float("nan")])
def test_no_pressure_for_an_impossible_ratio(ratio: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        pressure_from_ratio(np.array([1.0, ratio]))


@given(st.floats(-700, 700))
def test_inverse_in_logarithms(logarithm: float) -> None:
    assert pressure_from_logarithm(logarithm) == pytest.approx(pressure_from_ratio(np.exp(logarithm)), abs=1e-9)


def test_ends_of_the_logarithm() -> None:
    ends = pressure_from_logarithm(np.array([-np.inf, np.inf, np.nan, 0.0]))
    np.testing.assert_array_equal(ends, [np.inf, -np.inf, np.nan, 0.0])


def test_flat_begins_where_the_scatter_of_the_response_exceeds_the_pressure() -> None:
    """σ_p/p = RESPONSE_SD·|ln f|/(|d ln f/dp|·p) jumps over 1 at the end of TOLD_KPA, and the slope falls ninefold."""

    def slope(pressure: float) -> float:
        return float(-np.diff(np.log(ratio_from_pressure([pressure - 1e-3, pressure + 1e-3])))[0] / 2e-3)

    def relative(pressure: float) -> float:
        return float(-RESPONSE_SD * np.log(ratio_from_pressure(pressure)) / slope(pressure) / pressure)

    flat = TOLD_KPA[1]
    assert relative(flat - 0.01) < 0.2
    assert relative(flat + 0.01) > 1
    assert slope(flat - 0.01) / slope(flat + 0.01) == pytest.approx(9.2, abs=0.1)
