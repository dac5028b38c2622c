"""The pressure response: the published points, strictly falling, and its own inverse."""

from dataclasses import replace
from itertools import product
from typing import get_args

import numpy as np
import pytest
from laws.samples import examples

from lampest import Film, Panel, PowerResponse, Scene, TableResponse, Water
from lampest.apps.film.pressure import pressure_of
from lampest.panel.conditions import water_pressure
from lampest.panel.response import AnyResponse, Response, ratio_from_pressure

RESPONSES = [
    *(example for member in get_args(get_args(AnyResponse)[0]) for example in examples(member)),
    TableResponse(pressure_kpa=(-5, 0, 1, 5, 20), resistance_ohm=(9e4, 3e4, 9e3, 2500, 800)),
    PowerResponse(exponent=0.8, scale_kpa=1.5),
]
EACH_RESPONSE = pytest.mark.parametrize("response", RESPONSES, ids=lambda response: response.kind)
ROUNDING = 1e-12  # float64 over seven interpolations
INVERSE_ROUNDING = 1e-9  # relative, of curves whose slope varies by three decades


@pytest.mark.parametrize(
    ("pressure", "change"),
    [
        (-10, 6.54),
        (0, 0),
        (1, -0.192),
        (2.5, -0.48),
        (10, -0.6),
        (28, -0.888),
        (40, -0.94),
        (235, -0.98),
    ],
)
def test_the_published_curve_passes_through_its_points(pressure: float, change: float) -> None:
    assert ratio_from_pressure(pressure) - 1 == pytest.approx(change, abs=ROUNDING)


@EACH_RESPONSE
def test_an_own_response_falls_strictly_from_1_and_is_inverted(response: Response) -> None:
    low, high = (2 * end for end in response.told_kpa)
    pressure = np.linspace(low - 1, high, 1001)
    assert np.all(np.diff(response.logarithm(pressure)) < 0)
    assert ratio_from_pressure(0.0, response) == pytest.approx(1.0)
    back = response.pressure(response.logarithm(pressure))
    np.testing.assert_allclose(
        back, pressure, rtol=INVERSE_ROUNDING, atol=INVERSE_ROUNDING * (high - low)
    )
    ends = response.pressure(np.array([-np.inf, np.inf, np.nan]))
    np.testing.assert_array_equal(ends, [np.inf, -np.inf, np.nan])


@EACH_RESPONSE
def test_pressures_pass_through_the_curve_and_gains_of_the_scene(response: Response) -> None:
    gain = ((0.7, 1.0, 1.3), (1.1, 0.9, 1.0))
    own = replace(response, gain=gain, gain_sd=None)
    pressure = np.linspace(0.1, 0.9, 7)[:, None, None] * own.told_kpa[1] * np.ones((2, 3))
    for water, film in product((None, Water(30.0)), (None, Film())):
        scene = Scene(Panel(2, 3), water=water, film=film, response=own)
        depth = water_pressure(scene.panel, water)
        change = np.array(gain) * (own.logarithm(depth + pressure) - own.logarithm(depth))
        pressed = pressure_of(np.exp(change), np.exp(change), np.exp(change), scene)
        np.testing.assert_allclose(pressed.pressure, pressure, rtol=INVERSE_ROUNDING)
