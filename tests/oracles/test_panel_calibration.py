"""Channels and reference from ordinary recordings under many loads, against those that readings were made with."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lampest import Array, Estimator, InputError, Misfit, Panel, Recording, Scene, Systematic, two_point_resistance
from lampest.estimate.calibration.channels import ChannelCalibration, calibrate_channels
from lampest.estimate.sequence import reconstruct
from lampest.files.document import parse_document, validated
from lampest.panel.conditions import MeasuredSubject
from lampest.panel.readouts import LoadedColumnsReadout, TwoPointReadout

SIDE, LOADS, SPREAD = 4, 8, 5.0
TOLD = Systematic(reference_tolerance=0.01, channel_spread_ohm=SPREAD)


def loaded(rng: np.random.Generator, loads: int = LOADS) -> Array:
    """Two unloaded frames, then loads of 2 × 2 cells, three frames each, or three frames without any; ohm."""
    cells = np.tile(3000 * np.exp(0.2 * rng.standard_normal((SIDE, SIDE))), (2 + 3 * max(loads, 1), 1, 1))
    for load in range(loads):
        row, column = rng.integers(0, SIDE - 1, 2)
        cells[2 + 3 * load : 5 + 3 * load, row : row + 2, column : column + 2] *= rng.uniform(0.1, 0.3)
    return np.asarray(cells)


def recording(seed: int, channels: Array, reference: float = 0.0, loads: int = LOADS) -> Recording:
    """Channels (8) ohm, rows first, beside the scene's 140 ohm, and a reference off by a fraction."""
    rng, scene = np.random.default_rng(seed), Scene(Panel(SIDE, SIDE), TwoPointReadout(adc_bits=12), 140.0)
    cells = loaded(rng, loads)
    true = two_point_resistance(cells) + 140.0 + channels[:SIDE, None] + channels[SIDE:]
    recorded = true / (1 + reference)
    recorded = recorded + scene.circuit.sigma(recorded) * rng.standard_normal(cells.shape)
    role = (np.arange(len(cells)) >= 2).astype(np.uint8)
    time = np.arange(len(cells), dtype=float)
    return Recording(replace(scene, systematic=TOLD), recorded, time, role, truth_cell_resistance=cells)


def pulls(found: ChannelCalibration, channels: Array, reference: float) -> float:
    """χ² over the number of errors."""
    off = found.errors - np.concatenate([[reference], channels])
    return float(off @ np.linalg.solve(found.covariance, off)) / len(off)


@pytest.mark.slow
def test_channels_come_back_within_their_deviations_and_cells_are_nearer() -> None:
    channels = SPREAD * np.random.default_rng(7).standard_normal(2 * SIDE)
    found = calibrate_channels([recording(seed, channels, 0.005) for seed in (1, 2)])
    after, before = found.apart, found.apart_before
    assert before == pytest.approx(SPREAD) and after < 0.6 * SPREAD and not found.warnings
    assert pulls(found, channels, 0.005) < 1.5
    centred = found.errors[1:] - channels
    centred -= np.repeat([centred[:SIDE].mean(), centred[SIDE:].mean()], SIDE)
    assert np.sqrt(np.mean(centred**2)) < 0.5 * np.std(channels)
    read = validated(parse_document(found.text(), "scene.yaml"), Scene)
    assert read == found.scene and read.specified_systematic != TOLD
    fresh, errors = recording(3, channels, 0.005), []
    for scene in (fresh.scene, read):
        cells = reconstruct(replace(fresh, scene=scene), Estimator((Misfit(),), "reduced")).cell_resistance
        errors.append(np.median(np.abs(np.log(cells / fresh.truth_cell_resistance[2:]))))
    assert errors[1] < 0.7 * errors[0]


def test_without_loads_it_is_said_that_nothing_is_known() -> None:
    made = recording(1, np.zeros(2 * SIDE), loads=0)
    other = replace(made, scene=replace(made.scene, subject=MeasuredSubject(id="another")))
    found = calibrate_channels([made, other])
    assert found.warnings[0].startswith("these loads determine hardly any channel")
    assert found.apart > 0.9 * SPREAD and found.frames == 10


@pytest.mark.slow
def test_drives_of_loaded_columns_are_written_into_the_readout() -> None:
    readout, rng = LoadedColumnsReadout(adc_bits=12, drive_ohm=100.0), np.random.default_rng(3)
    scene = Scene(Panel(SIDE, SIDE), readout, systematic=Systematic(channel_spread_ohm=SPREAD))
    cells, drives = loaded(rng), SPREAD * rng.standard_normal(SIDE)
    recorded = readout.simulated(cells, scene, drives, np.zeros(SIDE))
    recorded = recorded + scene.circuit.sigma(recorded) * rng.standard_normal(cells.shape)
    role = (np.arange(len(cells)) >= 2).astype(np.uint8)
    found = calibrate_channels([Recording(scene, recorded, np.arange(len(cells), dtype=float), role)])
    after = found.scene.readout
    assert isinstance(after, LoadedColumnsReadout)
    assert np.std(np.subtract(after.drive_ohm, 100.0) - drives) < np.std(drives)


def test_recordings_that_tell_nothing_of_a_circuit_are_refused() -> None:
    made = recording(1, np.zeros(2 * SIDE), loads=0)
    with pytest.raises(InputError, match="names no readout"):
        calibrate_channels([replace(made, scene=Scene(made.scene.panel))])
    with pytest.raises(InputError, match="its scene is another"):
        calibrate_channels([made, replace(made, scene=replace(made.scene, series_resistance_ohm=100.0))])
    with pytest.raises(InputError, match="no frame could be estimated"):
        calibrate_channels([replace(made, recorded=np.full_like(made.recorded, np.nan))])


def test_the_command_writes_a_scene(tmp_path: Path, lampest: Callable[..., SimpleNamespace]) -> None:
    recording(1, SPREAD * np.random.default_rng(7).standard_normal(2 * SIDE), loads=2).save(tmp_path / "many.h5")
    ended = lampest("calibrate", "--from-recording", tmp_path / "many.h5", "--out", tmp_path / "scene.yaml")
    assert ended.code == 0 and ended.out.startswith("reference ")
    assert "rows are off by " in (tmp_path / "scene.yaml").read_text()
