"""Pressure from resistance against pressures put in."""

import dataclasses

import numpy as np
import pytest

from lampest import Array, Cells, Panel, Scene, Simulation, SuctionCup, Temperature, Water
from lampest.apps.film.pressure import pressure_of
from lampest.panel.conditions import water_pressure
from lampest.panel.response import RESPONSE_SD, VACUUM_KPA, ratio_from_pressure
from lampest.recording.simulation.simulation import simulate

COOLING = Temperature(-0.003, 20.0, 8.0, 0.001)
AIR = Scene(Panel(4, 3))
ROUNDING_KPA = 1e-9
ROUNDING = 1e-12  # relative
SCENES = {
    "air": AIR,
    "water": Scene(Panel(4, 3), water=Water(70.0)),
    "cold": Scene(Panel(4, 3), temperature=COOLING),
    "cold water": Scene(Panel(4, 3), water=Water(3000.0), temperature=COOLING),
}


def log_change(pressure: Array, scene: Scene) -> Array:
    """ln(f(p_w + p)/f(p_w)) + α (T − T_b), written out once more; (frames, rows, columns)."""
    film = (
        9.81e-3 * (scene.water.top_row_depth_mm + 10 * np.arange(4))[:, None]
        if scene.water
        else 0.0
    )
    warm = scene.temperature
    shift = (
        warm.coefficient_per_kelvin * (warm.measured_celsius - warm.baseline_celsius)
        if warm
        else 0.0
    )
    return np.asarray(
        np.log(ratio_from_pressure(film + pressure) / ratio_from_pressure(film)) + shift
    )


@pytest.mark.parametrize("name", SCENES)
def test_pressures_come_back_from_their_cells(name: str) -> None:
    pressure = np.linspace(-20, 235, 2001)[:, None, None] * np.ones((4, 3))
    ratio = np.exp(log_change(pressure, SCENES[name]))
    pressed = pressure_of(ratio, ratio, ratio, SCENES[name])
    np.testing.assert_allclose(pressed.pressure, pressure, atol=ROUNDING_KPA)
    assert np.all(np.diff(pressed.pressure, axis=0) > 0)
    for ends in (pressed.lower, pressed.upper):
        assert np.all(np.diff(ends, axis=0) > 0)
    assert np.all((pressed.lower <= pressed.pressure) & (pressed.pressure <= pressed.upper))


def test_the_simulation_applies_the_response_of_the_scene() -> None:
    scene = Scene(Panel(8, 8), water=Water(50.0), temperature=COOLING)
    cup = SuctionCup(
        centre_mm=(35, 35), inner_diameter_mm=27, outer_diameter_mm=35, pressure_kpa=-8
    )
    simulation = Simulation(
        schema=1, seed=3, scene=scene, cells=Cells(), baseline_frames=1, frames=3, loads=(cup,)
    )
    recording = simulate(simulation)
    cells = recording.truth_cell_resistance
    pressure = recording.truth_pressure
    ratio = cells[1:] / cells[0]
    pressed = pressure_of(ratio, ratio, ratio, scene)
    np.testing.assert_allclose(
        pressed.pressure, pressure[1:] - water_pressure(scene.panel, scene.water), atol=ROUNDING_KPA
    )
    assert pressed.pressure.min() < 0.9 * cup.pressure_kpa and pressed.pressure.max() > 5
    untold = simulate(dataclasses.replace(simulation, scene=Scene(Panel(8, 8)), water=Water(50.0)))
    np.testing.assert_array_equal(untold.truth_cell_resistance[0], cells[0])
    np.testing.assert_allclose(
        cells[1:] / untold.truth_cell_resistance[1:], np.exp(0.036), rtol=ROUNDING
    )


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("sd", [0.003, 0.05, 0.2])
def test_the_interval_covers_the_truth(name: str, sd: float) -> None:
    """Estimate, response and temperature coefficient are drawn 4,000 times with their errors."""
    generator = np.random.default_rng([7, round(1000 * sd)])
    scene = SCENES[name]
    draws = 4000
    pressure = generator.uniform(-6, 20, (draws, 4, 3))
    warm = scene.temperature
    shift = warm.logarithm if warm else 0.0
    change = (log_change(pressure, scene) - shift) * (
        1 + RESPONSE_SD * generator.standard_normal(pressure.shape)
    )
    change += shift + sd * generator.standard_normal(pressure.shape)
    if warm:
        error = warm.coefficient_sd_per_kelvin * generator.standard_normal(pressure.shape)
        change += error * (warm.measured_celsius - warm.baseline_celsius)
    pressed = pressure_of(
        np.exp(change), np.exp(change - 1.96 * sd), np.exp(change + 1.96 * sd), scene
    )
    covered = np.mean((pressed.lower <= pressure) & (pressure <= pressed.upper))
    five_standard_errors = 5 * np.sqrt(0.95 * 0.05 / draws)
    assert abs(covered - 0.95) < five_standard_errors
    within = np.mean(np.abs(pressed.pressure - pressure) < pressed.errors)
    assert 0.5 < within < 0.75, "68 % of a normal distribution; a curve bends it"


def test_pressures_are_flagged_where_the_curve_ends() -> None:
    pressure = np.array([-10.5, -9.0, -8.0, 0.0, 20.0, 30.9, 31.5, 200.0])[:, None, None] * np.ones(
        (4, 3)
    )
    ratio = np.exp(log_change(pressure, AIR))
    flags = pressure_of(ratio, ratio, ratio, AIR).saturated
    assert flags.dtype == np.uint8
    # The scatter of the response alone reaches from −9 kPa below −10 and from 31 kPa beyond 40.
    np.testing.assert_array_equal(flags[:, 0, 0], [1, 1, 0, 0, 0, 0, 1, 1])
    uncertain = pressure_of(ratio, ratio / 5, ratio * 5, AIR).saturated
    np.testing.assert_array_equal(uncertain[:, 0, 0], [1, 1, 1, 0, 1, 1, 1, 1])
    deep = dataclasses.replace(AIR, water=Water(3000.0))  # 29 kPa of water stand on the film, too
    for scene, flag in ((AIR, 0), (deep, 1)):
        pressed = np.exp(log_change(np.full((1, 4, 3), 12.0), scene))
        assert np.all(pressure_of(pressed, pressed, pressed, scene).saturated == flag)


def test_open_and_unseen_cells_and_failed_frames_have_marked_pressures() -> None:
    ratio = np.full((1, 4, 3), 50.0)
    ratio[0, 0] = 1.0
    lower = 0.5 * ratio
    upper = np.full_like(ratio, np.inf)
    lower[0, 1] = 0.0
    for scene in (AIR, SCENES["water"]):
        pressed = pressure_of(ratio, lower, upper, scene)
        water = water_pressure(scene.panel, scene.water)
        np.testing.assert_allclose(pressed.lower[0] + water, VACUUM_KPA)
        assert np.all(np.isinf(pressed.upper[0]) == (np.arange(4) == 1)[:, None])
        assert np.all(np.isinf(pressed.errors[0]) == (np.arange(4) == 1)[:, None])
        assert np.all(pressed.saturated == 1)
        assert not np.any(np.isnan([pressed.pressure, pressed.lower, pressed.errors]))
    failed = np.where(np.arange(2)[:, None, None] == 1, np.nan, np.ones((2, 4, 3)))
    pressed = pressure_of(failed, failed, failed, SCENES["cold water"])
    for values in (pressed.pressure, pressed.lower, pressed.upper, pressed.errors):
        np.testing.assert_array_equal(np.isnan(values), np.isnan(failed))
    assert np.all(pressed.saturated[1] == 0)
