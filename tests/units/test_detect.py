"""What `lampest detect` is made of: the table, detections.h5 and the timeline, and what it says when it cannot."""

import dataclasses
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from support import invented_case

from lampest.files.errors import InputError
from lampest.loads.recognition.candidates import KINDS
from lampest.loads.recognition.settings import ModelErrors, RecognitionSettings
from lampest.loads.shapes import OralDisc
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.wiring import Lines
from lampest.panel.scene import Faults, Scene, Systematic, Water
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.report.detect.detection import MOST_SOURCES, QUANTITIES, GivenRecording, detect, detect_file, looked_at
from lampest.report.detect.events import event_table, write_detections
from lampest.report.plots.timeline import plot_timelines
from lampest.runs.results import CaseResult, Results, read_results, write_results
from lampest.runs.results.scene import arrays_of

FRAMES = 3
MOUTH = {
    "lamprey",
    "lamprey or cup",
}  # a cup that somebody pushes as hard as this mouth presses is rare, not impossible


def solved_case(
    estimator: str = "LSM", failed: tuple[int, ...] = (), faults: Faults | None = None, **known: Any
) -> CaseResult:
    """A mouth, measured, and an estimate that is its true cells; faults, known : what the scene says besides."""
    panel = Panel(8, 10, 10.0)
    load = OralDisc(
        kind="oral_disc", centre_mm=(48, 36), diameter_mm=33, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=85
    )
    scene = Scene(panel=panel, readout=TwoPointReadout(kind="two_point", noise_lsb=0.7), series_resistance_ohm=140.0)
    recording = simulate(Simulation(schema=1, seed=2, scene=scene, frames=FRAMES, loads=(load,)))
    recording = dataclasses.replace(recording, scene=dataclasses.replace(scene, faults=faults, **known))
    readings = recording.readings()
    resting = readings[[0, 1, 2]].mean()
    assert recording.truth_cell_resistance is not None and readings.sigma is not None
    cells = recording.truth_cell_resistance[3:].copy()
    baseline = recording.truth_cell_resistance[0]
    case = invented_case(estimator, "mouth", (FRAMES, 8, 10), failed=failed, scene=scene)
    cells[~case.solved] = np.nan
    return dataclasses.replace(
        case,
        scene=recording.scene,
        measured=readings.value[3:],
        measured_baseline=resting.value,
        sigma=readings.sigma_of_values[3:],
        sigma_baseline=resting.sigma_of_values,
        cell_resistance=cells,
        baseline_resistance=baseline,
        relative_change=100 * (cells / baseline - 1),
        truth=None,
        truth_baseline=None,
    )


@pytest.fixture(scope="module")
def results() -> Results:
    return Results((solved_case(), solved_case("LSR-CR", failed=(1,))), {})


@pytest.mark.slow
def test_every_estimate_and_the_readings_are_looked_at(results: Results) -> None:
    calls: list[tuple[int, int]] = []
    found = detect(results, on_case=lambda done, total: calls.append((done, total)))
    assert [detection.source for detection in found] == ["recording", "LSM", "LSR-CR"]
    assert calls == [(1, 3), (2, 3), (3, 3)]
    for detection in found:
        solved = np.isfinite(detection.goodness)
        assert list(solved) == [True, detection.source != "LSR-CR", True]
        assert {label for label, good in zip(detection.labels, solved, strict=True) if good} <= MOUTH
        np.testing.assert_allclose(detection.probabilities[solved].sum(axis=1), 1)
        np.testing.assert_allclose(detection.values[solved, 2], 33, atol=1.2)
    assert found[2].labels[1] == "not solved" and np.isnan(found[2].values[1]).all()


def test_of_many_estimators_the_first_are_looked_at_or_those_that_are_named() -> None:
    case = solved_case()
    many = Results(tuple(dataclasses.replace(case, estimator=f"E{number}") for number in range(300)))
    assert looked_at(many) == tuple(f"E{number}" for number in range(MOST_SOURCES - 1))
    assert looked_at(Results(tuple(dataclasses.replace(case, recording=f"r{i}") for i in range(300)))) == ("LSM",)
    assert [one.source for one in detect(many, estimators=["E299"])] == ["recording", "E299"]
    with pytest.raises(InputError, match=r"no estimator is called 'E300'; there are E0, .*did you mean"):
        detect(many, estimators=["E300"])


def test_the_table_names_what_where_and_how_strong(results: Results) -> None:
    table = event_table(detect(results))
    first = dict(zip(table.headers, table.cells[0], strict=True))
    assert (first["from"], first["event"]) == ("readings", "attached") and first["what"] in MOUTH
    assert "±" in first["diameter [mm]"] and first["inside [kPa]"].startswith("−")


def test_the_file_is_complete_and_says_its_units(results: Results, tmp_path: Path) -> None:
    found = detect(results)
    file = write_detections(tmp_path / "detections.h5", found)
    again = write_detections(tmp_path / "again.h5", found)
    assert file.read_bytes() == again.read_bytes()
    with h5py.File(file) as content:
        assert content.attrs["lampest_format"] == b"detections/1"
        for source in ("recording", "LSM", "LSR-CR"):
            group = content[f"entry/mouth/{source}"]
            assert group.attrs["NX_class"] == b"NXdata"
            assert group["label"].shape == group["state"].shape == (FRAMES,)
            for kind in KINDS:
                assert group[f"probability/{kind.replace(' ', '_')}"].shape == (FRAMES,)
            for quantity in QUANTITIES:
                for name in (quantity.name, quantity.name + "_errors"):
                    assert group[name].attrs["units"].decode() == quantity.units
                    assert group[name].attrs["long_name"] and group[name].dims[0].keys() == ["time"]
            assert list(group["events/event"][()]) == [b"attached"]
            assert list(group["count"][()]) == [1, 1 if source != "LSR-CR" else 0, 1]
            assert np.isnan(group["second/diameter"][()]).all() and group["third/diameter_errors"].shape == (FRAMES,)
            assert group["events/diameter"][0] == pytest.approx(33, abs=1.2)


def test_timelines_are_drawn(results: Results, tmp_path: Path) -> None:
    files = plot_timelines(results, detect(results), tmp_path)
    assert [file.name for file in files] == ["timeline_mouth.png"]
    assert files[0].read_bytes().startswith(b"\x89PNG")


def test_without_noise_nothing_is_claimed(tmp_path: Path) -> None:
    case = dataclasses.replace(solved_case(), sigma=None, sigma_baseline=None)
    write_results(tmp_path / "results.h5", [case])
    with pytest.raises(InputError, match=r"results\.h5: mouth: the noise of the readings is unknown"):
        detect_file(tmp_path / "results.h5")
    _, found = detect_file(tmp_path / "results.h5", RecognitionSettings(noise_percent=0.5))
    assert "lamprey" in found[0].labels[-1]


def test_a_recording_of_another_readout_leaves_the_others_in() -> None:
    mouth, other = solved_case(), dataclasses.replace(solved_case(), recording="driven")
    driven = dataclasses.replace(other.scene, readout=None, lines=Lines(row_ohm_per_cell=1.0))
    told: list[str] = []
    results = Results((mouth, dataclasses.replace(other, scene=driven)))
    found = detect(results, on_refused=told.append)
    assert [(one.recording, one.source) for one in found] == [("mouth", "recording"), ("mouth", "LSM")]
    assert len(told) == 1 and told[0].startswith("driven: recognition knows neither lines")
    with pytest.raises(InputError, match="recognition knows neither lines"):
        detect(Results(results.cases[1:]))


def test_readings_that_faults_blind_do_not_count() -> None:
    case = solved_case(faults=Faults(shorted=((0, 1),), dead_rows=(7,), dead_columns=(9,)))
    assert np.isinf(case.sigma[:, 7]).all() and np.isinf(case.sigma[:, 0, 1]).all()
    (first, *_), wild = detect(Results((case,))), case.measured.copy()
    wild[np.isinf(case.sigma)] *= np.random.default_rng(3).uniform(0.2, 5, int(np.isinf(case.sigma).sum()))
    (other, *_) = detect(Results((dataclasses.replace(case, measured=wild),)))
    for found in (first, other):
        assert set(found.labels) <= MOUTH
        np.testing.assert_allclose(found.values[:, 2], 33, atol=1.2)
    np.testing.assert_allclose(first.values, other.values, rtol=0.02)


def test_recognition_is_given_the_scene_of_the_results() -> None:
    case = solved_case(water=Water(70.0), systematic=Systematic(0.03, 5.0))
    given = GivenRecording.of(case, RecognitionSettings())
    np.testing.assert_allclose(given.water[:, 0], 9.81e-3 * (70 + 10 * np.arange(8)))
    errors = given.baseline.model_errors
    assert (errors.channel_ohm, errors.reference) == (5.0, pytest.approx(0.03 / 3**0.5))
    assert given.baseline.series_ohm == 140.0
    stated = RecognitionSettings(top_row_depth_mm=0.0, model_errors=ModelErrors(channel_ohm=1.0))
    assert (
        GivenRecording.of(case, stated).water[0, 0] == 0
        and GivenRecording.of(case, stated).baseline.model_errors == stated.model_errors
    )
    assert GivenRecording.of(solved_case(), RecognitionSettings()).baseline.model_errors == ModelErrors()
    seen = GivenRecording.of(dataclasses.replace(solved_case(), reading_error=0.03), RecognitionSettings())
    assert seen.baseline.model_errors == ModelErrors(reading_error=0.03)


def test_settings_out_of_range_are_refused() -> None:
    for wrong in ({"patch_mm": 0.0}, {"noise_percent": -1.0}, {"top_row_depth_mm": -5.0}):
        with pytest.raises(ValueError, match="must be"):
            RecognitionSettings(**wrong)  # type: ignore[arg-type]


def test_noise_that_frames_share_comes_back_from_results(tmp_path: Path) -> None:
    scene = solved_case().scene
    noise = FrameNoise(scene, 5, 0.002, np.zeros((10, 0)), np.full((10, 2), 1e-3))
    file = tmp_path / "results.h5"
    write_results(file, [dataclasses.replace(solved_case(), frame_noise=arrays_of(noise))])
    given = GivenRecording.of(read_results(file).cases[0], RecognitionSettings())
    assert given.noise is not None
    np.testing.assert_array_equal(next(given.frames()).common, noise.columns(given.measured[:1], False))
    with h5py.File(file, "r+") as opened:
        opened["entry/mouth/LSM"].attrs["frame_apart"] = np.zeros((8, 2))
    with pytest.raises(InputError, match="frame_apart must have 10 rows"):
        detect_file(file)
