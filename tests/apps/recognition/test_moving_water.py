"""Water that moves over a whole panel is a component of the unloaded frames, and no load.

Cells follow the water's pressure, which has a common part and two gradients; each cell responds a
little differently. Waves may be larger later than in the unloaded frames.
"""

from dataclasses import replace

import numpy as np
import pytest

from lampest import (
    Panel,
    PublishedResponse,
    Recording,
    Scene,
    TwoPointReadout,
    two_point_resistance,
)
from lampest.apps.recognition.observation import Observation
from lampest.apps.recognition.steady_frames import SteadyFrames, changes_without_water
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array
from tests.laws.recognised import answered, known_before

SIDE = 8
RATE = 4.0
UNLOADED = 5
SIGMA_LSB = 0.7


def recording_in_water(
    seed: int, size: float, frames: int, load: Array | float = 0.0, *, later: float = 1.0
) -> Recording:
    """Return frames of a panel whose cells move by `size` in ln r.

    The motion of measured frames is `later` times as large. A load changes ln r by an array
    (SIDE, SIDE) from the fifth measured frame on.
    """
    rng = np.random.default_rng(seed)
    number = np.arange(UNLOADED + frames)
    hertz = rng.uniform(0.15, 0.5, 3)
    phase = 2 * np.pi * (hertz[:, None] * number / RATE + rng.random((3, 1)))
    common, across, down = np.array([[1.0], [0.4], [0.4]]) * np.sin(phase)
    common, across, down = (part * 2**0.5 * size for part in (common, across, down))
    growth = np.where(number < UNLOADED, 1.0, later)
    place = np.linspace(-1, 1, SIDE)
    motion = common[:, None, None] + across[:, None, None] * place
    motion = growth[:, None, None] * (motion + down[:, None, None] * place[:, None])
    answer = np.exp(0.1 * rng.standard_normal((SIDE, SIDE)))
    resting = 3000 * np.exp(0.2 * rng.standard_normal((SIDE, SIDE)))
    on = np.where(number >= UNLOADED + 4, 1.0, 0.0)[:, None, None]
    total = two_point_resistance(resting * np.exp(answer * (motion + on * load))) + 140
    code = 1023 * 1000 / (total + 1000)
    code += np.hypot(SIGMA_LSB, 12**-0.5) / np.sqrt(20) * rng.standard_normal(code.shape)
    scene = Scene(
        Panel(SIDE, SIDE),
        TwoPointReadout(noise_lsb=SIGMA_LSB),
        140.0,
        response=PublishedResponse(),
    )
    role = (number >= UNLOADED).astype(np.uint8)
    return Recording(scene, 1000 * (1023 - code) / code, number / RATE, role, name="water")


def gentle_mouth() -> Array:
    """Return ln r/r0 of a ring that presses around cells that rise."""
    y, x = np.indices((SIDE, SIDE)) - 3.5
    radius = np.hypot(x, y)
    return np.where(radius < 1, 0.3, np.where(radius < 2.3, -0.25, 0.0))


@pytest.mark.parametrize("seed", range(3))
def test_motion_of_water_is_not_each_reading_s_own_noise(seed: int) -> None:
    """A motion of 3 % is 10 to 30 times the noise of the converter."""
    still = Prepared(recording_in_water(seed, 0.0, 3)).noise
    assert still.frame is None
    moving = Prepared(recording_in_water(seed, 0.03, 3)).noise
    assert moving.frame is not None
    assert moving.frame.motion[0] == moving.frame.motion.max() > 0.005
    assert "move together" in moving.sentence and "% motion" in moving.summary
    assert moving.sigma_factor < 2


@pytest.mark.parametrize("seed", [2, 3])
def test_bare_water_that_moves_is_no_load(seed: int) -> None:
    """It moves twice as much as in the unloaded frames."""
    bare = answered(recording_in_water(seed, 0.02, 32, later=2.0))
    assert bare.answer == "nothing"


@pytest.mark.parametrize("seed", [1, 6])
def test_a_mouth_in_moving_water_is_not_nothing(seed: int) -> None:
    attached = answered(recording_in_water(seed, 0.05, 24, gentle_mouth()))
    assert attached.answer == "sucks" and attached.probability > 0.9


def test_errors_that_readings_share_do_not_explain_a_load() -> None:
    """A motion of 11 % in a frame and in its baseline is no step of single cells by a third."""
    recording = recording_in_water(5, 0.0, 24, gentle_mouth())
    known = known_before(recording)
    chi_squares = []
    for size in (0.01, 0.11):
        setup = replace(known.watch().setup, motion=np.full(3, size))
        setup = replace(setup, errors=replace(setup.errors, response=0.0))
        baseline = setup.baseline(known.resting, known.sigma, UNLOADED)
        frame = setup.frame(recording.readings().value[-1], known.sigma, baseline)
        errors = frame.whitening() @ frame.residual()
        chi_squares.append(errors @ errors)
    assert chi_squares[1] > 0.5 * chi_squares[0]


def test_water_is_taken_off_in_common_and_along_both_sides() -> None:
    """Cells of a panel without a load follow a wave with gradients as large as its common part."""
    recording = recording_in_water(0, 0.0, 2)
    known = known_before(recording)
    baseline = known.watch().setup.baseline(known.resting, known.sigma, UNLOADED)
    frame = Observation(known.resting, known.sigma, baseline, np.zeros((SIDE, SIDE)), 0.0)
    place = np.linspace(-1, 1, SIDE)
    wave = 0.01 * (1 + place + place[:, None]).ravel()
    shown = frame.slope() @ wave / frame.measured.ravel()
    times = np.arange(8) / RATE
    logarithms = np.log(frame.measured.ravel()) + np.sin(2 * np.pi * times)[:, None] * shown
    interval = SteadyFrames(times, logarithms, np.zeros(8, dtype=np.intp), 1 / RATE)
    changes = changes_without_water(interval, frame, np.zeros((SIDE, SIDE)))
    assert np.abs(changes).max() < 0.02 * np.abs(shown).max()
