"""Exit code 2 leaves nothing behind, leftovers of killed writers go, and odd arguments end in a sentence."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support import invented_case

from lampest import InputError, Recording, export_results, read_scene, write_results
from lampest.files.whole import sparing, write_whole
from lampest.studies.study import Row, Study

Command = Callable[..., SimpleNamespace]


def one_row(found: object) -> list[Row]:
    return [Row(value=1.0)]


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["detections.h5", "timeline_small.png"])
def test_detect_whose_input_bears_an_outputs_name_writes_nothing(
    disk: SimpleNamespace, lampest: Command, name: str
) -> None:
    taken = disk.folder / name
    shutil.copyfile(disk.folder / "small.h5", taken)
    if name.endswith(".h5"):
        words = (taken,)
    else:
        (disk.folder / "small.h5").unlink()
        taken.rename(disk.folder / "small.h5")
        (disk.folder / name).symlink_to(disk.folder / "small.h5")
        words = (disk.folder / "small.h5",)
    before = names(disk.folder)
    done = lampest("detect", *words, "--out", disk.folder)
    assert (done.code, names(disk.folder)) == (2, before), done.err


def test_a_study_whose_input_bears_an_outputs_name_writes_nothing(tmp_path: Path) -> None:
    taken = tmp_path / "own.h5"
    taken.write_bytes(b"")
    study: Study[Any, Any] = Study("own", "things", "x.yaml", lambda *_: 0, lambda *_: 0, one_row, form="own/1")
    with sparing((taken,)), pytest.raises(InputError, match="is an input"):
        study.run(tmp_path / "x.yaml", tmp_path, (), lambda *_: None)
    assert names(tmp_path) == {"own.h5"}


@pytest.mark.parametrize("text", [None, 3, b"r.h5"])
def test_a_recording_is_loaded_from_a_path(text: Any) -> None:
    with pytest.raises(InputError, match="path"):
        Recording.load(text)


def test_a_recording_is_saved_under_a_name(disk: SimpleNamespace) -> None:
    with pytest.raises(InputError, match="names no file that could be written"):
        Recording.load(disk.folder / "small.h5").save("")


def test_a_scene_with_a_zero_byte_in_its_name_is_no_file() -> None:
    with pytest.raises(InputError, match="no such file"):
        read_scene("\0")


KILLED = """
import os, signal, sys
from pathlib import Path
from lampest.files.whole import whole_file
with whole_file(Path(sys.argv[1])) as unfinished:
    unfinished.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_writer_left_goes_with_the_next_export(tmp_path: Path) -> None:
    write_results(tmp_path / "r.h5", [invented_case("LSM", "mouth", (2, 3, 4))])
    assert subprocess.run([sys.executable, "-c", KILLED, tmp_path / "r.mat"], check=False).returncode == -9
    assert len([name for name in names(tmp_path) if name.endswith(".part")]) == 1
    foreign = tmp_path / ".r.mat.99999999-zzzz0000.part"  # of another computer
    foreign.touch()
    export_results(tmp_path / "r.h5", "mat")
    assert names(tmp_path) == {"r.h5", "r.mat", foreign.name}
    write_whole(tmp_path / "other.txt", "x")
    assert foreign.exists()


@pytest.mark.parametrize("appended", [b"\0", b"x" * 1000, None])
def test_bytes_behind_the_end_are_not_as_written(
    disk: SimpleNamespace, lampest: Command, appended: bytes | None
) -> None:
    path = disk.folder / "sealed.h5"
    Recording.load(disk.folder / "small.h5").save(path)
    assert lampest("check", path).code == 0
    with path.open("ab") as file:
        file.write(path.read_bytes() if appended is None else appended)
    done = lampest("check", path)
    assert done.code == 2 and "behind the end of the file as it was written" in done.err
