"""How far a batch's long cases are, as the files of their parts tell it, whichever process or machine solves them."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from lampest.recording.stored import StoredRecording
from lampest.runs.config import Case
from lampest.runs.long_case import PartFiles

EVERY_SECONDS = 1.0
MOST_TOLD = 3  # cases of which a line says how far they are


@dataclass(frozen=True)
class Watched:
    """A long case. begun : s of the monotonic clock when it was first looked at, and the frames that were done then."""

    files: PartFiles
    stored: StoredRecording
    begun: tuple[float, int]

    @classmethod
    def of(cls, case: Case, file: Path) -> "Watched | None":
        """Of a case whose result will be that file; None where it is not run by parts."""
        if case.stored is None:
            return None
        files = PartFiles(case, file.with_suffix(".parts"))
        return cls(files, case.stored, (time.monotonic(), frames_done(files, case.stored)))

    @property
    def under_way(self) -> bool:
        """Whether parts are there, and not yet the result that they become."""
        return self.files.folder.is_dir() and not self.files.folder.with_suffix(".h5").exists()

    @property
    def sentence(self) -> str:
        """'long × one: 45000 of 1000000 frames, 21 min left'."""
        done, (since, before) = frames_done(self.files, self.stored), self.begun
        text = f"{self.files.case.recording} × {self.files.case.name}: {done} of {self.stored.frames} frames"
        if done == self.stored.frames:
            return f"{text}, being put together"
        left = (time.monotonic() - since) * (self.stored.frames - done) / (done - before) if done > before else None
        return text if left is None else f"{text}, {time_in_words(left)} left"


def frames_done(files: PartFiles, stored: StoredRecording) -> int:
    """Frames up to the end of the last part that is whole; one in which no frame is measured has no file."""
    whole = files.whole
    return min(stored.frames, (whole[-1] + 1) * stored.length) if whole else 0


@contextmanager
def watched(cases: Sequence[tuple[Case, Path]], told: Callable[[str], None]) -> Iterator[None]:
    """Within it `told` hears once a second how far the long ones of these cases are, from a thread of its own.

    cases : each with the file that its result will be. Without a long one nothing is watched, and no thread begins.
    """
    long = [each for case, file in cases if (each := Watched.of(case, file))]
    ended = threading.Event()
    thread = threading.Thread(target=_watch, args=(long, told, ended), daemon=True)
    if long:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if long:
            thread.join()


def _watch(cases: Sequence[Watched], told: Callable[[str], None], ended: threading.Event) -> None:
    while not ended.wait(EVERY_SECONDS):
        if sentences := [each.sentence for each in cases if each.under_way]:
            told(_line(sentences))


def _line(sentences: Sequence[str]) -> str:
    more = len(sentences) - MOST_TOLD
    return "; ".join(sentences[:MOST_TOLD]) + (f"; and {more} more" if more > 0 else "")


def time_in_words(seconds: float) -> str:
    """'40 s', '21 min' or '3 h 5 min'."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
