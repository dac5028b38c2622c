"""The live engine and its server, without a board and without a browser."""

import dataclasses
import http.client
import json
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support import live_pictures

from lampest import two_point_resistance
from lampest.cost.terms import Arrival, Misfit
from lampest.estimate.estimator import AutoWeight, Bounds, Estimator
from lampest.estimate.prepared import Prepared
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError
from lampest.loads.pressure import Force, Pressure, PressureTrack, total_force, water_pressure
from lampest.loads.shapes import Rod
from lampest.loads.tare import Tare
from lampest.panel.film import Film
from lampest.panel.panel import Array, EachModule, Modules, Panel
from lampest.panel.readouts import TwoPointReadout, VirtualGroundReadout
from lampest.panel.response import PublishedResponse, ratio_from_pressure
from lampest.panel.scene import Faults, Scene, Water
from lampest.recording.readings import Readings
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.simulation import Course, Simulation, Unmodelled, read_simulations, simulate
from lampest.report.live import engine as engine_module
from lampest.report.live import server as server_module
from lampest.report.live.engine import Engine, FrameSource, with_picture
from lampest.report.live.handover import Newest
from lampest.report.live.message import POINTS, Message, Picture, View, view_text
from lampest.report.live.run import METHODS, Replay, chosen, from_recording, live
from lampest.report.live.server import Asks, PageServer, address, is_local_name, serving
from lampest.report.live.state import ASKED, PanelState, read_load, verdict_of
from lampest.report.live.watcher import Scan
from lampest.solvers.solution import Settings

LAMPREY = Path(__file__).parents[2] / "data" / "lamprey_25mm.h5"
LSM = Estimator((Misfit(),), "reduced")


@pytest.fixture(scope="module")
def lamprey() -> Recording:
    """Three unloaded and six measured frames."""
    whole = Recording.load(LAMPREY)
    cut = {name: getattr(whole, name)[:9] for name in ("recorded", "time", "role")}
    return dataclasses.replace(
        whole, **cut, truth_cell_resistance=None, truth_pressure=None, raw_sums=None, raw_readings=None
    )


def pictures(estimator: Estimator, recording: Recording, baseline: int = 3) -> list[Picture]:
    """A replay in which every frame waits until the one before was solved."""
    return live_pictures(estimator, baseline, lambda engine: from_recording(engine, recording, 1e9, None))


ARRIVAL = Estimator((Misfit(weighting="noise"), Arrival()), "reduced")


def of_every_frame(name: str) -> Estimator:
    """A method that takes every frame's own weight, since only a batch knows which will be the strongest."""
    return dataclasses.replace(METHODS[name], auto_weight=AutoWeight(per="frame"))


def test_weights_live_follow_the_strongest_frame_so_far(lamprey: Recording) -> None:
    ends = live_pictures(METHODS["smooth"], 3, lambda engine: from_recording(engine, lamprey, 1e9, None))
    batch = reconstruct(lamprey, METHODS["smooth"])
    last = ends[-1].relative_change
    assert np.median(np.abs(last - batch.relative_change[-1])) < 0.1 * np.median(np.abs(batch.relative_change[-1]))


@pytest.mark.slow
def test_what_is_left_to_another_process_reaches_the_frames_after(
    lamprey: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Weights, lower minima and error bars: a load that stays is soon seen as by an engine that waits for them."""
    monkeypatch.setattr(engine_module, "BARS_SECONDS", 0.0)
    lies = dataclasses.replace(lamprey, recorded=lamprey.recorded[[0, 1, 2, *(6 * [8])]])
    (waited,) = live_pictures(METHODS["smooth"], 3, lambda engine: from_recording(engine, lies, 1e9, None))[-1:]
    batch = reconstruct(lies, METHODS["smooth"])
    assert batch.pressure_errors is not None and batch.pressure is not None
    with Engine("test", "test", METHODS["smooth"], 3, beside=True) as engine:

        def found(seconds: float) -> None:
            until(lambda: engine.shown.thing.frames in (3, engine.shown.thing.deviation_of))  # three are unloaded

        from_recording(engine, lies, 1e9, None, found)
        engine.finish()
        view = engine.shown.thing
    assert view.picture is not None and view.skipped == 0
    np.testing.assert_allclose(view.picture.relative_change, waited.relative_change, atol=0.05)
    names = ("pressure", "lower", "upper", "errors", "own", "common", "saturated", "pressing")
    last = Pressure(*(getattr(batch._load, name)[-1] for name in names))
    force = total_force(lies.scene, last)
    assert view.deviation == pytest.approx(force.deviation, rel=0.1)
    assert json.loads(view_text(view, 0.0))["deviation"] == pytest.approx(view.deviation, abs=1e-4)


@pytest.mark.slow
def test_should_the_other_process_die_every_frame_waits_for_its_own(lamprey: Recording) -> None:
    with Engine("test", "test", METHODS["smooth"], 3, beside=True) as engine:

        def kill(seconds: float) -> None:
            settle(engine)
            beside = engine._beside
            assert beside is not None
            if engine.shown.thing.frames == 5:
                beside._worker.process.kill()
                until(lambda: beside.gone)

        from_recording(engine, lamprey, 1e9, None, kill)
        engine.finish()
        view = engine.shown.thing
    assert view.picture is not None and view.picture.status == "optimum verified"
    assert view.deviation_of == view.picture.number, "error bars come with the frame"


def until(true: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait until something is true."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.005)


@pytest.mark.parametrize(
    "method", [of_every_frame("smooth"), of_every_frame("relative_change"), ARRIVAL], ids=["gCR", "dCR", "arrival"]
)
def test_live_finds_what_a_batch_finds(method: Estimator) -> None:
    # Without outliers: only a batch sees the frames after one, which tell it from a change.
    ((_, simulation),) = read_simulations(Path(__file__).parents[2] / "configs" / "lamprey_35mm.yaml")
    calm = dataclasses.replace(simulation.unmodelled, outlier_probability=0.0)
    lamprey = simulate(dataclasses.replace(simulation, frames=6, unmodelled=calm))
    found = pictures(method, lamprey)
    batch = reconstruct(lamprey, method)
    np.testing.assert_array_equal([picture.relative_change for picture in found], batch.relative_change)
    np.testing.assert_array_equal(
        [picture.measured_change for picture in found], 100 * (batch.measured / batch.measured_baseline - 1)
    )
    assert [picture.status for picture in found] == ["optimum verified"] * 6
    np.testing.assert_array_equal(
        [picture.open_cell for picture in found], [s.solution.open_cell[-1] for s in batch.steps]
    )


def test_an_unloaded_reading_that_leaps_is_left_out_as_in_a_batch(lamprey: Recording) -> None:
    recorded = lamprey.recorded.copy()
    recorded[1, 2, 3] *= 1.5
    wild = dataclasses.replace(lamprey, recorded=recorded)
    found, calm = pictures(LSM, wild), pictures(LSM, lamprey)
    batch = reconstruct(wild, LSM)
    assert batch.noise.outliers[1, 2, 3]
    measured = np.array([picture.measured_change for picture in found])[:, 2, 3]
    np.testing.assert_allclose(measured, 100 * (batch.measured / batch.measured_baseline - 1)[:, 2, 3])
    np.testing.assert_allclose(measured, [picture.measured_change[2, 3] for picture in calm], atol=1)


def test_coupled_modules_leave_weights_to_second_looks_and_modules_by_themselves_nothing() -> None:
    for coupled in (True, False):
        scene = Scene(Panel(modules=Modules(1, 2, EachModule(4, 4), coupled=coupled)))
        resting = Readings.of(scene, np.full((4, 8), 1000.0))
        assert PanelState.begin(METHODS["smooth"], scene, 0.25, resting, hasty=True).stream.hasty == coupled


def test_a_reading_that_leaps_alone_stands_as_before_and_a_touch_does_not(lamprey: Recording) -> None:
    """Nobody knows yet whether it comes back: a touch of one cell moves its row and column, a lost bit does not."""
    scene = lamprey.scene
    cells = np.repeat(
        3000 * np.exp(0.1 * np.random.default_rng(1).standard_normal((1, *scene.panel.shape))), 10, axis=0
    )
    cells[8, 6, 2] *= 0.2
    exact = two_point_resistance(cells) + scene.series_resistance_ohm
    exact[7, 4, 4] *= 1.3
    role = np.where(np.arange(10) < 3, UNLOADED, MEASURED).astype(np.uint8)
    found = pictures(LSM, Recording(scene, exact, np.arange(10.0), role))
    assert [picture.outliers for picture in found] == [0, 0, 0, 0, 1, 0, 0]
    told = Message(scene.panel, found[4], View("here", "LSM", "receiving", scene.panel)).text()
    assert json.loads(told)["health"]["leaps"] == 1
    assert np.abs(found[4].relative_change).max() < 1
    assert found[5].relative_change[6, 2] == pytest.approx(-80, abs=1)


def test_where_a_reading_hears_its_own_cell_alone_nothing_is_taken_for_a_leap() -> None:
    readout = VirtualGroundReadout(feedback_ohm=1000.0, adc_bits=12, noise_lsb=1.0)
    scene = Scene(Panel(6, 7), readout)
    cells = np.full((8, 6, 7), 3000.0)
    cells[6:, 2, 3] = 1000.0
    role = np.where(np.arange(8) < 3, UNLOADED, MEASURED).astype(np.uint8)
    found = pictures(LSM, Recording(scene, readout.exact_reading(cells), np.arange(8.0), role))
    assert [picture.outliers for picture in found] == [0] * 5
    assert found[3].relative_change[2, 3] == pytest.approx(-66.7, abs=1)


def test_the_first_frames_are_the_baseline_where_none_is_said_to_be(lamprey: Recording) -> None:
    unsaid = dataclasses.replace(lamprey, role=np.full(9, MEASURED))
    found = pictures(METHODS["smooth"], unsaid)
    said = pictures(METHODS["smooth"], lamprey)
    np.testing.assert_array_equal(
        [picture.relative_change for picture in found], [picture.relative_change for picture in said]
    )
    assert [picture.number for picture in found] == [4, 5, 6, 7, 8, 9]


def test_a_circuit_that_does_not_explain_the_frames_is_said(lamprey: Recording) -> None:
    """The recording was made with 140 ohm in series; here nobody tells."""
    scene = dataclasses.replace(lamprey.scene, series_resistance_ohm=0.0)
    with Engine("test", "test", LSM, 3) as engine:
        from_recording(engine, dataclasses.replace(lamprey, scene=scene), 1e6, None)
        engine.finish()
        said = engine.shown.thing.model
    assert "series_resistance_ohm near" in said
    assert json.loads(view_text(View("a", "b", "c", model=said), 0.0))["model"] == said


def test_a_wrong_reading_and_channels_that_differ_are_no_other_circuit() -> None:
    """The first loaded frames of the shipped mouth: one reading is wrong, and its rim presses cells to 100 ohm."""
    mouth = Recording.load(LAMPREY.with_name("lamprey_35mm.h5"))
    frames = np.append(np.flatnonzero(mouth.role == UNLOADED), [4, 5, 6])
    role = np.array([UNLOADED] * 3 + [MEASURED] * 3, dtype=np.uint8)
    check = Prepared(Recording(mouth.scene, mouth.recorded[frames], np.arange(6.0), role)).check
    assert check.mark == "yes"


def test_slow_solving_goes_on_with_the_newest_frame_and_says_what_it_passed_over(
    lamprey: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go, shown, truly = threading.Semaphore(0), threading.Semaphore(0), [], engine_module.solved_scan

    def slowly(*arguments: Any) -> Any:
        begun.release()
        assert go.acquire(timeout=20)
        stream, picture = truly(*arguments)
        shown.append(picture)
        return stream, picture

    monkeypatch.setattr(engine_module, "solved_scan", slowly)
    source = FrameSource(lamprey.scene, 1.0, "receiving")
    scan = Scan(lamprey.recorded[5], None, 1.0, time.time())
    with Engine("test", "test", LSM, 1) as engine:
        for _ in range(2):
            engine.take(source, scan)
        assert begun.acquire(timeout=20)
        began = time.monotonic()
        for _ in range(5):
            engine.take(source, dataclasses.replace(scan, lost=2))
        assert time.monotonic() - began < 1, "taking a frame must not wait for the solver"
        go.release(10)
        engine.finish()
        view = engine.shown.thing
    assert [(picture.number, picture.skipped) for picture in shown] == [(2, 0), (7, 4)]
    assert (view.frames, view.lost, view.skipped, len(view.history)) == (7, 10, 4, 2)


def test_a_frame_that_fails_shows_no_number_and_the_next_one_goes_on(lamprey: Recording) -> None:
    resistance = lamprey.resistance.copy()
    resistance[4, 1:] = np.nan
    found = pictures(LSM, dataclasses.replace(lamprey, recorded=resistance))
    failed, after = found[1], found[2]
    assert failed.status == "too few of the frame's readings are values: the others are missing, or bounds"
    assert np.isnan(failed.measured_change[1:]).all() and np.isfinite(failed.measured_change[0]).all()
    assert np.isnan(failed.relative_change).all() and np.isnan(failed.force.newton) and not failed.open_cell.any()
    assert after.status == "optimum verified" and np.isfinite(after.relative_change).all()
    view = with_picture(View("here", "LSM", "receiving", lamprey.scene.panel), failed)
    content = json.loads(view_text(view, 0.0), parse_constant=pytest.fail)
    assert content["picture"]["change"] == [None] * 100 and not content["picture"]["health"]["solved"]
    assert content["picture"]["force"] is None and content["history"] == [[failed.time, None]]


def test_a_solver_that_gives_up_shows_its_sentence(lamprey: Recording) -> None:
    hasty = dataclasses.replace(METHODS["smooth"], solver=Settings(max_iterations=1))
    given_up = [picture for picture in pictures(hasty, lamprey) if picture.status != "optimum verified"]
    assert given_up
    for picture in given_up:
        assert picture.status == "no baseline: the iteration limit was reached before an optimum" or (
            picture.status == "the iteration limit was reached before an optimum"
        )
        assert np.isnan(picture.relative_change).all() and np.isnan(picture.force.newton)


def test_an_unloaded_panel_below_the_series_resistance_is_said_in_every_frame(lamprey: Recording) -> None:
    scene = dataclasses.replace(lamprey.scene, series_resistance_ohm=5000.0)
    for picture in pictures(LSM, dataclasses.replace(lamprey, scene=scene)):
        assert picture.status == "too few of the frame's readings are values: the others are missing, or bounds"
        assert np.isnan(picture.relative_change).all() and np.isnan(picture.force.newton)


@pytest.mark.parametrize("frames", [None, 1])
def test_what_stops_the_solver_stops_live(lamprey: Recording, frames: int | None) -> None:
    narrow = dataclasses.replace(LSM, bounds=Bounds(upper=1.0))
    with Engine("test", "test", narrow, 3) as engine, pytest.raises(InputError, match="bounds leave no room for cell"):
        from_recording(engine, lamprey, 1e9, frames)
        engine.finish()


def test_a_replay_takes_its_time(lamprey: Recording) -> None:
    waits: list[float] = []
    with Engine("test", "test", LSM, 3) as engine:
        from_recording(engine, lamprey, 4.0, 5, waits.append)
        engine.finish()
        view = engine.shown.thing
        assert view.frames == 8 and view.picture is not None, "its three unloaded frames count"
        assert view.picture.number == 8
    np.testing.assert_allclose(waits, 0.25 * np.arange(5), atol=0.1)


def test_total_pressure_is_a_force() -> None:
    """10 kPa on 100 cells of 10 mm × 10 mm are 100 N; where as much sucks on half of them, 50 N press."""
    scene = Scene(Panel(10, 10), response=PublishedResponse())
    assert force_of(scene, np.full((10, 10), 10.0)).newton == pytest.approx(100.0)
    half = np.repeat([[10.0], [-10.0]], 5, axis=0) * np.ones((10, 10))
    assert force_of(scene, half).newton == pytest.approx(50.0)


def test_a_force_with_saturated_cells_is_a_lower_bound() -> None:
    """A cell beyond what the response determines, 40 kPa, counts with that and is counted."""
    kpa = np.zeros((10, 10))
    kpa[2, 2:6], kpa[3, 3] = 10.0, 95.0
    force = force_of(Scene(Panel(10, 10), response=PublishedResponse()), kpa)
    assert force.newton == pytest.approx(4.0 + 4.0) and force.saturated == 1


def test_a_scene_without_a_response_has_no_force() -> None:
    pressed, force = read_load(PressureTrack.begin(Scene(Panel(2, 2))), np.full((2, 2), 0.5), None, 0.0)
    assert pressed is None and np.isnan(force.newton)


def force_of(scene: Scene, kpa: Array) -> Force:
    """Of cells under such pressures, without error bars."""
    water = water_pressure(scene.panel, scene.water)
    ratio = ratio_from_pressure(water + kpa) / ratio_from_pressure(water)
    return read_load(PressureTrack.begin(scene), ratio, None, 0.0)[1]


def test_a_force_is_that_of_the_scene() -> None:
    """Water that stood there before counts as nothing, nor does what a broken cell seems to say."""
    response, ten = PublishedResponse(), np.full((10, 10), 10.0)
    assert force_of(Scene(Panel(10, 10), water=Water(500.0), response=response), ten).newton == pytest.approx(100.0)
    broken = Scene(Panel(10, 10), faults=Faults(dead_rows=(3,), shorted=((0, 0),)), response=response)
    assert force_of(broken, ten).newton == pytest.approx(89.0)


def test_the_page_is_told_where_something_presses_and_what_its_force_leaves_out() -> None:
    pressure = np.zeros((2, 3))
    pressure[0, 1], pressure[0, 2], pressure[1, 0] = 10.0, 30.0, -5.0
    nothing, saturated = np.zeros((2, 3)), (pressure == 30.0).astype(np.uint8)
    picture = Picture(
        1, 0.0, 0.0, nothing, nothing, nothing > 0, Force(1.0, 0.1), "fine", 0.0, 0, nothing, pressure, saturated
    )

    def told(verdict: str) -> dict[str, Any]:
        view = View("here", "LSM", "receiving", Panel(2, 3), picture=dataclasses.replace(picture, verdict=verdict))
        content: dict[str, Any] = json.loads(view_text(view, 0.0))["picture"]
        return content

    assert told("pressing")["centre"] == [17.5, 0.0] and told("pressing")["health"]["saturated"] == [2]
    assert told("nothing")["centre"] is None and told("sucking")["centre"] is None


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({}, "nothing"),
        ({(1, 1): 0.4}, "pressing"),
        ({(1, 1): 0.4, (1, 2): 1.1}, "pressing"),
        ({(1, 1): 3.0}, "sucking"),
        ({(1, 1): 0.1, (2, 2): 6.0}, "pressing and sucking"),
    ],
)
@pytest.mark.parametrize("noise_told", [True, False])
def test_what_is_on_the_panel_in_a_word(change: dict[tuple[int, int], float], verdict: str, noise_told: bool) -> None:
    """Cells times so much; as much beside a load as a penalty leaves there is no suction, nor is an open cell."""
    scene, ratio = Scene(Panel(4, 5), TwoPointReadout() if noise_told else None), np.ones((4, 5))
    for cell, factor in change.items():
        ratio[cell] = factor
    cells = np.full((4, 5), 3000.0)
    resting, now = (Readings.of(scene, two_point_resistance(each)) for each in (cells, cells * ratio))
    open_cell = np.zeros((4, 5), dtype=bool)
    assert verdict_of(now, resting, ratio, open_cell) == verdict
    open_cell[3, 4], ratio[3, 4] = True, 1e6
    assert verdict_of(now, resting, ratio, open_cell) == verdict


def test_history_ends_somewhere() -> None:
    nothing = np.full((1, 1), np.nan)
    view = View("here", "LSM", "receiving", Panel(1, 1))
    for number in range(1, POINTS + 50):
        view = with_picture(
            view, Picture(number, float(number), 0.0, nothing, nothing, nothing > 0, Force(1.0, 0.1), "fine", 0.0, 0)
        )
    assert len(view.history) == POINTS and view.history[-1].number == POINTS + 49
    content = json.loads(view_text(view, 0.0, known=POINTS + 46))
    assert content["history"] == [[POINTS + 47.0, 1.0], [POINTS + 48.0, 1.0], [POINTS + 49.0, 1.0]]
    assert json.loads(view_text(view, 0.0, known=POINTS + 49))["picture"] is None


def test_the_newest_is_never_missed() -> None:
    """A reader that is slower than the writer skips, but sees numbers grow, and the last thing."""
    newest, seen = Newest(0), []

    def read() -> None:
        number = 0
        while (news := newest.after(number)) is not None:
            number = news.number
            seen.append(news)
            time.sleep(1e-4)

    reader = threading.Thread(target=read)
    reader.start()
    for thing in range(1, 2001):
        newest.put(thing)
    newest.close()
    reader.join(10)
    assert all(news.number == news.thing for news in seen)
    assert seen == sorted(seen) and seen[-1].thing == 2000
    assert newest.after(2000, 0.01) is None and newest.closed


@pytest.fixture
def page() -> Iterator[SimpleNamespace]:
    """A running server and what asks it."""
    shown = Newest(View("here", "LSM", "receiving"))
    with serving("127.0.0.1", 0, shown) as server:

        def ask(method: str = "GET", path: str = "/", **headers: str) -> http.client.HTTPResponse:
            connection = http.client.HTTPConnection(*server.server_address[:2], timeout=10)
            connections.append(connection)
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            answers.append(answer)
            return answer

        connections: list[http.client.HTTPConnection] = []
        answers: list[http.client.HTTPResponse] = []
        yield SimpleNamespace(server=server, shown=shown, ask=ask)
        for item in (*answers, *connections):
            item.close()


def first_view(answer: http.client.HTTPResponse) -> Any:
    line = answer.readline()
    assert line.startswith(b"data: ")
    return json.loads(line[6:])


def test_the_server_gives_the_page_and_the_views_and_nothing_else(page: SimpleNamespace) -> None:
    answer = page.ask()
    assert answer.status == 200 and answer.headers["Content-Type"] == "text/html; charset=utf-8"
    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    assert answer.read() == files("lampest.report.live").joinpath("page.html").read_bytes()
    views = page.ask(path="/views")
    assert views.headers["Content-Type"] == "text/event-stream"
    assert first_view(views)["state"] == "receiving"
    page.shown.change(lambda view: dataclasses.replace(view, state="gone"))
    assert views.readline() == b"\n"
    assert first_view(views)["state"] == "gone"
    for path in ("/favicon.ico", "/page.html", "/../setup", "/views/", "/?x"):
        assert page.ask(path=path).status == 404
    for method in ("HEAD", "PUT", "DELETE", "OPTIONS", "TRACE", "NONSENSE"):
        refused = page.ask(method)
        assert (refused.status, refused.headers["Allow"]) == (405, "GET, POST")
    assert page.server.server_address[0] == "127.0.0.1"


def test_a_new_zero_is_for_the_page_itself_to_ask_for() -> None:
    asked: list[str] = []
    shown = Newest(View("here", "LSM", "receiving"))
    with serving(
        "127.0.0.1", 0, shown, asks=Asks(lambda: asked.append("zero"), lambda: asked.append("seen"))
    ) as server:

        def posted(path: str, **headers: str) -> int:
            with closing(http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)) as connection:
                connection.request("POST", path, headers={name.replace("_", "-"): of for name, of in headers.items()})
                return connection.getresponse().status

        assert [posted("/zero"), posted("/zero", X_Lampest="one"), posted("/", X_Lampest="zero")] == [403, 403, 404]
        assert posted("/zero", X_Lampest="zero", Host="attacker.example") == 403
        assert not asked
        assert posted("/acknowledge") == posted("/acknowledge", X_Lampest="zero") == 403
        assert posted("/zero", X_Lampest="zero") == posted("/acknowledge", X_Lampest="acknowledge") == 200
        assert asked == ["zero", "seen"]
        assert posted("/record", X_Lampest="record") == 404, "there is nothing to record"


def test_a_recording_is_for_the_page_itself_to_ask_for_and_needs_the_token() -> None:
    asked: list[str] = []

    def record(name: str) -> None:
        if "." in name:
            raise InputError("that is no name")
        asked.append(name)

    shown = Newest(View("here", "LSM", "receiving"))
    with serving("127.0.0.1", 0, shown, "0123456789abcdef", Asks(record=record)) as server:

        def posted(path: str, **headers: str) -> int:
            with closing(http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)) as connection:
                connection.request("POST", path, headers={name.replace("_", "-"): of for name, of in headers.items()})
                return connection.getresponse().status

        told = {"Authorization": "Bearer 0123456789abcdef"}
        assert posted("/record", X_Lampest="record") == posted("/record", X_Lampest="zero", **told) == 403
        assert posted("/record?name=x", **told) == 403, "a foreign page's form has no such header"
        assert posted("/record?name=../x", X_Lampest="record", **told) == 400
        assert not asked
        assert posted("/record?name=x", X_Lampest="record", **told) == posted("/record", X_Lampest="record", **told)
        assert asked == ["x", ""]


def test_on_the_loopback_the_server_answers_to_no_foreign_name(page: SimpleNamespace) -> None:
    assert page.ask(Host="localhost:8137").status == 200
    assert page.ask(path="/views", Host="attacker.example:8137").status == 403
    assert all(is_local_name(name) for name in ("127.0.0.1", "[::1]:80", "[::1]", "localhost", "127.0.0.9:1"))
    assert not any(is_local_name(name) for name in ("", "10.0.0.1:80", "localhost.example", "[::2]:80"))


def test_clients_may_come_and_go_as_they_like(page: SimpleNamespace, capfd: pytest.CaptureFixture[str]) -> None:
    host, port = page.server.server_address[:2]
    for request in (b"", b"GET", b"\0\xff\r\n\r\n", b"GET /views HTTP/1.1\r\nHost: localhost\r\n\r\n") * 10:
        with socket.create_connection((host, port), timeout=10) as client:
            client.sendall(request)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    for _ in range(3):
        page.shown.change(lambda view: view)
        time.sleep(0.05)
    assert first_view(page.ask(path="/views"))["source"] == "here"
    assert page.ask().status == 200
    assert capfd.readouterr() == ("", "")


def test_more_clients_than_seats_are_told_so(page: SimpleNamespace) -> None:
    for _ in range(server_module.MOST_STREAMS):
        assert page.ask(path="/views").status == 200
    assert page.ask(path="/views").status == 503
    assert page.ask().status == 200


def test_the_last_view_reaches_everybody_and_nobody_holds_up_the_end() -> None:
    shown = Newest(View("here", "LSM", "receiving"))
    with serving("127.0.0.1", 0, shown) as server, socket.create_connection(server.server_address[:2]) as silent:
        connection = http.client.HTTPConnection(*server.server_address[:2], timeout=10)
        connection.request("GET", "/views")
        answer = connection.getresponse()
        first_view(answer)
        shown.change(lambda view: dataclasses.replace(view, state="lampest has ended"))
        began = time.monotonic()
        assert silent.fileno()
    rest = answer.read().decode()
    assert '"state":"lampest has ended"' in rest
    assert time.monotonic() - began < 3
    answer.close()
    connection.close()


def test_an_address_in_use_is_one_sentence(page: SimpleNamespace) -> None:
    host, port = page.server.server_address[:2]
    with pytest.raises(InputError, match=rf"cannot listen at 127\.0\.0\.1:{port} \(Address already in use\)"):
        live(Replay(LAMPREY), http=f"{host}:{port}")


@pytest.mark.parametrize("text", ["", "8137", "127.0.0.1", "127.0.0.1:x", "host:80", "127.0.0.1:70000", ":80"])
def test_addresses_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="not of the form HOST:PORT"):
        address(text)


def test_addresses() -> None:
    assert address("localhost:0") == ("127.0.0.1", 0)
    assert address("[::1]:81") == ("::1", 81)
    shown = Newest(View("here", "LSM", "receiving"))
    with serving("0.0.0.0", 0, shown) as open_to_all:
        assert not open_to_all.local and open_to_all.url.startswith("http://127.0.0.1:")
    assert PageServer.daemon_threads


def test_the_page_loads_nothing_from_elsewhere() -> None:
    text = files("lampest.report.live").joinpath("page.html").read_text(encoding="utf-8")
    assert not re.findall(r"https?://|\bsrc=|@import|url\(|<link(?! rel=\"icon\" href=\"data:,\")", text)
    assert len(text) < 30_000


def test_methods_and_those_of_a_file(disk: SimpleNamespace) -> None:
    assert chosen(None, None) == ("smooth", METHODS["smooth"])
    assert METHODS["smooth"].formulation == "reduced"
    assert chosen(None, disk.run())[0] == "LSM"
    name, found = chosen("LSR-dCR", disk.run())
    assert (name, found.formulation, found.relative) == ("LSR-dCR", "auto", True)
    with pytest.raises(InputError, match=r"no estimator is called 'LSR'; .*run\.yaml has LSM, LSR-CR, LSR-dCR"):
        chosen("LSR", disk.run())


ROD = Rod(kind="rod", centre_mm=(25, 25), diameter_mm=40, mass_g=1500)


def drifting(film: Film | None = None, drift: float = 0.01) -> Recording:
    """30 frames of nothing, 20 of a rod, 50 of nothing; 6 × 6 cells."""
    scene = Scene(Panel(6, 6), TwoPointReadout(adc_bits=12), 140.0, film=film, response=PublishedResponse())
    course = Course(start_s=30, release_at_s=50)
    unmodelled = Unmodelled(drift_per_minute=drift)
    return simulate(Simulation(1, 3, scene, frames=100, loads=(ROD,), course=course, film=film, unmodelled=unmodelled))


@pytest.mark.slow
def test_live_pressure_forgets_what_the_film_remembers() -> None:
    film = Film(0.2, 0.08)
    told, silent = drifting(film, 0.0), dataclasses.replace(drifting(film, 0.0), scene=drifting(None, 0.0).scene)
    left = [pictures(LSM, recording)[-40].force.newton for recording in (told, silent)]
    assert abs(left[0]) < 0.1 * abs(left[1])


@pytest.mark.slow
def test_zero_is_taken_anew_live_where_nothing_touches_the_panel() -> None:
    recording = drifting()
    said: list[str] = []
    with Engine("test", "test", dataclasses.replace(LSM, tare=Tare(10)), 3) as engine:

        def look(seconds: float) -> None:
            settle(engine)
            said.append(engine.shown.thing.zero)

        from_recording(engine, recording, 1e9, None, look)
        engine.finish()
        view = engine.shown.thing
    whens = [int(text.split("frame ")[1].split(":")[0]) for text in said if text]
    assert whens and "nothing touched the panel for 10 frames" in view.zero
    assert not any(31 <= when <= 50 for when in whens)
    (plain,) = pictures(LSM, recording)[-1:]
    assert view.picture is not None
    change = np.abs(view.picture.relative_change).max()
    assert change < 0.6 * np.abs(plain.relative_change).max()
    assert json.loads(view_text(view, 0.0))["zero"] == view.zero


def settle(engine: Engine) -> None:
    """Wait until every frame that was taken has been solved."""
    for _ in range(2000):
        view = engine.shown.thing
        if view.frames == 0 or (view.picture is not None and view.picture.number >= view.frames):
            return
        time.sleep(0.005)


@pytest.mark.slow
def test_zero_is_taken_anew_when_it_is_asked_for() -> None:
    recording = drifting()
    with Engine("test", "test", LSM, 3) as engine:

        def ask(seconds: float) -> None:
            settle(engine)
            if engine.shown.thing.frames == 35:  # the rod lies there: it is taken for the unloaded panel
                engine.tare()

        from_recording(engine, recording, 1e9, 45, ask)
        engine.finish()
        view = engine.shown.thing
    assert view.zero == f"taken anew after frame 38: {ASKED}"
    assert view.picture is not None and np.abs(view.picture.relative_change).max() < 5
