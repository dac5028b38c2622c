"""The page of `lampest live` in Chromium, with a board behind it."""

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from apps.board.bench import ONE_THREAD, bench, scene_file
from apps.live.browser import Browser, browser
from matplotlib.image import imread

from docs.studies.attachments import cells as mouth_cells
from docs.studies.attachments import courses
from docs.studies.mouth_scenes import MAKERS, film
from lampest import UNLOADED, Array, Panel, Recording
from tests.small_files import COMMAND

ROOT = Path(__file__).parents[3]
RING = ROOT / "data" / "ring.h5"
LAMPREY = ROOT / "data" / "lamprey_35mm.h5"
FORCE_ERROR = 0.05  # relative
ALIKE = 0.9  # correlation of the drawn map and the change of the cells
CLEARLY_MORE = 1.2  # colour of the estimated ring over that of the measured one
BLUER = 0.2  # mean blueness of a row
NUMBER = "return Number(document.getElementById('number').innerText) || 0"
PLACES = (
    "return arguments[0].map(name => {"
    "const box = document.getElementById(name).getBoundingClientRect(), at = place(box.width, "
    "box.height);"
    "return [box.left + at.left, box.top + at.top, at.cell, panel.rows, panel.columns] })"
)
CUT = (
    "return [...document.querySelectorAll('dt, dd, h1, h2, button, .note')].filter(one => "
    "one.offsetParent && "
    "one.scrollWidth > one.clientWidth + 1 && one.clientWidth).map(one => one.innerText)"
)
HIDDEN = (
    "return document.getElementById('sentence').hidden && !document.getElementById('alarm').hidden"
)


@contextmanager
def live(folder: Path, *words: object) -> Iterator[tuple[Browser, "subprocess.Popen[str]"]]:
    """Open a browser on a running `lampest live`, and end both.

    Ctrl-C ends the command unless it has ended before.
    """
    arguments = [str(word) for word in (COMMAND, "live", "--http", "127.0.0.1:0", *words)]
    pipes = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
        "env": os.environ | ONE_THREAD,
    }
    with browser(folder) as window, subprocess.Popen(arguments, cwd=folder, **pipes) as process:
        line = process.stdout.readline()
        if not line:
            pytest.fail(process.stderr.read(), pytrace=False)
        try:
            window.open(line.split()[0])
            yield window, process
            assert window.complaints() == []
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                assert process.wait(20) == 130


@contextmanager
def live_board(
    folder: Path, cells: Array, options: tuple[object, ...], *words: object, period: float = 1.0
) -> Iterator[tuple[Browser, "subprocess.Popen[str]"]]:
    """A browser that looks at a board in real time, four frames a second."""
    known = ("--scene", scene_file(folder), "--period", 0.25, *words)
    with (
        bench(folder, cells, "--real-time", *options, period=period) as board,
        live(folder, "--port", board.port, *known) as watched,
    ):
        yield watched


def truth_of(path: Path) -> tuple[Array, int]:
    """True cells of all frames (frames, rows, columns) and how many of them are unloaded."""
    recording = Recording.load(path)
    return recording.truth_cell_resistance, int(np.sum(recording.role == UNLOADED))


def blueness(window: Browser, path: Path, *canvases: str) -> list[Array]:
    """Return how blue each cell of the maps is on a screenshot, (rows, columns).

    A cell's value is the mean of the pixels around its centre. A new sentence moves the maps, so
    the screenshot is repeated until the maps keep their places.
    """
    boxes = window.run(PLACES, canvases)
    previous = None
    while boxes != previous:
        window.screenshot(path)
        boxes, previous = window.run(PLACES, canvases), boxes
    image = imread(path)
    maps = []
    for left, top, cell, rows, columns in boxes:
        blue = np.empty((rows, columns))
        for row, column in np.ndindex(blue.shape):
            y = int(top + (row + 0.5) * cell)
            x = int(left + (column + 0.5) * cell)
            blue[row, column] = 1 - image[y - 3 : y + 4, x - 3 : x + 4, 0].mean()
        maps.append(blue)
    return maps


@pytest.mark.slow
def test_the_page_shows_the_ring(tmp_path: Path) -> None:
    """A ring of 27 to 35 mm: 11.5 N under eight cells around four that carry nothing."""
    cells, unloaded = truth_of(RING)
    pressure = Recording.load(RING).truth_pressure
    with live_board(tmp_path, cells, (), "--baseline", unloaded, period=0.25) as (window, _):
        window.until(NUMBER, lambda number: number > 10)
        drawn, measured = blueness(
            window, ROOT / "results" / "live_screenshot.png", "cells", "measured"
        )
        assert window.text("state") == "receiving"
        assert float(window.text("total").split()[0]) == pytest.approx(
            0.1 * pressure[-1].sum(), rel=FORCE_ERROR
        )
        assert window.text("lost") == "0"
        label = window.run("return document.getElementById('cells').getAttribute('aria-label')")
    change = cells[-1] / cells[0] - 1
    ring = change < -0.4
    background = change > -0.1
    assert ring.sum() == 8
    assert np.corrcoef(drawn.ravel(), -change.ravel())[0, 1] > ALIKE
    assert drawn[ring].min() > drawn[background & ~inside(ring)].max(), "the ring stands out"
    assert drawn[ring].mean() > 2 * drawn[inside(ring)].mean(), "and is hollow"
    assert drawn[ring].mean() > CLEARLY_MORE * measured[ring].mean(), (
        "more than in what was measured"
    )
    assert label.startswith("Reconstructed cell resistance, relative change from −")


@pytest.mark.slow
def test_the_page_shows_the_map_of_an_estimating_board(tmp_path: Path) -> None:
    """Frames without an estimate leave it empty; a board without one has no third map."""
    ring = Recording.load(RING)
    change = np.log(ring.truth_cell_resistance / ring.truth_cell_resistance[0])
    # The first row is the board's own.
    board_change = np.where(np.arange(change.shape[1])[:, None] == 0, -2.0, change)
    replace(ring, board_log_change=board_change).save(tmp_path / "board.h5")
    board_change[-1] = np.nan
    replace(ring, board_log_change=board_change).save(tmp_path / "failed.h5")
    script = "return document.getElementById('state').innerText == 'the recording has ended'"
    for name, words in (
        ("board", "Cell resistance by the board, relative change from −"),
        ("failed", ""),
    ):
        with live(tmp_path, "--recording", tmp_path / f"{name}.h5", "--speed", 5) as (window, _):
            window.until(script)
            window.run("describe()")
            drawn, own = blueness(window, tmp_path / "screen.png", "board", "cells")
            label = window.run("return document.getElementById('board').getAttribute('aria-label')")
            assert window.text("board-range").startswith("−86") == (name == "board")
            assert label.startswith(words)
            assert (drawn[0].mean() > own[0].mean() + BLUER) == (name == "board")
    with live(tmp_path, "--recording", RING, "--speed", 5) as (window, _):
        window.until(script)
        assert window.run("return document.getElementById('board').parentNode.hidden")


def inside(ring: Any) -> Any:
    """Cells that have the ring on all four sides."""
    accumulate = np.logical_or.accumulate
    return (
        ~ring
        & accumulate(ring, axis=0)
        & accumulate(ring[::-1], axis=0)[::-1]
        & accumulate(ring, axis=1)
        & accumulate(ring[:, ::-1], axis=1)[:, ::-1]
    )


@pytest.mark.slow
def test_unsolved_frames_are_not_drawn(tmp_path: Path) -> None:
    run = tmp_path / "run.yaml"
    run.write_text(
        "schema: 1\nrecordings: [none.h5]\nestimators: {hasty: {terms: {misfit: {}, "
        "total_variation: {weight: 1}}}}\n"
        "formulation: reduced\nsolver: {max_iterations: 1}\n"
    )
    with live(tmp_path, "--recording", RING, "--speed", 5, "--config", run) as (window, _):
        window.until(NUMBER)
        (drawn,) = blueness(window, tmp_path / "screen.png", "cells")
        assert "the iteration limit was reached before an optimum" in window.text("failed")
        assert window.text("total") == window.text("seconds") == "–"
        assert window.text("cells-range") == ""
        assert window.text("measured-range") != ""
        assert window.run(
            "return document.getElementById('cells').getAttribute('aria-label')"
        ).endswith("not solved")
        assert "NaN" not in window.run("return document.body.innerText")
    assert np.ptp(np.delete(drawn, [4, 5], axis=0)) == 0, "one colour but for the words"


@pytest.mark.slow
def test_a_frame_without_readings_is_named_and_leaves_the_maps_empty(tmp_path: Path) -> None:
    ring = Recording.load(RING)
    resistance = ring.resistance.copy()
    resistance[-1] = np.nan
    replace(ring, recorded=resistance, raw_sums=None, raw_readings=None).save(tmp_path / "blind.h5")
    with live(tmp_path, "--recording", tmp_path / "blind.h5", "--speed", 5) as (window, _):
        window.until(NUMBER, lambda number: number == len(ring.time))
        assert "too few of the frame's readings are values" in window.text("failed")
        assert window.text("measured-range") == window.text("cells-range") == ""
        window.run("describe()")
        for name, words in (("measured", "no readings"), ("cells", "not solved")):
            assert window.run(
                f"return document.getElementById('{name}').getAttribute('aria-label')"
            ).endswith(words)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1400, 390])
def test_every_word_fits_a_wide_and_a_narrow_screen(width: int, tmp_path: Path) -> None:
    """The page never calls a change on the map nothing, and shows an alarm once."""
    with live(tmp_path, "--recording", LAMPREY, "--speed", 50) as (window, _):
        window.resized(width, 900, "dark")
        window.until(
            "return document.getElementById('state').innerText == 'the recording has ended'"
        )
        window.run("view.alarm = view.detection.sentence; answer()")
        assert window.run("return document.querySelectorAll('#events li').length") >= 1
        window.run("document.getElementById('total').innerText = '−123.45 ± 67.89 N'")
        assert (
            window.run("return document.documentElement.scrollWidth") == width
            and window.run(CUT) == []
        )
        page = window.run("return getComputedStyle(document.body).backgroundColor")
        assert max(map(int, page.strip("rgb()").split(","))) < 64, "dark where the browser is"
        # In one script, so that no message of the server comes between.
        reset = (
            "view.alarm = ''; view.detection.answer = view.detection.sentence = 'nothing'; "
            "answer(); "
        )
        for verdict, sentence in (
            ("pressing", "still deciding: the map shows a change"),
            ("nothing", "nothing"),
        ):
            shown = (
                f"picture.verdict = '{verdict}'; {reset} return "
                "document.getElementById('sentence').innerText"
            )
            assert window.run(shown) == sentence
        window.run("view.alarm = view.detection.sentence; answer()")
        assert window.run(HIDDEN)


@pytest.mark.slow
def test_an_unplugged_board_is_waited_for_and_every_frame_is_recorded(tmp_path: Path) -> None:
    cells, _ = truth_of(LAMPREY)
    out = tmp_path / "along.h5"
    unplugged = ("--loop", "--unplug", "3:3", "--no-reset-on-open")
    with live_board(tmp_path, cells, unplugged, "--out", out) as (window, process):
        window.until(
            "return document.getElementById('state').innerText",
            lambda text: "waiting for it" in text,
        )
        first_number = window.run(NUMBER)
        window.until("return document.getElementById('state').innerText == 'receiving'")
        window.until(NUMBER, lambda number: number > first_number + 5)
        process.send_signal(signal.SIGINT)
        window.until(
            "return document.getElementById('state').innerText",
            lambda text: text in ("lampest has ended", "no connection to lampest; trying again"),
        )
        assert process.wait(20) == 130
        assert "frames, " in process.stdout.read()
        window.complaints()
    recording = Recording.load(out)
    assert recording.acquisition is not None and recording.acquisition.session[-1] >= 1
    assert len(recording.time) > first_number + 5 and recording.role[:4].tolist() == [0, 0, 0, 1]


@pytest.mark.slow
def test_a_plugged_in_board_raises_the_alarm(tmp_path: Path) -> None:
    """A board that was plugged in before the start raises the alarm."""
    watched = "return document.getElementById('sentence').innerText"
    rng = np.random.default_rng(5)
    panel = Panel(10, 10)
    time = np.arange(0.0, 60.0, 0.125)
    course, _, _ = courses(rng, "still mouth", time, 60.0)
    breath = 1 + 0.08 * np.sin(2 * np.pi * 1.1 * time)
    mouth = MAKERS["uneven mouth"](rng, panel)
    layer = film(rng, "real")
    cells = mouth_cells(
        rng, panel, mouth, layer, course * breath[:, None], time, np.zeros(len(time))
    )
    with live_board(tmp_path, cells, (), "--baseline", 6, period=0.125) as (window, _):
        window.until(
            watched, lambda text: "something that sucks (lamprey or cup)" in text, seconds=30
        )
        window.until("return !document.getElementById('alarm').hidden", seconds=30)
        assert window.text("alarmed").startswith("lamprey attached since")
        assert "breathing 1.1" in window.text("alarmed")
        window.run("document.getElementById('acknowledge').click()")
        window.until("return document.getElementById('alarm').hidden", seconds=10)


@pytest.mark.slow
def test_a_button_records_the_frames_of_the_port(tmp_path: Path) -> None:
    """Recordings begin with the unloaded frames and go to the working folder."""
    cells, _ = truth_of(LAMPREY)
    script = "return document.getElementById('recorded').innerText"
    press = "document.getElementById('record').click()"
    with live_board(tmp_path, cells, ("--loop",)) as (window, process):
        window.until(NUMBER, lambda number: number > 8)
        window.run(f"document.getElementById('name').value = '../mine'; {press}")
        window.until(script, lambda text: text == "a name has letters, digits, - and _")
        window.run(f"document.getElementById('name').value = 'mine'; {press}")
        window.until(script, lambda text: text.endswith(f"{tmp_path}/mine.h5: 8 frames"))
        assert window.text("record") == "stop recording"
        window.run(press)
        window.until(
            script,
            lambda text: (
                text.startswith("recorded ") and text.endswith(f"frames: {tmp_path}/mine.h5")
            ),
        )
        window.run(press)
        window.until(script, lambda text: "mine.h5: exists already" in text)
        window.run(f"document.getElementById('name').value = ''; {press}")
        window.until(script, lambda text: text.endswith(".h5: 6 frames"))
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130
        window.complaints()
    recording = Recording.load(tmp_path / "mine.h5")
    assert recording.role[:4].tolist() == [0, 0, 0, 1] and len(recording.time) >= 8
    assert recording.sigma is not None and recording.time[3] - recording.time[2] > 1, (
        "the unloaded frames are those of the beginning"
    )
    (interrupted,) = tmp_path.glob("live_*.h5")
    assert Recording.load(interrupted).role[:4].tolist() == [0, 0, 0, 1], (
        "Ctrl-C leaves a clean file"
    )


@pytest.mark.parametrize(
    "seconds", [pytest.param(5, marks=pytest.mark.slow), pytest.param(600, marks=pytest.mark.soak)]
)
def test_the_open_page_shows_thirty_frames_a_second(tmp_path: Path, seconds: int) -> None:
    """All frames of 10 × 10 cells, 2 readings each, are recorded and shown in real time."""
    cells, _ = truth_of(LAMPREY)
    with (
        bench(tmp_path, cells, "--real-time", "--loop") as board,
        live(
            tmp_path,
            *(
                "--port",
                board.port,
                "--scene",
                scene_file(tmp_path, readings=2),
                "--period",
                1 / 30,
            ),
            *("--count", round(30 * seconds), "--out", tmp_path / "r.h5"),
        ) as (window, process),
    ):
        window.run(
            "window.times = []; setInterval(() => { if (latencies.length) "
            "times.push(latencies.at(-1)) }, 200)"
        )
        half = window.until(NUMBER, lambda number: number > 15 * seconds, seconds=seconds + 60)
        latency = window.run("return [median(times), Math.max(...times), times.length]")
        rate = window.text("rate")
        skipped = int(window.text("skipped"))
        assert process.wait(seconds + 60) == 0
        window.complaints()
        figures = board.stop()
    recording = Recording.load(tmp_path / "r.h5")
    lost = int(recording.acquisition.lost.sum())
    missed = int(recording.acquisition.missed.sum())
    print(
        f"\n{len(recording.time)} frames, {recording.time[-1]:.1f} s of board time, {lost} lost, "
        f"{missed} missed; "
        f"at frame {half} {rate} frames a second were shown, {skipped} not reconstructed; last "
        "byte to picture: median "
        f"{latency[0]:.0f} ms, longest {latency[1]:.0f} ms of {latency[2]}; {figures}"
    )
    assert (len(recording.time), lost, missed, figures["overrun"]) == (round(30 * seconds), 0, 0, 0)


def test_a_missing_browser_is_named_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with (
        pytest.raises(pytest.fail.Exception, match=r"apt-get install chromium chromium-driver$"),
        browser(tmp_path),
    ):
        pass
