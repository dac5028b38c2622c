"""What live says: forces, the word for the panel's state, the history, attachments and alarms."""

import dataclasses
import json
import socket
import sys
import time
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from lampest import (
    Array,
    Faults,
    InputError,
    OralDisc,
    Panel,
    Readings,
    Scene,
    TwoPointReadout,
    Water,
    two_point_resistance,
)
from lampest.loads.pressure import Force, PressureTrack, water_pressure
from lampest.loads.recognition.attachment import Attachment
from lampest.loads.recognition.breathing import Breathing
from lampest.panel.panel import EachModule, Modules
from lampest.panel.response import PublishedResponse, ratio_from_pressure
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.simulation import Course, Simulation, simulate
from lampest.report.detect.answer import Detected
from lampest.report.detect.detection import detect_recording
from lampest.report.live import watcher as watcher_module
from lampest.report.live.engine import Engine, with_picture
from lampest.report.live.handover import Errand
from lampest.report.live.message import (
    ANSWER,
    HISTORY_FRAMES,
    Message,
    Picture,
    View,
    acknowledged,
    view_text,
    with_detected,
)
from lampest.report.live.publish import LslPublish, publish_at, waited
from lampest.report.live.run import METHODS, scan_of
from lampest.report.live.state import read_load, verdict_of
from lampest.report.live.watcher import Unloaded, Watched, in_one_batch, watcher


def force_of(kpa: Array, **entries: Any) -> Force:
    """Of 10 × 10 cells of 10 mm × 10 mm under such pressures, without error bars."""
    scene = Scene(Panel(10, 10), response=PublishedResponse(), **entries)
    water = water_pressure(scene.panel, scene.water)
    ratio = ratio_from_pressure(water + kpa) / ratio_from_pressure(water)
    return read_load(PressureTrack.begin(scene), ratio, None, 0.0)[1]


def test_the_total_pressure_of_the_cells_is_a_force() -> None:
    """10 kPa on 100 cells are 100 N; what sucks, what stood there before and what is broken counts as nothing."""
    ten = np.full((10, 10), 10.0)
    broken = Faults(dead_rows=(3,), shorted=((0, 0),))
    assert force_of(ten).newton == force_of(ten, water=Water(500.0)).newton == pytest.approx(100.0)
    assert force_of(np.repeat([[10.0], [-10.0]], 5, axis=0) * np.ones((10, 10))).newton == pytest.approx(50.0)
    assert force_of(ten, faults=broken).newton == pytest.approx(89.0)
    kpa = np.zeros((10, 10))
    kpa[2, 2:6], kpa[3, 3] = 10.0, 95.0
    force = force_of(kpa)
    assert force.newton == pytest.approx(4.0 + 4.0), "beyond 40 kPa a cell counts with that, and is counted"
    assert force.saturated == 1
    pressed, unknown = read_load(PressureTrack.begin(Scene(Panel(2, 2))), np.full((2, 2), 0.5), None, 0.0)
    assert pressed is None and np.isnan(unknown.newton), "a scene without a response has no force"


def drawn(change: Array, force: Force, *maps: Array, number: int = 1) -> Picture:
    """The picture of a frame; maps : cells, pressure, saturated."""
    return Picture(number, float(number), 0.0, change, change, change > 0, force, "fine", 0.0, 0, *maps)


VERDICTS_ON: tuple[tuple[dict[tuple[int, int], float], str], ...] = (
    ({}, "nothing"),
    ({(1, 1): 0.4}, "pressing"),
    ({(1, 1): 0.4, (1, 2): 1.1}, "pressing"),
    ({(1, 1): 3.0}, "sucking"),
    ({(1, 1): 0.1, (2, 2): 6.0}, "pressing and sucking"),
)


def test_the_verdict_on_a_panel_ignores_open_cells_and_residues_of_penalties() -> None:
    """Cells times so much; as much beside a load as a penalty leaves there is no suction, nor is an open cell."""
    cells = 3000 * np.exp(0.3 * np.random.default_rng(1).standard_normal((4, 5)))
    for (change, verdict), readout in product(VERDICTS_ON, (TwoPointReadout(), None)):
        scene, ratio, open_cell = Scene(Panel(4, 5), readout), np.ones((4, 5)), np.zeros((4, 5), dtype=bool)
        for cell, factor in change.items():
            ratio[cell] = factor
        resting, now = (Readings.of(scene, two_point_resistance(each)) for each in (cells, cells * ratio))
        assert verdict_of(now, resting, ratio, open_cell) == verdict
        open_cell[3, 4], ratio[3, 4] = True, 1e6
        assert verdict_of(now, resting, ratio, open_cell) == verdict


def test_the_history_keeps_its_newest_points() -> None:
    nothing = np.full((1, 1), np.nan)
    view = View("here", "LSM", "receiving", Panel(1, 1))
    for number in range(1, HISTORY_FRAMES + 50):
        view = with_picture(view, drawn(nothing, Force(1.0, 0.1), number=number))
    assert len(view.history) == HISTORY_FRAMES and view.history[-1].number == HISTORY_FRAMES + 49
    content = json.loads(view_text(view, 0.0, known=HISTORY_FRAMES + 46))
    assert content["history"] == [[HISTORY_FRAMES + number, 1.0] for number in (47.0, 48.0, 49.0)]
    assert json.loads(view_text(view, 0.0, known=HISTORY_FRAMES + 49))["picture"] is None


def message_of(load: Attachment | None = None, alarm: str = "", number: int = 7) -> Message:
    """A frame of 2 × 3 cells under a load, and what is said of it."""
    change, panel = np.arange(6.0).reshape(2, 3) - 4, Panel(2, 3)
    picture = drawn(change, Force(1.5, 0.1), 1000 + change, change / 2, change > 1, number=number)
    picture = dataclasses.replace(picture, verdict="pressing", status="fine", arrived=50.0)
    detected = None if load is None else Detected.of("here", (load,), 4.0)
    view = View("here", "LSM", "receiving", panel, picture=picture, detected=detected, alarm=alarm, deviation=0.25)
    return Message(panel, picture, view)


def test_equal_messages_are_told_by_their_signature() -> None:
    silent = message_of()
    assert np.isnan(silent.row()[-len(ANSWER) :]).all() and silent.signature == (7, "", "")
    assert len(message_of(LAMPREY).row()) == len(message_of().channels()) == len(silent.row())
    signatures = [message_of(*given).signature for given in ((LAMPREY,), (CUP,), (CUP, "alarm"), (CUP, "alarm", 8))]
    assert len({silent.signature, *signatures}) == 5 and message_of(CUP).signature == signatures[1]
    gone = dataclasses.replace(silent, picture=dataclasses.replace(silent.picture, verdict="unsolved"))
    assert not gone.solved and gone.row()[3] == 0.0


def test_a_message_describes_the_panel_of_its_frame() -> None:
    listed, modules = Panel(2, 2, cells=((0, 0, 1.5, 2.0), (1, 1, 9.0, 8.0))), Modules(1, 2, EachModule(2, 3, 5.0), 4.0)
    for panel, known in (
        (Panel(1, 2, 8.0), {"rows": 1, "columns": 2, "pitch_mm": 8.0}),
        (listed, {"x_mm": [1.5, None, None, 9.0], "y_mm": [2.0, None, None, 8.0]}),
        (Panel(modules=modules), {"rows": 2, "columns": 6, "pitch_mm": 5.0, "modules": [2, 3], "seam_mm": 4.0}),
    ):
        told = json.loads(view_text(View("here", "LSM", "receiving", panel), 0.0))["panel"]
        assert known.items() <= told.items() and ("modules" in told) == (panel.modules is not None)


def test_osc_has_a_message_for_every_number_and_map() -> None:
    from pythonosc.osc_bundle import OscBundle

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(10)
        way = publish_at(f"osc://127.0.0.1:{ear.getsockname()[1]}/panel")
        with way.opened(print) as (where, send):
            send(message_of())
            send(message_of(LAMPREY))
        sent = [ear.recv(65536) for _ in range(2)]
    assert where == way.where and where.startswith("osc://127.0.0.1:")
    silent, told = ({part.address.removeprefix("/panel/"): part.params for part in OscBundle(each)} for each in sent)
    assert set(told) - set(silent) == {"answer", "probability", "sentence", "detection"}
    known = {"sequence": [7], "time": [7.0], "size": [2, 3], "force": [1.5], "force_sd": [0.25], "solved": [True]}
    known |= {"verdict": ["pressing"], "status": ["fine"], "alarm": [""], "change": [-4, -3, -2, -1, 0, 1]}
    known |= {"pressure": [-2, -1.5, -1, -0.5, 0, 0.5], "cells": [996, 997, 998, 999, 1000, 1001]}
    assert silent == known
    assert told["answer"] == ["lamprey"] and told["sentence"][0].startswith("lamprey attached since 6.0 s")
    assert json.loads(told["detection"][0])["answer"] == "lamprey"


def test_lsl_stamps_a_frame_once_and_tells_an_answer_when_it_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    streams: dict[str, list[Any]] = {}

    def outlet(info: Any) -> SimpleNamespace:
        streams[info.name] = [info]
        return SimpleNamespace(push_sample=lambda *sample: streams[info.name].append(sample))

    def info(name: str, kind: str, channels: int, rate: float, form: str, source: str) -> SimpleNamespace:
        return SimpleNamespace(name=name, about=(kind, channels, rate, form, source), desc=lambda: Described())

    monkeypatch.setattr("time.time", lambda: 52.0)
    stub = {"StreamInfo": info, "StreamOutlet": outlet, "local_clock": lambda: 10.0, "IRREGULAR_RATE": 0.0}
    monkeypatch.setitem(sys.modules, "pylsl", SimpleNamespace(set_config_content=lambda text: None, **stub))
    with LslPublish.at(urlsplit("lsl://panel"), None).opened(print) as (where, send):
        for message in (message_of(), message_of(CUP), message_of(CUP, "alarm"), message_of(CUP, "alarm", 8)):
            send(message)
    (numbers, *rows), (texts, *answers) = streams["panel"], streams["panel-answer"]
    size = len(message_of().row())
    assert where == "lsl://panel" and numbers.about == ("Pressure", size, 0.0, "float32", "panel")
    assert texts.about == ("Markers", 1, 0.0, "string", "panel-answer")
    assert [(row[0], stamp) for row, stamp in rows] == [(7.0, 8.0), (8.0, 8.0)]
    assert [json.loads(text)["alarm"] for ((text,),) in answers] == ["", "alarm"]


class Described:
    """What a stream is described by."""

    def append_child(self, name: str) -> "Described":
        return self

    def append_child_value(self, name: str, value: str) -> None:
        assert isinstance(value, str)


def test_an_urgent_errand_waits_for_urgent_ones_alone() -> None:
    look, urgent, other = Errand("look", int), Errand("look", int, urgent=True), Errand("check", int)
    assert look.queued([other]) == [other, look]
    assert Errand("look", float).queued([look, other]) == [Errand("look", float), other]
    assert look.queued([urgent]) == [urgent] and urgent.queued([look]) == [urgent] == urgent.queued([urgent])
    assert look.run() == 0


SCENE = Scene(Panel(6, 6), TwoPointReadout(noise_lsb=0.7), 140.0, response=PublishedResponse())
MOUTH = OralDisc(centre_mm=(26, 24), diameter_mm=33, rim_width_mm=5.5, pressure_kpa=-10, rim_kpa=85)
LAMPREY = Attachment(0.99, 6.0, (44.0, 0.6), (46.0, 0.6), (35.0, 1.6), (-11.0, 1.9), breath=Breathing(6.0))
CUP = dataclasses.replace(LAMPREY, breath=Breathing(-6.0, -6.0, hertz=(1.0, 0.1)))


def taken(frames: int, loads: tuple[OralDisc, ...] = (), period_s: float = 0.25) -> Recording:
    """Three unloaded frames and some measured ones."""
    course = Course(start_s=1, approach_s=0.5, attachment_s=0.5, breathing_hz=1.1, breathing_depth=0.1)
    made = Simulation(1, 2, SCENE, frames=frames, loads=loads, frame_period_s=period_s, course=course)
    return dataclasses.replace(simulate(made), name="mouth")


def news(recording: Recording) -> list[object]:
    """As the engine hands a recording on."""
    scans = [scan_of(recording, frame) for frame in range(len(recording.time))]
    unloaded = tuple(scan for scan, role in zip(scans, recording.role, strict=True) if role == UNLOADED)
    measured = [scan for scan, role in zip(scans, recording.role, strict=True) if role == MEASURED]
    return [Unloaded(recording.scene, unloaded), *measured]


def watched(recording: Recording) -> Watched:
    """After all of it."""
    here = Watched(recording.name)
    for one in news(recording):
        here = here.after(one)
    return here


@pytest.mark.slow
def test_live_answers_as_detect_does(tmp_path: Path) -> None:
    recording = taken(40, (MOUTH,))
    recording.save(tmp_path / "mouth.h5")
    batch, live = detect_recording(tmp_path / "mouth.h5"), watched(recording).detected
    assert live.answer == batch.answer == "lamprey" and live.content().keys() == batch.content().keys()
    assert live.frames_per_second == batch.frames_per_second == 4.0
    (one,), (other,) = live.attachments, batch.attachments
    assert one.since_s == other.since_s and one.place == pytest.approx(other.place, abs=0.3)


def test_a_panel_that_nothing_has_touched_is_answered_with_nothing() -> None:
    assert Watched("mouth").detected.answer == "cannot say"
    here = watched(taken(4))
    assert here.detected.answer == "nothing"
    broken = dataclasses.replace(scan_of(taken(4), 6), recorded=np.full((2, 2), np.nan))
    told = here.after(broken).detected
    assert told.answer == "cannot say" and told.why
    assert here.after(broken).after(scan_of(taken(4), 6)).detected.answer == "nothing"
    scan = dataclasses.replace(scan_of(taken(4), 3), recorded=np.full((33, 32), 1000.0))
    told = Watched("mat").after(Unloaded(dataclasses.replace(SCENE, panel=Panel(33, 32)), (scan,) * 3)).detected
    assert told.answer == "cannot say" and "up to 1024 cells" in told.why


def test_a_new_zero_ends_what_was_attached_and_the_latest_of_what_has_left_is_remembered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(watcher_module, "MAX_REMEMBERED", 1)
    recording = taken(8)

    def with_attached(*attachments: Attachment) -> Watched:
        return dataclasses.replace(here, watch=dataclasses.replace(here.watch, attachments=attachments))

    here = watched(recording)
    left = [dataclasses.replace(LAMPREY, since_s=float(since), until_s=8.0) for since in (1, 2)]
    after = with_attached(CUP, *left).after(scan_of(recording, 6))
    assert after.detected.attachments == (CUP, left[1])
    here = with_attached(LAMPREY).after(2)
    for frame in (5, 6):
        assert here.detected.attachments[0].present
        here = here.after(scan_of(recording, frame))
    assert here.detected.attachments[0].until_s == recording.time[5] and not here.missing
    assert here.watch is not None and here.watch.rest_s == recording.time[6]


def test_an_alarm_stays_until_it_is_acknowledged_and_rises_once_for_each_lamprey() -> None:
    view = View("here", "LSM", "receiving", Panel(2, 3))
    cup, lamprey = (Detected.of("here", (one,), 4.0) for one in (CUP, LAMPREY))
    assert with_detected(view, cup).alarm == ""
    raised = with_detected(view, lamprey)
    assert raised.alarm == lamprey.sentence
    gone = Detected.of("here", (dataclasses.replace(LAMPREY, until_s=9.0),), 4.0)
    left = with_detected(raised, gone)
    assert "to 9.0 s" in left.alarm and with_detected(left, Detected.of("here", (), 4.0)).alarm == left.alarm
    seen = acknowledged(left)
    assert seen.alarm == "" and with_detected(seen, gone).alarm == ""
    another = Detected.of("here", (LAMPREY, dataclasses.replace(LAMPREY, since_s=20.0)), 4.0)
    assert with_detected(seen, another).alarm == another.sentence
    slow = Detected.of("here", (dataclasses.replace(LAMPREY, breath=Breathing()),), 1.0)
    assert with_detected(view, slow).alarm == slow.sentence, "nothing more will be known"


def test_more_than_can_be_watched_is_watched_less_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watcher_module, "MAX_WAITING", 4)
    (unloaded, *scans), waiting = news(taken(8)), []
    for one in (unloaded, *scans):
        waiting = in_one_batch([one], waiting)
    (batch,) = waiting
    assert batch[0] is unloaded and batch[-1] is scans[-1] and len(batch) <= 5
    for more, left in ((3, [0, 1, 2]), (4, [1, 3]), (5, [0, 2, 4])):
        (batch,) = in_one_batch(scans[2:more], [[unloaded, *scans[:2]]])
        assert batch == [unloaded, *(scans[number] for number in left)]


@pytest.mark.slow
def test_a_process_of_its_own_answers_and_its_death_is_said() -> None:
    answers: list[Detected] = []
    beside = watcher("mouth", answers.append)
    for one in news(taken(4)):
        beside.ask([one])
    beside.finish()
    assert answers[-1].answer == "nothing"
    beside = watcher("mouth", answers.append)
    beside.ask([2])
    assert waited(lambda: bool(beside._workers.processes), 20.0)
    beside._workers.kill()
    beside.finish()
    assert answers[-1].answer == "cannot say" and "has died" in answers[-1].why
    beside.close()


def test_an_address_has_the_usual_host_port_and_path_of_its_protocol() -> None:
    wheres = {"mqtt": "mqtt://localhost:1883/lampest", "mqtt://a/b/": "mqtt://a:1883/b", "osc://:7/x": None}
    for where, whole in wheres.items():
        found = publish_at(where)
        assert found.where == (whole or f"osc://{type(found).host}:7/x")
    way = publish_at("mqtt://me:p%40ss@h:5/t", "key")
    assert (way.user, way.password, way.token, way.where) == ("me", "p@ss", "key", "mqtt://h:5/t")
    for wrong, words in (("mqtt://h:99999", "is no address"), ("mqtt://h?x=1", "question mark"), ("up", "begins with")):
        with pytest.raises(InputError, match=words):
            publish_at(wrong)


def test_a_wait_ends_with_its_condition_or_its_time() -> None:
    answers = [True, True, True, False, False]
    assert waited(lambda: answers.pop(), 60.0) and answers == [True], "asked once more at the end"
    begin = time.monotonic()
    assert not waited(lambda: False, 0.03) and 0.03 <= time.monotonic() - begin < 5.0
    assert waited(lambda: True, 0.0)


def test_an_answer_that_changes_is_in_the_log_with_its_reason(caplog: pytest.LogCaptureFixture) -> None:
    answers = [Detected.of("mouth", (one,), 4.0) for one in (CUP, CUP, LAMPREY, LAMPREY)]
    with Engine("test", "test", METHODS["smooth"], 3) as engine:
        for answer in answers:
            engine._take_detected(answer)
    said = [record.getMessage() for record in caplog.records if record.name == "lampest"]
    assert said == [f"mouth: {answers[0].sentence}", f"mouth: {answers[2].sentence}"]
