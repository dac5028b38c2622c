"""Several boards as one image: aligned by clocks, and missing alone while one is gone."""

import itertools
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wild_board import IDLE, Script, WildBoard, wild_board, wire

from lampest import InputError, Panel, Recording, Scene, TwoPointReadout
from lampest.panel.conditions import Faults
from lampest.panel.panel import EachModule, Modules
from lampest.recording.board.protocol import Frame, Hello
from lampest.recording.board.record import record
from lampest.recording.board.several import LATE_SECONDS, Alignment, samples_of
from lampest.recording.board.stream import Sample

PERIOD = 0.05
LAYOUT = Modules(2, 2, EachModule(3, 4), 4.0)
SCENE = Scene(Panel(modules=LAYOUT), TwoPointReadout(readings=2))
AT = replace(IDLE, period_us=round(1e6 * PERIOD))


def steady(hello: Hello) -> Iterator[tuple[float, bytes]]:
    for number in itertools.count():
        yield PERIOD, wire(hello, number)


def pausing(hello: Hello) -> Iterator[tuple[float, bytes]]:
    """Ten frames, then none for a while."""
    for number in itertools.count():
        if number == 10:
            yield 1.2, b""
        yield PERIOD, wire(hello, number + (24 if number >= 10 else 0))


def opened(stack: ExitStack, *scripts: Script) -> list[WildBoard]:
    return [stack.enter_context(wild_board(script)) for script in scripts]


@pytest.mark.slow
def test_a_board_that_falls_silent_is_missing_alone_and_comes_back(tmp_path: Path) -> None:
    with ExitStack() as stack:
        boards = opened(stack, steady, pausing, steady, steady)
        ports = [board.port for board in boards]
        done = record(ports, tmp_path / "r.h5", frames=60, scene=SCENE, period=PERIOD, baseline=3)
    found = Recording.load(tmp_path / "r.h5")
    parts = np.isnan(LAYOUT.split(found.recorded))
    gone = parts.all(axis=(2, 3))
    assert done.frames == 60 and done.lost == 0 and not gone[:, [0, 2, 3]].any()
    assert 15 <= gone[:, 1].sum() == done.parted <= 40 and not gone[-3:, 1].any()
    assert found.acquisition is not None and found.acquisition.event_label[:2] == ("gone: 0,1", "back: 0,1")
    assert np.diff(found.time) == pytest.approx(PERIOD, abs=0.6 * PERIOD)
    assert found.readings().enough(SCENE).any()


@pytest.mark.slow
def test_a_board_that_answers_without_frames_for_long_comes_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one board alone that is an error; beside others it is opened anew, and its clock compared anew."""
    monkeypatch.setattr("lampest.recording.board.stream.UNFIT_SECONDS", 0.4)
    monkeypatch.setattr("lampest.recording.board.stream.SILENCE_SECONDS", 0.2)
    runs = itertools.count()

    def hanging(hello: Hello) -> Iterator[tuple[float, bytes]]:
        if next(runs) == 0:
            yield from itertools.islice(steady(hello), 10)
            yield 60.0, b""
        yield from steady(hello)

    with ExitStack() as stack:
        ports = [board.port for board in opened(stack, steady, hanging, steady, steady)]
        done = record(ports, tmp_path / "r.h5", frames=140, scene=SCENE, period=PERIOD, baseline=3)
    gone = np.isnan(LAYOUT.split(Recording.load(tmp_path / "r.h5").recorded)).all(axis=(2, 3))
    assert done.frames == 140 and done.lost == 0 and not gone[:, [0, 2, 3]].any()
    assert 5 <= gone[:, 1].sum() == done.parted <= 110 and not gone[-3:, 1].any()


def test_ports_and_modules_must_be_as_many() -> None:
    dead = replace(SCENE, faults=Faults(dead_modules=((0, 1),)))
    with pytest.raises(InputError, match=r"reads 3 modules: .* order \[0, 0\], \[1, 0\], \[1, 1\]; not 2"):
        samples_of(("a", "b"), dead)
    with pytest.raises(InputError, match="several boards need a scene"):
        samples_of(("a", "b"), None)


def sent(number: int, at: float, arrived: float | None = None) -> Sample:
    """Frame `number` of a board whose clock began at −100 s of the host's."""
    sums = np.full((3, 4), number, np.uint16)
    frame = Frame(2, number, round(1e3 * (at + 100)), 0, sums)
    return Sample(frame, AT, at + 100, at if arrived is None else arrived, 0, 0)


def shown(here: Alignment, now: float) -> tuple[Alignment, list[tuple[int | None, ...]]]:
    frames = []
    while (found := here.frame(now)) is not None:
        here, parts = found
        frames.append(tuple(parts[b].frame.sequence if b in parts else None for b in range(len(here.shown))))
    return here, frames


def test_late_arrivals_are_set_right_by_the_boards_clocks() -> None:
    """Frames of two boards that begin a fifth of a period apart arrive by up to half a period late."""
    rng, here, seen = np.random.default_rng(1), Alignment.of(2), []
    for number in range(30):
        for board in range(2):
            at = (number + 0.2 * board) * PERIOD
            late = 0.0 if number % 5 == 0 else rng.uniform(0, 0.5 * PERIOD)
            here = here.taking(board, sent(number, at, at + late))
        here, frames = shown(here, (number + 1) * PERIOD)
        seen += frames
    assert all(one == other for one, other in seen) and len(seen) >= 29


def test_the_next_board_leads_while_the_first_is_gone_and_nobody_waits_twice() -> None:
    here, seen = Alignment.of(2), []
    for number in range(20):
        for board in range(2):
            if board or not 5 <= number < 12:
                here = here.taking(board, sent(number, number * PERIOD))
        here, frames = shown(here, number * PERIOD + 0.01)
        seen += frames
        if number == 9:
            here, frames = shown(here, number * PERIOD + 2.5 * PERIOD + LATE_SECONDS)
            seen += frames
    whole = [(number, number) for number in (*range(5), *range(12, 20))]
    assert [one for one in seen if None not in one] == whole
    assert [one for one in seen if None in one] == [(None, number) for number in range(5, 12)]


def test_a_clock_that_runs_slow_loses_no_frame_of_the_other() -> None:
    here, seen = Alignment.of(2), []
    for number in range(400):
        here = here.taking(0, sent(number, number * PERIOD))
        if number < 392:
            here = here.taking(1, sent(number, number * PERIOD * 1.02))
        here, frames = shown(here, number * PERIOD)
        seen += frames
    here, frames = shown(here, 1e9)
    assert [one for one, _ in seen + frames] == list(range(400))
    assert sum(other is None for _, other in seen + frames) <= 12
