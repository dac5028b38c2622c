"""The published curve has one point under suction: bars contain films that answer along a straight line."""

import numpy as np
import pytest

from lampest.loads.pressure import pressure_of, suction_curve_sd
from lampest.panel.panel import Panel
from lampest.panel.response import PUBLISHED, TOLD_KPA, TableResponse
from lampest.panel.scene import Scene


@pytest.mark.parametrize("kpa", [-0.6, -2.0, -5.0, -10.0, -20.0, -26.0])
def test_the_interval_of_suction_contains_a_straight_film(kpa: float) -> None:
    """r grows along a line through the published point; the literature's suctions at rest are -0.6 to -26 kPa."""
    line = 1 + kpa / TOLD_KPA[0] * np.expm1(PUBLISHED.logarithm(TOLD_KPA[0]))
    ratio = np.full((1, 2, 2), line)
    found = pressure_of(
        ratio, 0.99 * ratio, 1.01 * ratio, Scene(Panel(2, 2), series_resistance_ohm=140.0, response=PUBLISHED)
    )
    assert np.all((found.lower < kpa) & (kpa < found.upper))
    assert np.all(found.errors < 0.6 * np.abs(found.pressure))


def test_a_measured_response_and_loads_that_press_have_no_such_error() -> None:
    table = TableResponse(pressure_kpa=(-10.0, 0.0, 5.0), resistance_ohm=(20000.0, 3000.0, 900.0))
    assert not suction_curve_sd(table, np.array([1.0])).any()
    assert not suction_curve_sd(PUBLISHED, np.array([-1.0, 0.0])).any()
    assert suction_curve_sd(PUBLISHED, PUBLISHED.logarithm(-10.0)) == pytest.approx(0.0, abs=1e-12)
