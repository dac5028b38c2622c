"""Readings that firmware changed: recognised, refused and, where possible, restored."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lampest
from lampest import (
    Array,
    GroundedReadout,
    InputError,
    LoadedColumnsReadout,
    Panel,
    Scene,
    TwoPointReadout,
)
from lampest.panel.readouts.tolerances import simulated
from lampest.recording.processed import processing_of
from lampest.recording.recording import UNLOADED

SHAPE = (6, 8)
UNLOADED_FRAMES = 5
SCENES = {
    "grounded": Scene(
        Panel(*SHAPE), GroundedReadout(load_ohm=1000.0, drive_ohm=50.0, readings=1, noise_lsb=1.0)
    ),
    "loaded": Scene(
        Panel(*SHAPE),
        LoadedColumnsReadout(load_ohm=10e3, drive_ohm=100.0, readings=1, noise_lsb=1.0),
    ),
    "two_point": Scene(Panel(*SHAPE), TwoPointReadout(readings=1, noise_lsb=1.0), 140.0),
}
every_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)


def codes_of(scene: Scene, seed: int = 1) -> Array:
    """Codes of five unloaded frames and five with a load."""
    rng = np.random.default_rng(seed)
    cells = np.tile(3000 * np.exp(0.2 * rng.normal(size=SHAPE)), (10, 1, 1))
    cells[UNLOADED_FRAMES:, 2:4, 3:5] /= 5
    circuit = scene.circuit
    volt = circuit.volt_from_recorded(
        simulated(circuit, cells, scene, np.zeros(SHAPE[0]), np.zeros(SHAPE[1]))
    )
    return np.asarray(circuit.code_from_volt(volt + circuit.lsb_volt * rng.normal(size=volt.shape)))


def imported(
    folder: Path,
    scene: Scene,
    codes: Array,
    resting: Array | None = None,
    unloaded: int = UNLOADED_FRAMES,
) -> lampest.Recording:
    np.save(folder / "mine.npy", codes)
    options = {}
    if resting is not None:
        np.save(folder / "resting.npy", resting)
        options["resting"] = folder / "resting.npy"
    recording, _ = lampest.import_file(
        folder / "mine.npy", scene=scene, unit="code", baseline_frames=unloaded, **options
    )
    return recording


def subtracted(codes: Array) -> tuple[Array, Array]:
    """Codes less their rounded unloaded mean, and this mean."""
    resting = np.round(codes[:UNLOADED_FRAMES].mean(axis=0)).astype(int)
    return codes - resting, resting[None]


@every_scene
def test_readings_as_converted_are_imported(tmp_path: Path, scene: Scene) -> None:
    for seed in range(20):
        assert not processing_of(
            codes_of(scene, seed), np.arange(10) < UNLOADED_FRAMES, scene.panel.present
        )
    imported(tmp_path, scene, codes_of(scene))


@every_scene
def test_a_subtracted_baseline_is_refused_with_a_remedy(tmp_path: Path, scene: Scene) -> None:
    difference, _ = subtracted(codes_of(scene))
    with pytest.raises(
        InputError, match=r"the unloaded readings are exactly 0: .* send what the converter gives"
    ):
        imported(tmp_path, scene, np.maximum(difference, 0))
    with pytest.raises(
        InputError, match=r"codes below 0, down to -.*: the firmware subtracts a resting frame"
    ):
        imported(tmp_path, scene, difference)


def test_a_threshold_is_refused(tmp_path: Path) -> None:
    codes = codes_of(SCENES["loaded"])
    with pytest.raises(
        InputError, match=r"none lies between 0 and .*: the firmware has a threshold"
    ):
        imported(
            tmp_path,
            SCENES["loaded"],
            np.where(codes > np.quantile(codes, 0.6), codes, 0),
            unloaded=0,
        )


def test_a_rescaled_table_is_refused(tmp_path: Path) -> None:
    codes = codes_of(SCENES["loaded"]).astype(float)
    np.save(tmp_path / "mine.npy", (codes - codes.min()) / np.ptp(codes))
    with pytest.raises(InputError, match="from exactly 0 to exactly 1 are scaled to some range"):
        lampest.import_file(
            tmp_path / "mine.npy", scene=SCENES["loaded"], unit="volt", baseline_frames=5
        )


@every_scene
def test_the_resting_frame_restores_unclipped_readings(tmp_path: Path, scene: Scene) -> None:
    codes = codes_of(scene)
    difference, resting = subtracted(codes)
    by_difference = replace(scene, baseline="subtracted")
    raw = imported(
        tmp_path,
        lampest.Scene(scene.panel, scene.readout, scene.series_resistance_ohm, baseline="raw"),
        codes,
    )
    unclipped = imported(tmp_path, by_difference, difference, resting)
    loaded = unclipped.role != UNLOADED
    np.testing.assert_array_equal(unclipped.recorded[loaded], raw.recorded[loaded])
    clipped = imported(tmp_path, by_difference, np.maximum(difference, 0), resting)
    positive = difference[loaded] > 0
    np.testing.assert_array_equal(
        clipped.recorded[loaded][positive], raw.recorded[loaded][positive]
    )
    assert np.isnan(clipped.recorded[loaded][~positive]).all()
    assert unclipped.scene.baseline == "raw"


def test_a_subtracted_frame_must_be_given_and_specified(tmp_path: Path) -> None:
    scene = SCENES["grounded"]
    difference, resting = subtracted(codes_of(scene))
    with pytest.raises(InputError, match="give the resting frame that was subtracted"):
        imported(tmp_path, Scene(scene.panel, scene.readout, baseline="subtracted"), difference)
    with pytest.raises(InputError, match="where the scene says baseline: subtracted"):
        imported(tmp_path, scene, difference, resting)


def test_cells_open_at_rest_are_imported_if_the_scene_allows_them(tmp_path: Path) -> None:
    scene = Scene(
        Panel(*SHAPE), GroundedReadout(load_ohm=1000.0, drive_ohm=50.0, readings=1), baseline="raw"
    )
    codes = np.where(np.arange(10)[:, None, None] >= UNLOADED_FRAMES, codes_of(scene), 0)
    assert imported(tmp_path, scene, codes).scene.baseline == "raw"
