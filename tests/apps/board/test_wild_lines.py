"""Serial lines that never end or lie, and counters that wrap."""

import itertools
import os
import re
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from promises import promise
from wild_board import IDLE, Script, hundred_a_second, wild_board, wire

from lampest import InputError, Panel, Recording, Scene, TwoPointReadout
from lampest.apps.board import stream
from lampest.apps.board.journal import noise_from_repeats
from lampest.apps.board.port import NoBoardError
from lampest.apps.board.protocol import Estimate, Frame, Garbage, Hello
from lampest.apps.board.record import Progress, Recorded, record
from lampest.apps.board.sample import (
    CLOCK_JUMPED,
    CLOCK_STOPPED,
    HOST_CLOCK_SET,
    OTHER_BOARD,
    Listening,
    Sample,
)
from lampest.apps.board.stream import Scanning, scene_of
from lampest.files import process
from lampest.panel.readouts.converter import noise_of_variance
from lampest.recording.acquisition import Acquisition
from lampest.recording.recording import MEASURED, UNLOADED

Sent = Iterator[tuple[float, bytes]]
ROUNDING_S = 1e-9
BOARD_SCENE = scene_of(IDLE, None)
IMPOSSIBLE_FIELDS = {
    "rows": (0, 255),
    "columns": (0, 17),
    "readings": (0, 65),
    "most_rows": (0,),
    "most_readings": (0,),
}
IMPOSSIBLE_FIELDS |= {
    "shortest_period_us": (0,),
    "supply_millivolt": (0,),
    "reference_milliohm": (0,),
    "adc_bits": (0, 33, 255),
}
# Messages that arrive, how the board answers when it is asked (None: not at all), when the end is
# requested, and how many samples come in each batch; and how many answers came since the last of
# them.
RUNNING = replace(IDLE, running=True, period_us=0)
FIT = Frame(2, 9, 50, 0, np.ones((3, 4), np.uint16))
ENDED_RUNS: tuple[tuple[list[Any], list[Hello | None], list[bool], list[int], int], ...] = (
    ([(FIT,), (IDLE,)], [RUNNING], [False, False], [1, 0], 2),
    ([(FIT,)], [RUNNING], [False, True], [1, 1], 0),
    ([(), ()], [RUNNING, IDLE], [False, False], [0, 0], 2),
    ([(), ()], [RUNNING, replace(RUNNING, readings=3)], [False, False], [0, 0], 2),
    ([()], [None], [False], [0], 0),
)
MAX_SECONDS = 15.0  # until a line is given up that is allowed one second without a valid frame


def replayed(hello: Hello) -> Sent:
    """Twenty frames, then the first ten of them for ever."""
    return (
        (0.01, wire(hello, number))
        for number in itertools.chain(range(20), itertools.cycle(range(10)))
    )


def recorded(script: Script, folder: Path, **limits: Any) -> Recorded:
    with wild_board(script) as board:
        return record(Listening((board.port,), period=0.01), folder / "r.h5", **limits)


def silent(frames: int) -> Script:
    return lambda hello: ((0.01, wire(hello, number)) for number in range(frames))


# What a line sends when ten frames are requested, the sentence, and how many frames are in the
# file.
USELESS: tuple[tuple[Script, str, int], ...] = (
    (replayed, r"nothing fit .* frames out of order\); the 20 frames that came before are in", 20),
    (silent(0), r"no frame came for \d s", 0),
    (silent(5), r"no frame came for \d s; the 5 frames", 5),
)


@pytest.mark.slow
def test_a_line_without_valid_frames_ends_with_a_sentence_and_keeps_earlier_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, seconds in (("stream", 0.5), ("record", 1.0)):
        monkeypatch.setattr(f"lampest.apps.board.{module}.UNFIT_SECONDS", seconds)
    for script, sentence, count in USELESS:
        began = time.monotonic()
        with pytest.raises(InputError, match=sentence):
            recorded(script, tmp_path, frames=30)
        assert time.monotonic() - began < MAX_SECONDS
        assert len(list(tmp_path.iterdir())) == (count > 0)
        if count:
            recording = Recording.load(tmp_path / "r.h5")
            assert recording.acquisition.sequence.tolist() == list(range(count))
            assert not recording.acquisition.lost.any()
            (tmp_path / "r.h5").unlink()


def frame(number: int, device_ms: int) -> Frame:
    return Frame(2, number % 2**32, device_ms % 2**32, 0, np.zeros((3, 4), np.uint16))


def run_of(*frames: tuple[int, int]) -> tuple[Scanning, list[Sample]]:
    """A run of 10 ms between frames, and the samples that frames (number, ms) make of it."""
    run = Scanning(replace(IDLE, period_us=10_000), BOARD_SCENE, 0, None)
    samples = list[Sample]()
    for number, device_ms in frames:
        samples += run.take(frame(number, device_ms))
    return run, samples


def places(samples: list[Sample]) -> list[tuple[int, int, int]]:
    return [(sample.frame.sequence, sample.lost, sample.session) for sample in samples]


def complete_frames(count: int, session: int = 0) -> list[tuple[int, int, int]]:
    return [(number, 0, session) for number in range(count)]


def ticked(count: int, jumps: dict[int, int], gone: range = range(0)) -> list[tuple[int, int]]:
    """Return (number, clock in ms) of frames every 10 ms, without the frames in `gone`.

    The clock jumps by `jumps[number]` ms at a frame.
    """
    clock = (
        100_000 + 10 * number + sum(ms for at, ms in jumps.items() if at <= number)
        for number in range(count)
    )
    return [(number, ms) for number, ms in enumerate(clock) if number not in gone]


TICKS = ticked(20, {})
LATE_TICKS = [
    (n, int(1000 + 10 * (n + late)))
    for n, late in enumerate(np.random.default_rng(43).uniform(0, 0.95, 500))
]
# Frames (number, ms), what is made of them (number, frames lost before it, session), and where the
# clock jumped.
RUNS: dict[str, tuple[list[tuple[int, int]], list[tuple[int, int, int]], list[int]]] = {
    "numbers and clock wrap": (
        [((2**32 - 5 + step) % 2**32, 2**32 - 22 + 10 * step) for step in range(9)],
        [((2**32 - 5 + step) % 2**32, 0, 0) for step in range(9)],
        [],
    ),
    "frames are sent again": ([*TICKS, *TICKS[:15], *TICKS[3:9]], complete_frames(20), []),
    "frames are sent again, then new ones": (
        [*TICKS, *TICKS[:15], (20, 100_200)],
        complete_frames(21),
        [],
    ),
    "numbers begin anew": (
        [(0, 500), (1, 510), (2, 520), (0, 530), (1, 540), (2, 550)],
        [*complete_frames(3), *complete_frames(3, session=1)],
        [],
    ),
    "numbers begin anew after a pause": (
        [(0, 500), (1, 510), (2, 520), (0, 560), (1, 570)],
        [*complete_frames(3), (0, 3, 1), (1, 0, 1)],  # what the clock says is missing
        [],
    ),
    "a frame is out of order": (
        [(0, 500), (1, 510), (900, 515), (2, 520), (3, 530)],
        complete_frames(4),
        [],
    ),
    "a clock is wild once": (
        [(0, 500), (1, 510), (2, 5520), (3, 530), (4, 540)],
        complete_frames(5),
        [2],
    ),
    "a clock is wild once, and the frame before is gone": (
        [(0, 500), (1, 510), (3, 5530), (4, 540), (5, 550)],
        [*complete_frames(2), (3, 1, 0), (4, 0, 0), (5, 0, 0)],
        [2],
    ),
    "scans are late": (LATE_TICKS, complete_frames(500), []),
    **{
        f"a jump by {ms} ms": (ticked(30, {10: ms}), complete_frames(30), [10])
        for ms in (5_000, -5_000, 2**31, -(2**31))
    },
    **{
        f"a jump by {ms} ms where {gone} are gone": (
            ticked(30, {10: ms}, range(10, 10 + gone)),
            [*complete_frames(10), (10 + gone, gone, 0), *complete_frames(30)[11 + gone :]],
            [10],
        )
        for ms in (10_000, 300, -5_000)
        for gone in (1, 4)
    },
}
ADJACENT = ({10: 10_000, 11: -9_000}, {10: 5_000, 11: 5_000, 12: -3_000}, {10: -20, 11: 9_000})


def test_frames_are_counted_and_timed_despite_wild_numbers_and_clocks() -> None:
    for name, (sent, expected, jumps) in RUNS.items():
        _, samples = run_of(*sent)
        assert places(samples)[1:] == expected[1:], name
        assert [
            number for number, sample in enumerate(samples) if CLOCK_JUMPED in sample.events
        ] == jumps, name
        period = [0.01 * (1 + lost) for _, lost, _ in expected[1:]]
        elapsed = [sample.time for sample in samples]
        np.testing.assert_allclose(
            np.diff(elapsed), period, atol=0.01 if sent is LATE_TICKS else 1e-9, err_msg=name
        )
    for jumps in ADJACENT:
        _, samples = run_of(*ticked(30, jumps))
        assert places(samples) == complete_frames(30)
        np.testing.assert_allclose(
            [sample.time for sample in samples], 0.01 * np.arange(30), atol=ROUNDING_S
        )


@promise("apps/board/board: A jump of the board's clock costs no frame.")
def test_a_wild_clock_in_the_last_frame_costs_no_frame() -> None:
    for last_ms in (5_520, 100, 2**31):
        run, samples = run_of((0, 500), (1, 510), (2, last_ms))
        samples += run.last_sample()
        assert places(samples) == complete_frames(3) and samples[-1].events == (CLOCK_JUMPED,)
        assert samples[-1].time == pytest.approx(0.02) and not run.last_sample()
    for last in ((1, 510), (0, 500), (900, 515)):
        run, samples = run_of((0, 500), (1, 510), last)
        assert not run.last_sample() and places(samples) == complete_frames(2), (
            "repeated and foreign frames are none"
        )


def test_the_clock_limits_the_accepted_frame_number() -> None:
    """The first one; and none that its clock puts days ahead."""
    assert [
        run_of(first)[1][0].lost for first in ((7, 100), (2**32 - 5, 100), (10**8, 2 * 10**9))
    ] == [7, 0, 0]
    assert places(run_of((0, 500), (1, 510), (10**8, 510 + 10**9), (2, 520))[1]) == complete_frames(
        3
    )
    _, samples = run_of((0, 500), (1, 510), (10**8, 510 + 10**9), (10**8 + 1, 520 + 10**9))
    assert samples[2].session == 1 and samples[2].lost < 10_000 and samples[2].time < 100


def test_a_stopped_clock_costs_no_frame_and_is_named_once() -> None:
    _, samples = run_of(*((number, 500 + 10 * min(number, 4)) for number in range(101)))
    assert places(samples) == complete_frames(101) and np.all(
        np.diff([sample.time for sample in samples]) >= 0.01 - ROUNDING_S
    )
    assert [(number, sample.events) for number, sample in enumerate(samples) if sample.events] == [
        (6, (CLOCK_STOPPED,))
    ]


@pytest.mark.long
@pytest.mark.parametrize("first", [7, 9])
def test_frames_of_another_board_on_the_line_are_left_out_with_a_warning(
    tmp_path: Path, first: int
) -> None:
    """Two boards whose numbers and clocks go in step; of each frame either may come first."""

    def both(hello: Hello) -> Sent:
        for number in itertools.count():
            yield 0.01, wire(hello, number, identity=first)
            yield 0.0, wire(hello, number, identity=16 - first)

    with wild_board(both, identity=7) as board:
        summary = record(Listening((board.port,), period=0.01), tmp_path / "r.h5", frames=40)
    recording = Recording.load(tmp_path / "r.h5")
    assert np.all(recording.raw_sums == 707) and (summary.frames, summary.lost) == (40, 0)
    assert recording.acquisition.sequence.tolist() == list(range(40))
    assert summary.count[OTHER_BOARD] and "another board" in recording.acquisition.event_label


@pytest.mark.parametrize("step_s", [-86_400.0, -3600.0, 3600.0, 86_400.0])
@pytest.mark.parametrize(
    "frames",
    {
        "the board goes on": [(n, 500 + 10 * n) for n in range(6)],
        "its clock stands still": [(n, 500) for n in range(6)],
        "its clock jumps": [(n, 500 + 10 * n + 10**7 * (n > 2)) for n in range(6)],
        "it restarts": [(n % 3, 500 + 10 * (n % 3) + 900 * (n > 2)) for n in range(6)],
    }.values(),
)
def test_no_time_depends_on_a_clock_that_is_set(
    monkeypatch: pytest.MonkeyPatch, frames: list[tuple[int, int]], step_s: float
) -> None:
    """The host's clock is set before the fourth frame; the steady one goes on by 10 ms a frame."""
    steps = [0.0]
    clocks = SimpleNamespace(
        time=lambda: 1.7e9 + 0.01 * len(steps) + steps[-1], monotonic=lambda: 0.01 * len(steps)
    )
    monkeypatch.setattr(stream, "time", clocks)
    runs = []
    for sizes in (6 * [0.0], [0.0, 0.0, 0.0, step_s, step_s, step_s]):
        steps[:] = [0.0]
        run = Scanning(replace(IDLE, period_us=10_000), BOARD_SCENE, 0, None, since=0.0)
        samples = list[Sample]()
        for size, (number, device_ms) in zip(sizes, frames, strict=True):
            steps.append(size)
            samples += run.take(frame(number, device_ms))
        runs.append(samples)
    steady, moved = runs
    assert len(moved) >= 5
    assert [sample.time for sample in moved] == [sample.time for sample in steady]
    assert [sample.session for sample in moved] == [sample.session for sample in steady]
    assert max(np.diff([sample.time for sample in moved])) < 60
    assert sum(HOST_CLOCK_SET in sample.events for sample in moved) == 1
    assert not any(HOST_CLOCK_SET in sample.events for sample in steady)


def test_an_unplugged_board_loses_no_counted_frames_and_missed_ticks_are_no_jump() -> None:
    run, (*_, last) = run_of((0, 500), (1, 510))
    resumed = Scanning(
        replace(IDLE, period_us=10_000),
        BOARD_SCENE,
        1,
        replace(last, arrived=last.arrived - 60),
    )
    (sample,) = resumed.take(frame(3, 540))
    assert (sample.lost, sample.session) == (3, 1) and sample.time == pytest.approx(60, abs=1)
    (sample,) = run.take(replace(frame(2, 5520), missed=500))
    assert sample.time == pytest.approx(5.02) and not sample.events


def test_a_wrongly_accepted_frame_is_doubted_after_a_silence() -> None:
    run, _ = run_of((0, 500), (1, 510), (149, 2000))
    assert not run.take(frame(2, 520))
    run.doubt()
    assert not run.take(frame(0, 500)), "nor is what was sent before the frame that is not in doubt"
    samples = run.take(frame(4, 540))
    assert places(list(samples)) == [(4, 2, 0)] and samples[0].time > 1.5
    assert run.take(frame(5, 550))


def test_an_impossible_hello_is_refused_with_a_sentence(tmp_path: Path) -> None:
    wrong = [(field, value) for field, values in IMPOSSIBLE_FIELDS.items() for value in values]
    greetings = [replace(IDLE, **{field: value}) for field, value in wrong]
    for hello, (field, value) in zip(greetings, wrong, strict=True):
        assert re.fullmatch(
            rf"the board says that {field} is {value}; 1 to \d+ is possible", hello.fault
        )
    assert IDLE.fault == ""
    with (
        wild_board(hundred_a_second, greetings[0]) as board,
        pytest.raises(InputError, match=r"rows is 0; .* possible \(firmware pins\.h\)"),
    ):
        record(Listening((board.port,)), tmp_path / "r.h5", frames=3)
    assert not list(tmp_path.iterdir())


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_recording_leaves_a_clean_file(
    tmp_path: Path, number: signal.Signals
) -> None:
    def interrupt(progress: Progress) -> None:
        if progress.frames == 6:
            os.kill(os.getpid(), number)

    with wild_board(hundred_a_second) as board:
        summary = record(
            Listening((board.port,), period=0.01), tmp_path / "r.h5", on_progress=interrupt
        )
    assert summary.ended_by == number.name and summary.frames >= 6
    assert len(Recording.load(tmp_path / "r.h5").time) == summary.frames
    assert [path.name for path in tmp_path.iterdir()] == ["r.h5"]


def test_signals_within_a_second_are_one_request_and_a_later_one_ends_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(KeyboardInterrupt), process.ending_signals():  # nothing is worth finishing
        signal.raise_signal(signal.SIGTERM)
    monkeypatch.setattr(process, "time", SimpleNamespace(monotonic=iter((0.0, 0.9, 1.1)).__next__))
    with process.ending_signals(lambda: True) as ended_by:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.raise_signal(number)
        assert ended_by() == "SIGTERM"
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)


def test_an_ignored_signal_stays_ignored_unless_it_ends_programs() -> None:
    """`nohup` ignores SIGHUP, and shells ignore Ctrl-C for their background jobs."""
    handlers = {
        number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGHUP, signal.SIGINT)
    }
    try:
        with process.ending_signals(lambda: True) as ended_by:
            signal.raise_signal(signal.SIGHUP)
            assert ended_by() == ""
            signal.raise_signal(signal.SIGINT)
            assert ended_by() == "SIGINT"
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def test_a_scene_that_contradicts_the_board_is_refused() -> None:
    for panel, changes, words in (
        (Panel(17, 10), {}, r"panel\.rows is 17, but the board can do at most 16"),
        (
            Panel(3, 4),
            {"readings": 65},
            r"readout\.readings is 65, but the board can do at most 64",
        ),
        (
            Panel(3, 4),
            {"measured_across": "sensor"},
            "measured_across is sensor, but the board says reference",
        ),
    ):
        with pytest.raises(InputError, match=words):
            scene_of(IDLE, Scene(panel, TwoPointReadout(**changes)))


def test_the_error_names_a_port_without_a_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lampest.apps.board.port.HELLO_SECONDS", 0.5)
    with pytest.raises(InputError, match="no lampest board answered"):
        record(Listening(("loop://",)), tmp_path / "r.h5", frames=1)


def test_invalid_messages_are_counted_by_kind_until_a_valid_frame() -> None:
    line = stream._Line("url", Listening())
    idle = replace(IDLE, running=True)
    fit, misshapen = (Frame(2, 9, 50, 0, np.ones(shape, np.uint16)) for shape in ((3, 4), (3, 5)))
    unfit = (Garbage(3), misshapen, misshapen, Garbage(1), Garbage(2), idle, idle, idle, idle)
    for messages, over in ((unfit, False), ((*unfit, IDLE, fit), True)):
        samples, finished = line._taken(Scanning(idle, BOARD_SCENE, 0, None), messages)
        assert (samples, finished) == ((), over)
    counts = {"pieces that are no message": 6, "frames of another size": 4, "answers": 9}
    assert line._unfit == counts
    line._since -= stream.UNFIT_SECONDS + 3.1
    line.check(1.1)
    kinds = "9 answers, 6 pieces that are no message, 4 frames of another size"
    with pytest.raises(
        InputError, match=rf"^url: nothing fit for 33 s, though the line is not silent \({kinds}\)$"
    ):
        line.check(1.0)
    run = Scanning(idle, BOARD_SCENE, 0, None)
    samples, finished = line._taken(run, (fit, fit))
    assert len(samples) == 1 and not finished and line._unfit == {"frames out of order": 1}
    assert line._taken(run, (fit,)) == ((), False) and line._unfit == {"frames out of order": 2}


def test_a_frame_has_the_estimate_sent_before_it() -> None:
    """A lost, garbled, late or failed estimate costs only itself, and the line stays in use."""
    line = stream._Line("url", Listening())
    run = Scanning(replace(IDLE, running=True), BOARD_SCENE, 0, None)
    change = np.arange(12, dtype=np.float32).reshape(3, 4)
    frames = [
        Frame(2, number, 50 + 1000 * number, 0, np.ones((3, 4), np.uint16)) for number in range(7)
    ]
    messages = (
        *(Estimate(0, 0, change), frames[0], frames[1]),
        *(Estimate(0, 1, change), frames[2]),
        *(Estimate(3, 3, change), frames[3]),
        *(Estimate(0, 4, change[:, :3]), frames[4]),
        *(Garbage(40), frames[5]),
        *(Estimate(0, 6, 2 * change), Garbage(40), frames[6]),
    )
    samples, _ = line._taken(run, messages)
    assert [sample.frame.sequence for sample in samples] == [*range(7)]
    assert [sample.frame.log_change is None for sample in samples] == [False, *5 * [True], False]
    assert samples[3].frame.unestimated == "something lies on the panel while it takes its baseline"
    np.testing.assert_array_equal(samples[6].frame.log_change, 2 * change)
    line._taken(run, 40 * (Estimate(0, 9, change),))
    assert not line._unfit


def test_a_run_ends_with_its_board_or_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    """A silent board is identified anew: its run goes on if it still scans, and ends otherwise."""
    monkeypatch.setattr(stream, "SILENCE_SECONDS", -1.0)
    for arrived, answers, ending, sizes, since in ENDED_RUNS:
        messages = iter(arrived)
        identities = iter(answers)
        ends = iter(ending)

        def identify(identities: Iterator[Hello | None] = identities) -> Hello:
            if (answer := next(identities)) is None:
                raise NoBoardError("silent")
            return answer

        board: Any = SimpleNamespace(messages=messages.__next__, identify=identify, heard=5)
        board.stop = lambda: (replace(FIT, sequence=10, device_ms=1050),)
        line = stream._Line("url", Listening(ending=ends.__next__))
        batches = line._run(board, RUNNING, BOARD_SCENE)
        taken = [*itertools.islice(batches, len(sizes))]
        assert [len(batch) for batch in taken] == sizes
        assert all(sample.session == 0 for batch in taken for sample in batch)
        with pytest.raises(NoBoardError if None in answers else StopIteration):
            next(batches)
        assert line._unfit["answers"] == since
    _, (last,) = run_of((3, 500))
    line.last = replace(last, session=4)
    board.messages = [(FIT,)].pop
    board.identify = lambda: IDLE
    line._how = Listening()
    assert [
        sample.session for batch in line._run(board, RUNNING, BOARD_SCENE) for sample in batch
    ] == [5]


def test_noise_is_estimated_from_pairs_of_consecutive_unloaded_codes() -> None:
    """Pairs over a restart, of loaded frames and at the ends of the converter count as nothing."""
    rng = np.random.default_rng(3)
    readings = 4
    frames = 60
    readout = TwoPointReadout(readings=readings)
    sums = np.round(readings * (500 + 3 * rng.standard_normal((frames, 2, 3)))).astype(np.uint16)
    sums[30:] += 800
    sums[50:] += np.arange(0, 1000, 100, dtype=np.uint16)[:, None, None]
    sums[::2, 0, 0] = 2 * readings
    sums[::2, 0, 1] = 1021 * readings
    sums[1::2, 0, :2] = 500 * readings
    codes = sums[:50].reshape(50, 6)[:, 2:] / readings
    differences = np.concatenate([np.diff(codes[:30], axis=0), np.diff(codes[30:], axis=0)])
    numbers = np.arange(frames)
    session = (numbers >= 30).astype(np.uint16)
    zeros = np.zeros(frames, np.uint16)
    counters = numbers * 1.0, numbers, numbers, zeros, zeros, session

    def first(count: int) -> Recording:
        return Recording(
            Scene(Panel(2, 3), readout),
            readout.recorded_from_volt(readout.volt_from_code(sums[:count] / readings)),
            numbers[:count] * 1.0,
            np.where(numbers < 50, UNLOADED, MEASURED).astype(np.uint8)[:count],
            raw_sums=sums[:count],
            raw_readings=readings,
            acquisition=Acquisition(*(counter[:count] for counter in counters), np.zeros(0)),
        )

    assert noise_from_repeats([first(frames)]) == noise_of_variance(
        readout, np.mean(differences**2) / 2
    )
    assert noise_from_repeats([first(13)]) is None, "48 pairs"
    assert noise_from_repeats([first(14)]) is not None, "52 pairs"
