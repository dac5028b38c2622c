"""Lines that are read at the far end of their wire, against netlists."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from promises import promise

import lampest
from lampest import (
    Array,
    ContactPrior,
    Contacts,
    DrivenReadout,
    Faults,
    GroundedReadout,
    Lines,
    LoadedColumnsReadout,
    Panel,
    Readout,
    Recording,
    Scene,
)
from lampest.panel.difference_network import wire_responses
from lampest.panel.joined_network import JoinedNetwork
from tests.estimates import log_errors
from tests.netlist import wired_volts

COUNT = 60
SHAPES = ((3, 4), (4, 3), (2, 5), (1, 4), (4, 1))
CONTRAST = 8.0  # of |ln r| about 3 kilo-ohms
TOLERANCE = 1e-8  # of the largest reading; measured 7e-11
OF_DIFFERENCES = 1e-5  # relative, central differences
CONVERGED = 2e-6  # of log r: the certificate holds where the next step moves no cell by 1e-6
# Largest |log r| where wire has 2 ohm a cell and loads have 1 kilo-ohm
WITH_KEY = 1e-8  # measured 5e-11
WITHOUT_KEY = 0.03  # measured 0.049
READOUTS: dict[str, Readout] = {
    "loads": LoadedColumnsReadout(drive_ohm=100.0, load_ohm=2000.0, read_at="far_end"),
    "pull-ups": LoadedColumnsReadout(polarity="down", driven="columns", read_at="far_end"),
    "grounded": GroundedReadout(sense_ohm=70.0, read_at="far_end"),
    "one": GroundedReadout(sense="one", driven="columns", read_at="far_end"),
    "outputs at LOW": GroundedReadout(sense="one", idle_load_ohm=30.0, read_at="far_end"),
    "held": DrivenReadout(idle_ohm=0.0, drive_ohm=70.0, idle_load_ohm=0.0, read_at="far_end"),
    "pull-downs": DrivenReadout(
        drive_ohm=95.0, idle_ohm=10_000.0, idle_stays=True, input_ohm=1e6, read_at="far_end"
    ),
}


def random_scene(seed: int) -> tuple[Scene, Array]:
    """Return a scene whose lines of wire enter at either end, and cells (rows, columns) ohm."""
    rng = np.random.default_rng(seed)
    shape = SHAPES[seed % len(SHAPES)]
    readout: Any = list(READOUTS.values())[seed % len(READOUTS)]
    readout = replace(readout, driven=("rows", "columns")[rng.integers(2)])
    row_ohm, column_ohm = 10 ** rng.uniform(-2, 2, 2)
    enter, leave = ("left", "right")[rng.integers(2)], ("bottom", "top")[rng.integers(2)]
    keys: dict[str, Any] = {"lines": Lines(row_ohm, column_ohm, enter, leave)}
    if seed % 3 == 0:
        contacts = tuple(rng.uniform(1, 100, sum(shape)))
        keys["contacts"] = Contacts(
            ContactPrior(contacts[: shape[0]]), ContactPrior(contacts[shape[0] :])
        )
    if seed % 4 == 1 and min(shape) > 1 and readout.__dict__.get("idle_ohm") != 0:
        keys["faults"] = Faults(joined_rows=((0, 1),))
    cells = 3000 * np.exp(rng.uniform(-CONTRAST, CONTRAST, shape))
    return Scene(Panel(*shape), readout, **keys), cells


@pytest.mark.parametrize("seed", range(COUNT))
def test_readings_are_the_potentials_of_the_far_ends_of_a_netlist(seed: int) -> None:
    scene, cells = random_scene(seed)
    expected = wired_volts(cells, scene)
    reading = scene.circuit.exact_reading(cells, scene.wiring)
    recorded = scene.circuit.to_recorded(reading, scene)
    assert_allclose(recorded, expected, rtol=0, atol=TOLERANCE * np.abs(expected).max())


@pytest.mark.parametrize("readout", READOUTS)
def test_responses_to_wire_and_leaks_are_those_of_readings(readout: str) -> None:
    """Central differences of a hundredth of an ohm; a leak has its exact change."""
    cells = 3000 * np.exp(np.random.default_rng(3).standard_normal((2, 3)))
    contacts = Contacts(ContactPrior(5.0), ContactPrior(5.0))
    scene = Scene(Panel(2, 3), READOUTS[readout], lines=Lines(20.0, 30.0), contacts=contacts)

    def network_of_scene(**keys: Any) -> Any:
        circuit = replace(scene, **keys).circuit
        return circuit.network(cells, circuit.ties(cells), replace(scene, **keys).wiring)

    def difference(keys: Any) -> Array:
        high, low = (network_of_scene(**keys(sign * 0.01)).reading() for sign in (1, -1))
        return np.asarray((high - low) / 0.02)

    network = network_of_scene()
    along, down = wire_responses(network, Lines(20.0, 30.0))
    for response, expected in (
        (along, difference(lambda ohm: {"lines": Lines(20.0 + ohm, 30.0)})),
        (down, difference(lambda ohm: {"lines": Lines(20.0, 30.0 + ohm)})),
    ):
        assert_allclose(response, expected, atol=OF_DIFFERENCES * np.abs(expected).max())
    across = np.array([[1.0, -1.0, 0.0, 0.0, 0.0]]).T
    leaking = network_of_scene(leak_ohm=lampest.NeighbourLeaks(rows=500.0)).reading()
    assert_allclose(network.leaking(across, 1 / 500.0).reading(), leaking, rtol=TOLERANCE)


def recording_of(scene: Scene) -> Recording:
    """An unloaded and a loaded frame, without noise of the converter."""
    rng = np.random.default_rng(4)
    cells = 3000 * np.exp(0.5 * rng.standard_normal((2, *scene.panel.shape)))
    exact = np.stack([scene.circuit.exact_reading(frame, scene.wiring) for frame in cells])
    recorded = scene.circuit.to_recorded(exact, scene)
    recording = Recording.from_array(recorded, unit="volt", baseline=1, scene=scene)
    return replace(recording, truth_cell_resistance=cells)


@pytest.mark.long
@pytest.mark.parametrize("readout", READOUTS)
def test_both_solvers_find_the_same_optimum(readout: str) -> None:
    """One reading depends on each cell, and the cells are those of the simulation."""
    scene = Scene(Panel(4, 3), READOUTS[readout], lines=Lines(20.0, 5.0), systematic="none")
    recording = recording_of(scene)
    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=20.0)]
    cells = {}
    for formulation in ("reduced", "nodal", "per_pixel"):
        estimate = lampest.reconstruct(recording, terms, formulation=formulation, error_bars=False)
        assert set(estimate.status) == {"local optimum verified"}
        cells[formulation] = np.log(estimate.cell_resistance)
    assert_allclose(cells["nodal"], cells["reduced"], atol=CONVERGED)
    assert_allclose(cells["per_pixel"], cells["reduced"], atol=CONVERGED)


@promise("howto/readouts: With `read_at: far_end` the converter is at the other end")
def test_the_key_makes_cells_right_where_wire_matters() -> None:
    """Wire of 2 ohm a cell, loads of 1 kilo-ohm at one end of columns, the reader at the other."""
    readout = LoadedColumnsReadout(load_ohm=1000.0, adc_bits=16, read_at="far_end")
    scene = Scene(Panel(8, 6), readout, lines=Lines(0.0, 2.0), systematic="none")
    recording = recording_of(scene)
    silent = replace(scene, readout=replace(readout, read_at=None))
    errors = {
        key: np.abs(log_errors(lampest.reconstruct(recorded, [lampest.Misfit()]))).max()
        for key, recorded in (("with", recording), ("without", replace(recording, scene=silent)))
    }
    assert errors["with"] < WITH_KEY and errors["without"] > WITHOUT_KEY


def test_a_terminal_is_no_far_end() -> None:
    """Scenes without the key share bases as before; without wire both ends read alike."""
    cells = np.geomspace(1e3, 1e4, 12).reshape(3, 4)
    near = GroundedReadout(sense="one")
    far = replace(near, read_at="far_end")
    assert not isinstance(near.network(cells, near.ties(cells)), JoinedNetwork)
    assert_allclose(far.exact_reading(cells), near.exact_reading(cells), rtol=1e-12)
