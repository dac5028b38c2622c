"""Ends of lines that a scene leaves out: doubted where readings may show them, else named."""

from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest

from lampest import (
    Array,
    DrivenReadout,
    GroundedReadout,
    NeighbourLeaks,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
)
from lampest.inference.prepared import Prepared
from tests.netlist import two_point_resistances, volts

UNLOADED = 5
CONVERTER: dict[str, Any] = {"supply_volt": 5.0, "adc_bits": 12, "readings": 1}
GROUNDED = GroundedReadout(
    sense="one", load_ohm=10_000.0, drive_ohm=30.0, **(CONVERTER | {"adc_bits": 10})
)
HELD = "readout: {idle_load_ohm: 0} (ends of idle columns, as of outputs at LOW)"
LEAK_OHM = 6000.0
SHEET = NeighbourLeaks(rows=LEAK_OHM, columns=LEAK_OHM)


def soft_load(random: np.random.Generator, shape: tuple[int, int], level: float) -> Array:
    """Return cells of unloaded frames and of three under two soft loads, (frames, …) ohm."""
    row, column = np.indices(shape)
    resting = level * np.exp(0.23 * random.standard_normal(shape))
    first = 0.8 * np.exp(-((row - 2) ** 2 + (column - 2) ** 2) / 5.0)
    second = 0.65 * np.exp(-((row - shape[0] + 1.5) ** 2 + (column - shape[1] + 2) ** 2) / 4.0)
    film = np.exp(0.001 * random.standard_normal((UNLOADED + 3, *shape)))
    factor = np.ones((UNLOADED + 3, *shape))
    factor[UNLOADED:] -= np.maximum(first, second)
    return np.asarray(resting * factor * film)


def pressed(random: np.random.Generator, shape: tuple[int, int], level: float) -> Array:
    """Return cells of unloaded frames and of three in which four cells are pressed, ohm."""
    cells = np.repeat(level * np.exp(0.23 * random.standard_normal((1, *shape))), 8, axis=0)
    cells[UNLOADED:, 2:4, 3:5] *= 0.25
    return np.asarray(cells * np.exp(0.001 * random.standard_normal(cells.shape)))


def check_of(random: np.random.Generator, scene: Scene, cells: Array, built: Any) -> Any:
    """Return the check of a recording by the circuit that is built, with noise of 0.7 LSB."""
    volt = np.array([volts(frame, built) for frame in cells])
    return check_of_volts(random, scene, volt)


def check_of_volts(random: np.random.Generator, scene: Scene, volt: Array) -> Any:
    readout: Any = scene.readout
    noisy = volt + 0.7 * readout.lsb_volt * random.standard_normal(volt.shape)
    codes = np.clip(np.rint(readout.code_from_volt(noisy)), 0, 2**readout.adc_bits - 1)
    return Prepared(
        Recording.from_array(1.0 * codes, unit="code", scene=scene, baseline=UNLOADED)
    ).check


def check_of_sheet(cells: Array, random: np.random.Generator, built: float, **keys: Any) -> Any:
    """Return the check of a two-point recording of a mat whose strips leak by so many ohm."""
    readout = TwoPointReadout(reference_ohm=1000.0, measured_across="reference", **CONVERTER)
    ohm = np.array([two_point_resistances(frame, built) for frame in cells])
    volt = readout.volt_from_recorded(ohm)
    scene = Scene(Panel(*cells.shape[1:]), readout, purpose="mat", **keys)
    return check_of_volts(random, scene, volt)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(8, 8), (6, 9)])
def test_idle_columns_that_may_be_held_are_a_doubt_until_the_scene_states_them(
    shape: tuple[int, int],
) -> None:
    random = np.random.default_rng(7)
    cells = soft_load(random, shape, 12_000.0)
    built = replace(GROUNDED, idle_load_ohm=30.0)
    silent = check_of(random, Scene(Panel(*shape), GROUNDED), cells, built)
    assert silent.mark == "doubtful" and not silent.compared
    assert HELD in silent.sentence and "smaller" in silent.sentence
    assert "no other known one" not in silent.sentence
    assert "state what idle columns end in (.inf: nothing)" in silent.sentence
    stated = check_of(random, Scene(Panel(*shape), built), cells, built)
    assert stated.mark == "yes" and "idle_load_ohm" not in stated.sentence


@pytest.mark.slow
def test_a_press_shows_that_idle_columns_float_and_that_nothing_leaks() -> None:
    random = np.random.default_rng(8)
    readout = replace(GROUNDED, load_ohm=4700.0, sense_ohm=70.0, adc_bits=12)
    cells = pressed(random, (8, 8), 4000.0)
    check = check_of(random, Scene(Panel(8, 8), readout, purpose="mat"), cells, readout)
    assert check.mark == "yes" and check.compared
    assert "exclude" not in check.sentence and "about as likely" not in check.sentence


@pytest.mark.slow
def test_idle_columns_that_are_stated_to_float_are_no_question() -> None:
    random = np.random.default_rng(9)
    readout = replace(GROUNDED, idle_load_ohm=inf)
    cells = soft_load(random, (8, 8), 12_000.0)
    check = check_of(random, Scene(Panel(8, 8), readout), cells, readout)
    assert check.mark == "yes" and "idle_load_ohm" not in check.sentence


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_one_sheet_of_film_is_a_doubt_or_named_and_none_where_the_scene_states_it(
    seed: int,
) -> None:
    random = np.random.default_rng(seed)
    cells = soft_load(random, (8, 8), 5000.0)
    silent = check_of_sheet(cells, random, LEAK_OHM)
    assert "leak_ohm: {rows: " in silent.sentence and "larger" in silent.sentence
    stated = check_of_sheet(cells, random, LEAK_OHM, leak_ohm=SHEET)
    assert stated.mark == "yes" and "leak_ohm" not in stated.sentence


@pytest.mark.slow
def test_soft_loads_on_cut_squares_leave_a_right_circuit_its_yes_and_say_what_they_hide() -> None:
    random = np.random.default_rng(3)
    check = check_of_sheet(soft_load(random, (8, 8), 5000.0), random, inf)
    assert check.mark == "yes" and "they do not exclude leak_ohm: {rows: " in check.sentence


@pytest.mark.slow
def test_pull_downs_that_may_stay_are_named() -> None:
    random = np.random.default_rng(4)
    switched = DrivenReadout(
        drive_ohm=300.0,
        idle_ohm=2200.0,
        load_ohm=10_000.0,
        idle_load_ohm=inf,
        **CONVERTER,
    )
    cells = soft_load(random, (4, 4), 6000.0)
    staying = replace(switched, idle_stays=True)
    check = check_of(random, Scene(Panel(4, 4), switched), cells, staying)
    assert "readout: {idle_stays: true} (resistors that stay at driven rows)" in check.sentence
    stated = check_of(random, Scene(Panel(4, 4), staying), cells, staying)
    assert stated.mark == "yes" and "idle_stays" not in stated.sentence
