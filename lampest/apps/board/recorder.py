"""Recording on request of the samples of a watched port.

Any thread may start or end a recording while one thread passes the samples.
"""

import contextlib
import re
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

from lampest.apps.board.journal import Journal, finished, journal_for
from lampest.apps.board.sample import Sample
from lampest.files.errors import InputError
from lampest.files.process import deaf

# No dot or separator: a visible file within the folder.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


class Recorder:
    """Recorder on request.

    One thread passes all samples, and any thread may start or end a recording. Every file begins
    with the unloaded frames of the watch, or with those after the last request of `zero`.

    Parameters
    ----------
    folder : Path
        Folder of the files.
    baseline : int
        Number of unloaded frames.
    say : callable
        Called with a sentence, and with whether a recording is running.
    """

    def __init__(self, folder: Path, baseline: int, say: Callable[[str, bool], None]) -> None:
        self._folder = folder.absolute()
        self._say = say
        self._baseline = baseline
        self._unloaded = deque[Sample](maxlen=baseline)
        self._asked: deque[str] = deque(maxlen=1)
        self._zeroed = Event()
        self._journal: Journal | None = None  # that grows
        self._open = contextlib.ExitStack()
        self._path: Path  # of the journal, with its frames
        self._finishing: list[Thread] = []

    def ask(self, name: str) -> None:
        """Start a recording by its name ('': the time), or end a running one, from any thread.

        Raises InputError for an unusable name.
        """
        if name and not NAME.fullmatch(name):
            raise InputError("a recording's name has up to 64 letters, digits, - and _")
        self._asked.append(name)

    def zero(self) -> None:
        """Declare the next frames as unloaded ones of later recordings.

        A running recording has an event instead.
        """
        self._zeroed.set()

    def take(self, sample: Sample) -> None:
        """Process a sample; a requested recording starts once all unloaded frames are known."""
        try:
            if self._zeroed.is_set():
                self._zeroed.clear()
                self._unloaded.clear()
                if self._journal is not None:
                    self._journal.mark(sample.time, "zero")
            if len(self._unloaded) < self._baseline:
                self._unloaded.append(sample)
            if self._journal is not None:
                if self._asked:
                    self._asked.clear()
                    self._end()
                else:
                    self._grow(self._journal, (sample,), 0)
            elif self._asked and len(self._unloaded) == self._baseline:
                name = self._asked.popleft() or time.strftime("live_%Y-%m-%d_%H-%M-%S")
                self._path = self._folder / f"{name}.h5"
                if self._path.exists():
                    raise InputError(
                        f"{self._path}: exists already; a recording is never written over"
                    )
                self._journal = self._open.enter_context(journal_for(sample, self._path))
                self._grow(self._journal, tuple(self._unloaded), self._baseline)
                if sample is not self._unloaded[-1]:
                    self._grow(self._journal, (sample,), 0)
        except InputError as error:
            self._end(str(error))

    def close(self) -> None:
        """End a running recording, and wait until all files are closed.

        Signals do not interrupt the wait.
        """
        if self._journal is not None:
            self._end()
        with deaf():
            for thread in self._finishing:
                thread.join()

    def _grow(self, journal: Journal, samples: tuple[Sample, ...], unloaded: int) -> None:
        """Append samples, and report the progress.

        The first `unloaded` samples are unloaded.
        """
        journal.append(samples, unloaded)
        refused = f"; {journal.trouble}; it is tried again" if journal.pending else ""
        self._tell(f"recording {self._path}: {journal.frames} frames{refused}")

    def _tell(self, sentence: str) -> None:
        """Say a sentence, with whether a recording is running."""
        self._say(sentence, self._journal is not None)

    def _end(self, trouble: str = "") -> None:
        """Close the journal, and rewrite it as a recording in another thread.

        Another thread does it because frames continue to arrive.
        """
        if self._journal is None:
            self._tell(f"not recorded: {trouble}")
            return
        path = self._path
        frames = self._journal.frames
        self._journal = None
        try:
            self._open.close()
        except InputError as error:
            trouble = trouble or str(error)
        self._tell(f"closing {path}")

        def finish() -> None:
            try:
                finished(path)
                done = f"recorded {frames} frames: {path}" + (f"; {trouble}" if trouble else "")
            except InputError as error:
                done = str(error)
            self._tell(done)

        thread = Thread(target=finish, name="lampest-recorder")
        thread.start()
        self._finishing = [*(running for running in self._finishing if running.is_alive()), thread]
