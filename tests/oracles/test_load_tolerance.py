"""Load resistors that differ from line to line: the truth has others than the scene."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from lampest import Recording
from lampest.files.document import parse_document
from lampest.inference.prepared import Prepared
from lampest.panel.effects.loads import resistors_of
from lampest.recording.simulation import Simulation, simulate
from lampest.recording.simulation.file import simulation_of
from tests.estimates import share_in_bars

SIDE = 6
TOLERANCE = 0.03
DRAWS = 4
# Of a uniform error the whole lies within √3 standard deviations.
MIN_WITHIN, MAX_UNNAMED = 0.9, 0.4
NAMED = f"load_tolerance: {TOLERANCE}"
CIRCUITS = {
    "loads that stay": ("{kind: grounded, sense: all, load_ohm: 1000, adc_bits: 14}", 1),
    "floating rows": ("{kind: loaded_columns, load_ohm: 1000, drive_ohm: 50, adc_bits: 14}", 1),
    "amplifiers": ("{kind: virtual_ground, feedback_ohm: 300, sense_ohm: 20, adc_bits: 14}", 1),
    "columns driven": ("{kind: grounded, driven: columns, load_ohm: 1000, adc_bits: 14}", 1),
    "two multiplexers": (
        "{kind: grounded, groups: [[0, 1, 2], [3, 4, 5]], load_ohm: 1000, adc_bits: 14}",
        SIDE // 2,
    ),
}


def simulation(readout: str, named: str, unmodelled: str = "", seed: int = 0) -> Simulation:
    """Return a simulation of a weight on a panel whose scene names these sizes of `systematic`."""
    text = f"""
schema: 1
seed: {seed}
scene: {{panel: {{rows: {SIDE}, columns: {SIDE}}}, readout: {readout}, systematic: {{{named}}}}}
cells: {{resistance_ohm: 3050, spread: 0.1}}
baseline_frames: 5
frames: 2
loads:
  - {{kind: rod, centre_mm: [20, 30], diameter_mm: 15, mass_g: 300}}
unmodelled: {{{unmodelled}}}
"""
    return simulation_of(parse_document(text, "loads.yaml"))


def recordings(readout: str, lines: int, named: str) -> Iterator[Recording]:
    """Yield recordings whose resistors, of `lines` lines each, differ from the scene's."""
    for seed in range(DRAWS):
        nominal = simulation(readout, named, seed=seed)
        circuit = nominal.scene.readout
        key = circuit.of_sensed[0]
        drawn = np.random.default_rng(seed).uniform(-TOLERANCE, TOLERANCE, SIDE // lines)
        ohm = getattr(circuit, key) * (1 + np.repeat(drawn, lines))
        true = replace(nominal.scene, readout=replace(circuit, **{key: tuple(ohm.tolist())}))
        yield replace(simulate(replace(nominal, scene=true), "true"), scene=nominal.scene)


@pytest.mark.long
@pytest.mark.parametrize("circuit", CIRCUITS)
def test_bars_hold_resistors_that_differ_where_the_scene_says_so(circuit: str) -> None:
    readout, lines = CIRCUITS[circuit]
    assert share_in_bars(recordings(readout, lines, NAMED)) > MIN_WITHIN
    assert share_in_bars(recordings(readout, lines, "")) < MAX_UNNAMED


def test_one_resistor_behind_a_multiplexer_does_not_differ_from_itself() -> None:
    for readout in ("{kind: two_point}", "{kind: grounded, sense: one}"):
        scene = simulation(readout, "").scene
        assert not len(resistors_of(scene.circuit, scene.panel.shape))
    parallel = simulation("{kind: two_point, groups: [[0, 1, 2, 3], [4, 5]]}", "").scene
    resistors = resistors_of(parallel.circuit, parallel.panel.shape)
    np.testing.assert_array_equal(resistors, [[1, 1, 1, 1, 0, 0], [0, 0, 0, 0, 1, 1]])


def test_simulated_resistors_change_one_column_each() -> None:
    readout = "{kind: virtual_ground, feedback_ohm: 300, sense_ohm: 20, adc_bits: 24}"
    plain, drawn = (
        simulate(simulation(readout, "", unmodelled), "drawn").recorded
        for unmodelled in ("", NAMED)
    )
    factors = np.mean(drawn / plain, axis=(0, 1))
    assert 0.003 < np.std(factors) < TOLERANCE
    np.testing.assert_allclose(drawn / plain, np.broadcast_to(factors, plain.shape), atol=1e-4)


def test_no_change_of_a_cell_shows_the_resistors() -> None:
    named = "load_tolerance: estimated"
    readout = CIRCUITS["loads that stay"][0]
    noise = Prepared(simulate(simulation(readout, named, NAMED), "loads")).noise
    assert "systematic.load_tolerance" not in noise.estimated
    assert any("measure the resistors with an ohmmeter" in each for each in noise.warnings)
