"""Driven circuits whose line ends have potentials, against netlists of resistors."""

from dataclasses import replace
from itertools import product
from math import inf
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from promises import promise

import lampest
from lampest import (
    Array,
    DrivenReadout,
    GroundedReadout,
    LoadedColumnsReadout,
    Misfit,
    Panel,
    Recording,
    Scene,
    VirtualGroundReadout,
)
from tests.netlist import volts

ROWS, COLUMNS = SHAPE = (4, 6)
SOURCE = 5.0
IDLE_OHM = (inf, 0.0, 330.0)
IDLE_LOAD_OHM = (None, inf, 0.0, 2200.0)
IDLE_VOLT = (None, 1.5, "follows")
LOAD_VOLT = (None, 2.5)
PAIRS = ((0, 2, 4), (5, 1, 3))
ROW_PAIRS = ((0, 1), (3, 2))


def cells_of(seed: int, shape: tuple[int, int] = SHAPE, contrast: float = 1.0) -> Array:
    return 2000 * np.exp(contrast * np.random.default_rng(seed).uniform(-2, 2, shape))


def recorded(readout: Any, cells: Array) -> Array:
    scene = Scene(Panel(*cells.shape), readout)
    return np.asarray(readout.to_recorded(readout.exact_reading(cells), scene))


def combinations() -> dict[str, DrivenReadout]:
    """Circuits of all combinations of idle states, potentials and sides that are one."""
    circuits = {}
    for idle, idle_load, volt, load_volt, driven in product(
        IDLE_OHM, IDLE_LOAD_OHM, IDLE_VOLT, LOAD_VOLT, ("rows", "columns")
    ):
        keys: dict[str, Any] = {"idle_ohm": idle, "idle_load_ohm": idle_load, "driven": driven}
        if idle < inf:
            keys["idle_volt"] = volt
        elif volt is not None:
            # Floating lines have no potential: the idle sensed lines get one of their own
            if idle_load in (None, inf):
                continue
            keys["idle_load_volt"] = 3.5 if volt == "follows" else 0.8
        keys["load_volt"] = load_volt
        circuits[str(keys)] = DrivenReadout(
            drive_ohm=70.0, load_ohm=1000.0, sense_ohm=30.0, supply_volt=SOURCE, **keys
        )
    return circuits


OTHERS: dict[str, Any] = {
    "mid-supply loads": LoadedColumnsReadout(load_ohm=1e5, drive_ohm=70.0, load_volt=2.5),
    "mid-supply loads, driven low": LoadedColumnsReadout(
        load_ohm=1e4, drive_ohm=70.0, load_volt=2.5, polarity="down"
    ),
    "mid-supply loads, converter": LoadedColumnsReadout(
        load_ohm=1e4, drive_ohm=70.0, load_volt=2.5, input_ohm=5e4
    ),
    "driven multiplexers": LoadedColumnsReadout(
        load_ohm=1e3, drive_ohm=70.0, driven_groups=ROW_PAIRS
    ),
    "driven multiplexers at a potential": DrivenReadout(
        load_ohm=1e3, drive_ohm=70.0, driven_groups=ROW_PAIRS, idle_volt=1.0
    ),
    "driven multiplexers without resistance": DrivenReadout(
        load_ohm=1e3, drive_ohm=0.0, driven_groups=ROW_PAIRS, idle_volt=1.0, load_volt=2.0
    ),
    "multiplexers on both sides": DrivenReadout(
        load_ohm=1e3, drive_ohm=70.0, driven_groups=ROW_PAIRS, groups=PAIRS, load_volt=1.2
    ),
    "multiplexers of columns, idle loads": DrivenReadout(
        load_ohm=1e3,
        drive_ohm=70.0,
        groups=PAIRS,
        load_volt=1.2,
        idle_load_ohm=900.0,
        idle_load_volt=3.0,
        idle_ohm=500.0,
        idle_volt=0.4,
    ),
    "inputs without a resistor": DrivenReadout(
        load_ohm=inf, drive_ohm=45.0, idle_ohm=45.0, idle_volt=1.0
    ),
    "grounded, mid-supply": GroundedReadout(load_volt=2.5, sense="one"),
    "grounded, feedback": GroundedReadout(idle_volt="follows"),
    "amplifiers at mid-supply": VirtualGroundReadout(
        sense_ohm=40.0, feedback_ohm=400.0, idle_volt=2.5, load_volt=2.5
    ),
    "amplifiers, idle columns higher": VirtualGroundReadout(
        sense_ohm=40.0, feedback_ohm=400.0, idle_volt=2.0, load_volt=1.0, idle_load_volt=1.5
    ),
}


@pytest.mark.slow
@promise(
    "howto/readouts: Loads, idle driven lines and idle sensed lines may end in a potential of "
    "their own"
)
def test_every_combination_of_potentials_agrees_with_its_netlist() -> None:
    circuits = combinations()
    assert len(circuits) >= 96
    for number, (name, readout) in enumerate(circuits.items()):
        cells = cells_of(number)
        assert_allclose(
            recorded(readout, cells), volts(cells, readout), rtol=1e-10, atol=1e-10, err_msg=name
        )


@pytest.mark.parametrize("name", OTHERS)
def test_every_circuit_with_potentials_agrees_with_its_netlist(name: str) -> None:
    readout = OTHERS[name]
    cells = cells_of(7)
    assert_allclose(recorded(readout, cells), volts(cells, readout), rtol=1e-10, atol=1e-10)


SOLVED = {
    name: OTHERS[name]
    for name in (
        "mid-supply loads",
        "driven multiplexers",
        "multiplexers on both sides",
        "grounded, mid-supply",
        "grounded, feedback",
        "amplifiers at mid-supply",
    )
} | {
    "pull-downs, mid-supply": DrivenReadout(
        idle_ohm=0.0, idle_volt=1.0, load_volt=2.5, drive_ohm=30.0
    )
}


def estimate_of(readout: Any, resting: Array, loaded: Array, formulation: str = "auto") -> Array:
    """Return the estimate of loaded cells, (rows, columns) ohm, by readings without noise."""
    scene = Scene(Panel(*resting.shape), replace(readout, adc_bits=16, noise_lsb=0.1, readings=1))
    frames = np.stack([volts(resting, readout), volts(loaded, readout)])
    recording = Recording.from_array(frames, unit="volt", scene=scene, baseline=1)
    terms = [Misfit(weighting="noise")]
    return lampest.reconstruct(recording, terms, formulation=formulation).cell_resistance[0]


@pytest.mark.parametrize("formulation", ["reduced", "nodal", "per_pixel"])
@pytest.mark.parametrize("name", SOLVED)
def test_every_formulation_finds_the_cells(name: str, formulation: str) -> None:
    resting = cells_of(5, contrast=0.2)
    loaded = resting.copy()
    loaded[1:3, 2:4] *= 0.3
    assert_allclose(estimate_of(SOLVED[name], resting, loaded, formulation), loaded, rtol=2e-3)


@pytest.mark.long
@pytest.mark.parametrize(
    ("readout", "shape", "pressed", "factor"),
    [
        (OTHERS["grounded, mid-supply"], SHAPE, ([1], [2]), 0.05),
        (
            LoadedColumnsReadout(drive_ohm=80.0, driven_groups=((0, 1, 2, 3), (4, 5, 6, 7))),
            (8, 5),
            ([1, 1, 1, 7], [1, 2, 3, 2]),
            0.1,
        ),
    ],
)
def test_bounds_of_a_hard_press_contain_its_cells(
    readout: Any, shape: tuple[int, int], pressed: Any, factor: float
) -> None:
    resting = cells_of(5, shape, contrast=0.2)
    loaded = resting.copy()
    # It moves the other readings of the column beyond those of any uniform panel.
    loaded[pressed] *= factor
    assert_allclose(estimate_of(readout, resting, loaded), loaded, rtol=2e-3)
