"""Every readout against a netlist that is solved resistor by resistor, with ideal sources and without Z."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array, CaseResult, Estimator, InputError, Panel, Recording, Squared, import_file, read_run
from lampest.cost.terms import Gradient, LogRatio, Misfit
from lampest.estimate.sequence import reconstruct
from lampest.panel.readouts import GroundedReadout, LoadedColumnsReadout, TwoPointReadout, VirtualGroundReadout
from lampest.panel.scene import Faults, Scene, SeriesPerLine
from lampest.report.info import describe
from lampest.runs.batch import run_batch
from lampest.runs.executors import Serial
from lampest.runs.results import read_results
from tests.oracles.netlist import Resistor, potentials

ROWS, COLUMNS = 5, 6
DRIVES, SENSES = tuple(40.0 + 9 * line for line in range(ROWS)), tuple(60.0 + 11 * line for line in range(COLUMNS))
TWO_POINT = TwoPointReadout(adc_bits=12, noise_lsb=1)
LOADED = LoadedColumnsReadout(supply_volt=3.3, load_ohm=10_000, drive_ohm=1080, adc_bits=12, readings=20, noise_lsb=1)
LOADED_LISTS = replace(LOADED, load_ohm=tuple(8000.0 + 300 * line for line in range(COLUMNS)), drive_ohm=DRIVES)
LOADED_TURNED = replace(LOADED_LISTS, driven="columns", load_ohm=LOADED_LISTS.load_ohm[:5], drive_ohm=(*DRIVES, 99.0))
ALL = GroundedReadout(load_ohm=1000, drive_ohm=70, sense_ohm=30, adc_bits=12, noise_lsb=1)
ONE = replace(ALL, sense="one")
LISTS = replace(ALL, drive_ohm=DRIVES, sense_ohm=SENSES, load_ohm=tuple(900.0 + 50 * line for line in range(COLUMNS)))
VIRTUAL = VirtualGroundReadout(drive_ohm=70, sense_ohm=70, feedback_ohm=150, adc_bits=12, noise_lsb=1)
READOUTS: dict[str, Any] = {
    "two point": TWO_POINT,
    "two point across the sensor": replace(TWO_POINT, measured_across="sensor"),
    "loaded, up": LOADED,
    "loaded, down": replace(LOADED, polarity="down"),
    "loaded, columns": replace(LOADED, driven="columns"),
    "loaded, ideal": replace(LOADED, drive_ohm=0.0),
    "loaded, converter": replace(LOADED, input_ohm=50e3),
    "loaded, lists": LOADED_LISTS,
    "loaded, lists, columns down": replace(LOADED_TURNED, polarity="down"),
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
every_kind = pytest.mark.parametrize("readout", [LOADED, ALL, ONE, VIRTUAL], ids=["loaded", "all", "one", "virtual"])
LSM = (Misfit(weighting="noise"),)
SMOOTH = (*LSM, LogRatio(weight=10.0, loss=Squared()))


def each(ohm: float | tuple[float, ...], lines: int) -> tuple[float, ...]:
    return ohm if isinstance(ohm, tuple) else (ohm,) * lines


def volts(cells: Array, readout: Any) -> Array:
    """Return the voltage at the converter, (rows, columns): a netlist of its own for every reading."""
    turned = getattr(readout, "driven", "rows") == "columns"
    matrix = cells.T if turned else cells
    volt = np.empty(matrix.shape)
    for driven, sensed in np.ndindex(matrix.shape):
        volt[driven, sensed] = volt_of(matrix, readout, driven, sensed)
    return volt.T if turned else volt


def volt_of(matrix: Array, readout: Any, driven: int, sensed: int) -> float:
    """Return the voltage of one reading of a panel (driven lines, sensed lines) ohm."""
    lines, others = matrix.shape
    network: list[Resistor] = [(("d", line), ("s", other), ohm) for (line, other), ohm in np.ndenumerate(matrix)]
    if isinstance(readout, TwoPointReadout):
        of_sensor, tap = readout.measured_across == "sensor", ("d" if readout.measured_across == "sensor" else "s")
        ends = ("high", ("d", driven)) if of_sensor else (("s", sensed), "low")
        wire = (("s", sensed), "low", 0.0) if of_sensor else ("high", ("d", driven), 0.0)
        held = {"high": readout.supply_volt, "low": 0.0}
        return potentials([*network, (*ends, readout.reference_ohm), wire], held)[tap, driven if of_sensor else sensed]
    floating = isinstance(readout, LoadedColumnsReadout)
    drive = each(readout.drive_ohm, lines)
    network += [
        (("d", line), "high" if line == driven else "low", drive[line])
        for line in range(lines)
        if line == driven or not floating
    ]
    high, low = (
        (0.0, readout.supply_volt) if getattr(readout, "polarity", "up") == "down" else (readout.supply_volt, 0.0)
    )
    if isinstance(readout, VirtualGroundReadout):
        channels = each(readout.sense_ohm, others)
        volt = potentials(
            [*network, *((("s", line), "low", channels[line]) for line in range(others))], {"high": high, "low": low}
        )
        through = [(volt["d", line] - volt["s", sensed]) / matrix[line, sensed] for line in range(lines)]
        return each(readout.feedback_ohm, others)[sensed] * sum(through)
    loads, channels = each(readout.load_ohm, others), (0.0,) * others if floating else each(readout.sense_ohm, others)
    for line in [sensed] if getattr(readout, "sense", "all") == "one" else range(others):
        network += [(("s", line), ("load", line), channels[line]), (("load", line), "low", loads[line])]
        network += [] if readout.input_ohm is None else [(("load", line), "low", readout.input_ohm)]
    return potentials(network, {"high": high, "low": low})["load", sensed]


def panel_of(readout: Any, noise: float, seed: int = 5, shape: tuple[int, int] = (ROWS, COLUMNS)) -> Recording:
    """Three unloaded frames and two with a load, with noise of so many σ, none of it quantised."""
    rng = np.random.default_rng(seed)
    scene = Scene(Panel(*shape), readout, systematic="none")
    resting = 3000 * np.exp(0.3 * rng.normal(size=shape))
    loaded = resting.copy()
    loaded[1:3, 2:4] *= 0.1
    truth = np.stack([resting] * 3 + [loaded] * 2)
    recorded = readout.recorded_from_volt(np.stack([volts(frame, readout) for frame in truth]))
    recorded = recorded + noise * readout.sigma(recorded) * rng.normal(size=recorded.shape)
    role = np.array([0, 0, 0, 1, 1], dtype=np.uint8)
    return Recording(scene, recorded, np.arange(5.0), role, truth_cell_resistance=truth, name="panel")


def truth_of(recording: Recording) -> Array:
    return recording.truth_cell_resistance[3:]


def test_every_readout_reads_what_the_netlist_says() -> None:
    for name, readout in READOUTS.items():
        recording = panel_of(readout, 0.0)
        modelled = readout.to_recorded(readout.exact_reading(recording.truth_cell_resistance), recording.scene)
        ideal = getattr(readout, "drive_ohm", 1.0) == 0
        assert_allclose(modelled, recording.recorded, rtol=1e-7 if ideal else 1e-11, err_msg=name)


@every_readout
@pytest.mark.parametrize("formulation", ["reduced", "nodal"])
def test_clean_readings_give_the_cells(readout: Any, formulation: Any) -> None:
    recording = panel_of(readout, 0.0)
    done = reconstruct(recording, Estimator(LSM, formulation))
    assert all(step.solution.solved for step in done.steps)
    assert_allclose(done.cell_resistance, truth_of(recording), rtol=1e-4)


@every_readout
@pytest.mark.parametrize("terms", [LSM, SMOOTH], ids=["plain", "smooth"])
def test_nodal_and_reduced_reach_one_optimum(readout: Any, terms: Any) -> None:
    recording = panel_of(readout, 1.0)
    nodal, reduced = (reconstruct(recording, Estimator(terms, name)) for name in ("nodal", "reduced"))
    assert all(step.solution.solved for step in (*nodal.steps, *reduced.steps))
    held = isinstance(readout, GroundedReadout | VirtualGroundReadout)
    assert_allclose(nodal.cell_resistance, reduced.cell_resistance, rtol=1e-6 if held else 1e-5)


@every_kind
@pytest.mark.parametrize("penalty", [Gradient(weight="auto"), LogRatio(weight="auto")], ids=["gradient", "log_ratio"])
def test_a_weight_is_chosen(readout: Any, penalty: Any) -> None:
    recording = panel_of(readout, 1.0)
    done = reconstruct(recording, Estimator((*LSM, penalty), "reduced"))
    assert np.median(np.abs(done.cell_resistance / truth_of(recording) - 1)) < 0.02


@pytest.mark.parametrize(
    "readout",
    [
        LOADED,
        replace(LOADED, polarity="down"),
        *(replace(kind, load_ohm=ohm) for kind in (ALL, ONE) for ohm in (1e3, 1e4)),
        VIRTUAL,
    ],
)
def test_a_dead_driven_line_leaves_the_model(readout: Any) -> None:
    """Its cells are open, and the voltage of its readings says nothing, not even to bounds and starts of others."""
    sound = panel_of(readout, 0.0, shape=(8, COLUMNS))
    broken = np.where(np.arange(8)[:, None] == 4, 1e15, 1.0)
    volt = np.stack([volts(frame * broken, readout) for frame in sound.truth_cell_resistance])
    volt[:, 4] = 0.7
    recording = replace(sound, scene=replace(sound.scene, faults=Faults(dead_rows=(4,))), recorded=volt)
    done = reconstruct(recording, Estimator(LSM, "reduced"))
    assert all(step.solution.solved for step in done.steps)
    sound_rows = np.arange(8) != 4
    assert_allclose(done.cell_resistance[:, sound_rows], truth_of(sound)[:, sound_rows], rtol=1e-3)


@every_kind
def test_volt_and_code_are_imported_and_the_readout_is_named(readout: Any, tmp_path: Path) -> None:
    recording = panel_of(readout, 0.0)
    np.save(tmp_path / "volt.npy", recording.recorded)
    np.save(tmp_path / "code.npy", readout.code_from_volt(recording.recorded))
    for unit in ("volt", "code"):
        loaded = import_file(tmp_path / f"{unit}.npy", ROWS, COLUMNS, recording.scene, unit, 3)[0]
        assert np.max(np.abs(loaded.recorded - recording.recorded)) <= 0.5 * readout.lsb_volt * (1 + 1e-9)
        assert unit == "code" or np.allclose(loaded.recorded, recording.recorded, rtol=1e-7)
    with pytest.raises(InputError, match="gives volt"):
        import_file(tmp_path / "volt.npy", ROWS, COLUMNS, recording.scene, "ohm")
    loaded.save(tmp_path / "panel.h5")
    assert any(readout.description() in line for line in describe(tmp_path / "panel.h5"))


def run_over(recording: Recording, folder: Path) -> CaseResult:
    """Run the least squares of a recording as `lampest run` does."""
    folder.mkdir(exist_ok=True)
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
        recording = panel_of(LOADED, 1.0, seed)
        case = run_over(recording, tmp_path / str(seed))
        scores.append((case.cell_resistance - truth_of(recording)) / case.cell_resistance_errors)
    assert 0.8 < np.mean(np.square(scores)) < 1.25


def test_a_recording_and_its_results_are_in_volt(tmp_path: Path) -> None:
    recording = panel_of(LOADED, 1.0)
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


@pytest.mark.parametrize("series", [140.0, SeriesPerLine(70.0, 70.0)])
def test_a_series_resistance_is_refused_and_its_place_told(series: float | SeriesPerLine) -> None:
    with pytest.raises(ValueError, match=r"belongs to readout\.kind: two_point.*drive_ohm or sense_ohm"):
        Scene(Panel(ROWS, COLUMNS), LOADED, series)
