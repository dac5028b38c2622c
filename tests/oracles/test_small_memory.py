"""A converter's small memory is named where evidence shows it."""

from dataclasses import replace

import numpy as np
import pytest

from docs.studies.effects import LOADS, Row, recording
from lampest import (
    Array,
    GroundedReadout,
    LoadedColumnsReadout,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
)
from lampest.files.levels import MIN_EVIDENCE_GAIN, NOISE_REACH
from lampest.inference.circuits.alternatives import Alternative
from lampest.inference.effects.converter_memory import estimated_memory, memory_gain
from lampest.inference.effects.effect import names_none
from lampest.inference.prepared import Prepared
from lampest.panel.readouts.channel_memory import with_memory
from lampest.panel.readouts.readout import Readout

FRAMES = 6  # unloaded ones, and as many loaded ones
MAX_ERROR = 0.005  # a quarter of the smallest memory here
CONVERTER = {"adc_bits": 12, "readings": 1, "noise_lsb": 1}
COLUMNS = LoadedColumnsReadout(load_ohm=10_000, drive_ohm=70, **CONVERTER)


def recording_of(
    readout: Readout, cells: Array, memory: float, generator: np.random.Generator
) -> Recording:
    """A recording of cells (frames, rows, columns) ohm by a converter that keeps a share."""
    volt = with_memory(readout, memory, readout.exact_reading(cells))
    codes = np.round(volt / readout.lsb_volt + generator.standard_normal(volt.shape))
    role = np.repeat([0, 1], FRAMES).astype(np.uint8)
    return Recording(
        Scene(Panel(8, 8), readout), codes * readout.lsb_volt, np.arange(2.0 * FRAMES), role
    )


def gain_of(recording: Recording) -> float:
    """The evidence that a recording's frames give for a memory."""
    question = Prepared(recording).question
    return memory_gain(question, question.explanation)


def test_a_panel_without_a_load_tells_no_memory() -> None:
    """A fine converter, beside whose noise the assumed creep of cells is large."""
    fine = LoadedColumnsReadout(load_ohm=3300, drive_ohm=1080, adc_bits=16, readings=20)
    generator = np.random.default_rng(3)
    film = 3000 * np.exp(0.3 * generator.standard_normal((1, 8, 8)))
    unloaded = recording_of(fine, np.repeat(film, 2 * FRAMES, axis=0), 0.0, generator)
    assert gain_of(unloaded) == 0.0
    assert estimated_memory(unloaded) == "no frame is loaded: press a few cells"


def pressed_mat(memory: float) -> Recording:
    generator = np.random.default_rng(7)
    cells = np.repeat(2000 * np.exp(0.1 * generator.standard_normal((1, 8, 8))), 2 * FRAMES, axis=0)
    cells[FRAMES:, (1, 4, 6), (2, 6, 7)] *= 0.4
    return recording_of(COLUMNS, cells, memory, generator)


@pytest.mark.long
@pytest.mark.parametrize("memory", [0.02, 0.04, 0.08])
def test_evidence_shows_a_small_memory(memory: float) -> None:
    recording = pressed_mat(memory)
    assert gain_of(recording) > MIN_EVIDENCE_GAIN
    estimate = estimated_memory(recording)
    assert not isinstance(estimate, str) and abs(estimate[0] - memory) < MAX_ERROR


def test_evidence_shows_no_absent_memory() -> None:
    assert gain_of(pressed_mat(0.0)) <= 0


def test_larger_shares_are_tried_while_they_are_about_as_likely(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each share costs fits of both frames."""
    tried: list[float] = []
    with_memory = Alternative.with_memory

    def noted(alternative: Alternative, share: float) -> Alternative:
        tried.append(share)
        return with_memory(alternative, share)

    monkeypatch.setattr(Alternative, "with_memory", noted)
    assert gain_of(pressed_mat(0.0)) == 0
    assert len(tried) < 5
    tried.clear()
    assert gain_of(pressed_mat(0.04)) > MIN_EVIDENCE_GAIN
    assert len(tried) > 3


def test_understated_noise_is_not_taken_for_memory() -> None:
    recording = pressed_mat(0.0)
    quiet = replace(recording.scene, readout=replace(COLUMNS, readings=20))
    assert gain_of(replace(recording, scene=quiet)) <= 0


def test_the_edge_of_a_load_is_not_taken_for_memory() -> None:
    """Edge cells, next in the order of the scan, change by a share of the load's change."""
    generator = np.random.default_rng(100)
    cells = 2000 * np.exp(generator.choice([0.05, 0.3]) * generator.standard_normal((8, 8)))
    cells = np.repeat(cells[None], 2 * FRAMES, axis=0)
    row, column = np.indices((8, 8))
    for _ in range(generator.integers(1, 4)):
        distance = np.hypot(row - generator.uniform(0, 8), column - generator.uniform(0, 8))
        cells[FRAMES:] *= np.exp(
            -generator.uniform(0.3, 2) * np.exp(-((distance / generator.uniform(1, 3)) ** 4))
        )
    readout = GroundedReadout(load_ohm=1000, drive_ohm=50, **CONVERTER)
    assert gain_of(recording_of(readout, cells, 0.0, generator)) < MIN_EVIDENCE_GAIN


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 3, 7])
def test_a_share_is_not_too_large_where_readings_gain_nothing_by_it(seed: int) -> None:
    """Weak presses say little of a memory, and a larger one spreads all readings."""
    generator = np.random.default_rng(seed)
    cells = np.repeat(2000 * np.exp(0.1 * generator.standard_normal((1, 8, 8))), 2 * FRAMES, axis=0)
    for _ in range(4):
        cells[FRAMES:, generator.integers(8), generator.integers(8)] *= generator.uniform(0.5, 0.9)
    readout = GroundedReadout(load_ohm=1000, drive_ohm=50, **CONVERTER)
    estimate = estimated_memory(recording_of(readout, cells, 0.05, generator))
    assert not isinstance(estimate, str) and abs(estimate[0] - 0.05) < 2 * MAX_ERROR


@pytest.mark.long
@pytest.mark.parametrize("readout", [COLUMNS, TwoPointReadout(reference_ohm=1000, **CONVERTER)])
def test_a_rough_palm_determines_no_memory(readout: Readout) -> None:
    """Where most cells changed, each by itself, their changes explain any share."""
    generator = np.random.default_rng(3)
    cells = np.repeat(2000 * np.exp(0.1 * generator.standard_normal((1, 8, 8))), 2 * FRAMES, axis=0)
    row, column = np.indices((8, 8))
    pressure = np.exp(-((np.hypot(row - 3.5, column - 3.5) / 4) ** 4))
    cells[FRAMES:] *= np.exp(-pressure * np.exp(0.2 * generator.standard_normal((8, 8))))
    estimate = estimated_memory(recording_of(readout, cells, 0.02, generator))
    assert isinstance(estimate, str) or (estimate[0] == 0 and estimate[1] > 0.02)


@pytest.mark.slow
def test_a_palm_shows_a_large_memory() -> None:
    """Films alike at rest and a smooth load tell it, though all cells changed."""
    row = Row(memory=0.16)
    made = recording(16001, LOADS["palm"], row, {})
    assert gain_of(made) > MIN_EVIDENCE_GAIN
    assert gain_of(recording(16001, LOADS["palm"], Row(), {})) < MIN_EVIDENCE_GAIN
    estimate = estimated_memory(made)
    assert not isinstance(estimate, str) and abs(estimate[0] - 0.16) < NOISE_REACH * estimate[1]


def test_a_memory_that_a_scene_names_is_not_advised_where_nothing_determines_it() -> None:
    """Advice that tries what it advises would never end."""
    generator = np.random.default_rng(7)
    recording = recording_of(COLUMNS, np.full((2 * FRAMES, 8, 8), 2000.0), 0.05, generator)
    scene = replace(recording.scene, converter_memory="estimated")
    prepared = Prepared(replace(recording, scene=scene))
    assert prepared.cleaned.recording.scene.converter_memory is None
    assert not names_none(prepared, "converter_memory")
