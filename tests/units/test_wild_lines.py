"""A serial line that never ends or that lies: deadlines hold, counters wrap, and what is replayed is no frame."""

import itertools
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wild_board import IDLE, Script, hundred_a_second, wild_board, wire

from lampest import InputError, Recording
from lampest.cli.board import report_recorded
from lampest.recording.board import stream
from lampest.recording.board.protocol import Frame, Hello, message
from lampest.recording.board.record import Recorded, record
from lampest.recording.board.stream import Sample, Scanning, board_samples
from tests.bodies import hello_body

Sent = Iterator[tuple[float, bytes]]


def larger(hello: Hello) -> Sent:
    """Well-formed frames of another size, as fast as the line takes them."""
    for number in itertools.count():
        yield 0.0, wire(hello, number, shape=(5, 5))


def garbage(hello: Hello) -> Sent:
    rng = np.random.default_rng(16)
    while True:
        yield 0.0, rng.bytes(400)


def restarts(hello: Hello) -> Sent:
    """A board that says again and again that it does not scan."""
    while True:
        yield 0.0, message(hello_body(replace(hello, running=False)))


def replayed(hello: Hello) -> Sent:
    """Twenty frames, then the first ten of them for ever."""
    for number in itertools.chain(range(20), itertools.cycle(range(10))):
        yield 0.01, wire(hello, number)


def flooded(hello: Hello) -> Sent:
    """Good frames, each among many of another size."""
    for number in itertools.count():
        yield 0.01, wire(hello, number) + wire(hello, number, shape=(5, 5)) * 20


def recorded(script: Script, folder: Path, frames: int | None = None, seconds: float | None = None) -> Recorded:
    with wild_board(script) as board:
        return record(board.port, folder / "r.h5", frames=frames, seconds=seconds, period=0.01)


@pytest.mark.parametrize(
    ("script", "said"),
    [(larger, "frames of another size"), (garbage, "pieces that are no message"), (restarts, "answers")],
)
def test_a_line_that_never_says_what_fits_ends_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: Script, said: str
) -> None:
    monkeypatch.setattr(stream, "UNFIT_SECONDS", 0.5)
    with pytest.raises(InputError, match=rf"nothing fit for \d+ s, though the line is not silent \(\d+ {said}"):
        recorded(script, tmp_path, frames=10)
    assert not (tmp_path / "r.h5").exists()


def test_what_came_before_a_flood_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "UNFIT_SECONDS", 0.5)
    with pytest.raises(
        InputError, match=r"nothing fit .* frames out of order\); the 20 frames that came before are in"
    ):
        recorded(replayed, tmp_path, frames=30)
    found = Recording.load(tmp_path / "r.h5")
    assert found.acquisition is not None
    assert found.acquisition.sequence.tolist() == list(range(20)) and not found.acquisition.lost.any()


@pytest.mark.slow
@pytest.mark.parametrize("script", [larger, garbage, restarts])
def test_a_flood_does_not_stretch_the_time(tmp_path: Path, script: Script) -> None:
    """By the host's clock it ends, a second and a period late at most; some seconds more are the machine's."""
    began = time.monotonic()
    with pytest.raises(InputError, match="ended before the first frame"):
        recorded(script, tmp_path, seconds=0.2)
    assert time.monotonic() - began < 10


def falls_silent(hello: Hello) -> Sent:
    """Thirty frames, and then nothing."""
    for number in range(30):
        yield 0.01, wire(hello, number)


@pytest.mark.slow
def test_silence_at_the_end_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with wild_board(falls_silent) as board:
        done = record(board.port, tmp_path / "out.h5", seconds=1.0, period=0.01)
    assert (done.frames, done.lost, done.silent) == (30, 0, 0.7)
    report_recorded(done)
    assert "lampest: no frame came in the last 0.7 s\n" in capsys.readouterr().err
    with wild_board(hundred_a_second) as board:
        assert record(board.port, tmp_path / "whole.h5", seconds=0.5, period=0.01).silent == 0.0


def test_frames_are_found_in_a_flood(tmp_path: Path) -> None:
    done = recorded(flooded, tmp_path, frames=50)
    assert (done.frames, done.lost, done.restarts) == (50, 0, 0)


@pytest.mark.slow
def test_the_flood_of_a_live_line_ends_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "UNFIT_SECONDS", 0.5)
    with wild_board(garbage) as board, pytest.raises(InputError, match="nothing fit"):
        for batch in board_samples(board.port):
            assert batch == ()


def frame(number: int, device_ms: int) -> Frame:
    return Frame(2, number % 2**32, device_ms % 2**32, 0, np.zeros((3, 4), np.uint16))


def run_of(*frames: tuple[int, int]) -> tuple[Scanning, list[Sample]]:
    """A run of 10 ms between frames, and the samples that frames (number, ms) make of it."""
    run, found = Scanning(replace(IDLE, period_us=10_000), 0, None), []
    for number, device_ms in frames:
        run, samples = run.taking(frame(number, device_ms))
        found += samples
    return run, found


def places(found: list[Sample]) -> list[tuple[int, int, int]]:
    return [(sample.frame.sequence, sample.lost, sample.session) for sample in found]


def test_numbers_and_clock_wrap() -> None:
    _, found = run_of(*((2**32 - 5 + step, 2**32 - 22 + 10 * step) for step in range(9)))
    assert [lost for _, lost, _ in places(found)][1:] == [0] * 8
    np.testing.assert_allclose([sample.time for sample in found], 0.01 * np.arange(9))


def test_a_first_number_is_believed_as_far_as_the_clock_allows() -> None:
    assert run_of((7, 100))[1][0].lost == 7
    assert run_of((2**32 - 5, 100))[1][0].lost == 0


def test_no_frame_is_believed_that_its_clock_puts_days_ahead() -> None:
    _, found = run_of((0, 500), (1, 510), (10**8, 510 + 10**9), (2, 520))
    assert places(found) == [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
    assert run_of((10**8, 2 * 10**9))[1][0].lost == 0
    _, found = run_of((0, 500), (1, 510), (10**8, 510 + 10**9), (10**8 + 1, 520 + 10**9))
    assert found[2].session == 1 and found[2].lost < 10_000 and found[2].time < 100


def test_what_is_sent_again_is_no_frame() -> None:
    sent = [(number, 500 + 10 * number) for number in range(20)]
    run, found = run_of(*sent, *sent[:15], *sent[3:9])
    assert places(found) == [(number, 0, 0) for number in range(20)]
    more = [sample for step in range(5) for sample in run.taking(frame(*sent[step]))[1]]
    assert not more
    _, found = run_of(*sent, *sent[:15], (20, 700))
    assert places(found)[-1] == (20, 0, 0)


def test_numbers_that_begin_anew_while_the_clock_goes_on_are_a_new_session() -> None:
    _, found = run_of((0, 500), (1, 510), (2, 520), (0, 530), (1, 540), (2, 550))
    assert places(found) == [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 1)]
    np.testing.assert_allclose([sample.time for sample in found], 0.01 * np.arange(6))
    _, found = run_of((0, 500), (1, 510), (2, 520), (0, 560), (1, 570))
    assert places(found)[3:] == [(0, 3, 1), (1, 0, 1)], "what the clock says is missing"


@pytest.mark.parametrize("jump_ms", [5_000, -5_000, 2**31, -(2**31)])
def test_a_jump_of_the_clock_costs_no_frame_and_is_marked(jump_ms: int) -> None:
    sent = [(number, 100_000 + 10 * number + (jump_ms if number >= 10 else 0)) for number in range(30)]
    _, found = run_of(*sent)
    assert places(found) == [(number, 0, 0) for number in range(30)]
    np.testing.assert_allclose([sample.time for sample in found], 0.01 * np.arange(30), atol=1e-9)
    assert [number for number, sample in enumerate(found) if sample.clock_jump] == [10]


@pytest.mark.parametrize("jumps", [{10: 10_000, 11: -9_000}, {10: 5_000, 11: 5_000, 12: -3_000}, {10: -20, 11: 9_000}])
def test_adjacent_jumps_of_the_clock_cost_neither_frames_nor_time(jumps: dict[int, int]) -> None:
    clock = [100_000 + 10 * number + sum(ms for at, ms in jumps.items() if at <= number) for number in range(30)]
    _, found = run_of(*enumerate(clock))
    assert places(found) == [(number, 0, 0) for number in range(30)]
    np.testing.assert_allclose([sample.time for sample in found], 0.01 * np.arange(30), atol=1e-9)


@pytest.mark.parametrize("jump_ms", [10_000, 300, -5_000])
@pytest.mark.parametrize("gone", [1, 4])
def test_a_jump_beside_lost_frames_counts_those_that_are_lost(jump_ms: int, gone: int) -> None:
    sent = [(number, 100_000 + 10 * number + (jump_ms if number >= 10 else 0)) for number in range(30)]
    _, found = run_of(*sent[:10], *sent[10 + gone :])
    assert [sample.lost for sample in found] == [0] * 10 + [gone] + [0] * (len(found) - 11)
    assert [sample.session for sample in found] == [0] * (30 - gone)
    assert found[-1].time == pytest.approx(0.29)


def test_a_late_scan_before_one_in_time_is_no_jump() -> None:
    random = np.random.default_rng(43)
    sent = [(number, int(1000 + 10 * (number + random.uniform(0, 0.95)))) for number in range(500)]
    _, found = run_of(*sent)
    assert places(found) == [(number, 0, 0) for number in range(500)]
    assert not any(sample.clock_jump or sample.events for sample in found)
    assert found[-1].time == pytest.approx(4.99, abs=0.02)


def test_a_clock_that_stands_still_costs_no_frame_and_is_named_once(tmp_path: Path) -> None:
    _, found = run_of(*((number, 500 + 10 * min(number, 4)) for number in range(101)))
    assert places(found) == [(number, 0, 0) for number in range(101)]
    assert np.all(np.diff([sample.time for sample in found]) >= 0.01 - 1e-9)
    assert [number for number, sample in enumerate(found) if sample.events] == [6]
    assert not any(sample.clock_jump for sample in found)


def frozen(hello: Hello) -> Sent:
    """Good frames, whose clock stands still after the fifth."""
    for number in itertools.count():
        yield 0.01, wire(hello, number, 1000 + 10 * min(number, 5))


def test_a_recording_names_the_clock_that_stands_still(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = recorded(frozen, tmp_path, frames=40)
    found = Recording.load(tmp_path / "r.h5")
    assert (done.frames, done.lost, done.restarts, done.clock_jumps) == (40, 0, 0, 0)
    assert found.acquisition is not None and found.acquisition.event_label == ("clock stopped",)
    assert 0.35 < found.time[-1] < 3
    report_recorded(done)
    assert "the board's clock stood still" in capsys.readouterr().err


def test_a_storm_of_jumps_jitter_and_lost_frames_keeps_time_and_counts() -> None:
    random = np.random.default_rng(4343)
    sent, ahead, came = [], 100_000, []
    for number in range(3000):
        if random.random() < 0.05:
            ahead += int(random.integers(-10_000, 10_000))
        if number in (0, 1, 2, 2998, 2999) or random.random() > 0.1:
            sent.append((number, ahead + int(10 * (number + random.uniform(0, 0.9)))))
            came.append(number)
    _, found = run_of(*sent)
    numbers = [sample.frame.sequence for sample in found]
    assert len(found) > 0.99 * len(came), "whole frames are kept"
    assert sum(sample.lost for sample in found) == numbers[-1] + 1 - len(found)
    assert not any(sample.session for sample in found)
    assert found[-1].time == pytest.approx(29.99, rel=0.01)


def test_a_plug_that_is_out_loses_no_frames() -> None:
    _, (*_, last) = run_of((0, 500), (1, 510))
    again = Scanning(replace(IDLE, period_us=10_000), 1, replace(last, host_time=last.host_time - 60))
    _, (sample,) = again.taking(frame(3, 540))
    assert (sample.lost, sample.session) == (3, 1) and sample.time == pytest.approx(60, abs=1)


def test_a_single_wild_clock_is_no_jump() -> None:
    _, found = run_of((0, 500), (1, 510), (2, 5520), (3, 530), (4, 540))
    assert [(place, lost) for place, lost, _ in places(found)] == [(0, 0), (1, 0), (3, 1), (4, 0)]
    assert not any(sample.clock_jump for sample in found)


def test_ticks_that_the_board_missed_are_no_jump() -> None:
    run, _ = run_of((0, 500), (1, 510))
    _, (sample,) = run.taking(replace(frame(2, 5520), missed=500))
    assert sample.time == pytest.approx(5.02) and not sample.clock_jump


def jumping(hello: Hello) -> Sent:
    """Good frames; the clock goes back by 5 s twice, and forward by 5 s."""
    for number in itertools.count():
        jumps = np.searchsorted((40, 80, 120), number, side="right")
        yield 0.01, wire(hello, number, 20_000 + 10 * number + (0, -5_000, 0, -5_000)[jumps])


def test_a_recording_holds_the_jumps_of_the_clock_as_events(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = recorded(jumping, tmp_path, frames=160)
    found = Recording.load(tmp_path / "r.h5").acquisition
    assert (done.frames, done.lost, done.restarts, done.clock_jumps) == (160, 0, 0, 3)
    assert found is not None and found.event_label == ("clock jump",) * 3
    np.testing.assert_allclose(found.event_time, (0.4, 0.8, 1.2), atol=1e-9)
    report_recorded(done)
    assert "3 jumps of the board's clock" in capsys.readouterr().err


def test_a_single_frame_out_of_order_is_dropped() -> None:
    _, found = run_of((0, 500), (1, 510), (900, 515), (2, 520), (3, 530))
    assert places(found) == [(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)]


def test_a_wrong_frame_that_was_believed_is_doubted_after_a_silence() -> None:
    run, _ = run_of((0, 500), (1, 510), (149, 2000))
    run, samples = run.taking(frame(2, 520))
    assert not samples
    doubting = run.doubted()
    again, samples = doubting.taking(frame(4, 540))
    assert places(list(samples)) == [(4, 2, 0)] and samples[0].time > 1.5
    assert not doubting.taking(frame(0, 500))[1], "nor is what was sent before the frame that is not in doubt"
    assert again.taking(frame(5, 550))[1]


ABSURD = {
    "rows": (0, 255),
    "columns": (0, 17),
    "readings": (0, 65),
    "most_rows": (0,),
    "most_readings": (0,),
    "shortest_period_us": (0,),
    "supply_millivolt": (0,),
    "reference_milliohm": (0,),
    "adc_bits": (0, 33, 255),
}


@pytest.mark.parametrize(("field", "value"), [(name, value) for name, values in ABSURD.items() for value in values])
def test_a_board_that_says_what_no_board_can_be_is_refused_in_a_sentence(
    tmp_path: Path, field: str, value: int
) -> None:
    said = rf"the board says that {field} is {value}; 1 to \d+ is possible \(firmware pins\.h\)"
    with (
        wild_board(hundred_a_second, replace(IDLE, **{field: value})) as board,
        pytest.raises(InputError, match=said),
    ):
        record(board.port, tmp_path / "r.h5", frames=3)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("frames", [0, 5])
def test_counted_frames_that_never_come_end_the_recording(
    tmp_path: Path, frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lampest.recording.board.record.UNFIT_SECONDS", 1.0)

    def silent(hello: Hello) -> Sent:
        yield from ((0.01, wire(hello, number)) for number in range(frames))

    began = time.monotonic()
    with pytest.raises(InputError, match=r"no frame came for \d s" + ("; the 5 frames" if frames else "")):
        recorded(silent, tmp_path, frames=10)
    assert time.monotonic() - began < 15
    assert len(list(tmp_path.iterdir())) == (frames > 0)
