"""Every live frame watched as `lampest detect` watches a recording, in a process of its own: fits wait for nobody."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lampest.estimate.prepared import Prepared
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
from lampest.report.live.handover import Beside

LATEST = 16  # attachments that live remembers, beside those that are there
MOST_WAITING = 2000  # frames; beyond, every second one is left out: a fit on 32 × 32 cells takes a minute
WAITING = "waiting for frames of the unloaded panel"
DIED = "the process that recognises loads has died; restart lampest live"


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


def as_recording(scene: Scene, scans: tuple[Scan, ...], times: Array, role: list[int], name: str = "") -> Recording:
    """Frames as a recording, at these times in s; σ is known where it is of all."""
    known = [scan.sigma for scan in scans if scan.sigma is not None]
    sigma = np.stack(known) if len(known) == len(scans) else None
    recorded = np.stack([scan.recorded for scan in scans])
    return Recording(scene, recorded, times, np.array(role, dtype=np.uint8), sigma, name=name)


@dataclass(frozen=True, eq=False)
class Unloaded:
    """Frames of the unloaded panel, with which watching begins anew."""

    scene: Scene
    scans: tuple[Scan, ...]


News = Unloaded | Scan | int  # the last is the wish that so many frames to come are the new zero


@dataclass(frozen=True, eq=False)
class Watched:
    """A panel while it is watched.

    why : why nothing can be said after the last frame, or ''. scene : that of the last unloaded frames. known, watch :
    as `lampest detect` has them, None where these are of no use. times : s, of the last HEAD frames. missing, zero :
    how many frames of a new zero still have to come, and those that came.
    """

    name: str
    why: str = WAITING
    scene: Scene | None = None
    known: Known | None = None
    watch: Watch | ImageWatch | None = None
    times: tuple[float, ...] = ()
    missing: int = 0
    zero: tuple[Scan, ...] = ()

    def after(self, news: News) -> "Watched":
        """After unloaded frames, one frame, or a wish."""
        try:
            if isinstance(news, int):
                return replace(self, missing=news, zero=())
            if isinstance(news, Unloaded):
                return self._begun(news)
            return self._zeroed(news) if self.missing else self._seen(news)
        except (InputError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            return replace(self, why=told_reason(error, self.name))

    @property
    def detected(self) -> Detected:
        """The answer after the last frame."""
        if self.why or self.known is None or self.watch is None:
            return Detected.unknown(self.name, self.why)
        return self.known.detected(self.watch, frame_rate(self.times))

    def _begun(self, news: Unloaded) -> "Watched":
        """Against unloaded frames; what was attached before has left."""
        times = np.array([scan.time for scan in news.scans])
        known = known_of(Prepared(as_recording(news.scene, news.scans, times, [UNLOADED] * len(times), self.name)))
        here = Watched(self.name, "", news.scene, times=self.times)
        if isinstance(known, Detected):
            return replace(here, why=known.why)
        try:
            watch = known.watch()
        except (ArithmeticError, ValueError) as error:
            return replace(here, why=told_reason(error, self.name))
        before, end = () if self.watch is None else self.watch.attachments, news.scans[0].time
        closed = tuple(replace(one, until_s=end) if one.here else one for one in before)
        return replace(here, known=known, watch=replace(watch, attachments=closed))

    def _zeroed(self, scan: Scan) -> "Watched":
        here = replace(self, missing=self.missing - 1, zero=(*self.zero, scan))
        return here if here.missing or self.scene is None else here._begun(Unloaded(self.scene, here.zero))

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

    def __call__(self, batch: list[News]) -> Detected:
        """The answer after a batch of news."""
        for news in batch:
            self._watched = self._watched.after(news)
        return self._watched.detected


def watcher(name: str, on_answer: Callable[[Detected], None]) -> Beside[list[News]]:
    """What takes lists of news, never waits, and hands its answers on from a thread of its own."""

    def answered(batch: list[News], found: Any) -> None:
        on_answer(found if isinstance(found, Detected) else Detected.unknown(name, told_reason(found, name)))

    return Beside(Desk(name), in_one_batch, answered, lambda: on_answer(Detected.unknown(name, DIED)))


def in_one_batch(more: list[News], waiting: list[list[News]]) -> list[list[News]]:
    """All that waits as one batch; of more than MOST_WAITING every second frame is left out, but the last."""
    batch = [*(waiting[0] if waiting else []), *more]
    if len(batch) > MOST_WAITING:
        odd = len(batch) % 2
        batch = [one for number, one in enumerate(batch, odd) if number % 2 or not isinstance(one, Scan)]
    return [batch]
