"""Recordings of what a port delivers, begun and ended at any time while somebody watches it."""

import re
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from threading import Event, Thread

from lampest.files.errors import InputError
from lampest.files.process import deaf
from lampest.panel.scene import Scene
from lampest.recording.board.journal import Journal
from lampest.recording.board.record import appended, finished, journal_of
from lampest.recording.board.stream import Sample

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")  # no dot, no separator: a file of one folder, and no hidden one


class Recorder:
    """Takes every sample from one thread; any other may ask for the next recording's beginning or end.

    The unloaded frames with which a watch began, or the last zero that was asked for, come first in every file.
    folder : of the files. baseline : so many frames are unloaded. say : gets a sentence, and whether a recording runs.
    """

    def __init__(self, folder: Path, scene: Scene | None, baseline: int, say: Callable[[str, bool], None]) -> None:
        self._folder, self._scene, self._say = folder.absolute(), scene, say
        self._baseline, self._unloaded = baseline, deque[Sample](maxlen=baseline)
        self._asked: deque[str] = deque(maxlen=1)
        self._zeroed = Event()
        self._journal: Journal | None = None  # that grows
        self._path, self._open, self._frames = folder, ExitStack(), 0  # of it
        self._finishing: list[Thread] = []

    def ask(self, name: str) -> None:
        """From any thread: begin a recording of that name, '' for the time; or end one that runs. Raises InputError."""
        if name and not NAME.fullmatch(name):
            raise InputError("a recording's name has up to 64 letters, digits, - and _")
        self._asked.append(name)

    def zero(self) -> None:
        """The next frames are unloaded: those of the next recordings, and an event in one that runs."""
        self._zeroed.set()

    def take(self, sample: Sample) -> None:
        """A sample has come; a recording begins once there are unloaded ones."""
        try:
            if self._zeroed.is_set():
                self._zeroed.clear()
                self._unloaded.clear()
                if self._journal is not None:
                    self._journal.mark(sample.time, "zero")
            if len(self._unloaded) < self._baseline:
                self._unloaded.append(sample)
            if self._journal is not None and self._asked:
                self._asked.clear()
                self._end()
            elif self._journal is not None:
                self._grow(self._journal, (sample,), 0)
            elif self._asked and len(self._unloaded) == self._baseline:
                self._begin(self._asked.popleft(), sample)
        except InputError as error:
            self._end(str(error))

    def close(self) -> None:
        """End what runs; every file is closed then, whatever signals come."""
        if self._journal is not None:
            self._end()
        with deaf():
            for thread in self._finishing:
                thread.join()

    def _begin(self, name: str, sample: Sample) -> None:
        self._path, self._frames = self._folder / f"{name or time.strftime('live_%Y-%m-%d_%H-%M-%S')}.h5", 0
        if self._path.exists():
            raise InputError(f"{self._path}: exists already; a recording is never written over")
        self._journal = self._open.enter_context(journal_of(self._path, sample, self._scene))
        self._grow(self._journal, tuple(self._unloaded), self._baseline)
        if sample is not self._unloaded[-1]:
            self._grow(self._journal, (sample,), 0)

    def _grow(self, journal: Journal, samples: tuple[Sample, ...], unloaded: int) -> None:
        appended(journal, samples, self._scene, unloaded)
        self._frames += len(samples)
        self._say(f"recording {self._path}: {self._frames} frames", True)

    def _end(self, trouble: str = "") -> None:
        """Close the journal here, and make a clean file of it beside: frames go on."""
        if self._journal is None:
            self._say(f"not recorded: {trouble}", False)
            return
        path, frames, self._journal = self._path, self._frames, None
        self._open.close()
        self._say(f"closing {path}", False)

        def finish() -> None:
            try:
                finished(path)
                self._say(f"recorded {frames} frames: {path}" + (f"; {trouble}" if trouble else ""), False)
            except InputError as error:
                self._say(f"{error}; lampest check --repair makes a clean file of it", False)

        thread = Thread(target=finish, name="lampest-recorder")
        thread.start()
        self._finishing = [*(one for one in self._finishing if one.is_alive()), thread]
