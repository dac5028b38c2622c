"""A disk that is full, frozen, fails, or loses the file while a board is recorded."""

import errno
import itertools
import os
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from promises import promise
from wild_board import hundred_a_second, wild_board

from lampest import InputError, Recording
from lampest.apps.board import journal
from lampest.apps.board.record import Progress, record
from lampest.apps.board.recorder import Recorder
from lampest.apps.board.sample import Listening
from lampest.apps.board.stream import board_samples

FRAMES = 100
FROZEN_S = 2.0
FROZEN_CALL = 20  # the write to the disk that takes so long
COMMAND = (sys.executable, "-c", "from lampest.cli import main; main()")
SMALL_DISK = "2000k"
FILLED_UP_TO = 16_384  # bytes that remain: for a part of the rewriting, not for all of it
ROOM = 412_000  # bytes: a journal of 3 × 4 cells reserves 366,000, its first frame takes 45,000


def full_disk(monkeypatch: pytest.MonkeyPatch, is_full: Callable[[], bool], room: int) -> None:
    """Refuse bytes behind the first `room` of every growing file while the disk is full."""
    write: Callable[..., int] = os.pwrite
    allocate: Callable[..., None] = os.posix_fallocate

    def refuse(end: int) -> None:
        if is_full() and end > room:
            raise OSError(errno.ENOSPC, "No space left on device")

    def limited_write(descriptor: int, data: bytes, begin: int) -> int:
        refuse(begin + 1)
        return write(descriptor, data[: room - begin] if is_full() else data, begin)

    def limited_allocate(descriptor: int, begin: int, size: int) -> None:
        refuse(begin + size)
        allocate(descriptor, begin, size)

    monkeypatch.setattr(os, "pwrite", limited_write)
    monkeypatch.setattr(os, "posix_fallocate", limited_allocate)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system of SMALL_DISK, where root may."""
    folder = tmp_path / "disk"
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", f"size={SMALL_DISK}", "tmpfs", str(folder)]
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root may mount a small file system")
    if subprocess.run(words, capture_output=True).returncode != 0:
        pytest.skip("this system allows no mounts")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(disk: Path, remaining: int = 0) -> Path:
    """Fill a file system with a file, but for some bytes; return the file."""
    filler = disk / "filler"
    with filler.open("ab", buffering=0) as handle, suppress(OSError):
        while handle.write(bytes(4096)):
            continue
    os.truncate(filler, filler.stat().st_size - remaining)
    return filler


def recorded(out: Path, frames: int = FRAMES, **options: Any) -> Any:
    with wild_board(hundred_a_second) as board:
        return record(Listening((board.port,), period=0.01), out, frames=frames, **options)


def check_frames(out: Path, frames: int) -> Recording:
    """Whether the file has these first frames, whole and in order."""
    recording = Recording.load(out)
    acquisition = recording.acquisition
    assert acquisition is not None and acquisition.sequence.tolist() == list(range(frames))
    assert np.all(recording.raw_sums == 700) and len(recording.time) == frames
    return recording


def test_a_full_disk_ends_the_command_with_one_sentence_and_whole_frames(tmp_path: Path) -> None:
    """The limit is one of the operating system on a file's size."""
    out = tmp_path / "r.h5"
    with wild_board(hundred_a_second) as board:
        words = ["record", "--port", board.port, "--period", "0.01", "--count", FRAMES]
        completed = subprocess.run(
            [*COMMAND, *map(str, words), "--out", str(out)],
            capture_output=True,
            text=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM)),
        )
    assert completed.returncode == 2 and "Traceback" not in completed.stderr, completed
    waiting = re.search(r"no space: ([\d,]+) frames? kept until \d\d:\d\d:\d\d", completed.stderr)
    assert waiting is not None and 0 < int(waiting[1].replace(",", "")) < FRAMES, completed.stderr
    assert check_frames(out, int(waiting[1].replace(",", ""))).acquisition.event_label == (
        "no space",
    )


@pytest.mark.slow
@promise("apps/board/board: A disk that is full, or fails, costs no frame for 10 s")
def test_frames_wait_for_a_disk_that_is_full_for_a_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted: list[Progress] = []
    full_disk(monkeypatch, lambda: len(counted) < 70, ROOM)
    summary = recorded(tmp_path / "r.h5", on_progress=counted.append)
    assert summary.frames == FRAMES and summary.lost == 0
    recording = check_frames(tmp_path / "r.h5", FRAMES)
    assert recording.acquisition.event_label == ("no space",)
    assert max(progress.frames for progress in counted[:70]) < 60, "absent frames were counted"


@pytest.mark.slow
@pytest.mark.parametrize("call", [9, 40, 171])
def test_a_write_that_fails_once_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: int
) -> None:
    write: Callable[..., int] = os.pwrite
    calls = itertools.count()

    def failing(descriptor: int, data: bytes, begin: int) -> int:
        if next(calls) == call:
            raise OSError(errno.EIO, "Input/output error")
        return write(descriptor, data[: len(data) // 2 + 1], begin)  # short writes besides

    monkeypatch.setattr(os, "pwrite", failing)
    assert recorded(tmp_path / "r.h5").frames == FRAMES
    check_frames(tmp_path / "r.h5", FRAMES)


def test_a_disk_that_is_full_from_the_beginning_gets_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full_disk(monkeypatch, lambda: True, 1000)
    with pytest.raises(InputError, match=r"r\.h5: cannot be made \(No space left on device\)"):
        recorded(tmp_path / "r.h5")
    assert not any(tmp_path.iterdir())


def test_a_small_file_system_keeps_the_frames_that_it_has_room_for(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program fills it before the first frame, and again as the recording goes on."""
    monkeypatch.setattr(journal, "PATIENCE_SECONDS", 0.3)
    fill(small_disk, ROOM)
    counted: list[Progress] = []
    with pytest.raises(InputError, match=r"no space: [\d,]+ frames? kept until"):
        recorded(small_disk / "r.h5", frames=100_000, on_progress=counted.append)
    recording = check_frames(small_disk / "r.h5", counted[-1].frames)
    assert recording.acquisition.event_label == ("no space",)


@pytest.mark.slow
@pytest.mark.parametrize("remaining", [0, FILLED_UP_TO])
@pytest.mark.parametrize("trouble", ["", "the board is gone"])
def test_frames_are_kept_where_their_rewriting_has_no_room(
    small_disk: Path, monkeypatch: pytest.MonkeyPatch, remaining: int, trouble: str
) -> None:
    """Another program fills the file system after the last frame, or after a board's error."""
    out = small_disk / "r.h5"
    rewrite = journal.finished

    def rewrite_without_room(path: Path) -> object:
        fill(small_disk, remaining)
        return rewrite(path)

    def report(progress: Progress) -> None:
        if trouble and progress.frames == FRAMES:
            raise InputError(trouble)

    monkeypatch.setattr("lampest.apps.board.record.finished", rewrite_without_room)
    with pytest.raises(InputError) as caught:
        recorded(out, on_progress=report)
    words = f"{trouble}; the {FRAMES} frames that came before are in" if trouble else "frames kept"
    assert words in str(caught.value)
    assert f"lampest check --repair {out} completes" in str(caught.value)
    assert {path.name for path in small_disk.iterdir()} == {"r.h5", "filler"}
    check_frames(out, FRAMES)
    with pytest.raises(InputError, match=f"{FRAMES} frames kept, but the file cannot be completed"):
        journal.finished(out)
    (small_disk / "filler").unlink()
    assert journal.repair(out) == (FRAMES, 0)
    check_frames(out, FRAMES)


def test_a_removed_file_is_noticed_at_the_next_frame(tmp_path: Path) -> None:
    out = tmp_path / "r.h5"

    def remove(progress: Progress) -> None:
        if progress.frames == 9:
            out.unlink()

    with pytest.raises(InputError, match=r"r\.h5: was removed or renamed .* frames went with it"):
        recorded(out, frames=100_000, on_progress=remove)


def test_the_page_says_that_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sentences: list[str] = []
    full_disk(monkeypatch, lambda: True, ROOM)
    with wild_board(hundred_a_second) as board:
        recorder = Recorder(tmp_path, 1, lambda sentence, running: sentences.append(sentence))
        recorder.ask("r")
        batches = board_samples(board.port, Listening(period=0.01))
        samples = (sample for batch in batches for sample in batch)
        for sample in itertools.islice(samples, FRAMES):
            recorder.take(sample)
        recorder.close()
        samples.close()
    assert re.search(
        r"no space: \d+ frames? kept until .*; it is tried again", "\n".join(sentences)
    )
    ending = re.fullmatch(r"recorded (\d+) frames: .*r\.h5; no space: .*", sentences[-1])
    assert ending is not None, sentences[-1]
    check_frames(tmp_path / "r.h5", int(ending[1].replace(",", "")))


@pytest.mark.slow
def test_a_disk_frozen_for_seconds_costs_no_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames wait in the port meanwhile, as where a network disk's server is busy."""
    append: Callable[..., None] = journal.Journal.append
    calls = itertools.count()

    def stalled(growing: journal.Journal, *arguments: Any) -> None:
        if next(calls) == FROZEN_CALL:
            time.sleep(FROZEN_S)
        append(growing, *arguments)

    monkeypatch.setattr(journal.Journal, "append", stalled)
    summary = recorded(tmp_path / "r.h5", 3 * FRAMES)
    assert (summary.frames, summary.lost) == (3 * FRAMES, 0) and next(calls) > FROZEN_CALL
    check_frames(tmp_path / "r.h5", 3 * FRAMES)
