"""Numbers that a scene calls `estimated` and its recording cannot determine."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from promises import promise

import lampest
from lampest.inference.noise import unseen_noise
from lampest.inference.prepared import Prepared
from lampest.inference.resolve import MODEL_ERROR, OF_NOISE
from lampest.panel.scene import specified
from lampest.panel.sizes import ESTIMATED
from lampest.recording.recording import UNLOADED
from tests.laws.test_determined_numbers import KEYS, SHAPE, scene_that_asks_for
from tests.panels import recorded

UNLOADED_FRAMES = 6
LOADED_FRAMES = 3


def recording_of(key: str, shape: tuple[int, int] = SHAPE) -> lampest.Recording:
    """Unloaded frames, and a load on one cell, with a scene that asks for the key."""
    scene = replace(scene_that_asks_for(key), panel=lampest.Panel(*shape))
    readout = lampest.TwoPointReadout(noise_lsb=0.7)
    plain = lampest.Scene(lampest.Panel(*shape), readout)
    rng = np.random.default_rng(79)
    cells = np.tile(
        3000 * np.exp(0.1 * rng.standard_normal(shape)), (UNLOADED_FRAMES + LOADED_FRAMES, 1, 1)
    )
    cells[UNLOADED_FRAMES:, 0, 0] /= 3
    volts = readout.volt_from_recorded(plain.circuit.exact_reading(cells, plain.wiring))
    volts = volts + 0.7 * readout.lsb_volt * rng.standard_normal(volts.shape)
    made = recorded(plain, readout.code_from_volt(volts), UNLOADED_FRAMES)
    return replace(made, scene=scene)


def only(made: lampest.Recording, frames: slice) -> lampest.Recording:
    return replace(
        made, recorded=made.recorded[frames], time=made.time[frames], role=made.role[frames]
    )


def one_measured_frame(made: lampest.Recording) -> lampest.Recording:
    return only(made, slice(UNLOADED_FRAMES, UNLOADED_FRAMES + 1))


def unloaded_frames(made: lampest.Recording) -> lampest.Recording:
    return only(made, slice(0, UNLOADED_FRAMES))


def constant(made: lampest.Recording) -> lampest.Recording:
    return replace(made, recorded=np.full_like(made.recorded, made.recorded.mean()))


def no_loaded_reading(made: lampest.Recording) -> lampest.Recording:
    loaded = (made.role != UNLOADED)[:, None, None]
    return replace(made, recorded=np.where(loaded, np.nan, made.recorded))


RECORDINGS = (one_measured_frame, unloaded_frames, constant, no_loaded_reading)
SLOW_CASES = (  # a second each
    (no_loaded_reading, "converter_memory"),
    (no_loaded_reading, "readout.converter.zero_volt"),
)
# Unloaded frames determine these, and a lone frame shows whether its circuit explains it.
DETERMINED = {
    unloaded_frames: {"gain", "ripple", "systematic.reading_error", OF_NOISE},
    no_loaded_reading: {"gain", "ripple", "systematic.reading_error", OF_NOISE, MODEL_ERROR},
    constant: {OF_NOISE},
    one_measured_frame: {MODEL_ERROR},
}


@promise("howto/error_bars: One that it cannot determine is a warning, with the reason")
@pytest.mark.parametrize(
    ("weaken", "key"),
    [
        pytest.param(weaken, key, marks=[pytest.mark.slow] * ((weaken, key) in SLOW_CASES))
        for weaken in RECORDINGS
        for key in KEYS
    ],
)
def test_a_number_that_a_recording_cannot_determine_has_a_reason(
    weaken: Callable[[lampest.Recording], lampest.Recording], key: str
) -> None:
    noise = Prepared(weaken(recording_of(key))).noise
    reasons = [text for text in noise.warnings if text.startswith(key)]
    determined = {name: size for name, size in noise.estimated.items() if name.startswith(key)}
    if key in DETERMINED[weaken]:
        assert determined and not reasons
        assert all(deviation > 0 for _, deviation in determined.values())
        return
    assert not determined
    assert len(reasons) == 1 and "broke down" not in reasons[0]
    remedies = ("record", "press", "load more cells", "calibrate", "show none")
    assert any(words in reasons[0] for words in remedies)


@pytest.mark.parametrize("key", ["gain", "ripple"])
def test_errors_of_frames_on_one_row_are_no_number(key: str) -> None:
    noise = Prepared(recording_of(key, (1, 6))).noise
    assert key not in noise.estimated
    assert any("too few lines" in text for text in noise.warnings)


def test_equal_readings_leave_room_for_noise_below_a_step() -> None:
    noise = Prepared(constant(recording_of(OF_NOISE))).noise
    size, deviation = noise.estimated[OF_NOISE]
    assert size == 0 and deviation >= unseen_noise(UNLOADED_FRAMES * np.prod(SHAPE))
    rng = np.random.default_rng(1)
    hidden = unseen_noise(100)
    shown = [np.any(np.abs(hidden * rng.standard_normal(100)) > 0.5) for _ in range(1000)]
    assert 0.3 < np.mean(shown) < 0.5  # a Poisson number of readings with mean ½


def test_a_scene_without_the_number_is_left() -> None:
    made = Prepared(constant(recording_of("motion"))).resolved
    assert specified(made.scene, "motion") != ESTIMATED
