"""Boards that print lines of text, recorded over every kind of port."""

import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from printing_board import (
    BANNER,
    STEP_MS,
    frame_with_millis,
    in_datagrams,
    in_file,
    mat_codes,
    on_socket,
    on_terminal,
    printed,
    rows_and_a_blank_line,
)

from lampest import Array, InputError, LoadedColumnsReadout, Panel, Recording, Scene, import_file
from lampest.apps.board.record import Recorded, record
from lampest.apps.board.sample import TOO_FAST, Listening
from lampest.files.document import to_yaml
from lampest.panel.panel import EachModule, Modules

SHAPE = (4, 5)
SCENE = Scene(Panel(*SHAPE), LoadedColumnsReadout(adc_bits=10, readings=1, noise_lsb=1.0))
FRAMES = 14
CODES = mat_codes(FRAMES, SHAPE)
LINES = Listening(lines=True)
ARRIVAL_S = 0.05  # by which an arrival may be late on a busy machine

Ports = Callable[[list[bytes]], AbstractContextManager[str]]


@pytest.fixture(autouse=True)
def _hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lampest.apps.board.port.SILENCE_SECONDS", 0.3)
    monkeypatch.setattr("lampest.apps.board.printed.RATE_SECONDS", 1.0)
    monkeypatch.setattr("lampest.apps.board.printed.WORDS_SECONDS", 1.0)


def codes_of(recording: Recording) -> Array:
    """Return the codes that were printed, NaN where none was."""
    assert recording.scene.readout is not None
    return np.rint(recording.scene.readout.steps_from_volt(recording.recorded))


def recorded(
    url: str,
    path: Path,
    frames: int | None = FRAMES - 1,
    how: Listening = LINES,
) -> tuple[Recorded, Recording]:
    """Record a port, and return the summary and the recording."""
    summary = record(replace(how, ports=(url,), scene=SCENE, baseline=2), path, frames=frames)
    return summary, Recording.load(path)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["socket", "datagrams", "file", "pipe"])
def test_every_kind_of_port_gives_the_same_codes(kind: str, tmp_path: Path) -> None:
    parts = printed(frame_with_millis, CODES)
    out = tmp_path / "r.h5"
    if kind == "pipe":
        (tmp_path / "scene.yaml").write_text(to_yaml(SCENE))
        script = "from lampest.cli import main; main()"
        words = [sys.executable, "-c", script, "record", "--port", "-", "--out", str(out)]
        words += ["--scene", str(tmp_path / "scene.yaml"), "--baseline", "2"]
        run = subprocess.run(words, input=b"".join(parts), capture_output=True, check=True)
        assert b"the board prints: " in run.stdout
    else:
        ports: dict[str, Ports] = {
            "socket": on_socket,
            "datagrams": in_datagrams,
            "file": lambda parts: in_file(parts, tmp_path / "log.txt"),
        }
        with ports[kind](parts) as url:
            recorded(url, out)
    recording = Recording.load(out)
    codes = codes_of(recording)
    np.testing.assert_array_equal(codes, CODES[: len(codes)])
    assert len(codes) >= FRAMES - 1
    np.testing.assert_allclose(np.diff(recording.time), STEP_MS / 1000, atol=1e-9)


def test_numbers_are_read_where_no_lampest_board_answers(tmp_path: Path) -> None:
    parts = printed(frame_with_millis, mat_codes(60, SHAPE))
    with on_terminal(parts) as url:
        _, recording = recorded(url, tmp_path / "r.h5", 30, Listening())
    np.testing.assert_array_equal(codes_of(recording)[0], mat_codes(60, SHAPE)[0])


def test_a_socket_that_closes_before_lampest_has_asked_loses_no_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lampest.apps.board.port.SILENCE_SECONDS", 5.0)
    with on_socket(printed(frame_with_millis, CODES), period=0.001) as url:
        _, recording = recorded(url, tmp_path / "r.h5", FRAMES - 1, Listening())
    np.testing.assert_array_equal(codes_of(recording), CODES[: FRAMES - 1])


def test_times_are_arrivals_where_the_board_sends_none(tmp_path: Path) -> None:
    with on_terminal(printed(rows_and_a_blank_line, CODES), period=0.1) as url:
        summary, recording = recorded(url, tmp_path / "r.h5")
    assert "time: a frame's arrival" in summary.understood
    assert np.median(np.diff(recording.time)) == pytest.approx(0.1, abs=ARRIVAL_S)


@pytest.mark.slow
def test_a_period_replaces_arrivals(tmp_path: Path) -> None:
    with on_terminal(printed(rows_and_a_blank_line, CODES)) as url:
        _, recording = recorded(url, tmp_path / "r.h5", how=replace(LINES, period=0.25))
    np.testing.assert_allclose(np.diff(recording.time), 0.25)


def test_a_board_that_resets_goes_on(tmp_path: Path) -> None:
    parts = [*printed(frame_with_millis, CODES[:7]), BANNER.encode()]
    parts += printed(frame_with_millis, CODES[7:])
    with on_terminal(parts) as url:
        summary, recording = recorded(url, tmp_path / "r.h5", frames=12)
    codes = codes_of(recording)
    assert {tuple(frame.ravel()) for frame in codes} <= {tuple(frame.ravel()) for frame in CODES}
    assert len(codes) == 12 and summary.restarts == 1
    assert np.all(np.diff(recording.time) > 0) and np.diff(recording.time).max() < 1.0


def test_a_line_that_lost_bytes_is_no_other_frame(tmp_path: Path) -> None:
    """Two numbers become one that no converter gives, and a line lacks a field."""
    parts = printed(rows_and_a_blank_line, CODES)
    parts[8] = parts[8].replace(b",", b"", 1)
    with on_terminal(parts) as url:
        _, recording = recorded(url, tmp_path / "r.h5", frames=12)
    codes = codes_of(recording)
    known = np.isfinite(recording.recorded)
    for number, frame in enumerate(codes):
        same = [np.array_equal(frame[known[number]], codes[known[number]]) for codes in CODES]
        assert any(same), f"frame {number} was not printed"


def test_words_are_refused_with_the_first_line(tmp_path: Path) -> None:
    parts = [b"Hello from my sketch\r\n"] * 40
    with (
        on_terminal(parts) as url,
        pytest.raises(InputError, match="prints 'Hello from my sketch' first, where lines of 5"),
    ):
        recorded(url, tmp_path / "r.h5")
    assert not (tmp_path / "r.h5").exists()


def test_a_board_that_prints_needs_a_scene(tmp_path: Path) -> None:
    with (
        on_terminal(printed(frame_with_millis, CODES)) as url,
        pytest.raises(InputError, match=r"prints '\d.*--scene says the rows, columns and circuit"),
    ):
        record(Listening((url,), lines=True), tmp_path / "r.h5", frames=2)


@pytest.mark.slow
def test_a_line_at_another_rate_is_said(tmp_path: Path) -> None:
    """At a wrong rate bytes are no text; a pseudo-terminal has no rate that would help."""
    noise = np.random.default_rng(1).integers(128, 255, (200, 60), np.uint8)
    with on_terminal([row.tobytes() for row in noise]) as url:
        for baud, words in ((None, r"at any usual rate; --baud N"), (9_600, "at 9600 baud")):
            how = replace(LINES, baud=baud)
            with pytest.raises(InputError, match=f"is no text {words}"):
                recorded(url, tmp_path / "r.h5", how=how)
    assert not (tmp_path / "r.h5").exists()


@pytest.mark.slow
def test_bytes_that_come_too_fast_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten frames that find no room are lost, and none of the others is mixed."""
    monkeypatch.setattr("lampest.apps.board.source.MAX_WAITING", 400)
    codes = mat_codes(60, SHAPE)
    lines = printed(frame_with_millis, codes)
    with in_datagrams([*lines[:30], b"".join(lines[30:40]), *lines[40:]], period=0.05) as url:
        summary, recording = recorded(url, tmp_path / "r.h5", frames=45)
    assert summary.count[TOO_FAST]
    whole = np.concatenate([codes[:30], codes[40:55]])
    np.testing.assert_array_equal(codes_of(recording), whole)


@pytest.mark.long
@pytest.mark.parametrize("form", ["letters", "lists"])
def test_panels_in_one_line_are_modules_of_one_image(tmp_path: Path, form: str) -> None:
    """As etextile's grids print: 'x' between numbers, 'z' between panels; or lists with names."""
    panel = Panel(modules=Modules(1, 2, EachModule(*SHAPE)))
    scene = Scene(panel, LoadedColumnsReadout(adc_bits=10, readings=1, noise_lsb=1.0))
    both = np.stack([CODES, mat_codes(len(CODES), SHAPE, seed=5)], axis=1)

    def line(frame: Array) -> str:
        if form == "lists":
            return json.dumps({"left": frame[0].tolist(), "right": frame[1].tolist()})
        return "z".join("".join(f"{code}x" for code in part.ravel()) for part in frame)

    log = tmp_path / "log.txt"
    log.write_text("".join(f"{line(frame)}\n" for frame in both))
    imported, _ = import_file(log, scene=scene, unit="code", baseline_frames=2, period=0.04)
    with on_socket([f"{line(frame)}\r\n".encode() for frame in both]) as url:
        done = record(
            Listening((url,), scene=scene, baseline=2, lines=True), tmp_path / "r.h5", frames=8
        )
    assert "2 parts of a line are the modules" in done.understood
    images = np.concatenate(np.moveaxis(both, 1, 0), axis=2)
    np.testing.assert_array_equal(codes_of(imported), images)
    np.testing.assert_array_equal(codes_of(Recording.load(tmp_path / "r.h5")), images[:8])


def test_modules_that_print_are_one_image(tmp_path: Path) -> None:
    """Each of two boards prints the lines of its module."""
    panel = Panel(modules=Modules(1, 2, EachModule(*SHAPE)))
    scene = Scene(panel, LoadedColumnsReadout(adc_bits=10, readings=1, noise_lsb=1.0))
    both = CODES, mat_codes(FRAMES, SHAPE, seed=5)
    with (
        on_terminal(printed(frame_with_millis, both[0])) as left,
        on_terminal(printed(frame_with_millis, both[1])) as right,
    ):
        record(
            Listening((left, right), scene=scene, baseline=2, lines=True),
            tmp_path / "r.h5",
            frames=8,
        )
    codes = codes_of(Recording.load(tmp_path / "r.h5"))
    assert codes.shape == (8, 4, 10)
    for frame in codes:
        for part, printed_codes in zip(np.split(frame, 2, axis=1), both, strict=True):
            assert np.isnan(part).all() or (part == printed_codes).all(axis=(1, 2)).any()
