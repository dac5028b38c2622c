"""The live engine, without a board and without a browser."""

import dataclasses
import json
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support import live_pictures, until
from wild_board import IDLE

from docs.studies.long_lives import live_figures, stream_figures
from lampest import Arrival, InputError, Misfit, Rod, Scene, two_point_resistance
from lampest.apps.board import record as record_module
from lampest.apps.board.protocol import Frame
from lampest.apps.board.sample import Listening, Sample
from lampest.apps.board.stream import scene_of
from lampest.apps.film.pressure import Pressure, total_force
from lampest.apps.live import engine as engine_module
from lampest.apps.live import run as run_module
from lampest.apps.live.engine import Engine, FrameSource, with_picture
from lampest.apps.live.handover import NICENESS, Beside, Errand
from lampest.apps.live.message import Picture, View, view_text
from lampest.apps.live.run import (
    METHODS,
    chosen,
    from_board,
    from_recording,
    recorded_from_board,
    recorder_of,
)
from lampest.apps.live.watcher import Scan
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.estimate.weights import AutoWeight
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.response import Film, PublishedResponse
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.simulation import Course, Simulation, read_simulations, simulate
from lampest.solvers.posed import Bounds

LAMPREY = Path(__file__).parents[3] / "data" / "lamprey_25mm.h5"
HARDLY_PERCENT = 0.05  # of a change: findings that arrive later move the estimate by no more
NEARLY = 0.1  # relative
WRITTEN_NEWTON = 1e-4  # last digit of a force in a message
BUSY_S = 0.1  # of a machine that is busy with other tests
LSM = Estimator((Misfit(),), "reduced")
ARRIVAL = Estimator((Misfit(weighting="noise"), Arrival()), "reduced")
# A leak of one float a frame would be 8 bytes; interpreters keep some pools of their own.
FRAMES = 1000
LEAK_BYTES_PER_FRAME = 60.0


@pytest.fixture(scope="module")
def lamprey() -> Recording:
    """Three unloaded and six measured frames."""
    recording = Recording.load(LAMPREY, slice(9))
    return dataclasses.replace(recording, number=None, raw_sums=None, raw_readings=None)


def pictures(estimator: Estimator, recording: Recording, baseline: int = 3) -> list[Picture]:
    """A replay in which every frame waits until the one before was solved."""
    return live_pictures(
        estimator, baseline, lambda engine: from_recording(engine, recording, 1e9, None)
    )


def of_every_frame(name: str) -> Estimator:
    """Return a method that chooses a weight for every frame.

    Only a batch knows the strongest frame, so live cannot choose by it.
    """
    return dataclasses.replace(METHODS[name], auto_weight=AutoWeight(per="frame"))


@pytest.mark.slow
def test_findings_of_the_other_process_reach_later_frames(
    lamprey: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Weights, lower minima and error bars."""
    monkeypatch.setattr(engine_module, "BARS_SECONDS", 0.0)
    lies = dataclasses.replace(lamprey, recorded=lamprey.recorded[[0, 1, 2, *(6 * [8])]])
    *_, waited = pictures(METHODS["smooth"], lies)
    batch = reconstruct(lies, METHODS["smooth"])
    engine = Engine("test", "test", METHODS["smooth"], 3, beside=True)
    view = replay(
        engine,
        lies,
        lambda: until(lambda: engine.shown.item.frames in (3, engine.shown.item.deviation_of)),
    )
    assert view.picture is not None and view.skipped == 0
    np.testing.assert_allclose(
        view.picture.relative_change, waited.relative_change, atol=HARDLY_PERCENT
    )
    names = ("pressure", "lower", "upper", "errors", "own", "common", "saturated", "pressing")
    last = Pressure(*(getattr(batch._load, name)[-1] for name in names))
    force = total_force(lies.scene, last)
    assert view.deviation == pytest.approx(force.deviation, rel=NEARLY)
    assert json.loads(view_text(view, 0.0))["deviation"] == pytest.approx(
        view.deviation, abs=WRITTEN_NEWTON
    )


@pytest.mark.slow
def test_processes_beside_yield_to_the_one_that_estimates() -> None:
    answers: list[int] = []
    beside = Beside(
        os.nice, lambda task, waiting: [*waiting, task], lambda _, it: answers.append(it)
    )
    beside.ask(0)
    beside.finish()
    assert answers == [min(os.nice(0) + NICENESS, 19)]


@pytest.mark.slow
def test_every_frame_waits_for_its_findings_if_the_other_process_dies(lamprey: Recording) -> None:
    engine = Engine("test", "test", METHODS["smooth"], 3, beside=True)

    def kill() -> None:
        if engine.shown.item.frames == 5:
            until(lambda: engine._beside._worker.process is not None)
            engine._beside._worker.kill()
            engine._beside.ask(Errand("check", tuple))  # an idle process dies unnoticed
            until(lambda: engine._beside.gone)

    view = replay(engine, lamprey, kill)
    assert view.picture is not None and view.picture.status == "local optimum verified"
    assert view.deviation_of == view.picture.number, "error bars come with the frame"


def replay(engine: Engine, recording: Recording, on_frame: Callable[[], object]) -> View:
    """The last view of a replay; each frame waits for the one before, and for `on_frame`."""

    def solved() -> bool:
        view = engine.shown.item
        return view.frames == (view.picture.number if view.picture else 3)  # three are unloaded

    def look(seconds: float) -> None:
        until(solved)
        on_frame()

    with engine:
        from_recording(engine, recording, 1e9, None, look)
        engine.finish()
        return engine.shown.item


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [of_every_frame("smooth"), of_every_frame("relative_change"), ARRIVAL],
    ids=["gCR", "dCR", "arrival"],
)
def test_live_estimates_equal_those_of_a_batch(method: Estimator) -> None:
    # Without outliers, and errors of single readings: only a batch sees later frames, which tell
    # them from a change.
    ((_, simulation),) = read_simulations(
        Path(__file__).parents[3] / "configs" / "lamprey_35mm.yaml"
    )
    calm = dataclasses.replace(simulation.unmodelled, outlier_probability=0.0)
    exact = dataclasses.replace(simulation.scene, systematic="none")
    lamprey = simulate(dataclasses.replace(simulation, scene=exact, frames=6, unmodelled=calm))
    live = pictures(method, lamprey)
    batch = reconstruct(lamprey, method)
    np.testing.assert_array_equal(
        [picture.relative_change for picture in live], batch.relative_change
    )
    change = 100 * (batch.measured / batch.measured_baseline - 1)
    np.testing.assert_array_equal([picture.measured_change for picture in live], change)
    assert [picture.status for picture in live] == ["local optimum verified"] * 6
    flags = [step.solution.open_cell[-1] for step in batch.steps]
    np.testing.assert_array_equal([picture.open_cell for picture in live], flags)


def test_a_reading_frozen_in_the_unloaded_frames_stays_missing_and_is_named() -> None:
    rng = np.random.default_rng(3)
    recorded = two_point_resistance(3000 * np.exp(0.001 * rng.standard_normal((11, 5, 6))))
    recorded[8:, 2] *= 0.9
    recorded[:, 2, 3] = recorded[0, 1, 1]
    frozen = Recording(
        Scene(Panel(5, 6), TwoPointReadout()), recorded, np.arange(11.0), np.repeat([0, 1], [8, 3])
    )
    with Engine("test", "test", LSM, 8) as engine:
        from_recording(engine, frozen, 1e9, None)
        engine.finish()
        view = engine.shown.item
    assert view.picture is not None
    assert np.argwhere(np.isnan(view.picture.measured_change)).tolist() == [[2, 3]]
    assert "one value in all frames at row 2, column 3" in view.model


@pytest.mark.slow
def test_live_reports_a_wrong_circuit_but_not_a_wrong_reading(lamprey: Recording) -> None:
    """The recording was made with 140 ohm in series, which the scene omits."""
    scene = dataclasses.replace(lamprey.scene, series_resistance_ohm=0.0)
    with Engine("test", "test", LSM, 3) as engine:
        from_recording(engine, dataclasses.replace(lamprey, scene=scene), 1e6, None)
        engine.finish()
        sentence = engine.shown.item.model
    assert "series_resistance_ohm near" in sentence
    assert json.loads(view_text(View("a", "b", "c", model=sentence), 0.0))["model"] == sentence
    # The first loaded frames of the shipped mouth: one reading is wrong, and its rim presses cells
    # to 100 ohm.
    mouth = Recording.load(LAMPREY.with_name("lamprey_35mm.h5"))
    frames = np.append(np.flatnonzero(mouth.role == UNLOADED), [4, 5, 6])
    role = np.repeat([UNLOADED, MEASURED], 3)
    first = Recording(mouth.scene, mouth.recorded[frames], np.arange(6.0), role.astype(np.uint8))
    assert Prepared(first).check.mark == "yes"


def test_slow_solving_continues_with_the_newest_frame_and_counts_skipped_ones(
    lamprey: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = threading.Semaphore(0)
    go = threading.Semaphore(0)
    shown = []
    original = engine_module.solved_scan

    def slowly(*arguments: Any) -> Any:
        started.release()
        assert go.acquire(timeout=20)
        stream, picture = original(*arguments)
        shown.append(picture)
        return stream, picture

    monkeypatch.setattr(engine_module, "solved_scan", slowly)
    source = FrameSource(lamprey.scene, 1.0, "receiving")
    scan = Scan(lamprey.recorded[5], None, 1.0, time.time())
    with Engine("test", "test", LSM, 1) as engine:
        for _ in range(2):
            engine.take(source, scan)
        assert started.acquire(timeout=20)
        began = time.monotonic()
        for _ in range(5):
            engine.take(source, dataclasses.replace(scan, lost=2))
        assert time.monotonic() - began < 1, "taking a frame must not wait for the solver"
        go.release(10)
        engine.finish()
        view = engine.shown.item
    assert [(picture.number, picture.skipped) for picture in shown] == [(2, 0), (7, 4)]
    assert (view.frames, view.lost, view.skipped, len(view.history)) == (7, 10, 4, 2)


@pytest.mark.slow
def test_a_failed_frame_shows_no_number_and_the_next_is_solved(lamprey: Recording) -> None:
    resistance = lamprey.resistance.copy()
    resistance[4, 1:] = np.nan
    shown = pictures(LSM, dataclasses.replace(lamprey, recorded=resistance))
    failed = shown[1]
    recovered = shown[2]
    assert (
        failed.status
        == "too few of the frame's readings are values: the others are missing, or bounds"
    )
    assert (
        np.isnan(failed.measured_change[1:]).all() and np.isfinite(failed.measured_change[0]).all()
    )
    assert (
        np.isnan(failed.relative_change).all()
        and np.isnan(failed.force.newton)
        and not failed.open_cell.any()
    )
    assert (
        recovered.status == "local optimum verified"
        and np.isfinite(recovered.relative_change).all()
    )
    view = with_picture(View("here", "LSM", "receiving", lamprey.scene.panel), failed)
    content = json.loads(view_text(view, 0.0), parse_constant=pytest.fail)
    assert (
        content["picture"]["change"] == [None] * 100 and not content["picture"]["health"]["solved"]
    )
    assert content["picture"]["force"] is None and content["history"] == [[failed.time, None]]
    below = dataclasses.replace(
        lamprey, scene=dataclasses.replace(lamprey.scene, series_resistance_ohm=5000.0)
    )
    for picture in pictures(LSM, below):
        assert picture.status == failed.status
        assert np.isnan(picture.relative_change).all() and np.isnan(picture.force.newton)


@pytest.mark.parametrize("frames", [None, 1])
def test_an_exception_of_the_solver_stops_live(lamprey: Recording, frames: int | None) -> None:
    narrow = dataclasses.replace(LSM, bounds=Bounds(upper=1.0))
    with (
        Engine("test", "test", narrow, 3) as engine,
        pytest.raises(InputError, match="bounds leave no room for cell"),
    ):
        from_recording(engine, lamprey, 1e9, frames)
        engine.finish()


@pytest.mark.slow
def test_a_replay_keeps_its_pace(lamprey: Recording) -> None:
    waits: list[float] = []
    with Engine("test", "test", LSM, 3) as engine:
        from_recording(engine, lamprey, 4.0, 5, waits.append)
        engine.finish()
        view = engine.shown.item
        assert view.frames == 8 and view.picture is not None, "its three unloaded frames count"
        assert view.picture.number == 8
    np.testing.assert_allclose(waits, 0.25 * np.arange(5), atol=BUSY_S)


def test_estimators_are_chosen_by_name_or_from_a_file(disk: SimpleNamespace) -> None:
    assert chosen(None, disk.run())[0] == "LSM"
    name, estimator = chosen("LSR-dCR", disk.run())
    assert (name, estimator.formulation, estimator.relative) == ("LSR-dCR", "auto", True)
    with pytest.raises(
        InputError, match=r"no estimator is called 'LSR'; .*run\.yaml has LSM, LSR-CR, LSR-dCR"
    ):
        chosen("LSR", disk.run())


@pytest.mark.slow
def test_live_pressure_excludes_the_memory_of_the_film() -> None:
    """30 frames of nothing, 20 of a rod, 50 of nothing."""
    film = Film(0.2, 0.08)
    course = Course(start_s=30, release_at_s=50)
    rod = Rod(kind="rod", centre_mm=(25, 25), diameter_mm=40, mass_g=1500)
    scene = Scene(
        Panel(6, 6), TwoPointReadout(adc_bits=12), 140.0, film=film, response=PublishedResponse()
    )
    specified = simulate(
        Simulation(1, 3, scene, frames=100, loads=(rod,), course=course, film=film)
    )
    silent = dataclasses.replace(specified, scene=dataclasses.replace(specified.scene, film=None))
    forces = [pictures(LSM, recording)[-40].force.newton for recording in (specified, silent)]
    assert abs(forces[0]) < NEARLY * abs(forces[1])


def test_frames_of_a_board_reach_the_engine_and_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The button of the page and `out` record; two frames before the second of three were lost."""
    hello = dataclasses.replace(IDLE, readings=64, period_us=500_000)
    sums = np.full((4, 3, 4), 64 * 700, np.uint16)
    sums[2:, 1, 2] = 64 * 720
    frames = [Frame(64, number, 500 * number, 0, each) for number, each in enumerate(sums)]
    declared = scene_of(hello, None)
    samples = [
        Sample(each, hello, declared, 0.5 * number, 50.0, 2 * (number == 1), 0)
        for number, each in enumerate(frames)
    ]

    def arriving(*source: Any, **options: Any) -> Any:
        yield from (samples[:2], (), samples[2:])

    for module in (run_module, record_module):
        monkeypatch.setattr(module, "samples_of", arriving)
    monkeypatch.chdir(tmp_path)
    board = Listening(("port",), None, 2)
    with Engine("port", "LSM", LSM, 2) as engine, recorder_of(board, engine) as (recorder, actions):
        assert (
            recorder is not None
            and actions.record is not None
            and engine.shown.item.recording == ("", False)
        )
        actions.record("one")
        from_board(engine, board, 3, recorder.take)
        assert engine.shown.item.recording == (f"recording {tmp_path / 'one.h5'}: 3 frames", True)
        actions.tare()
        assert engine._zero_asked.is_set() and recorder._zeroed.is_set()
        engine.finish()
        button = engine.shown.item
    out = tmp_path / "two.h5"
    with (
        Engine("port", "LSM", LSM, 2) as engine,
        recorder_of(board, engine, out) as (recorder, actions),
    ):
        assert recorder is None and actions.record is None
        assert recorded_from_board(engine, board, out, 3).frames == 3
        engine.finish()
        written = engine.shown.item
    for view, name in ((button, "one"), (written, "two")):
        assert (view.frames, view.lost, view.state) == (
            3,
            2,
            "receiving",
        ) and view.picture is not None
        assert (view.picture.number, view.picture.time, view.picture.arrived) == (3, 1.0, 50.0)
        assert np.unravel_index(np.argmax(np.abs(view.picture.measured_change)), (3, 4)) == (1, 2)
        recording = Recording.load(tmp_path / f"{name}.h5")
        assert recording.role.tolist() == [UNLOADED, UNLOADED, MEASURED]
        np.testing.assert_array_equal(recording.raw_sums, sums[:3])


@pytest.mark.slow
def test_a_stream_retains_no_past_frames() -> None:
    early, late = stream_figures((FRAMES // 4, FRAMES))
    assert late.allocated - early.allocated < LEAK_BYTES_PER_FRAME * (late.frames - early.frames)
    assert late.open_files <= early.open_files


@pytest.mark.slow
def test_the_live_page_retains_only_its_history() -> None:
    """The history is full after 1,800 frames."""
    early, late = live_figures((2 * FRAMES, 3 * FRAMES))
    assert late.allocated - early.allocated < LEAK_BYTES_PER_FRAME * (late.frames - early.frames)
    assert late.open_files <= early.open_files and late.threads == early.threads
