"""Messages of live: forces, the word for the panel's state, history, attachments and alarms."""

import dataclasses
import functools
import time
from pathlib import Path

import pytest

from lampest import (
    OralDisc,
    Panel,
    Scene,
    TwoPointReadout,
)
from lampest.apps.live.engine import Engine
from lampest.apps.live.handover import Errand
from lampest.apps.live.publish import waited
from lampest.apps.live.run import METHODS, scan_of
from lampest.apps.live.watcher import Unloaded, Watched, watcher
from lampest.apps.recognition.attachment import Attachment
from lampest.apps.recognition.breathing import Breathing
from lampest.apps.recognition.detect.answer import Detected, alarming
from lampest.apps.recognition.detect.detection import detect_recording
from lampest.panel.response import PublishedResponse
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.simulation import Course, Simulation, simulate

SCENE = Scene(Panel(6, 6), TwoPointReadout(noise_lsb=0.7), 140.0, response=PublishedResponse())
MOUTH = OralDisc(centre_mm=(26, 24), diameter_mm=33, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=85)
LAMPREY = Attachment(
    0.99, 6.0, (44.0, 0.6), (46.0, 0.6), (35.0, 1.6), ((-11.0, 1.9),), breath=Breathing(6.0)
)
CUP = dataclasses.replace(LAMPREY, breath=Breathing(-6.0, -6.0, hertz=(1.0, 0.1)))


def test_an_urgent_errand_waits_only_for_urgent_ones() -> None:
    look = Errand("look", int)
    urgent = Errand("look", int, urgent=True)
    check = Errand("check", int)
    assert look.queued([check]) == [check, look]
    assert Errand("look", float).queued([look, check]) == [Errand("look", float), check]
    assert look.queued([urgent]) == [urgent] and urgent.queued([look]) == [urgent] == urgent.queued(
        [urgent]
    )
    assert look.run() == 0


def simulated_mouth(
    frames: int, loads: tuple[OralDisc, ...] = (), period_s: float = 0.25
) -> Recording:
    """Three unloaded frames and some measured ones."""
    course = Course(
        start_s=1, approach_s=0.5, attachment_s=0.5, breathing_hz=1.1, breathing_depth=0.1
    )
    simulation = Simulation(
        1, 2, SCENE, frames=frames, loads=loads, frame_period_s=period_s, course=course
    )
    return dataclasses.replace(simulate(simulation), name="mouth")


def news(recording: Recording) -> list[object]:
    """Return the scans of a recording in the form in which the engine passes them on."""
    scans = [scan_of(recording, frame) for frame in range(len(recording.time))]
    unloaded = tuple(
        scan for scan, role in zip(scans, recording.role, strict=True) if role == UNLOADED
    )
    measured = [scan for scan, role in zip(scans, recording.role, strict=True) if role == MEASURED]
    return [Unloaded(recording.scene, unloaded), *measured]


@pytest.mark.slow
def test_live_and_detect_give_the_same_answer(tmp_path: Path) -> None:
    recording = simulated_mouth(40, (MOUTH,))
    recording.save(tmp_path / "mouth.h5")
    batch = detect_recording(tmp_path / "mouth.h5")
    live = functools.reduce(Watched.after, news(recording), Watched(recording.name)).detected
    assert (
        live.answer == batch.answer == "lamprey" and live.content().keys() == batch.content().keys()
    )
    assert live.frames_per_second == batch.frames_per_second == 4.0
    (live_load,) = live.attachments
    (batch_load,) = batch.attachments
    assert live_load.since_s == batch_load.since_s and live_load.place == pytest.approx(
        batch_load.place, abs=0.3
    )


@pytest.mark.slow
def test_the_watching_process_answers_and_its_death_is_reported() -> None:
    answers: list[Detected] = []
    watching = watcher("mouth", answers.append)
    for item in news(simulated_mouth(4)):
        watching.ask([item])
    watching.finish()
    assert answers[-1].answer == "nothing"
    watching = watcher("mouth", answers.append)
    watching.ask([2])
    assert waited(lambda: watching._worker.process is not None, 20.0)
    watching._worker.kill()
    watching.finish()
    assert answers[-1].answer == "cannot say" and "has died" in answers[-1].why
    watching.close()


def test_a_wait_ends_on_its_condition_or_timeout() -> None:
    answers = [True, True, True, False, False]
    assert waited(lambda: answers.pop(), 60.0) and answers == [True], "asked once more at the end"
    begin = time.monotonic()
    assert not waited(lambda: False, 0.03) and 0.03 <= time.monotonic() - begin < 5.0
    assert waited(lambda: True, 0.0)


def test_below_four_frames_a_second_everything_that_sucks_raises_the_alarm() -> None:
    unsure = dataclasses.replace(LAMPREY, breath=Breathing(0.0))
    stone = dataclasses.replace(unsure, sucks=0.01)
    for rate, raised in ((8.0, []), (1.0, [unsure.since_s])):
        assert alarming(Detected.of("mouth", (unsure,), rate)) == raised
        assert alarming(Detected.of("mouth", (stone,), rate)) == []
        assert alarming(Detected.of("mouth", (LAMPREY,), rate)) == [LAMPREY.since_s]


def test_the_log_contains_each_changed_answer_with_its_reason(
    caplog: pytest.LogCaptureFixture,
) -> None:
    answers = [Detected.of("mouth", (load,), 4.0) for load in (CUP, CUP, LAMPREY, LAMPREY)]
    with Engine("test", "test", METHODS["smooth"], 3) as engine:
        for answer in answers:
            engine._take_detected(answer)
    messages = [record.getMessage() for record in caplog.records if record.name == "lampest"]
    assert messages == [f"mouth: {answers[0].sentence}", f"mouth: {answers[2].sentence}"]
