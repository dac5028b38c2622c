"""Circuits that differ in the resistors of idle lines, under palms, feet and mouths."""

import re
from math import inf
from typing import Any

import numpy as np
import pytest
from promises import promise

from docs.studies.advice import advised
from docs.studies.effects import LOADS, Row
from docs.studies.effects import recording as drawn
from lampest import DrivenReadout, Panel, Recording, Scene
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array
from tests.estimates import recording_of

PULLED = {"idle_ohm": 4700.0}
BY_LOADS = {"idle_load_ohm": 1000.0}
IN_PARALLEL = {"groups": (tuple(range(5)), tuple(range(5, 10)))}
UNLOADED = 5


def circuit(**keys: Any) -> DrivenReadout:
    """Return a circuit whose idle lines float but for the keys."""
    floating: dict[str, Any] = {"idle_ohm": inf, "idle_load_ohm": inf}
    converter: dict[str, Any] = {"adc_bits": 12, "readings": 20, "noise_lsb": 0.7}
    return DrivenReadout(supply_volt=5.0, load_ohm=1000.0, **converter, **{**floating, **keys})


def feet(seed: int) -> Array:
    """Return cells under two feet that stand on a film, (frames, 10, 10) ohm."""
    rng = np.random.default_rng([seed, 77])
    row, column = np.indices((10, 10))
    fall = np.zeros((10, 10))
    for middle in (2.2, 6.8):
        across = column - middle - rng.uniform(-0.4, 0.4)
        down = row - rng.uniform(-0.4, 0.4)
        for centre, length, width, force in (
            (2.2, 1.6, 1.1, 1),
            (7, 1.3, 1, 1),
            (4.5, 3, 0.9, 0.4),
        ):
            fall += force * np.exp(-(((down - centre) / length) ** 2) - (across / width) ** 2)
    rest = 3000 * np.exp(0.1 * np.random.default_rng([seed, 5]).standard_normal((10, 10)))
    forces = np.array([0.0] * UNLOADED + [0.9, 1.0, 1.05, 0.95, 1.1, 0.9])
    return np.asarray(rest * np.exp(-forces[:, None, None] * fall))


def told(cells: Array, true: DrivenReadout, as_told: DrivenReadout, seed: int) -> Recording:
    """Return readings of a circuit with a scene that tells another one."""
    volt = true.volt_from_recorded(true.to_recorded(true.exact_reading(cells), scene_of(true)))
    noise = 0.7 * np.random.default_rng([seed, 9]).standard_normal((20, *volt.shape))
    codes = np.round(volt * 4095 / 5 + noise).clip(0, 4095).mean(axis=0)
    return recording_of(scene_of(as_told), codes * 5 / 4095, UNLOADED)


def scene_of(readout: DrivenReadout) -> Scene:
    """Return the scene of a panel with a readout."""
    return Scene(Panel(10, 10), readout)


def cells_under(load: str, seed: int) -> Array:
    """Return cells of every frame under a load, (frames, 10, 10) ohm."""
    cells = (
        feet(seed) if load == "feet" else drawn(seed, LOADS[load], Row(), {}).truth_cell_resistance
    )
    assert cells is not None
    return cells


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "keys", "number"),
    [
        ("palm", PULLED, r"readout.idle_(load_)?ohm: (\d+)"),
        ("mouth", PULLED, r"readout.idle_()ohm: (\d+)"),
        ("mouth", {"idle_load_ohm": 4700.0}, r"readout.idle_(load_)ohm: (\d+)"),
    ],
)
@promise("theory/model_check: resistors that hold idle lines, whose value is estimated;")
def test_the_resistor_of_idle_lines_is_named_with_its_value(
    load: str, keys: dict[str, float], number: str
) -> None:
    check = Prepared(told(cells_under(load, 1), circuit(**keys), circuit(), 1)).check
    found = re.search(number, check.better)
    assert check.mark == "no" and found, check.sentence
    assert float(found.group(2)) == pytest.approx(4700, rel=0.3 if load == "palm" else 0.03)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "keys", "name"),
    [
        ("feet", IN_PARALLEL, "read in parallel"),
        ("palm", BY_LOADS, "loaded_columns"),
    ],
)
@promise(
    "theory/model_check: Changed cells are single ones, or a smooth field within an outline or "
    "everywhere, such as a palm or two feet."
)
def test_a_circuit_is_named_under_loads_that_change_most_cells(
    load: str, keys: dict[str, Any], name: str
) -> None:
    """Single cells alone would rather have the wrong circuit under a palm."""
    check = Prepared(told(cells_under(load, 1), circuit(**keys), circuit(), 1)).check
    assert check.mark == "no" and name in check.better, check.sentence


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
@promise(
    "theory/model_check: Where single changed cells are likelier under the scene's circuit, "
    "that counts against the alternative."
)
def test_two_feet_are_no_other_circuit(seed: int) -> None:
    pulled = circuit(**PULLED)
    check = Prepared(told(feet(seed), pulled, pulled, seed)).check
    assert check.mark == "yes", check.sentence


@pytest.mark.slow
@pytest.mark.parametrize("seed", [17000, 17001, 17003, 17005])
def test_errors_of_readings_under_a_palm_are_no_other_circuit(seed: int) -> None:
    """By single changed cells alone, lines that are read in parallel explained them better."""
    expected = (("systematic.reading_error",),)
    found = advised(drawn(seed, LOADS["palm"], Row(static=0.02), {}), expected)
    assert found.mark == "doubtful" and found.right and not found.wrong, found
