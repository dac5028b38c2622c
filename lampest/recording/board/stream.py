"""Frames from a board in the order of time, through lost frames, resets and unplugging."""

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass

from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.board.identity import scene_of
from lampest.recording.board.port import Board, NoBoardError
from lampest.recording.board.protocol import Frame, Hello

RETRY_SECONDS = 0.2
SILENCE_SECONDS = 2.5


@dataclass(frozen=True, eq=False)
class Sample:
    """A frame with its place in the recording.

    time : s since the first frame, by the board's clock; across a restart of the board by the host's.
    host_time : s since 1970-01-01 UTC.
    lost : frames missing before this one.
    session : number of restarts and reconnections before it.
    """

    frame: Frame
    hello: Hello
    time: float
    host_time: float
    lost: int
    session: int


def agreed_and_recorded(sample: Sample, scene: Scene | None) -> tuple[Scene, Array]:
    """The agreed scene, and (rows, columns) what its readout makes of the mean code: ohm or volt.

    Raises InputError as `scene_of`.
    """
    agreed = scene_of(sample.hello, scene)
    assert agreed.readout is not None
    return agreed, agreed.readout.recorded_from_sums(sample.frame.sums, sample.frame.readings)


def board_samples(
    url: str,
    scene: Scene | None = None,
    period: float | None = None,
    on_state: Callable[[str], None] = lambda sentence: None,
) -> Generator[Sample | None, None, None]:
    """Samples as they come, and None now and then while nothing does; never ends by itself. Close it to stop the board.

    Parameters
    ----------
    url : port name or pyserial URL.
    scene : what the board must fit, and is set to.
    period : s between frames; None for 1 s, or the shortest where that is longer.
    on_state : told in a sentence when the board is gone.

    Raises InputError where no board answers at first, where it does not fit the scene, or cannot be that fast.
    """
    last: Sample | None = None
    session = 0
    while True:
        try:
            with Board.open(url) as board:
                for sample in _one_connection(board, scene, period, last, session):
                    if sample is not None:
                        last, scene = sample, scene_of(sample.hello, scene)
                    yield sample
        except OSError as error:
            if last is None:
                raise NoBoardError(f"{url}: the board went away ({' '.join(str(error).split())})") from error
            reason = "the board is gone; waiting for it"
        except NoBoardError:
            if last is None:
                raise
            reason = "the board does not answer; waiting for it"
        session = last.session + 1 if last else 0
        on_state(reason)
        yield None
        time.sleep(RETRY_SECONDS)


def _one_connection(
    board: Board, scene: Scene | None, period: float | None, last: Sample | None, session: int
) -> Generator[Sample | None, None, None]:
    """Samples until the board is gone; a board that restarts is set and started again."""
    hello = board.hello()
    try:
        while True:
            agreed = scene_of(hello, scene)
            readings = agreed.readout.readings if agreed.readout else hello.readings
            wanted = None if period is None else round(period * 1e6)
            settings = board.start(agreed.panel.rows, agreed.panel.columns, readings, wanted)
            for sample in _one_run(board, settings, last, session):
                last = sample or last
                yield sample
            yield None
            hello = board.hello()
            session += 1
    finally:
        board.stop()


def _one_run(board: Board, hello: Hello, last: Sample | None, session: int) -> Generator[Sample | None, None, None]:
    """Samples until the board says that it no longer scans."""
    before: Frame | None = None
    silent_after = max(SILENCE_SECONDS, 3e-6 * hello.period_us)
    heard = time.monotonic()
    while True:
        found = board.messages()
        for item in found:
            if isinstance(item, Hello) and not item.running:
                return
            if isinstance(item, Frame) and _fits(item, hello) and _follows(item, before, hello):
                heard = time.monotonic()
                last = _placed(item, before, hello, last, session)
                before = item
                yield last
        if not found:
            yield None
        if time.monotonic() - heard > silent_after:
            now = board.identify()
            if not now.running or (now.rows, now.columns, now.readings) != (hello.rows, hello.columns, hello.readings):
                return
            # Should a wrong frame have been believed, nothing else would ever follow it.
            before, heard = None, time.monotonic()


def _fits(frame: Frame, hello: Hello) -> bool:
    return frame.sums.shape == (hello.rows, hello.columns) and frame.readings == hello.readings


def _follows(frame: Frame, before: Frame | None, hello: Hello) -> bool:
    """Whether the board can have sent this after that: numbers grow, and the clock at least as they do."""
    if before is None:
        return True
    steps = (frame.sequence - before.sequence) % 2**32
    elapsed_ms = (frame.device_ms - before.device_ms) % 2**32
    return 0 < steps < 2**31 and elapsed_ms >= 0.99e-3 * steps * hello.period_us - 2


def _placed(frame: Frame, before: Frame | None, hello: Hello, last: Sample | None, session: int) -> Sample:
    now = time.time()
    period = hello.period_us * 1e-6
    if before is not None and last is not None:
        moved = ((frame.device_ms - before.device_ms) % 2**32) / 1000
        lost = (frame.sequence - before.sequence) % 2**32 - 1
        return Sample(frame, hello, last.time + moved, now, lost, session)
    if last is None:
        return Sample(frame, hello, 0.0, now, frame.sequence, session)
    moved = max(now - last.host_time, period)
    return Sample(frame, hello, last.time + moved, now, max(round(moved / period) - 1, 0), session)
