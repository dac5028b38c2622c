"""Recognition of loads in live frames, as in `lampest detect`, in a separate process."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lampest.apps.live.handover import Beside
from lampest.apps.recognition.detect.answer import Detected
from lampest.apps.recognition.detect.detection import HEAD_FRAMES, Known, known_of
from lampest.apps.recognition.image import ImageWatch
from lampest.apps.recognition.watch import Watch
from lampest.files.process import logged_reason
from lampest.inference.prepared import Prepared
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings
from lampest.recording.recording import MEASURED, UNLOADED, Recording

MAX_REMEMBERED = 200  # former attachments that are kept: those of a day with eight visits an hour
# Waiting frames beyond which every second one is dropped: a fit on 32 × 32 cells takes a minute.
MAX_WAITING = 2000
WAITING = "waiting for frames of the unloaded panel"
DIED = "the process that recognises loads has died; restart lampest live"


@dataclass(frozen=True, eq=False)
class Scan:
    """A frame as it arrives.

    Attributes
    ----------
    recorded, sigma : array, shape (rows, columns)
        Ohm or volt, as in `Readings.of`; sigma may be None.
    time : float
        Seconds on the time axis of the recording.
    arrived : float
        Seconds since 1970-01-01 UTC.
    lost : int
        Frames missing before this one.
    board_log_change : array, shape (rows, columns), or None
        ln(r / r unloaded) that the board estimated.
    """

    recorded: Array
    sigma: Array | None
    time: float
    arrived: float
    lost: int = 0
    board_log_change: Array | None = None


Scans = tuple[Scan, ...]


@dataclass(frozen=True, eq=False)
class Unloaded:
    """Frames of the unloaded panel, from which recognition starts again."""

    scene: Scene
    scans: Scans

    def recording(self, loaded: Scans = (), name: str = "") -> Recording:
        """Return these frames, and loaded ones after them, as a recording.

        σ is None unless all frames have it.
        """
        scans = self.scans + loaded
        known = [scan.sigma for scan in scans if scan.sigma is not None]
        sigma = np.stack(known) if len(known) == len(scans) else None
        role = np.repeat([UNLOADED, MEASURED], [len(self.scans), len(loaded)]).astype(np.uint8)
        times = np.arange(float(len(scans))) if loaded else np.array([scan.time for scan in scans])
        recorded = np.stack([scan.recorded for scan in scans])
        return Recording(self.scene, recorded, times, role, sigma, name=name)


# a number requests that so many of the next frames become the new zero
News = Unloaded | Scan | int


@dataclass(frozen=True, eq=False)
class Watched:
    """State of a watched panel.

    Attributes
    ----------
    name : str
        Name of the recording.
    why : str
        Reason why there is no answer after the last frame, or ''.
    scene : Scene or None
        Scene of the last unloaded frames.
    known, watch
        As in `lampest detect`, None if the unloaded frames are unusable.
    times : tuple of float
        Times in s of the last HEAD_FRAMES frames.
    missing : int
        Frames still required for a new zero.
    zero : tuple of Scan
        Frames received for it.
    """

    name: str
    why: str = WAITING
    scene: Scene | None = None
    known: Known | None = None
    watch: Watch | ImageWatch | None = None
    times: tuple[float, ...] = ()
    missing: int = 0
    zero: Scans = ()

    def after(self, news: News) -> "Watched":
        """Return the state after unloaded frames, a frame, or a request for a zero."""
        if isinstance(news, int):
            return replace(self, missing=news, zero=())
        start = self
        try:
            if isinstance(news, Unloaded):
                start = Watched(self.name, "", news.scene, times=self.times)
                return self._begun(start, news)
            if not self.missing:
                # The watch keeps at most MAX_REMEMBERED ended attachments.
                if self.known is None or self.watch is None:
                    return self
                readings = Readings.of(self.known.scene, news.recorded, news.sigma)
                watch = self.watch.push(*self.known.values(readings), news.time)
                ended = [attachment for attachment in watch.attachments if not attachment.present]
                forgotten = ended[:-MAX_REMEMBERED]
                remembered = (each for each in watch.attachments if each not in forgotten)
                watch = replace(watch, attachments=tuple(remembered))
                return replace(
                    self, why="", watch=watch, times=(*self.times[-HEAD_FRAMES:], news.time)
                )
        except (ArithmeticError, ValueError) as error:
            return replace(start, why=logged_reason(error, self.name))
        zeroed = replace(self, missing=self.missing - 1, zero=(*self.zero, news))
        if zeroed.missing or self.scene is None:
            return zeroed
        return zeroed.after(Unloaded(self.scene, zeroed.zero))

    @property
    def detected(self) -> Detected:
        """Answer after the last frame."""
        if self.why or self.known is None or self.watch is None:
            return Detected.unknown(self.name, self.why)
        return self.known.detected(self.watch, self.times)

    def _begun(self, start: "Watched", news: Unloaded) -> "Watched":
        """Return the state `start` with the watch of new unloaded frames.

        Previous attachments have ended.
        """
        known = known_of(Prepared(news.recording(name=self.name)))
        if isinstance(known, Detected):
            return replace(start, why=known.why)
        watch = known.watch()
        end = news.scans[0].time
        closed = tuple(
            replace(attachment, until_s=end) if attachment.present else attachment
            for attachment in (self.watch.attachments if self.watch else ())
        )
        return replace(start, known=known, watch=replace(watch, attachments=closed))


class Desk:
    """Watch of a panel, called in the other process with one batch after the other."""

    def __init__(self, name: str) -> None:
        self._watched = Watched(name)

    def __call__(self, batch: list[News]) -> Detected:
        """Return the answer after a batch of news."""
        for news in batch:
            self._watched = self._watched.after(news)
        return self._watched.detected


def watcher(name: str, on_answer: Callable[[Detected], None]) -> Beside[list[News]]:
    """Return a process that watches lists of news; answers come from a thread of its own."""

    def answered(batch: list[News], answer: Any) -> None:
        if not isinstance(answer, Detected):
            answer = Detected.unknown(name, logged_reason(answer, name))
        on_answer(answer)

    return Beside(
        Desk(name), in_one_batch, answered, lambda: on_answer(Detected.unknown(name, DIED))
    )


def in_one_batch(more: list[News], waiting: list[list[News]]) -> list[list[News]]:
    """Merge waiting news into one batch.

    Beyond MAX_WAITING every second frame is dropped, except the last.
    """
    batch = [*(waiting[0] if waiting else []), *more]
    if len(batch) > MAX_WAITING:
        numbered = enumerate(batch, len(batch) % 2)
        batch = [news for number, news in numbered if number % 2 or not isinstance(news, Scan)]
    return [batch]
