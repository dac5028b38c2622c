"""What a recording does not show moves no cell: an estimated effect that is not there."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import lampest
from lampest.inference.effects.static_errors import estimating
from lampest.panel.effects import SHARED

SYSTEMATIC = tuple(f"systematic.{setting}" for setting in SHARED)
KEYS = (
    *("gain", "ripple", "motion", "creep", "leaks", "contacts", "ground_ohm", "converter_memory"),
    *SYSTEMATIC,
)
FAST = "creep"  # `make test` takes it
MAX_SHARE = 0.1  # of a cell's standard deviation
SHAPE = (7, 6)


@cache
def recording(seed: int) -> lampest.Recording:
    """Return a press on a film behind grounded lines, without any effect."""
    random = np.random.default_rng(seed)
    circuit = lampest.DrivenReadout(
        drive_ohm=50.0, idle_ohm=50.0, load_ohm=1000.0, adc_bits=12, noise_lsb=0.7
    )
    cells = 3000.0 * np.exp(0.1 * random.standard_normal(SHAPE))
    loaded = cells.copy()
    row, column = random.integers(1, 4, 2)
    loaded[row : row + 2, column : column + 2] *= random.uniform(0.3, 0.8)
    volts = circuit.exact_reading(np.stack([cells] * 5 + [loaded] * 3))
    noise = 0.7 * random.standard_normal((circuit.readings, *volts.shape))
    codes = np.round(volts / circuit.lsb_volt + noise).mean(axis=0)
    scene = lampest.Scene(lampest.Panel(*SHAPE), circuit)
    return lampest.Recording.from_array(
        codes * circuit.lsb_volt, unit="volt", baseline=5, scene=scene
    )


@cache
def cells_of(seed: int, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Return ln r of the loaded frames, and its deviations, where the scene estimates a key."""
    made = recording(seed)
    scene = made.scene
    if key in SYSTEMATIC:
        scene = estimating(scene, key.removeprefix("systematic."))
    elif key:
        scene = replace(scene, **{key: "estimated"})
    found = lampest.reconstruct(replace(made, scene=scene))
    values = found.to_xarray()
    deviation = np.hypot(values["sigma_own"].values, values["sigma_common"].values)
    return np.log(found.cell_resistance), deviation


@pytest.mark.parametrize(
    "key", [pytest.param(key, marks=[] if key == FAST else [pytest.mark.slow]) for key in KEYS]
)
def test_an_effect_that_is_not_there_moves_no_cell(key: str) -> None:
    plain, deviation = cells_of(0, "")
    assert np.max(np.abs(cells_of(0, key)[0] - plain) / deviation) < MAX_SHARE
