"""What a film remembers of a lamprey is no lamprey; one that comes back is."""

from dataclasses import replace

import numpy as np
import pytest

from lampest.loads.recognition.baseline import Baseline
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.frame import Direct
from lampest.loads.recognition.memory import Remembered
from lampest.loads.recognition.model_errors import ModelErrors
from lampest.loads.recognition.verdict import OR
from lampest.loads.shapes import OralDisc
from lampest.panel.film import Film
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.recording.simulation.course import Course
from lampest.recording.simulation.simulation import Simulation, simulate

MOUTH = OralDisc(kind="oral_disc", centre_mm=(37, 35), diameter_mm=32, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=60)
SCENE = Scene(Panel(8, 8), TwoPointReadout(noise_lsb=0.7), 140.0)
FORGETS = ModelErrors(creep=0.0, creep_sd=0.0)


def recorded(film: Film | None, mouth: OralDisc = MOUTH, frames: int = 24) -> Recording:
    """A lamprey of 15 frames, then nothing."""
    course = Course(release_at_s=15)
    return simulate(Simulation(1, 5, SCENE, frames=frames, loads=(mouth,), course=course, film=film))


def labels(recordings: list[Recording], errors: ModelErrors) -> list[str]:
    """What the frames of recordings, one after the other, are called; the first one has the baseline."""
    readings = recordings[0].readings()
    resting = readings[[0, 1, 2]].mean()
    assert resting.sigma is not None
    baseline = Baseline.of(resting.value, resting.sigma, SCENE, errors)
    detector, found = None, []
    for recording in recordings:
        readings = recording.readings()
        assert readings.sigma is not None
        for value, sigma in zip(readings.value[3:], readings.sigma[3:], strict=True):
            frame = Direct(value, sigma, baseline, np.zeros(SCENE.panel.shape), len(found) + 1.0)
            detector, verdict = (detector or Detector.of(SCENE.panel, 6.0, frame)).push(frame)
            found.append(verdict.label)
    return found


@pytest.mark.parametrize("creep", [0.03, 0.1])
def test_memory_of_a_lamprey_is_nothing(creep: float) -> None:
    recording = recorded(Film(0.24, creep, cell_spread=0.2))
    found = labels([recording], ModelErrors())
    assert all("lamprey" in label.split(OR) for label in found[2:15])
    assert all("nothing" in label.split(OR) for label in found[15:])
    forgetful = labels([recording], FORGETS)
    assert any("nothing" not in label.split(OR) for label in forgetful[15:])


def test_a_weaker_lamprey_that_comes_back_to_its_place_is_seen() -> None:
    again = recorded(None, replace(MOUTH, pressure_kpa=-4, rim_kpa=30), frames=6)
    found = labels([recorded(None, frames=20), again], ModelErrors())
    assert all("lamprey" in label.split(OR) and "nothing" not in label.split(OR) for label in found[21:26])


def test_memory_follows_from_the_answer_and_fades() -> None:
    recording = recorded(None)
    resting = recording.readings()[[0, 1, 2]].mean()
    assert resting.sigma is not None
    errors = ModelErrors(creep=0.05, creep_sd=0.02)
    baseline = Baseline.of(resting.value, resting.sigma, SCENE, errors)
    change = np.zeros(SCENE.panel.shape)
    change[3, 3], change[3, 4] = 1.5, -2.0
    nothing = Remembered.nothing(change.shape)
    assert nothing.rest(baseline, 1.0) is baseline
    film = nothing.after(change, 100.0)
    for seconds, decades in ((10.0, np.log10(11)), (100.0, np.log10(2))):
        rest = film.rest(baseline, 100 + seconds)
        left = rest.logarithm - baseline.logarithm
        np.testing.assert_allclose(left[3, 3:5], 0.05 * decades * np.array([1.5, -2.0]), rtol=0.1)
        assert np.count_nonzero(left) == 2
        widened = np.sqrt(np.diag(rest.covariance - baseline.covariance)[:64].reshape(8, 8)[3, 3])
        assert widened == pytest.approx(left[3, 3] * np.hypot(0.4, 0.3 * np.hypot(1, 0.4)), rel=1e-6)
    assert film.rest(baseline, 1e6) is baseline
