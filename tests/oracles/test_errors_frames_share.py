"""Errors that frames share: they stay out of weights, and are taken off where they show."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lampest
from docs.studies.effects import LOADS, ROWS, figures, recording
from lampest import (
    GroundedReadout,
    LoadedColumnsReadout,
    Panel,
    Readout,
    Recording,
    Scene,
    Systematic,
    TwoPointReadout,
    Unmodelled,
)
from lampest.files.document import read_document
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array
from lampest.recording.simulation.measure import measured
from lampest.runs.starter import write_starter

ESTIMATED = Systematic(reading_error="estimated")
UNLOADED = 3
FRAMES = 4
FILM_SIDES = (6, 8, 10)
MOVED = 0.1  # of an error bar, by an error that is not significant


def films(random: np.random.Generator, side: int, kind: str) -> Array:
    """Return unloaded cells in ohm: normal, with outliers, thicker to one side, or patched."""
    scatter = float(random.choice([0.05, 0.1, 0.2]))
    row, column = np.indices((side, side)) - (side - 1) / 2
    way = random.uniform(0, 2 * np.pi)
    unit = random.standard_normal((side, side))
    deviation = {
        "normal": unit,
        "outliers": random.standard_t(3, (side, side)),
        "thicker": unit / 2 + 3 * (row * np.cos(way) + column * np.sin(way)) / side,
        "patched": unit / 2 + 2 * (np.hypot(row - 1, column + 1) < side / 4),
    }[kind]
    return np.asarray(3000 * np.exp(scatter * deviation))


def falls(random: np.random.Generator, side: int) -> Array:
    """Return the fall of log r under a mouth, a palm, a rod or a small load, (side, side)."""
    row, column = np.indices((side, side)) - (side - 1) / 2
    far = np.hypot(row - random.uniform(-1.5, 1.5), column - random.uniform(-1.5, 1.5))
    kinds = (
        1.6 * np.exp(-(((far - 1.9) / 0.6) ** 2)) - 0.4 * (far < 1.2),
        0.6 * np.exp(-((far / 4.5) ** 2)) + 0.6 * np.exp(-((far / 2.5) ** 2)),
        1.2 / (1 + np.exp((far - 2) / 0.15)),
        np.exp(-((far / 0.7) ** 2)),
    )
    return np.asarray(kinds[int(random.integers(len(kinds)))])


def drawn(seed: int) -> Recording:
    """Return a recording whose readings have noise alone, of one of three circuits."""
    random = np.random.default_rng([seed, 7])
    side = int(random.choice(FILM_SIDES))
    kind = str(random.choice(["normal", "outliers", "thicker", "patched"]))
    resting = films(random, side, kind)
    fall = falls(random, side)
    creep = 0.003 * random.standard_normal((side, side))
    forces = random.uniform(0.9, 1.1, FRAMES)
    loaded = [resting * np.exp(creep - force * fall) for force in forces]
    cells = np.stack([*[resting] * UNLOADED, *loaded])
    converter = {
        "adc_bits": int(random.choice([10, 12])),
        "readings": int(random.choice([1, 20])),
        "noise_lsb": float(random.choice([0.5, 1.0, 2.5])),
    }
    readouts: tuple[Readout, ...] = (
        TwoPointReadout(**converter),
        LoadedColumnsReadout(**converter, load_ohm=1000.0),
        GroundedReadout(**converter, load_ohm=1000.0),
    )
    scene = Scene(Panel(side, side), readouts[seed % 3], 0.0 if seed % 3 else 140.0)
    recorded, _ = measured(scene, cells, Unmodelled(), seed)
    role = (np.arange(len(cells)) >= UNLOADED).astype(np.uint8)
    time = np.arange(len(cells)) / 4
    return Recording(scene, recorded, time, role, truth_cell_resistance=cells)


def named(made: Recording, systematic: Systematic) -> Recording:
    """Return the recording with errors in its scene."""
    return replace(made, scene=replace(made.scene, systematic=systematic))


def moved(seed: int) -> float:
    """Return the largest move of a cell by an absent error that is estimated, over its bar."""
    made = drawn(seed)
    without, estimated = map(lampest.reconstruct, (made, named(made, ESTIMATED)))
    bars = estimated.cell_resistance_errors
    assert bars is not None
    return float(np.max(np.abs(estimated.cell_resistance - without.cell_resistance) / bars))


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds",
    [
        (9, 11, 16, 19, 29, 52),
        *(pytest.param(tuple(range(n, n + 20)), marks=pytest.mark.slow) for n in range(0, 100, 20)),
    ],
)
def test_an_absent_error_of_readings_moves_no_cell(seeds: tuple[int, ...]) -> None:
    """Cells moved by up to six bars, and films thicker to one side were errors of 5 to 10 %."""
    assert {seed: move for seed in seeds if (move := moved(seed)) > MOVED} == {}


@pytest.mark.parametrize("systematic", [ESTIMATED, Systematic(reading_error=0.02)])
def test_errors_that_frames_share_stay_out_of_sigma(systematic: Systematic) -> None:
    prepared = Prepared(named(drawn(9), systematic))
    assert prepared.noise.reading_error > 0
    np.testing.assert_array_equal(
        prepared.noise.readings.sigma,
        prepared.frame_noise.readings.sigma,
    )


@pytest.mark.slow
@pytest.mark.parametrize("row", ["readings off by 2 %", "readings off by 5 %"])
def test_errors_of_readings_that_the_unloaded_panel_shows_are_taken_off(row: str) -> None:
    """In σ alone they left cells under mouths 18 and 26 % off; unnamed 29 and more."""
    effect = ROWS[row]
    estimated = [
        figures(recording(seed, LOADS["mouth"], effect, effect.estimated), advised=False)
        for seed in (100, 101)
    ]
    assert np.mean([of.error for of in estimated]) < 16
    assert min(of.cells for of in estimated) > 92


def test_a_part_of_a_recording_is_corrected_as_the_whole() -> None:
    effect = ROWS["readings off by 2 %"]
    whole = Prepared(recording(100, LOADS["mouth"], effect, effect.estimated))
    assert whole.noise.log_factor is not None
    made = whole.recording
    first = Recording(made.scene, made.recorded[:8], made.time[:8], made.role[:8])
    part = Prepared(first, whole.noise)
    np.testing.assert_allclose(part.noise.readings.value, whole.noise.readings.value[:8])


def test_a_starter_calls_nothing_estimated(tmp_path: Path) -> None:
    """Advice names what a recording shows."""
    write_starter(tmp_path, "two_mux", 6, 6)
    assert "estimated" not in str(read_document(tmp_path / "scene.yaml"))


def test_stated_errors_are_taken_off_without_unloaded_frames() -> None:
    """Loads count as scatter of the cells there; uncorrected, cells are 30 % off."""
    effect = ROWS["readings off by 2 %"]
    made = recording(100, LOADS["mouth"], effect, effect.stated)
    loaded = made.role == 1
    assert made.truth_cell_resistance is not None
    alone = replace(
        made,
        recorded=made.recorded[loaded],
        time=made.time[loaded],
        role=made.role[loaded],
        truth_cell_resistance=made.truth_cell_resistance[loaded],
    )
    assert figures(alone, advised=False).error < 22


@pytest.mark.slow
def test_stated_errors_are_taken_off_panels_of_more_than_four_hundred_cells() -> None:
    """Uncorrected, cells of 24 × 24 are 32 % off, as unnamed; with the error in σ 21 %."""
    random = np.random.default_rng(5)
    shape = (24, 24)
    resting = 3000 * np.exp(0.1 * random.standard_normal(shape))
    row, column = np.indices(shape) - 11.5
    loaded = resting * np.exp(-1.2 / (1 + np.exp((np.hypot(row, column) - 4) / 0.3)))
    cells = np.stack([resting, resting, loaded])
    scene = Scene(Panel(*shape), TwoPointReadout(readings=20, noise_lsb=0.7), 140.0)
    recorded, _ = measured(scene, cells, Unmodelled(reading_error=0.02), 5)
    role = np.array([0, 0, 1], dtype=np.uint8)
    made = Recording(scene, recorded, np.arange(3.0), role)
    done = lampest.reconstruct(named(made, Systematic(reading_error=0.02)), error_bars=False)
    assert np.sqrt(np.mean(np.log(done.cell_resistance / loaded) ** 2)) < 0.16
