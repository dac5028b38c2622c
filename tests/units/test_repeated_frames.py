"""Frames that are stored twice, and those that a converter repeats because it hardly has noise."""

import numpy as np
import pytest

import lampest
from lampest import Course, Panel, Recording, Rod, Scene, Simulation, TwoPointReadout
from lampest.inference.readings.repeated import repeated_frames


def pressed_slowly(noise_lsb: float) -> Recording:
    """Three unloaded frames, and a load that grows in three more."""
    readout = TwoPointReadout(adc_bits=8, readings=1, noise_lsb=noise_lsb)
    rod = Rod(centre_mm=(20, 20), diameter_mm=20, mass_g=300)
    scene = Scene(Panel(5, 6), readout)
    course = Course(approach_s=4.0)
    return lampest.simulate(Simulation(1, 2, scene, frames=3, loads=(rod,), course=course))


def test_unloaded_frames_of_a_converter_without_noise_may_be_equal() -> None:
    quiet = pressed_slowly(noise_lsb=0.002)
    assert (quiet.recorded[0] == quiet.recorded[1]).all()
    assert (quiet.recorded[2] != quiet.recorded[5]).any()
    assert len(repeated_frames(quiet)) == 0


@pytest.mark.parametrize("copied", [1, 4])
def test_a_frame_of_a_noisy_converter_that_equals_the_one_before_is_a_copy(copied: int) -> None:
    noisy = pressed_slowly(noise_lsb=0.7)
    assert len(repeated_frames(noisy)) == 0
    recorded = noisy.recorded.copy()
    recorded[copied] = recorded[copied - 1]
    twice = Recording(noisy.scene, recorded, noisy.time, noisy.role)
    np.testing.assert_array_equal(repeated_frames(twice), [copied])
