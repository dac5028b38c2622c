"""The command `lampest live`: frames of a board or a recording, an engine and a server."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

from lampest.apps.board.port import only_port
from lampest.apps.board.record import Progress, Recorded, record
from lampest.apps.board.recorder import Recorder
from lampest.apps.board.sample import Listening, Printing, Sample
from lampest.apps.board.several import samples_of
from lampest.apps.live.engine import Engine, FrameSource
from lampest.apps.live.message import acknowledged
from lampest.apps.live.publish import Say, publish_at, publishing
from lampest.apps.live.server import PageActions, address, serving
from lampest.apps.live.watcher import Scan
from lampest.cost.terms import (
    CellResistance,
    Gradient,
    GradientOfRelativeChange,
    Misfit,
    RelativeChange,
    Term,
)
from lampest.estimate.estimator import Estimator, Tare
from lampest.estimate.sequence import frame_period
from lampest.files.document import read_document, validated
from lampest.files.errors import InputError, counted, meant
from lampest.recording.recording import UNLOADED, Recording
from lampest.runs.config import RunFile, resolve

PENALTIES: dict[str, tuple[Term, ...]] = {
    "smooth": (Gradient(),),
    "LSM": (),
    "changes": (GradientOfRelativeChange(),),
    "cell_resistance": (CellResistance(),),
    "relative_change": (RelativeChange(),),
}
# The data choose the weights, so the names differ from the paper's.
METHODS = {
    name: Estimator((Misfit(), *penalties), "reduced", tare=Tare())
    for name, penalties in PENALTIES.items()
}


@dataclass(frozen=True)
class Replay:
    """A recording as the source, replayed at `speed` times its rate.

    `baseline` as in `Listening` if no frame is unloaded.
    """

    path: Path
    speed: float = 1.0
    baseline: int = 3


@dataclass(frozen=True)
class Outlets:
    """Outlets of live frames: pages, files and publishers.

    Attributes
    ----------
    http : str
        HOST:PORT of the page; port 0 for any free one.
    token : str or None
        Required of visitors of the page, by default a generated one; of WebSocket listeners from
        elsewhere.
    publish : sequence of str
        Addresses such as ``mqtt://localhost:1883/lampest``.
    out : Path or None
        Recording of the board to write as well.
    """

    http: str = "127.0.0.1:8137"
    token: str | None = None
    publish: Sequence[str] = ()
    out: Path | None = None


def live(
    source: Listening | Replay,
    estimator: tuple[str, Estimator],
    outlets: Outlets = Outlets(),
    frames: int | None = None,
    on_url: Say = lambda url: None,
    on_trouble: Say = lambda sentence: None,
    on_note: Say = lambda sentence: None,
) -> Recorded | None:
    """Reconstruct frames as they arrive and show them in the browser until Ctrl-C or a last frame.

    Parameters
    ----------
    source : Listening or Replay
    estimator : (str, Estimator)
        Name and estimator, as returned by `chosen`.
    outlets : Outlets
    frames : int, optional
        Number of frames; by default all.
    on_url : callable
        Receives the address of the page once it can be opened, then the addresses of published
        frames.
    on_trouble : callable
        Receives sentences on failures of publishing.
    on_note : callable
        Receives how the lines of a board that prints are read, and the counts of frames at the end.

    Returns
    -------
    Recorded or None
        The recording, if one was written.

    Raises
    ------
    InputError
        If the source or an address fails.
    """
    name, method = estimator
    recording = Recording.load(source.path) if isinstance(source, Replay) else None
    if isinstance(source, Listening) and not source.ports:
        source = replace(source, ports=(only_port(),))
    port = ", ".join(source.ports) if isinstance(source, Listening) else ""
    ways = [publish_at(where, outlets.token) for where in outlets.publish]
    title = port if recording is None else recording.name
    with (
        Engine(title, name, method, source.baseline, beside=True) as engine,
        publishing(ways, engine.shown, on_trouble) as published,
        recorder_of(source, engine, outlets.out) as (recorder, actions),
        serving(*address(outlets.http), engine.shown, outlets.token, actions) as server,
    ):
        for where in (server.url, *published):
            on_url(where)
        with _saying_how_it_ended(engine):
            done = _pass_frames(engine, source, recording, recorder or outlets.out, frames, on_note)
            engine.finish()
            if isinstance(source, Replay) and frames is None:
                engine.say("the recording has ended")
                Event().wait()
        return done


@contextmanager
def _saying_how_it_ended(engine: Engine) -> Iterator[None]:
    """Show on the page that frames have ended, or the mistake that stopped them."""
    try:
        yield
    except InputError as error:
        engine.say(f"stopped: {error}")
        raise
    engine.say("lampest has ended")


def _pass_frames(
    engine: Engine,
    source: Listening | Replay,
    recording: Recording | None,
    recorder: Recorder | Path | None,
    frames: int | None,
    on_note: Say,
) -> Recorded | None:
    """Pass `frames` frames, or all, of a replayed recording or of a board.

    Those of a board go to the recorder of the page's button, or into a file. Return the recording
    if one was written.
    """
    if isinstance(source, Replay):
        assert recording is not None
        from_recording(engine, recording, source.speed, frames)
    elif isinstance(recorder, Recorder):
        from_board(engine, source, frames, recorder.take, on_note)
        view = engine.shown.item
        on_note(
            f"{counted(view.frames, 'frame')}, {view.lost} lost, "
            f"{view.skipped} not reconstructed because newer ones had come"
        )
    else:
        assert recorder is not None
        return recorded_from_board(engine, source, recorder, frames)
    return None


@contextmanager
def recorder_of(
    source: Listening | Replay, engine: Engine, out: Path | None = None
) -> Iterator[tuple[Recorder | None, PageActions]]:
    """Yield the recorder of the page's button, or None, and the requests that the page may send."""
    actions = PageActions(engine.tare, lambda: engine.shown.change(acknowledged))
    if isinstance(source, Replay) or out is not None:
        yield None, actions
        return

    def say(*state: Any) -> None:
        engine.show(recording=state)

    def tare() -> None:
        recorder.zero()
        engine.tare()

    engine.show(recording=("", False))
    with closing(Recorder(Path(), source.baseline, say)) as recorder:
        yield recorder, replace(actions, tare=tare, record=recorder.ask)


def chosen(
    name: str | None, config: Path | None, settings: tuple[str, ...] = ()
) -> tuple[str, Estimator]:
    """Return an estimator by its name, the first one by default.

    Raises InputError for an unknown name.

    Returns
    -------
    name : str
    estimator : Estimator
    """
    if config is None:
        known = [*METHODS]
        where = "there are"
    else:
        document = read_document(config, settings)
        run = validated(document, RunFile)
        known = [*run.estimators]
        where = f"{config} has"
    name = name or known[0]
    if name not in known:
        names = ", ".join(known)
        raise InputError(
            f"--estimator: no estimator is called {name!r}; {where} {names}{meant(name, known)}"
        )
    return name, METHODS[name] if config is None else resolve(document, run, name)


def from_board(
    engine: Engine,
    board: Listening,
    frames: int | None,
    on_sample: Callable[[Sample], None],
    on_note: Say = lambda sentence: None,
) -> None:
    """Pass `frames` frames of a board, or all, to the engine and to `on_sample`.

    `on_note` receives how the lines of a board that prints are read.

    Raises InputError as `lampest.apps.board.stream.stream`.
    """
    engine.say(f"waiting for the board at {', '.join(board.ports)}")
    with closing(samples_of(replace(board, on_state=engine.say))) as samples:
        for number, sample in enumerate(islice(chain.from_iterable(samples), frames)):
            if isinstance(sample.hello, Printing) and not number:
                on_note(f"the board prints: {sample.hello.understood}")
            take_sample(engine, sample)
            on_sample(sample)


def recorded_from_board(
    engine: Engine, board: Listening, out: Path, frames: int | None
) -> Recorded:
    """Record frames of a board into `out` and pass them to the engine.

    Raises InputError as `record`.
    """
    engine.say(f"waiting for the board at {', '.join(board.ports)}")

    def on_progress(progress: Progress) -> None:
        if progress.sample is not None:
            take_sample(engine, progress.sample)
        if progress.state:
            engine.say(progress.state)

    return record(board, out, frames=frames, on_progress=on_progress)


def take_sample(engine: Engine, sample: Sample) -> None:
    """Pass a frame of a board to the engine, in the form of a recording."""
    settings = sample.hello
    state = f"receiving; {settings.understood}" if isinstance(settings, Printing) else "receiving"
    source = FrameSource(sample.scene, settings.period, state)
    scan = Scan(
        sample.recorded, None, sample.time, sample.host_time, sample.lost, sample.frame.log_change
    )
    engine.take(source, scan)


def from_recording(
    engine: Engine,
    recording: Recording,
    speed: float,
    frames: int | None,
    wait: Callable[[float], None] = time.sleep,
) -> None:
    """Replay the measured frames of a recording at `speed` times its rate.

    The unloaded frames of the recording are the baseline.
    """
    source = FrameSource(
        recording.scene, frame_period(recording), f"replaying at {speed:g} times its speed"
    )
    unloaded = np.flatnonzero(recording.role == UNLOADED).tolist()
    if unloaded:
        engine.begin(source, [scan_of(recording, frame) for frame in unloaded])
    measured = recording.measured_frames()[:frames].tolist()
    times = recording.time / speed
    began = time.monotonic() - times[measured[0]]
    for frame in measured:
        wait(max(0.0, began + times[frame] - time.monotonic()))
        engine.take(source, scan_of(recording, frame))


def scan_of(recording: Recording, frame: int) -> Scan:
    """Return a frame of a recording as if it arrived now."""
    recorded = recording.recorded
    sigma = recording.sigma
    if sigma is not None:
        sigma = np.broadcast_to(sigma, recorded.shape)[frame]
    lost = 0 if recording.acquisition is None else int(recording.acquisition.lost[frame])
    board = recording.board_log_change
    known = None if board is None or np.isnan(board[frame]).all() else board[frame]
    return Scan(recorded[frame], sigma, float(recording.time[frame]), time.time(), lost, known)
