"""`lampest live`: frames of a board or a recording, an engine and a server, put together."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

from lampest.cost.terms import CellResistance, Gradient, GradientOfRelativeChange, Misfit, RelativeChange, Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import frame_period
from lampest.files.document import read_document, validated
from lampest.files.errors import InputError, meant
from lampest.loads.tare import Tare
from lampest.panel.scene import Scene
from lampest.recording.board.port import only_port
from lampest.recording.board.record import Progress, Recorded, Recorder, record
from lampest.recording.board.several import samples_of
from lampest.recording.board.stream import Sample, agreed_and_recorded
from lampest.recording.recording import UNLOADED, Recording
from lampest.report.live.engine import Engine, FrameSource
from lampest.report.live.message import acknowledged
from lampest.report.live.publish import publish_at
from lampest.report.live.publish.publish import publishing
from lampest.report.live.server import Asks, address, serving
from lampest.report.live.watcher import Scan
from lampest.runs.config import RunFile, resolve

PENALTIES: dict[str, tuple[Term, ...]] = {
    "smooth": (Gradient(),),
    "LSM": (),
    "changes": (GradientOfRelativeChange(),),
    "cell_resistance": (CellResistance(),),
    "relative_change": (RelativeChange(),),
}
# With weights that the data choose, under other names than the paper's.
METHODS = {name: Estimator((Misfit(), *terms), "reduced", tare=Tare()) for name, terms in PENALTIES.items()}


@dataclass(frozen=True)
class LiveBoard:
    """Live from a board.

    ports : its port or a pyserial URL, of a panel of modules those of all boards; none: the only one that looks like an
    Arduino. scene : what it must fit. baseline : the first so many frames are unloaded. period : s between frames.
    out : a recording to make as well.
    """

    ports: tuple[str, ...] = ()
    scene: Scene | None = None
    baseline: int = 3
    period: float | None = None
    out: Path | None = None


@dataclass(frozen=True)
class Replay:
    """Live from a recording: `speed` times as fast as it was taken; `baseline` as above where no frame is unloaded."""

    path: Path
    speed: float = 1.0
    baseline: int = 3


def live(
    source: LiveBoard | Replay,
    method: str | None = None,
    config: Path | None = None,
    http: str = "127.0.0.1:8137",
    frames: int | None = None,
    token: str | None = None,
    on_url: Callable[[str], None] = lambda url: None,
    settings: tuple[str, ...] = (),
    publish: Sequence[str] = (),
    on_trouble: Callable[[str], None] = lambda sentence: None,
) -> Recorded | None:
    """Reconstruct each frame as it comes and show it in the browser, until `frames` have come or Ctrl-C.

    Parameters
    ----------
    method, config : an estimator of a run's file, the first by default; without a file, one of METHODS.
    http : HOST:PORT to listen at; port 0 for any that is free.
    token : asked of visitors of the page; where others can reach it, one is made up if none is given.
    on_url : gets the page's address once it can be opened, and then where frames are published.
    settings : PATH=VALUE entries that override the file's. publish : where frames go, such as
        'mqtt://localhost:1883/lampest'. on_trouble : gets sentences on what fails there.

    Returns what was recorded, if anything was. Raises InputError where the source, the estimator or the address fail.
    """
    name, estimator = chosen(method, config, settings)
    recording = Recording.load(source.path) if isinstance(source, Replay) else None
    if isinstance(source, LiveBoard) and not source.ports:
        source = replace(source, ports=(only_port(),))
    port = ", ".join(source.ports) if isinstance(source, LiveBoard) else ""
    ways, done = [publish_at(where, token) for where in publish], None
    with (
        Engine(port if recording is None else recording.name, name, estimator, source.baseline, True) as engine,
        publishing(ways, engine.shown, on_trouble) as published,
        recorder_of(source, engine) as (recorder, asks),
        serving(*address(http), engine.shown, token, asks) as server,
    ):
        for where in (server.url, *published):
            on_url(where)
        try:
            if isinstance(source, Replay):
                assert recording is not None
                from_recording(engine, recording, source.speed, frames)
            elif recorder is not None:
                from_board(engine, source, frames, recorder.take)
            else:
                done = recorded_from_board(engine, source, frames)
            engine.finish()
        except InputError as error:
            engine.say(f"stopped: {error}")
            raise
        if isinstance(source, Replay) and frames is None:
            engine.say("the recording has ended")
            Event().wait()
        engine.say("lampest has ended")
        return done


@contextmanager
def recorder_of(source: LiveBoard | Replay, engine: Engine) -> Iterator[tuple[Recorder | None, Asks]]:
    """What the page's button records with, into the working folder, or None; and what the page may ask for."""
    asks = Asks(engine.tare, lambda: engine.shown.change(acknowledged))
    if isinstance(source, Replay) or source.out is not None:
        yield None, asks
        return

    def say(sentence: str, on: bool) -> None:
        engine.show(recording=(sentence, on))

    def tare() -> None:
        recorder.zero()
        engine.tare()

    say("", False)
    with closing(Recorder(Path(), source.scene, source.baseline, say)) as recorder:
        yield recorder, replace(asks, tare=tare, record=recorder.ask)


def chosen(name: str | None, config: Path | None, settings: tuple[str, ...] = ()) -> tuple[str, Estimator]:
    """An estimator and its name; the first where none is named. Raises InputError where there is none of that name."""
    if config is None:
        known, where = tuple(METHODS), "there are"
    else:
        document = read_document(config, settings)
        run: RunFile = validated(document, RunFile)
        known, where = tuple(run.estimators), f"{config} has"
    name = name or known[0]
    if name not in known:
        close = meant(name, known)
        raise InputError(f"--estimator: no estimator is called {name!r}; {where} {', '.join(known)}{close}")
    return name, METHODS[name] if config is None else resolve(document, run, name)


def from_board(engine: Engine, board: LiveBoard, frames: int | None, on_sample: Callable[[Sample], None]) -> None:
    """Every frame of a board, until `frames` have come or for ever; on_sample : given each of them, too.

    Raises InputError as `lampest.recording.board.stream.stream`.
    """
    engine.say(f"waiting for the board at {', '.join(board.ports)}")
    with closing(samples_of(board.ports, board.scene, board.period, engine.say)) as samples:
        for sample in islice((sample for batch in samples for sample in batch), frames):
            take_sample(engine, sample, board.scene)
            on_sample(sample)


def recorded_from_board(engine: Engine, board: LiveBoard, frames: int | None) -> Recorded:
    """The same while every frame goes into the recording `board.out` first. Raises InputError as `record`."""
    assert board.out is not None
    engine.say(f"waiting for the board at {', '.join(board.ports)}")

    def on_progress(progress: Progress) -> None:
        if progress.sample is not None:
            take_sample(engine, progress.sample, board.scene)
        elif progress.state:
            engine.say(progress.state)

    how: dict[str, Any] = {"frames": frames, "baseline": board.baseline, "period": board.period}
    return record(board.ports, board.out, scene=board.scene, on_progress=on_progress, **how)


def take_sample(engine: Engine, sample: Sample, scene: Scene | None) -> None:
    """Hand a board's frame on, as a recording would hold it."""
    agreed, recorded = agreed_and_recorded(sample, scene)
    source = FrameSource(agreed, sample.hello.period_us * 1e-6, "receiving")
    engine.take(source, Scan(recorded, None, sample.time, sample.host_time, sample.lost))


def from_recording(
    engine: Engine, recording: Recording, speed: float, frames: int | None, wait: Callable[[float], None] = time.sleep
) -> None:
    """A recording's measured frames, `speed` times as fast as they were taken; its unloaded frames are the baseline."""
    source = FrameSource(recording.scene, frame_period(recording), f"replaying at {speed:g} times its speed")
    unloaded = [scan_of(recording, int(frame)) for frame in np.flatnonzero(recording.role == UNLOADED)]
    if unloaded:
        engine.begin(source, unloaded)
    measured = recording.measured_frames()[:frames]
    began = time.monotonic() - recording.time[measured[0]] / speed
    for frame in measured:
        wait(max(0.0, began + recording.time[frame] / speed - time.monotonic()))
        engine.take(source, scan_of(recording, int(frame)))


def scan_of(recording: Recording, frame: int) -> Scan:
    """One frame of a recording, as if it arrived now."""
    sigma, recorded, origin = recording.sigma, recording.recorded, recording.acquisition
    of_frame = None if sigma is None else np.broadcast_to(sigma, recorded.shape)[frame]
    lost = 0 if origin is None else int(origin.lost[frame])
    return Scan(recorded[frame], of_frame, float(recording.time[frame]), time.time(), lost)
