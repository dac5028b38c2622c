"""Channels and a resistance in series that a recording shows correct the circuit of its scene."""

from dataclasses import replace

import numpy as np
import pytest

import lampest
from docs.studies.effects import LOADS, Row, recording, systematic
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array

CHANNELS = Row(channel_ohm=10.0, **systematic("channel_spread_ohm", 10.0))
IN_SERIES = Row(series_ohm=60.0, **systematic("series_tolerance_ohm", 60.0))


def own_error(cells: Array, truth: Array) -> float:
    """Return the rms error of ln r beside a common factor."""
    error = np.log(cells / truth)
    return float(np.std(error - np.median(error, axis=(1, 2), keepdims=True)))


def errors_of(row: Row, load: str, seed: int) -> tuple[float, float]:
    """Return the errors of the loaded cells without and with an estimated effect."""
    errors = []
    for keys in ({}, row.estimated):
        made = recording(seed, LOADS[load], row, keys)
        estimates = lampest.reconstruct(made)
        assert made.truth_cell_resistance is not None
        truth = made.truth_cell_resistance[estimates.frame]
        errors.append(own_error(estimates.cell_resistance, truth))
    return errors[0], errors[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("row", "load", "seeds", "ratio"),
    [
        (CHANNELS, "still", (41, 42, 43), 0.8),
        (CHANNELS, "mouth", (41, 42, 43), 0.8),
        (IN_SERIES, "still", (40, 42, 43), 0.6),
    ],
)
def test_cells_are_nearer_to_the_truth(
    row: Row, load: str, seeds: tuple[int, ...], ratio: float
) -> None:
    without, corrected = np.transpose([errors_of(row, load, seed) for seed in seeds])
    assert np.median(corrected / without) < ratio
    assert np.max(corrected / without) < 1.02


def test_the_resolved_scene_has_the_channels_of_each_line() -> None:
    made = recording(42, LOADS["mouth"], CHANNELS, CHANNELS.estimated)
    prepared = Prepared(made)
    series = prepared.resolved.scene.series_resistance_ohm
    assert isinstance(series, lampest.SeriesPerLine)
    rows, columns = (np.asarray(lines) for lines in (series.rows, series.columns))
    assert np.std(rows) > 3 and np.std(columns) > 3
    before = prepared.frame_noise.readings.value
    taken_off = before - prepared.noise.readings.value
    np.testing.assert_allclose(taken_off, (rows[:, None] + columns - 140.0)[None] + 0 * before)


def test_channels_of_a_driven_circuit_are_those_of_its_resistors() -> None:
    random = np.random.default_rng(3)
    told = lampest.DrivenReadout(
        drive_ohm=70.0, sense_ohm=70.0, idle_ohm=70.0, load_ohm=1000.0, adc_bits=12, noise_lsb=0.7
    )
    channels = np.clip(70 + 12 * random.standard_normal((2, 10)), 30, 110)
    true = replace(told, drive_ohm=tuple(channels[0]), sense_ohm=tuple(channels[1]))
    resting = 3000 * np.exp(0.1 * random.standard_normal((10, 10)))
    row, column = np.indices((10, 10)) - 4.5
    fall = 1.5 * np.exp(-((np.hypot(row, column) - 2) ** 2))
    cells = np.stack([resting] * 5 + [resting * np.exp(-force * fall) for force in (0.9, 1, 1.1)])
    volt = true.exact_reading(cells)
    noise = 0.2 * random.standard_normal(volt.shape) * told.lsb_volt
    errors = []
    for keys in ({}, CHANNELS.estimated):
        scene = lampest.Scene(lampest.Panel(10, 10), replace(told, readings=12), **keys)
        made = lampest.Recording.from_array(volt + noise, unit="volt", baseline=5, scene=scene)
        estimates = lampest.reconstruct(made)
        errors.append(own_error(estimates.cell_resistance, cells[estimates.frame]))
    resolved = estimates.prepared.resolved.scene.readout
    assert np.corrcoef(resolved.drive_ohm, channels[0])[0, 1] > 0.8
    assert errors[1] < 0.7 * errors[0]


def test_channels_that_would_be_negative_widen_bars_alone() -> None:
    made = recording(42, LOADS["mouth"], CHANNELS, CHANNELS.estimated)
    scene = replace(made.scene, series_resistance_ohm=1.0)
    less = made.recorded - 139.0
    prepared = Prepared(replace(made, scene=scene, recorded=less))
    errors = prepared.noise.possible_errors
    assert errors is not None and not errors.in_circuit and errors.root is not None
    assert prepared.resolved.scene.series_resistance_ohm == 1.0
