"""Several boards as one image, and what of their frames is recorded."""

import copy
import itertools
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wild_board import IDLE

from lampest import Faults, InputError, Panel, Recording, Scene, TwoPointReadout
from lampest.apps.board import several
from lampest.apps.board.protocol import Frame
from lampest.apps.board.record import _wanted, record
from lampest.apps.board.recorder import Recorder
from lampest.apps.board.sample import (
    CLOCK_JUMPED,
    CLOCK_STOPPED,
    Listening,
    Sample,
    Samples,
)
from lampest.apps.board.several import LATE_SECONDS, Alignment, samples_of
from lampest.apps.board.stream import scene_of
from lampest.panel.panel import EachModule, Modules
from lampest.recording.recording import MEASURED, UNLOADED

BOARD_SCENE = scene_of(IDLE, None)
PERIOD = 0.05
ROUNDING_S = 1e-9
LAYOUT = Modules(2, 2, EachModule(3, 4), 4.0)
SCENE = Scene(Panel(modules=LAYOUT), TwoPointReadout(readings=2))
HELLO_AT_PERIOD = replace(IDLE, period_us=round(1e6 * PERIOD))


def test_ports_and_modules_must_have_equal_numbers() -> None:
    dead = replace(SCENE, faults=Faults(dead_modules=((0, 1),)))
    larger = Scene(Panel(modules=Modules(2, 3, EachModule(3, 4))), TwoPointReadout(readings=2))
    for ports, scene, words in (
        ("ab", dead, r"reads 3 modules: .* order \[0, 0\], \[1, 0\], \[1, 1\]; not 2"),
        ("ab", None, "several boards need a scene"),
        (
            "abcdefg",
            larger,
            r"reads 6 modules: .* order \[0, 0\], \[0, 1\], \[0, 2\], \[1, 0\], …; not 7",
        ),
    ):
        with pytest.raises(InputError, match=words):
            samples_of(Listening(tuple(ports), scene))


def sent(number: int, at: float, arrived: float | None = None) -> Sample:
    """Frame `number` of a board whose clock began at −100 s of the host's."""
    sums = np.full((3, 4), number, np.uint16)
    frame = Frame(2, number, round(1e3 * (at + 100)), 0, sums)
    moment = at if arrived is None else arrived
    return Sample(frame, HELLO_AT_PERIOD, BOARD_SCENE, at + 100, moment, 0, 0, arrived=moment)


def shown(alignment: Alignment, moment: float) -> list[tuple[int | None, ...]]:
    frames = []
    while (parts := alignment.frame(moment)) is not None:
        frames.append(
            tuple(parts[b].frame.sequence if b in parts else None for b in alignment.boards)
        )
    return frames


def images(arrivals: Iterable[tuple[int, int, float, float]]) -> list[tuple[int | None, ...]]:
    """Return the images of two boards' frames (board, number, time, arrival) at every arrival.

    Board −1 sends no frame.
    """
    image = Alignment(2)
    complete = list[tuple[int | None, ...]]()
    for board, number, at, arrival in arrivals:
        if board >= 0:
            image.take(board, sent(number, at, arrival))
        complete += shown(image, arrival)
    return complete


def test_a_board_is_waited_for_until_it_is_late() -> None:
    """A part that began 0.4 periods before belongs to the frame."""
    alignment = Alignment(2)
    late = 1.5 * PERIOD + LATE_SECONDS
    for board, at in enumerate((0.0, -0.4 * PERIOD)):
        alignment.take(board, sent(0, at))
    assert shown(alignment, 0.0) == [(0, 0)] and alignment.moment == 0.0 and LATE_SECONDS == 0.3
    alone = copy.deepcopy(alignment)
    waiting = alignment
    alone.take(0, sent(1, PERIOD))
    assert alone.frame(PERIOD + late - 1e-3) is None
    assert shown(alone, PERIOD + late + 1e-3) == [(1, None)] and alone.missing == (1,)
    waiting.take(1, sent(1, 0.9 * PERIOD))
    assert waiting.frame(late + PERIOD - 1e-3) is None
    assert shown(waiting, late + PERIOD + 1e-3) == [(None, 1)]
    assert (waiting.moment, waiting.began) == (pytest.approx(0.9 * PERIOD), 0.0)


def test_a_returning_board_is_shown_at_any_phase() -> None:
    """Frames of the returning board arrive after those of the leading one."""
    for phase in (0.0, 0.1, 0.2, 0.4):
        times = [(board, n, (n + phase * board) * PERIOD) for n in range(40) for board in range(2)]
        delivered = images(
            (*frame, frame[2]) for frame in times if frame[0] == 0 or not 5 <= frame[1] < 25
        )
        assert delivered[6:26] == [(number, None) for number in range(6, 26)]
        assert delivered[26:] == [(number, number) for number in range(26, 40)]


def test_the_image_begins_when_every_board_has_sent() -> None:
    alignment = Alignment(2)
    for number in range(-1, 3):
        alignment.take(0, sent(number + 1, number * PERIOD))
    assert alignment.frame(1e9) is None
    alignment.take(1, sent(7, 0.4 * PERIOD))
    assert shown(alignment, 0.1 * PERIOD) == [(1, 7)]


def test_a_boards_clock_is_set_by_the_quickest_of_fifty_frames() -> None:
    alignment = Alignment(1)
    for number in range(60):
        alignment.take(
            0, sent(number, number * PERIOD, number * PERIOD + (0.01 if number == 12 else 0.02))
        )
    assert len(alignment.delays[0]) == 50
    late = [alignment.waiting[0][number][0] - number * PERIOD for number in (11, 12, 59)]
    assert late == pytest.approx([0.02, 0.01, 0.01])
    alignment.take(0, replace(sent(60, 9.0, 9.5), session=1))
    assert [*alignment.delays[0]] == pytest.approx([-99.5])


def image_of(
    monkeypatch: pytest.MonkeyPatch, boards: dict[str, list[Any]]
) -> tuple[list[Sample], list[str]]:
    """Return the image of four boards, and the states that were reported meanwhile.

    The boards send these samples and then fall silent.
    """
    states = list[str]()
    silent = set[str]()
    waiting = {port: iter(samples) for port, samples in boards.items()}

    def samples(port: str, listening: Listening) -> Samples:
        for sample in waiting[port]:
            if isinstance(sample, InputError):
                raise sample
            yield (sample,)
        silent.add(port)
        while not listening.ending():
            time.sleep(1e-3)

    monkeypatch.setattr(several, "board_samples", samples)
    monkeypatch.setattr(several, "monotonic", lambda: 0.0)
    monkeypatch.setattr(several, "RETRY_SECONDS", 0.0)
    listening = Listening(
        (*boards,),
        SCENE,
        period=PERIOD,
        on_state=states.append,
        ending=lambda: len(silent) == len(boards),
    )
    batches = samples_of(listening)
    return [sample for batch in batches for sample in batch], states


def test_images_of_boards_survive_a_clock_that_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """One board's frames carry another date from the fourth on, the other's from the fifth."""
    boards = {name: [sent(number, 5 + number * PERIOD) for number in range(8)] for name in "abcd"}
    for first, samples in zip((3, 4, 4, 3), boards.values(), strict=True):
        samples[first:] = [
            replace(sample, host_time=sample.host_time + 86_400) for sample in samples[first:]
        ]
    images, _ = image_of(monkeypatch, boards)
    assert len(images) == 8 and not any(image.missing for image in images)
    np.testing.assert_allclose(
        [image.time for image in images], PERIOD * np.arange(8), atol=ROUNDING_S
    )


def test_boards_form_one_image_that_names_absent_boards(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second board lacks the frames 2 and 3, and the third hangs."""
    boards = {name: [sent(number, 5 + number * PERIOD) for number in range(6)] for name in "abcd"}
    del boards["b"][2:4]
    later = [replace(sample, lost=2, events=(CLOCK_JUMPED,)) for sample in boards["c"][4:]]
    boards["c"][4:] = [InputError("nothing fit"), *later]
    boards["d"] = [
        replace(sent(number, at, at + 0.01), frame=replace(sent(number, at).frame, missed=3))
        for number, at in enumerate(5 + PERIOD * np.arange(6))
    ]
    images, states = image_of(monkeypatch, boards)
    assert [image.missing for image in images] == [0, 0, 1, 1, 0, 0]
    jumped = (CLOCK_JUMPED,)
    assert [image.events for image in images] == [
        (),
        (),
        ("gone: 0,1",),
        (),
        (*jumped, "back: 0,1"),
        jumped,
    ]
    assert [image.frame.sequence for image in images] == [0, 1, 2, 3, 4, 5]
    assert {image.frame.missed for image in images} == {3}
    assert [image.session for image in images] == [0, 0, 0, 0, 1, 1]
    assert not any(image.lost for image in images), "no board lacks it where the others have it"
    np.testing.assert_allclose(
        [image.time for image in images], PERIOD * np.arange(6), atol=ROUNDING_S
    )
    np.testing.assert_allclose(
        [image.host_time for image in images], 5.01 + PERIOD * np.arange(6), atol=ROUNDING_S
    )
    assert {(image.hello.rows, image.hello.columns) for image in images} == {(6, 8)}
    parts = LAYOUT.split(np.array([image.frame.sums for image in images]))
    assert [[int(module[0, 0]) for module in image] for image in parts][1:3] == [
        [1] * 4,
        [2, 65535, 2, 2],
    ]
    assert set(states) == {"module 0,1 at b: no frame came"}


def test_frames_lost_by_all_boards_count_as_lost_and_a_silent_board_ends_the_recording(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    boards: dict[str, list[Any]] = {
        name: [sent(number, number * PERIOD) for number in (0, 1, 4)] for name in "abcd"
    }
    for lost, samples in enumerate(boards.values(), 2):
        samples[0], samples[-1] = replace(samples[0], lost=7), replace(samples[-1], lost=lost)
    images, states = image_of(monkeypatch, boards)
    assert ([image.lost for image in images], states) == ([0, 0, 2], [])
    with pytest.raises(InputError, match="no board at d"):
        image_of(monkeypatch, boards | {"d": [InputError("no board at d")]})


# Frames and seconds at most, and what is left of batches of 2, 0, 3 and 2 frames, 0.1 s apart, of
# 0.05 s each.
LIMITS = (
    (None, None, [2, 0, 3, 2]),
    (4, None, [2, 0, 2]),
    (5, None, [2, 0, 3]),
    (6, None, [2, 0, 3, 1]),
    (None, 0.25, [2, 0, 1]),
    (None, 0.35, [2, 0, 2]),
    (3, 0.35, [2, 0, 1]),
    (4, 0.25, [2, 0, 1]),
)


def batches_of(*sizes: int) -> Samples:
    numbers = itertools.count()
    yield from (
        tuple(sent(number, 0.1 * number - 100) for number in itertools.islice(numbers, size))
        for size in sizes
    )


def test_a_recording_ends_after_its_frames_or_seconds() -> None:
    for frames, seconds, sizes in LIMITS:
        assert [
            len(batch) for batch in _wanted(batches_of(2, 0, 3, 2), frames, seconds, 0.1)
        ] == sizes


@pytest.mark.slow
def test_a_requested_recording_follows_the_unloaded_frames(tmp_path: Path) -> None:
    messages: list[tuple[str, bool]] = []
    path = tmp_path / "one.h5"
    recorder = Recorder(tmp_path, 2, lambda sentence, runs: messages.append((sentence, runs)))
    with pytest.raises(InputError, match="up to 64 letters"):
        recorder.ask("a/b")
    for name in ("earlier", "one"):  # the last request counts
        recorder.ask(name)
    for number in range(8):
        if number == 4:
            recorder.zero()
        recorder.take(sent(number, 0.1 * number))
    recorder.ask("")
    recorder.take(sent(8, 0.8))
    recorder.close()
    growing = [(f"recording {path}: {count} frames", True) for count in (2, 3, 4, 5, 6, 7, 8)]
    assert messages == [*growing, (f"closing {path}", False), (f"recorded 8 frames: {path}", False)]
    recording = Recording.load(path)
    assert recording.acquisition is not None and recording.raw_sums is not None
    assert recording.acquisition.sequence.tolist() == [*range(8)]
    assert recording.role.tolist() == [UNLOADED] * 2 + [MEASURED] * 6
    assert recording.acquisition.event_label == ("zero",) and recording.acquisition.event_time[
        0
    ] == pytest.approx(100.4)
    del messages[:]
    for name in ("one", "two"):
        recorder.ask(name)
        for number in range(9, 11):
            recorder.take(sent(number, 0.1 * number))
    recorder.close()
    second = Recording.load(tmp_path / "two.h5")
    assert second.acquisition is not None and second.acquisition.sequence.tolist() == [
        4,
        5,
        9,
        10,
    ], "since the zero"
    assert second.role.tolist() == [UNLOADED] * 2 + [MEASURED] * 2
    assert messages[0] == (
        f"not recorded: {path}: exists already; a recording is never written over",
        False,
    )


@pytest.mark.slow
def test_a_recording_summary_counts_its_events(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    samples = [sent(number, 0.1 * number - 100) for number in range(5)]
    changes: tuple[dict[str, Any], ...] = (
        {"lost": 2},
        {"events": (CLOCK_JUMPED,)},
        {"events": (CLOCK_STOPPED,)},
    )
    for number, change in enumerate((*changes, {"missing": 1, "session": 3}), 1):
        samples[number] = replace(samples[number], **change)
    calls: list[Any] = []

    def arriving(how: Listening) -> Samples:
        calls.append((how.ports, how.scene, how.period, how.ending(), how.baseline))
        yield tuple(samples[:2])
        how.on_state("the board does not answer")
        how.on_state("the board is gone")
        yield ()
        yield tuple(samples[2:])
        yield ()

    monkeypatch.setattr("lampest.apps.board.record.samples_of", arriving)
    steps: list[tuple[int, int, str]] = []
    for name, ports, limits in (
        ("a", ("p",), {"seconds": 2.0}),
        ("b", ("p", "q"), {"frames": 5}),
        ("c", (), {}),
    ):
        del steps[:]
        limits |= {
            "on_progress": lambda at: steps.append((at.frames, at.lost, at.state)),
        }
        summary = record(Listening(ports, period=0.1), tmp_path / name, **limits)
        assert (summary.frames, summary.lost, summary.restarts) == (5, 2, 3)
        assert (summary.count[CLOCK_JUMPED], summary.count[CLOCK_STOPPED]) == (1, 1)
        assert (summary.count["parted"], summary.count["behind"]) == (1, 0)
        assert (summary.path, summary.ended_by, summary.noise_lsb) == (tmp_path / name, "", None)
        assert summary.silent == (1.55 if name == "a" else 0.0)
        assert steps == [
            (1, 0, ""),
            (2, 2, ""),
            (2, 2, "the board is gone"),
            (3, 2, ""),
            (4, 2, ""),
            (5, 2, ""),
        ]
        recording = Recording.load(summary.path)
        assert recording.role.tolist() == [MEASURED] * 5 and recording.acquisition is not None
        assert recording.acquisition.event_label == ("clock jump", "clock stopped")
        np.testing.assert_allclose(recording.acquisition.event_time, recording.time[[2, 3]])
    assert calls == [(urls, None, 0.1, False, 0) for urls in (("p",), ("p", "q"), ())]
