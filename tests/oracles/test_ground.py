"""A ground that idle driven lines share: the truth is a netlist with one more node."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.inference.prepared import Prepared
from lampest.panel.effects.ground import SharedGround
from lampest.panel.effects.line_effect import effect_on_readings
from lampest.recording.simulation.measure import Unmodelled, measured
from tests.netlist import network_of, potentials

GROUND_OHM = 8.0
SHAPE = (7, 6)
FRAMES, UNLOADED = 2, 5
NOISE_VOLT = 1e-4
CIRCUITS = {
    "loads stay": lampest.GroundedReadout(load_ohm=1000.0),
    "one load at a time": lampest.GroundedReadout(load_ohm=1000.0, sense="one"),
    "columns driven": lampest.GroundedReadout(driven="columns", load_ohm=1000.0),
    "rows at the supply": lampest.DrivenReadout(
        polarity="down", drive_ohm=40.0, idle_ohm=60.0, load_ohm=900.0
    ),
}
MIN_WITHIN = 0.9
MAX_WIDTH = 1.5  # of σ over the robust error


def netlist(cells: np.ndarray, circuit: lampest.Readout, ground_ohm: float) -> np.ndarray:
    """Return the recorded voltages of cells (rows, columns) ohm."""
    by_rows = circuit.driven == "rows"
    cells = cells if by_rows else cells.T
    low = 5.0 if getattr(circuit, "polarity", "up") == "down" else 0.0
    volts = np.zeros(cells.shape)
    for line, read in np.ndindex(cells.shape):
        parts = [
            (node, "shared" if node[0] == "d" and end == "low" else end, ohm)
            for node, end, ohm in network_of(cells, circuit, line, read)
        ]
        parts += [("shared", "low", ground_ohm)]
        held = {"high": 5.0 - low, "low": low}
        volts[line, read] = potentials(parts, held)["load", read]
    return volts if by_rows else volts.T


def panels(seed: int, factor: float = 0.5) -> np.ndarray:
    """Return cells (2, rows, columns) ohm, unloaded and with a press on a few of them."""
    cells = 3000.0 * np.exp(0.1 * np.random.default_rng(seed).standard_normal(SHAPE))
    loaded = cells.copy()
    loaded[2:5, 1:4] *= factor
    return np.stack([cells, loaded])


def recorded(circuit: lampest.Readout, seed: int, true_ohm: float, **keys: object) -> Prepared:
    """Return a recording of a netlist, prepared with these keys of its scene."""
    random = np.random.default_rng(seed)
    unloaded, loaded = (netlist(cells, circuit, true_ohm) for cells in panels(seed))
    volts = np.stack([unloaded] * UNLOADED + [loaded] * FRAMES)
    volts = volts + NOISE_VOLT * random.standard_normal(volts.shape)
    scene = lampest.Scene(lampest.Panel(*SHAPE), circuit, **keys)
    recording = lampest.Recording.from_array(volts, unit="volt", baseline=UNLOADED, scene=scene)
    return Prepared(replace(recording, sigma=np.full(SHAPE, NOISE_VOLT)))


@pytest.mark.parametrize("name", CIRCUITS)
def test_readings_and_derivatives_with_a_shared_ground_are_those_of_a_netlist(name: str) -> None:
    circuit = CIRCUITS[name]
    scene = lampest.Scene(lampest.Panel(*SHAPE), circuit)
    cells = panels(1)[1]
    ground = SharedGround((), size=GROUND_OHM)

    def reading(cells: np.ndarray) -> np.ndarray:
        network = circuit.network(cells, circuit.ties(cells))
        return network.reading() + effect_on_readings([ground], scene, network)

    truth = circuit.from_recorded(netlist(cells, circuit, GROUND_OHM), scene)
    plain = circuit.from_recorded(netlist(cells, circuit, 0.0), scene)
    assert np.abs(plain / truth - 1).max() > 0.01
    assert_allclose(reading(cells), truth, rtol=1e-7)
    step = np.random.default_rng(2).standard_normal(SHAPE)
    difference = (
        reading(cells * np.exp(1e-4 * step)) - reading(cells * np.exp(-1e-4 * step))
    ) / 2e-4
    network = circuit.network(cells, circuit.ties(cells))
    sensitivity = network.sensitivity() + ground.added_sensitivity(scene, network)
    assert_allclose((sensitivity @ step.ravel()).reshape(SHAPE), difference, rtol=1e-4, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("stated", ["estimated", pytest.param(GROUND_OHM, marks=pytest.mark.slow)])
def test_a_named_ground_is_taken_off_and_the_circuit_explains_its_readings(
    stated: str | float,
) -> None:
    circuit = CIRCUITS["loads stay"]
    plain, named = (
        recorded(circuit, 3, GROUND_OHM, **keys) for keys in ({}, {"ground_ohm": stated})
    )
    assert named.check.mark == "yes"
    truth = np.log(panels(3)[1])
    wrong, right = (
        np.abs(np.log(lampest.reconstruct(each).cell_resistance) - truth) for each in (plain, named)
    )
    assert np.median(wrong) > 0.1 and np.median(right) < 0.01
    if stated == "estimated":
        ohm, deviation = named.noise.estimated["ground_ohm"]
        assert abs(ohm - GROUND_OHM) < 4 * deviation < 0.05 * GROUND_OHM
        assert named.resolved.scene.ground_ohm == pytest.approx(GROUND_OHM, rel=0.05)
    else:
        assert "ground_ohm" not in named.noise.estimated


def test_a_ground_that_is_not_there_is_not_found() -> None:
    named = recorded(CIRCUITS["loads stay"], 4, 0.0, ground_ohm="estimated")
    assert "ground_ohm" not in named.noise.estimated
    assert any("ground_ohm: estimated, and not taken off" in each for each in named.noise.warnings)


def test_a_simulated_ground_is_that_of_the_netlist() -> None:
    circuit = replace(CIRCUITS["loads stay"], adc_bits=24, noise_lsb=0.0, readings=1)
    cells = panels(5)
    scene = lampest.Scene(lampest.Panel(*SHAPE), circuit)
    stated = replace(scene, ground_ohm=GROUND_OHM)
    for each, ohm in ((scene, GROUND_OHM), (stated, None)):
        volts, _ = measured(each, cells, Unmodelled(ground_ohm=ohm), 1)
        truth = [netlist(frame, circuit, GROUND_OHM) for frame in cells]
        assert_allclose(volts, truth, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("ohm", "seed"), [(2.0, 1), (3.0, 1), (GROUND_OHM, 3)])
def test_a_ground_is_named_even_where_another_circuit_is_about_as_likely(
    ohm: float, seed: int
) -> None:
    check = recorded(CIRCUITS["loads stay"], seed, ohm).check
    assert check.mark == "no" and check.addition == {"ground_ohm": "estimated"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["loads stay", "columns driven"])
def test_bars_hold_where_the_ground_is_estimated(name: str) -> None:
    own, sigma = [], []
    for seed in range(4):
        prepared = recorded(CIRCUITS[name], seed, GROUND_OHM, ground_ohm="estimated")
        found = lampest.reconstruct(prepared)
        error = np.log(found.cell_resistance) - np.log(panels(seed)[1])
        own.append(np.abs(error - np.median(error, axis=(1, 2), keepdims=True)))
        sigma.append(found.to_xarray()["sigma_own"].values)
    assert np.mean(np.array(own) < 1.96 * np.array(sigma)) > MIN_WITHIN
    assert np.median(sigma) < MAX_WIDTH * 1.4826 * np.median(own)
