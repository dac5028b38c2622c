"""Every live frame watched as `lampest detect` watches a recording, in a process of its own: fits wait for nobody."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Condition, Thread
from typing import Any

import numpy as np

from lampest.files.errors import InputError
from lampest.files.process import told_reason
from lampest.loads.recognition.image import ImageWatch
from lampest.loads.recognition.watch import Watch
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.recording.recording import UNLOADED, Recording
from lampest.report.detect.answer import Detected
from lampest.report.detect.detection import HEAD, Known, frame_rate, known_of
from lampest.report.live.handover import politely
from lampest.runs.executors import Worker

LATEST = 16  # attachments that live remembers, beside those that are there
MOST_WAITING = 2000  # frames; beyond, every second one is left out: a fit on 32 × 32 cells takes a minute
WAITING = "it waits for the unloaded panel"
DIED = "the process that recognises loads has died; begin lampest live again"


@dataclass(frozen=True, eq=False)
class Scan:
    """One frame as it arrives.

    recorded, sigma : (rows, columns) ohm or volt, as `Readings.of` takes them; σ may be None.
    time : s, on the recording's axis. arrived : s since 1970-01-01 UTC. lost : frames missing before this one.
    """

    recorded: Array
    sigma: Array | None
    time: float
    arrived: float
    lost: int = 0


@dataclass(frozen=True, eq=False)
class Unloaded:
    """Frames of the unloaded panel, with which watching begins anew."""

    scene: Scene
    scans: tuple[Scan, ...]


@dataclass(frozen=True, eq=False)
class Watched:
    """A panel while it is watched.

    why : why nothing can be said after the last frame, or ''. known, watch : as `lampest detect` has them, None without
    unloaded frames. times : s, of the last HEAD frames. missing, zero : how many frames of a new zero still have to
    come, and those that came.
    """

    name: str
    why: str = WAITING
    known: Known | None = None
    watch: Watch | ImageWatch | None = None
    times: tuple[float, ...] = ()
    missing: int = 0
    zero: tuple[Scan, ...] = ()

    def after(self, news: "Unloaded | Scan | int") -> "Watched":
        """After unloaded frames, one frame, or the wish that so many to come are the new zero."""
        try:
            if isinstance(news, int):
                return replace(self, missing=news, zero=())
            if isinstance(news, Unloaded):
                return self._begun(news.scene, news.scans)
            return self._zeroed(news) if self.missing else self._seen(news)
        except (InputError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            return replace(self, why=told_reason(error, self.name))

    @property
    def detected(self) -> Detected:
        """The answer after the last frame."""
        if self.why or self.known is None or self.watch is None:
            return Detected.unknown(self.name, self.why)
        return self.known.detected(self.watch, frame_rate(self.times))

    def _begun(self, scene: Scene, scans: tuple[Scan, ...]) -> "Watched":
        """Against unloaded frames; what was attached before has left."""
        sigmas = [scan.sigma for scan in scans if scan.sigma is not None]
        sigma = np.stack(sigmas) if len(sigmas) == len(scans) else None
        recorded, times = np.stack([scan.recorded for scan in scans]), np.array([scan.time for scan in scans])
        role = np.full(len(scans), UNLOADED, dtype=np.uint8)
        known = known_of(Recording(scene, recorded, times, role, sigma, name=self.name))
        if isinstance(known, Detected):
            return replace(self, why=known.why, known=None, watch=None, missing=0)
        before = () if self.watch is None else self.watch.attachments
        closed = tuple(replace(one, until_s=scans[0].time) if one.here else one for one in before)
        watch = replace(known.watch(), attachments=closed)
        return Watched(self.name, "", known, watch, self.times)

    def _zeroed(self, scan: Scan) -> "Watched":
        here = replace(self, missing=self.missing - 1, zero=(*self.zero, scan))
        return here if here.missing or self.known is None else here._begun(self.known.scene, here.zero)

    def _seen(self, scan: Scan) -> "Watched":
        if self.known is None or self.watch is None:
            return self
        readings = Readings.of(self.known.scene, scan.recorded, scan.sigma)
        watch = self.watch.push(*self.known.values(readings), scan.time)
        ended = [one for one in watch.attachments if not one.here][-LATEST:]
        watch = replace(watch, attachments=tuple(one for one in watch.attachments if one.here or one in ended))
        return replace(self, why="", watch=watch, times=(*self.times[-HEAD:], scan.time))


class Desk:
    """Where a panel is watched: in the other process, batch after batch."""

    def __init__(self, name: str) -> None:
        self._watched = Watched(name)

    def __call__(self, batch: "list[Unloaded | Scan | int]") -> Detected:
        """The answer after a batch of news."""
        politely()
        for news in batch:
            self._watched = self._watched.after(news)
        return self._watched.detected


class Watcher:
    """Hands all news to a desk, in their order, and its answers on. What comes while it is at work waits.

    on_answer : gets every answer, from a thread of its own.
    """

    def __init__(self, name: str, on_answer: Callable[[Detected], None]) -> None:
        self._name, self._on_answer = name, on_answer
        self._changed = Condition()
        self._waiting: list[Any] = []
        self._ending = False
        self._worker: Worker | None = None
        self._thread = Thread(target=self._serve, name="lampest-watch", daemon=True)
        self._thread.start()

    def take(self, news: "Unloaded | Scan | int") -> None:
        """Never waits."""
        with self._changed:
            self._waiting.append(news)
            if len(self._waiting) > MOST_WAITING:
                odd = len(self._waiting) % 2
                few = enumerate(self._waiting, odd)
                self._waiting = [one for number, one in few if number % 2 or not isinstance(one, Scan)]
            self._changed.notify_all()

    def finish(self) -> None:
        """Wait for the answer to all that came."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()
        self._thread.join()

    def close(self) -> None:
        """Drop what waits."""
        with self._changed:
            self._waiting, worker = [], self._worker
        if worker is not None:
            worker.process.kill()
        self.finish()

    def _serve(self) -> None:
        worker = Worker.start(Desk(self._name))
        with self._changed:
            self._worker = worker
        try:
            while batch := self._next():
                worker.send(batch)
                found = worker.connection.recv()
                known = isinstance(found, Detected)
                self._on_answer(found if known else Detected.unknown(self._name, told_reason(found, self._name)))
        except (EOFError, OSError):
            self._on_answer(Detected.unknown(self._name, DIED))
        finally:
            worker.kill()

    def _next(self) -> list[Any]:
        """All that came; nothing once nothing more will."""
        with self._changed:
            self._changed.wait_for(lambda: self._ending or bool(self._waiting))
            batch, self._waiting = self._waiting, []
            return batch
