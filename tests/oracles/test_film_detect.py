"""What a film remembers of a lamprey is no lamprey; one that comes back is."""

from dataclasses import replace

import numpy as np
import pytest

from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.loads.recognition.baseline import Baseline, Remembered
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.frame import Direct
from lampest.loads.recognition.settings import ModelErrors, RecognitionSettings
from lampest.loads.recognition.verdict import OR
from lampest.loads.shapes import OralDisc
from lampest.panel.film import Film
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.recording.simulation.measure import measured
from lampest.recording.simulation.pressure import Course
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.recording.simulation.unmodelled import Unmodelled
from lampest.report.detect.detection import GivenRecording, detected
from lampest.report.detect.events import events
from lampest.runs.filling import named_result

pytestmark = pytest.mark.slow

MOUTH = OralDisc(kind="oral_disc", centre_mm=(37, 35), diameter_mm=32, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=60)
SCENE = Scene(Panel(8, 8), TwoPointReadout(noise_lsb=0.7), 140.0)
FORGETS = ModelErrors(creep=0.0, creep_sd=0.0, remanence_sd=0.0)


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
    errors = ModelErrors(creep=0.05, creep_sd=0.02, remanence_sd=0.0)
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


def test_a_weak_lamprey_is_recognised_after_hours_because_the_unloaded_panel_is_taken_anew() -> None:
    """Cells drift by a quarter until it comes; against the first baseline its size is hardly known."""
    weak = replace(MOUTH, pressure_kpa=-4, rim_kpa=20)
    course, drift = Course(start_s=1350), Unmodelled(drift_per_minute=0.01)
    late = Simulation(1, 1, SCENE, frames=96, frame_period_s=15, loads=(weak,), course=course, unmodelled=drift)
    case = named_result(reconstruct(simulate(late), Estimator((Misfit(),), "naive")), "naive")
    found = [detected(GivenRecording.of(case, RecognitionSettings(zero_after=count)), None) for count in (0, 15)]
    assert [event.kind for event in events(found[1])] == ["attached"]
    assert np.nanmedian(found[0].errors[90:, 2]) > 1.3 * np.nanmedian(found[1].errors[90:, 2])
    stays, anew = (np.flatnonzero([bool(why) for why in one.tared]) for one in found)
    assert len(stays) == 0 and len(anew) > 2 and anew.max() < 90
    assert found[1].tared[anew[0]].startswith("nothing was there for 15 frames (210 s)")
    assert all("nothing" in label.split(OR) for label in found[1].labels[:90])


def test_memory_is_that_since_the_panel_was_taken_anew() -> None:
    resting = recorded(None).readings()[[0, 1, 2]].mean()
    assert resting.sigma is not None
    baseline = Baseline.of(
        resting.value, resting.sigma, SCENE, ModelErrors(creep=0.05, creep_sd=0.02, remanence_sd=0.0)
    )
    change = np.zeros(SCENE.panel.shape)
    change[3, 3] = 2.0
    film = Remembered.nothing(change.shape).after(change, 100.0)
    anew = film.against(film, 110.0)
    assert anew.rest(baseline, 0.0) is baseline
    whole = [film.rest(baseline, seconds).logarithm[3, 3] for seconds in (110.0, 160.0)]
    assert anew.rest(baseline, 50.0).logarithm[3, 3] - baseline.logarithm[3, 3] == pytest.approx(whole[1] - whole[0])


@pytest.mark.parametrize("minutes", [1.0, 10.0])
def test_memory_of_another_kind_is_nothing_either(minutes: float) -> None:
    """15 % of what cells have answered stays and fades exponentially, each cell's by a fifth more or less."""
    recording = recorded(None, frames=30)
    cells = recording.truth_cell_resistance
    assert cells is not None
    after = np.arange(len(cells)) - 18
    part = 0.15 * np.exp(0.2 * np.random.default_rng(3).standard_normal(SCENE.panel.shape))
    left = part * np.log(cells[12] / cells[0]) * np.exp(-np.maximum(after, 0) / (60 * minutes))[:, None, None]
    remembered = np.where((after >= 0)[:, None, None], cells * np.exp(left), cells)
    recorded_ohm, _ = measured(SCENE, remembered, Unmodelled(), 5)
    found = labels([replace(recording, recorded=recorded_ohm)], ModelErrors())
    assert all("nothing" in label.split(OR) for label in found[15:])
    if minutes == 1:
        forgetful = labels([replace(recording, recorded=recorded_ohm)], FORGETS)
        assert any("nothing" not in label.split(OR) for label in forgetful[15:])


def test_a_lamprey_that_sucks_less_is_still_there() -> None:
    less = recorded(None, replace(MOUTH, pressure_kpa=-3, rim_kpa=20), frames=6)
    found = labels([recorded(None, frames=15), less], ModelErrors())
    assert all("lamprey" in label.split(OR) and "nothing" not in label.split(OR) for label in found[16:])
