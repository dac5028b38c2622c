"""Frames from a board in the order of time, through lost frames, resets and unplugging."""

import time
from collections.abc import Callable, Generator, Sequence

from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.board.identity import scene_of
from lampest.recording.board.patience import Patience
from lampest.recording.board.port import Board, NoBoardError
from lampest.recording.board.protocol import Frame, Hello, Message
from lampest.recording.board.sample import Sample, Scanning

RETRY_SECONDS = 0.2
SILENCE_SECONDS = 2.5

Samples = Generator[tuple[Sample, ...], None, None]


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
    ending: Callable[[], bool] = lambda: False,
) -> Samples:
    """Samples as they come, several at once where they wait, and none now and then. Close it to stop the board.

    Parameters
    ----------
    url : port name or pyserial URL.
    scene : what the board must fit, and is set to.
    period : s between frames; None for 1 s, or the shortest where that is longer.
    on_state : told in a sentence when the board is gone.
    ending : asked again and again; once it says so, what the port has delivered comes as one last batch.

    Raises InputError where no board answers at first, where it does not fit the scene, cannot be that fast, or the line
    talks without a frame that fits.
    """
    last: Sample | None = None
    session = 0
    patience = Patience(url)
    while not ending():
        heard = False
        try:
            with Board.open(url) as board:
                try:
                    for samples in _one_connection(board, scene, period, last, session, patience, ending):
                        if samples:
                            last = samples[-1]
                            scene = scene_of(last.hello, scene)
                        yield samples
                finally:
                    heard = board.heard
        except OSError as error:
            if last is None:
                raise NoBoardError(f"{url}: the board went away ({' '.join(str(error).split())})") from error
            reason = "the board is gone; waiting for it"
        except NoBoardError:
            if last is None:
                raise
            reason = "the board does not answer; waiting for it"
        else:
            return
        if not heard:
            patience.renew()
        patience.check()
        session = last.session + 1 if last else 0
        on_state(reason)
        yield ()
        time.sleep(RETRY_SECONDS)


def _one_connection(
    board: Board,
    scene: Scene | None,
    period: float | None,
    last: Sample | None,
    session: int,
    patience: Patience,
    ending: Callable[[], bool],
) -> Samples:
    """Samples until the board is gone or the end is asked for; a board that restarts is set and started again."""
    hello = board.hello()
    try:
        while True:
            agreed = scene_of(hello, scene)
            readings = agreed.readout.readings if agreed.readout else hello.readings
            wanted = None if period is None else round(period * 1e6)
            settings = board.start(agreed.panel.rows, agreed.panel.columns, readings, wanted)
            for samples in _one_run(board, Scanning(settings, session, last), patience, ending):
                last = samples[-1] if samples else last
                yield samples
            if ending():
                return
            yield ()
            patience.check(settings.period_us)
            hello = board.hello()
            session = last.session + 1 if last else session + 1
    finally:
        board.stop()


def _one_run(board: Board, run: Scanning, patience: Patience, ending: Callable[[], bool]) -> Samples:
    """Samples until the board says that it no longer scans, or the end is asked for."""
    hello = run.hello
    silent_after = max(SILENCE_SECONDS, 3e-6 * hello.period_us)
    heard = time.monotonic()
    while True:
        asked = ending()
        found = board.last_messages() if asked else board.messages()
        run, samples, over = _taken(run, found, patience)
        if samples:
            heard = time.monotonic()
        yield samples
        if over or asked:
            return
        patience.check(hello.period_us)
        if time.monotonic() - heard > silent_after:
            now = board.identify()
            patience.hear(now, False)
            if not now.running or (now.rows, now.columns, now.readings) != (hello.rows, hello.columns, hello.readings):
                return
            run, heard = run.doubted(), time.monotonic()


def _taken(run: Scanning, found: Sequence[Message], patience: Patience) -> tuple[Scanning, tuple[Sample, ...], bool]:
    """The run with all messages, the samples they make, and whether the board said that it no longer scans."""
    samples: list[Sample] = []
    for item in found:
        if isinstance(item, Hello) and not item.running:
            patience.hear(item, False)
            return run, tuple(samples), True
        fits = isinstance(item, Frame) and _fits(item, run.hello)
        more: tuple[Sample, ...] = ()
        if isinstance(item, Frame) and fits:
            run, more = run.taking(item)
        if more:
            samples.extend(more)
            patience.renew()
        else:
            patience.hear(item, fits)
    return run, tuple(samples), False


def _fits(frame: Frame, hello: Hello) -> bool:
    return frame.sums.shape == (hello.rows, hello.columns) and frame.readings == hello.readings
