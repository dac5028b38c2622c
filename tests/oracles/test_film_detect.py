"""Over time: a load that stays is kept however still it is, what a film remembers of one is none, and bare panels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from docs.studies.attachments import recording as attached
from lampest import Array, Film, OralDisc, Panel, Recording, Rod, Scene, Shape, TwoPointReadout
from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.evidence import Verdict
from lampest.loads.recognition.observation import ModelErrors, Observation
from lampest.loads.recognition.watch import Panelled, Watch
from lampest.recording.simulation.measure import Unmodelled, measured
from lampest.recording.simulation.simulation import Course, Simulation, simulate
from lampest.report.detect.detection import detect_recording

pytestmark = pytest.mark.slow

MOUTH = OralDisc(kind="oral_disc", centre_mm=(37, 35), diameter_mm=32, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=60)
ROD = Rod(kind="rod", centre_mm=(37, 35), diameter_mm=30, mass_g=300)
SCENE = Scene(Panel(8, 8), TwoPointReadout(noise_lsb=0.7), 140.0)


def recorded(
    film: Film | None, load: Shape = MOUTH, frames: int = 40, release: float = 15, start: float = 4
) -> Recording:
    """A load from `start` on, and then nothing; s after the unloaded frames."""
    course = Course(start_s=start, approach_s=0.5, attachment_s=0.5, release_at_s=release, release_s=0.2)
    return simulate(Simulation(1, 5, SCENE, frames=frames, loads=(load,), course=course, film=film))


def watched(
    recordings: list[Recording], minutes: float = 0.0, drift: float = 0.0, period: float = 1.0
) -> tuple[Attachment, ...]:
    """What is attached in recordings, one after the other; the first has the baseline.

    minutes : between the first frames of the load and its last. drift : of ln y a decade, of each reading by itself a
    tenth of that. period : s, between frames.
    """
    readings = recordings[0].readings()
    resting = readings[[0, 1, 2]].mean()
    panelled = Panelled(SCENE, Detector(SCENE.panel, 6.0), np.zeros(SCENE.panel.shape), ModelErrors())
    watch = Watch.begin(panelled, resting.value, readings.sigma[0], readings.value[:3], 0.0)
    rng, time = np.random.default_rng(3), 0.0
    wander = drift * (1 + 0.1 * rng.standard_normal(SCENE.panel.shape))

    def pushed(watch: Watch, value: Array, sigma: Array, time: float) -> Watch:
        return watch.push(value * np.exp(wander * np.log10(1 + time / 10)), sigma, time)

    for recording in recordings:
        readings = recording.readings()
        for number in range(3, len(readings.value)):
            time += period
            watch = pushed(watch, readings.value[number], readings.sigma[number], time)
            for _ in range(round(60 * minutes / period) if number == 14 else 0):
                time += period
                noise = readings.sigma[number] * rng.standard_normal(SCENE.panel.shape)
                watch = pushed(watch, readings.value[number] + noise, readings.sigma[number], time)
    return watch.attachments


@pytest.mark.parametrize("creep", [0.03, 0.1])
def test_memory_of_a_lamprey_is_nothing(creep: float) -> None:
    (one,) = watched([recorded(Film(0.24, creep, cell_spread=0.2))])
    assert one.sucks > 0.9 and one.since_s == pytest.approx(5, abs=2) and one.until_s == pytest.approx(16, abs=2)


@pytest.mark.parametrize("load", [MOUTH, ROD], ids=["mouth", "rod"])
@pytest.mark.parametrize("drift", [0.0, 0.02])
def test_what_is_attached_stays_until_the_readings_step(load: Shape, drift: float) -> None:
    (one,) = watched([recorded(Film(0.24, 0.03), load)], minutes=5, drift=drift)
    assert one.since_s == pytest.approx(5, abs=2) and one.until_s == pytest.approx(316, abs=5)
    assert (one.sucks > 0.5) == (load is MOUTH)


def test_an_hour_at_a_frame_every_ten_seconds_is_kept_from_the_first_frame_to_the_last() -> None:
    (one,) = watched([recorded(Film(0.24, 0.03))], minutes=60, drift=0.02, period=10)
    assert one.since_s == pytest.approx(55, abs=6) and one.until_s == pytest.approx(3765, abs=6)
    assert one.sucks > 0.5


def test_a_known_load_ends_by_a_step_and_not_by_an_opinion(monkeypatch: pytest.MonkeyPatch) -> None:
    """However probable drift makes it afterwards that nothing is there."""
    first, verdicts = Detector.verdict, list[Verdict]()

    def judged(self: Detector, frame: Observation, before: Verdict | None = None) -> Verdict:
        verdicts.append(first(self, frame, before))
        nothing = (1.0, *(0.0 for _ in verdicts[-1].fits[1:]))
        return verdicts[-1] if len(verdicts) == 1 else replace(verdicts[-1], shares=nothing)

    monkeypatch.setattr(Detector, "verdict", judged)
    (one,) = watched([recorded(None)])
    assert len(verdicts) > 1 and one.since_s == pytest.approx(5, abs=2) and one.until_s == pytest.approx(16, abs=2)


def test_drift_of_hours_is_little_and_mostly_common_to_all_cells() -> None:
    covariance = ModelErrors().resting_covariance(6 * 3600, 4)
    assert 0.02 < np.sqrt(covariance[0, 0]) < 0.1 and covariance[0, 1] > 0.5 * covariance[0, 0]
    assert ModelErrors().resting_sd(86400) < 2 * ModelErrors().resting_sd(3600)


def test_a_weaker_lamprey_that_comes_back_to_its_place_is_seen() -> None:
    again = recorded(None, replace(MOUTH, pressure_kpa=-4, rim_kpa=30))
    found = watched([recorded(None), again])
    assert len(found) == 2 and all(one.sucks > 0.9 for one in found)


def test_a_lamprey_that_sucks_less_is_still_there() -> None:
    less = recorded(None, replace(MOUTH, pressure_kpa=-3, rim_kpa=20), release=60, start=-0.9)
    found = watched([recorded(None, frames=12, release=60), less])
    assert found[-1].present and found[-1].sucks > 0.5


@pytest.mark.parametrize("seed", range(2))
def test_a_bare_panel_is_nothing_for_ten_minutes(seed: int) -> None:
    """With drift, a gain that scatters, ripple and outliers."""
    real = Unmodelled(gain_spread=0.001, supply_ripple_lsb=0.4, outlier_probability=1e-4)
    bare = simulate(Simulation(1, seed, SCENE, frames=600, unmodelled=real))
    assert watched([bare], drift=0.02) == ()


@pytest.mark.parametrize("minutes", [1.0, 10.0])
def test_memory_of_another_kind_is_nothing_either(minutes: float) -> None:
    """15 % of what cells have answered stays and fades exponentially, each cell's by a fifth more or less."""
    recording = recorded(None, frames=60)
    cells = recording.truth_cell_resistance
    after = np.arange(len(cells)) - 18
    part = 0.15 * np.exp(0.2 * np.random.default_rng(3).standard_normal(SCENE.panel.shape))
    left = part * np.log(cells[12] / cells[0]) * np.exp(-np.maximum(after, 0) / (60 * minutes))[:, None, None]
    remembered = np.where((after >= 0)[:, None, None], cells * np.exp(left), cells)
    recorded_ohm, _ = measured(SCENE, remembered, Unmodelled(), 5)
    (one,) = watched([replace(recording, recorded=recorded_ohm)])
    assert one.until_s == pytest.approx(16, abs=2)


def test_a_step_of_noise_is_no_load(tmp_path: Path) -> None:
    """A recording not made with this package, in whose first frames ripple steps: a load was 1.5 times as probable."""
    bare, *_ = attached("nothing", 4.0, 98004)
    bare.save(tmp_path / "bare.h5")
    assert detect_recording(tmp_path / "bare.h5").answer == "nothing"
