"""Loaded columns against a netlist that is solved here resistor by resistor, with a supply and without Z."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest.cost.losses import Squared
from lampest.cost.terms import LogRatio, Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import LoadedColumnsReadout
from lampest.panel.scene import Faults, Scene, SeriesPerLine
from lampest.recording.foreign.importing import import_file
from lampest.recording.recording import Recording
from lampest.runs.batch import run_batch
from lampest.runs.case import CaseResult
from lampest.runs.config import read_run
from lampest.runs.executors import Serial
from lampest.runs.results import read_results

READOUT = LoadedColumnsReadout(supply_volt=3.3, load_ohm=10_000, drive_ohm=1080, adc_bits=12, readings=20, noise_lsb=1)
LISTS = replace(
    READOUT,
    load_ohm=tuple(8000.0 + 300 * line for line in range(6)),
    drive_ohm=tuple(50.0 + 7 * line for line in range(5)),
)
TURNED = replace(LISTS, driven="columns", load_ohm=LISTS.load_ohm[:5], drive_ohm=(*LISTS.drive_ohm, 99.0))  # type: ignore[index,misc]
READOUTS = {
    "rows up": READOUT,
    "rows down": replace(READOUT, polarity="down"),
    "columns up": replace(READOUT, driven="columns"),
    "no drive resistor": replace(READOUT, drive_ohm=0.0),
    "lists": LISTS,
    "lists, columns down": replace(TURNED, polarity="down"),
}
LSM = (Misfit(weighting="noise"),)
SMOOTH = (*LSM, LogRatio(weight=10.0, loss=Squared()))


def each(ohm: float | tuple[float, ...], lines: int) -> Array:
    return np.broadcast_to(np.asarray(ohm, dtype=float), lines)


def measured(cells: Array, readout: LoadedColumnsReadout) -> Array:
    """Volt at the converter, (rows, columns): a Kirchhoff system of its own for every driven line.

    Nodes are rows, then columns; the supply and the ground are ideal. Without a drive resistor the node is the supply.
    """
    rows, columns = cells.shape
    by_rows = readout.driven == "rows"
    high, low = (readout.supply_volt, 0.0) if readout.polarity == "up" else (0.0, readout.supply_volt)
    driven, sensed = (
        (range(rows), range(rows, rows + columns)) if by_rows else (range(rows, rows + columns), range(rows))
    )
    drive, load = each(readout.drive_ohm, len(driven)), each(readout.load_ohm, len(sensed))
    volt = np.empty((len(driven), len(sensed)))
    for number, line in enumerate(driven):
        matrix, current = np.zeros((rows + columns,) * 2), np.zeros(rows + columns)
        for row in range(rows):
            for column in range(columns):
                pair = [row, rows + column]
                matrix[np.ix_(pair, pair)] += np.array([[1, -1], [-1, 1]]) / cells[row, column]
        for node, ohm in zip(sensed, load, strict=True):
            matrix[node, node] += 1 / ohm
            current[node] += low / ohm
        if drive[number] == 0:
            matrix[line], current[line] = np.eye(rows + columns)[line], high
        else:
            matrix[line, line] += 1 / drive[number]
            current[line] += high / drive[number]
        volt[number] = np.linalg.solve(matrix, current)[list(sensed)]
    return volt if by_rows else volt.T


def panel_of(readout: LoadedColumnsReadout, noise: float, seed: int = 5, shape: tuple[int, int] = (5, 6)) -> Recording:
    """Three unloaded frames and two with a load, with noise of so many σ, none of it quantised."""
    rng = np.random.default_rng(seed)
    scene = Scene(Panel(*shape), readout, systematic="none")
    resting = 3000 * np.exp(0.3 * rng.normal(size=shape))
    loaded = resting.copy()
    loaded[1:3, 2:4] *= 0.1
    truth = np.stack([resting] * 3 + [loaded] * 2)
    volt = np.stack([measured(frame, readout) for frame in truth])
    volt = volt + noise * readout.sigma(volt) * rng.normal(size=volt.shape)
    role = np.array([0, 0, 0, 1, 1], dtype=np.uint8)
    return Recording(scene, volt, np.arange(5.0), role, truth_cell_resistance=truth, name="panel")


@pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)
def test_reads_what_the_netlist_says(readout: LoadedColumnsReadout) -> None:
    recording = panel_of(readout, 0.0)
    assert recording.truth_cell_resistance is not None
    modelled = readout.to_recorded(readout.exact_reading(recording.truth_cell_resistance), recording.scene)
    assert_allclose(modelled, recording.recorded, rtol=1e-11)


def truth_of(recording: Recording) -> Array:
    assert recording.truth_cell_resistance is not None
    return recording.truth_cell_resistance[3:]


@pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)
@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
def test_finds_the_cells_of_clean_readings(readout: LoadedColumnsReadout, formulation: Any) -> None:
    recording = panel_of(readout, 0.0)
    done = reconstruct(recording, Estimator(LSM, formulation))
    assert_allclose(done.cell_resistance, truth_of(recording), rtol=1e-4)


@pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)
def test_nodal_and_reduced_reach_one_optimum(readout: LoadedColumnsReadout) -> None:
    recording = panel_of(readout, 1.0)
    one, other = (reconstruct(recording, Estimator(SMOOTH, name)) for name in ("reduced", "nodal"))  # type: ignore[arg-type]
    assert all(step.solution.solved for step in (*one.steps, *other.steps))
    assert_allclose(one.cell_resistance, other.cell_resistance, rtol=1e-5)


def run_over(recording: Recording, folder: Path) -> CaseResult:
    """What `lampest run` makes of it."""
    recording.save(folder / "panel.h5")
    (folder / "run.yaml").write_text(
        "schema: 1\nrecordings: [panel.h5]\nformulation: reduced\nerror_bars: true\n"
        "estimators: {LSM: {terms: {misfit: {weighting: noise}}}}\n"
    )
    run_batch(read_run(folder / "run.yaml"), folder / "results", Serial())
    (case,) = read_results(folder / "results" / "results.h5").cases
    return case


@pytest.mark.slow
def test_error_bars_cover_the_truth(tmp_path: Path) -> None:
    """The mean square of errors in error bars, over panels: one, within what chance allows 720 cells."""
    scores = []
    for seed in range(12):
        recording = panel_of(READOUT, 1.0, seed)
        (tmp_path / str(seed)).mkdir()
        case = run_over(recording, tmp_path / str(seed))
        assert case.cell_resistance_errors is not None
        scores.append((case.cell_resistance - truth_of(recording)) / case.cell_resistance_errors)
    assert 0.8 < np.mean(np.square(scores)) < 1.25


def test_a_weight_is_chosen() -> None:
    recording = panel_of(READOUT, 1.0)
    done = reconstruct(recording, Estimator((*LSM, LogRatio(weight="auto")), "reduced"))
    assert np.median(np.abs(done.cell_resistance / truth_of(recording) - 1)) < 0.02


@pytest.mark.parametrize("polarity", ["up", "down"])
def test_a_dead_row_leaves_the_model(polarity: Any) -> None:
    """Its cells are open, and what the converter shows of it says nothing."""
    readout = replace(READOUT, polarity=polarity)
    sound = panel_of(readout, 0.0)
    truth = truth_of(sound)
    broken = np.where(np.arange(5)[:, None] == 4, 1e15, 1.0)
    assert sound.truth_cell_resistance is not None
    volt = np.stack([measured(frame * broken, readout) for frame in sound.truth_cell_resistance])
    volt[:, 4] = 0.7
    recording = replace(sound, scene=replace(sound.scene, faults=Faults(dead_rows=(4,))), recorded=volt)
    done = reconstruct(recording, Estimator(LSM, "reduced"))
    assert all(step.solution.solved for step in done.steps)
    assert_allclose(done.cell_resistance[:, :4], truth[:, :4], rtol=1e-4)


def test_a_recording_and_its_results_are_in_volt(tmp_path: Path) -> None:
    recording = panel_of(READOUT, 1.0)
    recording.save(tmp_path / "panel.h5")
    loaded = Recording.load(tmp_path / "panel.h5")
    assert loaded.scene == recording.scene and loaded.path == "/entry/readings/volt"
    assert np.array_equal(loaded.recorded, recording.recorded)
    case = run_over(loaded, tmp_path)
    with h5py.File(tmp_path / "results" / "results.h5") as file:
        (estimator,) = (group for name, group in file["/entry/panel"].items() if name != "recording")
        assert estimator["reading_model"].attrs["units"] == b"volt" and "two_point_model" not in estimator
        assert file["/entry/panel/recording/volt"].attrs["units"] == b"volt"
    assert case.scene == recording.scene
    assert_allclose(case.reading_model, case.measured, rtol=1e-2)


def test_volt_and_code_are_imported(tmp_path: Path) -> None:
    recording = panel_of(READOUT, 0.0)
    np.save(tmp_path / "volt.npy", recording.recorded)
    np.save(tmp_path / "code.npy", READOUT.code_from_volt(recording.recorded))
    volt, code = (import_file(tmp_path / f"{unit}.npy", 5, 6, recording.scene, unit, 3)[0] for unit in ("volt", "code"))
    assert_allclose(volt.recorded, recording.recorded)
    assert np.max(np.abs(code.recorded - recording.recorded)) <= 0.5 * READOUT.lsb_volt * (1 + 1e-9)
    with pytest.raises(InputError, match="gives volt"):
        import_file(tmp_path / "volt.npy", 5, 6, recording.scene, "ohm")


@pytest.mark.parametrize("series", [140.0, SeriesPerLine(70.0, 70.0)])
def test_a_series_resistance_is_refused_and_its_place_told(series: float | SeriesPerLine) -> None:
    with pytest.raises(ValueError, match=r"belongs to readout\.kind: two_point.*drive_ohm or sense_ohm"):
        Scene(Panel(5, 6), READOUT, series)
