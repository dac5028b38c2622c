"""Grounded drives and virtual ground against netlists that are solved here resistor by resistor."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest.cost.losses import Squared
from lampest.cost.terms import Gradient, LogRatio, Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import GroundedReadout, VirtualGroundReadout
from lampest.panel.scene import Faults, Scene
from lampest.recording.foreign.importing import import_file
from lampest.recording.recording import Recording
from lampest.report.info import describe
from tests.oracles.netlist import Resistor, potentials

ROWS, COLUMNS = 5, 6
ALL = GroundedReadout(load_ohm=1000, drive_ohm=70, sense_ohm=30, adc_bits=12, noise_lsb=1)
ONE = replace(ALL, sense="one")
DRIVES, SENSES = tuple(40.0 + 9 * line for line in range(ROWS)), tuple(60.0 + 11 * line for line in range(COLUMNS))
LOADS = tuple(900.0 + 50 * line for line in range(COLUMNS))
LISTS = replace(ALL, drive_ohm=DRIVES, sense_ohm=SENSES, load_ohm=LOADS)
VIRTUAL = VirtualGroundReadout(drive_ohm=70, sense_ohm=70, feedback_ohm=150, adc_bits=12, noise_lsb=1)
READOUTS: dict[str, GroundedReadout | VirtualGroundReadout] = {
    "all": ALL,
    "one": ONE,
    "all, columns": replace(ALL, driven="columns"),
    "one, columns": replace(ONE, driven="columns"),
    "all, down": replace(ALL, polarity="down"),
    "one, columns down": replace(ONE, driven="columns", polarity="down"),
    "all, lists": LISTS,
    "one, lists": replace(LISTS, sense="one"),
    "all, converter": replace(ALL, input_ohm=20e3),
    "one, converter": replace(ONE, input_ohm=20e3),
    "all, ideal": replace(ALL, drive_ohm=0.0),
    "one, ideal": replace(ONE, drive_ohm=0.0),
    "virtual": VIRTUAL,
    "virtual, columns": replace(VIRTUAL, driven="columns"),
    "virtual, lists": replace(VIRTUAL, drive_ohm=DRIVES, sense_ohm=SENSES, feedback_ohm=SENSES[::-1]),
    "virtual, ideal": replace(VIRTUAL, drive_ohm=0.0, sense_ohm=0.0),
}
every_readout = pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)
LSM = (Misfit(weighting="noise"),)


def each(ohm: float | tuple[float, ...], lines: int) -> tuple[float, ...]:
    return ohm if isinstance(ohm, tuple) else (ohm,) * lines


def measured(cells: Array, readout: GroundedReadout | VirtualGroundReadout) -> Array:
    """Volt at the converter, (rows, columns): a netlist of its own for every reading."""
    matrix = cells if readout.driven == "rows" else cells.T
    read = measured_grounded if isinstance(readout, GroundedReadout) else measured_virtual
    volt = np.array([[read(matrix, readout, *pair) for pair in line] for line in pairs(matrix.shape)])  # type: ignore[operator]
    return volt if readout.driven == "rows" else volt.T


def pairs(shape: tuple[int, ...]) -> list[list[tuple[int, int]]]:
    return [[(line, other) for other in range(shape[1])] for line in range(shape[0])]


def lines_of(matrix: Array, drive: tuple[float, ...], driven: int) -> list[Resistor]:
    """The panel (driven, sensed), and every driven line's way to its source."""
    lines, others = matrix.shape
    cells: list[Resistor] = [
        (("d", line), ("s", other), matrix[line, other]) for line in range(lines) for other in range(others)
    ]
    return cells + [(("d", line), "drive" if line == driven else "idle", drive[line]) for line in range(lines)]


def measured_grounded(matrix: Array, readout: GroundedReadout, driven: int, sensed: int) -> float:
    """At the load of the line that is read; with `sense: one` no other line has one."""
    lines, others = matrix.shape
    network = lines_of(matrix, each(readout.drive_ohm, lines), driven)
    loads, channels = each(readout.load_ohm, others), each(readout.sense_ohm, others)
    for line in range(others) if readout.sense == "all" else [sensed]:
        network += [(("s", line), ("load", line), channels[line]), (("load", line), "idle", loads[line])]
        if readout.input_ohm is not None:
            network.append((("load", line), "idle", readout.input_ohm))
    high, low = (readout.supply_volt, 0.0) if readout.polarity == "up" else (0.0, readout.supply_volt)
    return potentials(network, {"drive": high, "idle": low})[("load", sensed)]


def measured_virtual(matrix: Array, readout: VirtualGroundReadout, driven: int, sensed: int) -> float:
    """Rf times the current through the channel of the line that is read; of all cells where there is no channel."""
    lines, others = matrix.shape
    network = lines_of(matrix, each(readout.drive_ohm, lines), driven)
    channels = each(readout.sense_ohm, others)
    network += [(("s", line), "idle", channels[line]) for line in range(others)]
    volt = potentials(network, {"drive": readout.supply_volt, "idle": 0.0})
    through = [(volt[("d", line)] - volt[("s", sensed)]) / matrix[line, sensed] for line in range(lines)]
    return each(readout.feedback_ohm, others)[sensed] * sum(through)


def panel_of(readout: Any, noise: float, seed: int = 5, shape: tuple[int, int] = (ROWS, COLUMNS)) -> Recording:
    """Three unloaded frames and two with a load, with noise of so many σ, none of it quantised."""
    rng = np.random.default_rng(seed)
    resting = 3000 * np.exp(0.3 * rng.normal(size=shape))
    loaded = resting.copy()
    loaded[1:3, 2:4] *= 0.1
    truth = np.stack([resting] * 3 + [loaded] * 2)
    volt = np.stack([measured(frame, readout) for frame in truth])
    volt = volt + noise * readout.sigma(volt) * rng.normal(size=volt.shape)
    role = np.array([0, 0, 0, 1, 1], dtype=np.uint8)
    scene = Scene(Panel(*shape), readout)
    return Recording(scene, volt, np.arange(5.0), role, truth_cell_resistance=truth, name="panel")


def truth_of(recording: Recording) -> Array:
    assert recording.truth_cell_resistance is not None
    return recording.truth_cell_resistance[3:]


@every_readout
def test_reads_what_the_netlist_says(readout: Any) -> None:
    recording = panel_of(readout, 0.0)
    assert recording.truth_cell_resistance is not None
    modelled = readout.to_recorded(readout.exact_reading(recording.truth_cell_resistance), recording.scene)
    assert_allclose(modelled, recording.recorded, rtol=1e-7 if readout.drive_ohm == 0 else 1e-11)


@pytest.mark.slow
@every_readout
@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
def test_finds_the_cells_of_clean_readings(readout: Any, formulation: Any) -> None:
    recording = panel_of(readout, 0.0)
    done = reconstruct(recording, Estimator(LSM, formulation))
    assert all(step.solution.solved for step in done.steps)
    assert_allclose(done.cell_resistance, truth_of(recording), rtol=1e-4)


@every_readout
@pytest.mark.parametrize("terms", [LSM, (*LSM, LogRatio(weight=10.0, loss=Squared()))], ids=["plain", "smooth"])
def test_nodal_and_reduced_reach_one_optimum(readout: Any, terms: Any) -> None:
    recording = panel_of(readout, 1.0)
    one, other = (reconstruct(recording, Estimator(terms, name)) for name in ("reduced", "nodal"))  # type: ignore[arg-type]
    assert all(step.solution.solved for step in (*one.steps, *other.steps))
    assert_allclose(one.cell_resistance, other.cell_resistance, rtol=1e-6)


@pytest.mark.parametrize("readout", [ALL, ONE, VIRTUAL], ids=["all", "one", "virtual"])
def test_a_weight_is_chosen(readout: Any) -> None:
    recording = panel_of(readout, 1.0)
    done = reconstruct(recording, Estimator((*LSM, Gradient(weight="auto")), "reduced"))
    assert np.median(np.abs(done.cell_resistance / truth_of(recording) - 1)) < 0.02


@pytest.mark.parametrize("readout", [ALL, ONE, VIRTUAL], ids=["all", "one", "virtual"])
def test_volt_and_code_are_imported_and_named(readout: Any, tmp_path: Path) -> None:
    recording = panel_of(readout, 0.0)
    np.save(tmp_path / "volt.npy", recording.recorded)
    np.save(tmp_path / "code.npy", readout.code_from_volt(recording.recorded))
    for unit in ("volt", "code"):
        loaded = import_file(tmp_path / f"{unit}.npy", ROWS, COLUMNS, recording.scene, unit, 3)[0]
        assert np.max(np.abs(loaded.recorded - recording.recorded)) <= 0.5 * readout.lsb_volt * (1 + 1e-9)
    loaded.save(tmp_path / "panel.h5")
    assert any(readout.description() in line for line in describe(tmp_path / "panel.h5"))


@pytest.mark.parametrize("load", [1000.0, 10_000.0])
@pytest.mark.parametrize("readout", [ALL, ONE, VIRTUAL], ids=["all", "one", "virtual"])
def test_a_dead_driven_line_leaves_the_model(readout: Any, load: float) -> None:
    """Its cells are open, and what the converter shows of it says nothing, not even to bounds and starts of others."""
    heavy = readout if readout is VIRTUAL else replace(readout, load_ohm=load)
    sound = panel_of(heavy, 0.0, shape=(8, COLUMNS))
    truth = truth_of(sound)
    broken = np.where(np.arange(8)[:, None] == 4, 1e15, 1.0)
    assert sound.truth_cell_resistance is not None
    volt = np.stack([measured(frame * broken, heavy) for frame in sound.truth_cell_resistance])
    volt[:, 4] = 0.7
    recording = replace(sound, scene=replace(sound.scene, faults=Faults(dead_rows=(4,))), recorded=volt)
    done = reconstruct(recording, Estimator(LSM, "reduced"))
    assert all(step.solution.solved for step in done.steps)
    left = np.arange(8) != 4
    assert_allclose(done.cell_resistance[:, left], truth[:, left], rtol=1e-3)
