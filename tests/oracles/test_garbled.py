"""Frames that arrive garbled are left out, and loads that are present for one frame are not."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from docs.studies.wrong_readings import of_frame, with_lost_reading, with_swapped_rows
from lampest.inference.prepared import Prepared
from lampest.inference.readings.garbled import garbled_lines
from lampest.recording.datasets import load
from lampest.report.strongest import strongest_readings
from tests.panels import Plan, recorded

PLANS = range(150)
ROUNDING = 1e-12  # relative


@cache
def drawn(seed: int) -> tuple[Plan, NDArray[np.int64]]:
    """Return a plan and its clean codes, which no test changes."""
    plan = Plan.drawn(seed)
    codes = plan.codes()
    codes.flags.writeable = False
    return plan, codes


def garble(
    codes: NDArray[np.int64], frame: int, kind: str, top: int, rng: np.random.Generator
) -> None:
    """Garble a frame in place."""
    image = codes[frame]
    if kind == "two rows":
        image[rng.choice(len(image), 2, replace=False)] = rng.integers(0, top, (2, image.shape[1]))
    elif kind == "a column":
        image[:, rng.integers(image.shape[1])] = rng.integers(0, top, len(image))
    elif kind == "the frame":
        image[...] = rng.integers(0, top, image.shape)
    elif kind == "zeros":
        image[...] = 0
    elif kind == "a row of zeros":
        image[1] = 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "share"),
    [
        ("two rows", 0.93),
        ("a column", 0.82),
        ("the frame", 0.98),
        ("zeros", 0.98),
        ("a row of zeros", 0.96),
    ],
)
def test_garbled_lines_of_a_frame_are_detected(kind: str, share: float) -> None:
    detected = []
    for seed in PLANS:
        plan, clean = drawn(seed)
        codes = clean.copy()
        rng = np.random.default_rng([seed, 9])
        frame = int(rng.integers(1, plan.unloaded + plan.measured - 1))
        garble(codes, frame, kind, 2**plan.scene.circuit.adc_bits, rng)
        lines = garbled_lines(recorded(plan.scene, codes, plan.unloaded))
        detected.append([line.frame for line in lines] == [frame])
    assert np.mean(detected) > share


def test_rows_that_are_swapped_in_one_frame_are_named() -> None:
    """Measured: 8 of 12."""
    assert sum(of_frame(seed, "keys", with_swapped_rows) for seed in range(12)) >= 7


@pytest.mark.slow
def test_all_rows_after_a_lost_reading_are_named() -> None:
    """Measured: 11 of 12, and 4 by the evidence of single rows."""
    assert sum(of_frame(seed, "keys", with_lost_reading) for seed in range(12)) >= 9


def test_a_missing_reading_does_not_hide_that_its_row_is_swapped() -> None:
    plan, codes = drawn(1)
    garbled = codes.astype(float)
    garbled[2, [1, 2]] = codes[2, [2, 1]]
    garbled[:, 1, 3] = np.nan
    [lines] = garbled_lines(recorded(plan.scene, garbled, plan.unloaded))
    assert (lines.frame, lines.numbers) == (2, (1, 2))


@pytest.mark.slow
def test_no_frame_of_clean_recordings_is_garbled() -> None:
    for seed in PLANS:
        plan, codes = drawn(seed)
        assert not garbled_lines(recorded(plan.scene, codes, plan.unloaded)), seed


def test_readings_below_the_first_valid_code_make_no_line_rough() -> None:
    """A foot rolls over; codes up to 500 of the 12-bit converter are bounds, stored as 0."""
    assert load("insole_walking").scene.readout.floor_code == 500
    assert garbled_lines(load("insole_walking")) == ()


@pytest.mark.slow
def test_a_garbled_frame_affects_neither_the_circuit_check_nor_the_strongest_frame() -> None:
    plan = Plan.drawn(4, "two_point")
    codes = plan.codes()
    frame = plan.unloaded + 4
    garble(codes, frame, "two rows", 2**plan.scene.circuit.adc_bits, np.random.default_rng(3))
    recording = recorded(plan.scene, codes, plan.unloaded)
    prepared = Prepared(recording)
    strongest = strongest_readings(recording)
    assert prepared.check.explains
    assert f"of frame {frame}" in " ".join(prepared.warnings)
    assert strongest is not None and strongest[0] != frame
    intact = Prepared(plan.recording())
    np.testing.assert_allclose(
        prepared.noise.readings.value[frame + 1],
        intact.noise.readings.value[frame + 1],
        rtol=ROUNDING,
    )
