"""Outputs that would write, empty or remove files of others."""

import contextlib
import os
import shutil
import socket
from pathlib import Path

import numpy as np
import pytest
from attack.attack import PASSED, Outcomes, Rng, attack, called, drawn, everything, small_folder

from lampest import Recording, Scene, TwoPointReadout, two_point_resistance
from lampest.apps.board.journal import Journal

WRITERS: tuple[tuple[str, ...], ...] = (
    ("run", "run.yaml", "--jobs", "1", "--out"),
    ("simulate", "simulation.yaml", "--out"),
    ("import", "table.csv", "--rows", "3", "--columns", "4", "--out"),
    ("compare", "results.h5", "--csv"),
    ("compare", "results.h5", "--report"),
    ("plot", "results.h5", "--out"),
    ("detect", "results.h5", "--out"),
    ("calibrate", "known.h5", "--known", "1000", "--out"),
    ("record", "--port", "loop://", "--count", "1", "--out"),
)
# A command, and the inputs that it reads from files; the output is named last.
INPUTS = (
    *(writer for writer in WRITERS if writer[0] not in ("run", "detect", "record")),
    ("tare", "small.h5", "--frames", "0:1", "--out"),
    ("export", "results.h5", "--to", "csv", "--out"),
    ("import", "table.csv", "--scene", "scene.yaml", "--out"),
    ("calibrate", "known.h5", "--known", "known.csv", "--out"),
    ("calibrate", "known.h5", "--known", "known.npy", "--out"),
    ("calibrate", "small.h5", "--loads", "loads.yaml", "--out"),
    ("calibrate", "small.h5", "--loads", "loads.csv", "--out"),
    ("record", "--scene", "scene.yaml", "--out"),
    ("live", "--recording", "small.h5", "--config", "run.yaml", "--out"),
)
FILES = tuple(writer for writer in WRITERS if writer[0] not in ("run", "plot", "detect"))


@attack(18, 18)
def test_empty_and_root_paths_are_refused_as_outputs(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    work_folder = small_folder(folder / "work")
    for _, (writer, place) in drawn(
        rng, [(writer, place) for writer in WRITERS for place in ("", "/")], count
    ):
        yield _untouched(work_folder, (*writer, place))


@pytest.mark.slow
@attack(12, 30)
def test_devices_pipes_sockets_folders_and_links_are_refused_as_outputs(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    work_folder = _beside_precious(folder, "work")
    kinds = ["pipe", "folder", "link", "socket"]
    os.mkfifo(work_folder / "pipe.h5")
    (work_folder / "folder.h5").mkdir()
    (work_folder / "link.h5").symlink_to(folder / "precious")
    with socket.socket(socket.AF_UNIX) as server:
        with contextlib.chdir(work_folder):  # the names of sockets are short
            server.bind("socket.h5")
        with contextlib.suppress(PermissionError):
            os.mknod(work_folder / "device.h5", 0o600 | 0o020000, os.makedev(1, 3))
            kinds.append("device")
        for _, (writer, kind) in drawn(
            rng, [(writer, kind) for writer in FILES for kind in kinds], count
        ):
            yield _untouched(work_folder, (*writer, f"{kind}.h5")) or _precious(folder)


@pytest.mark.slow
@attack(12, 100)
def test_every_input_of_every_command_is_refused_as_its_output(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    cases = [
        (words, read, prefix)
        for words in INPUTS
        for read in words
        if "." in read
        for prefix in ("", "./", "hard")
    ]
    for index, (words, read, prefix) in drawn(rng, cases, count):
        work_folder = _inputs(folder / f"work{index}")
        place = prefix + read
        if prefix == "hard":
            (work_folder / place).hardlink_to(work_folder / read)
        yield _untouched(work_folder, (*words, place), read)
    work_folder = _inputs(folder / "detected")
    shutil.copy(work_folder / "results.h5", work_folder / "detections.h5")
    yield _untouched(work_folder, ("detect", "detections.h5"), "is an input")
    for place in ("z", "./z"):
        yield _untouched(
            work_folder, ("compare", "results.h5", "--csv", "z", "--report", place), "two outputs"
        )


def _inputs(work_folder: Path) -> Path:
    """A folder with all inputs of the commands."""
    small_folder(work_folder)
    (work_folder / "scene.yaml").write_text("panel: {rows: 3, columns: 4}\n")
    scene = Recording.load(work_folder / "small.h5").scene.panel
    known = np.full(scene.shape, 1000.0)
    np.savetxt(work_folder / "known.csv", known, delimiter=",")
    np.save(work_folder / "known.npy", known)
    read = np.tile(two_point_resistance(known) + 140.0, (9, 1, 1))
    recording = Recording(
        Scene(scene, TwoPointReadout(), 140.0), read, np.arange(9.0), np.ones(9, dtype=np.uint8)
    )
    recording.save(work_folder / "known.h5")
    (work_folder / "loads.yaml").write_text(
        "schema: 1\nloads: [{frames: [1, 2], pressure_kpa: 5}]\n"
    )
    (work_folder / "loads.csv").write_text("frames,pressure_kpa\n1:2,5\n")
    estimators = "estimators: {CR: {terms: {misfit: {}, cell_resistance: {weight: auto}}}}\n"
    (work_folder / "weights.yaml").write_text(
        f"schema: 1\nrecordings: [small.h5]\nformulation: reduced\n{estimators}"
    )
    return work_folder


@pytest.mark.slow
@attack()
def test_outputs_replaced_by_links_or_pipes_are_refused_and_foreign_files_survive(
    rng: Rng, folder: Path, count: int
) -> Outcomes:
    run = ("run", "run.yaml", "--jobs", "1", "--out", "out")
    for number, (place, commands) in enumerate(
        {
            "out/.lock": (run,),
            "out/results.h5": (run,),
            "simulation.h5": (("simulate", "simulation.yaml"),),
            "contours_small.png": (("plot", "results.h5"),),
        }.items()
    ):
        work_folder = _beside_precious(folder, f"work{number}")
        (work_folder / "out").mkdir()
        (work_folder / place).symlink_to(folder / "precious")
        for words in commands:
            yield called(*words, folder=work_folder).refused(Path(place).name) or _precious(folder)
    work_folder = small_folder(folder / "work")
    foreign = folder / "foreign"
    foreign.mkdir()
    for place in (work_folder / "out", foreign):
        place.mkdir(exist_ok=True)
        (place / ".theirs.h5.17.part").write_text("precious")
    (work_folder / "out" / "cases").symlink_to(foreign)
    for fresh in ((), ("--fresh",)):
        yield _untouched(work_folder, (*run, *fresh))
    (work_folder / "out" / "cases").unlink()
    completed = called(*run, folder=work_folder)
    yield PASSED if completed.code == 0 else completed.described("the run failed")
    untouched = [
        path for path in folder.rglob(".theirs.h5.17.part") if path.read_text() == "precious"
    ]
    yield PASSED if len(untouched) == 2 else "an unfinished file of another is gone"
    (work_folder / "out" / ".lock").unlink(missing_ok=True)
    os.mkfifo(work_folder / "out" / ".lock")
    yield _untouched(work_folder, run)


def _beside_precious(folder: Path, name: str) -> Path:
    (folder / "precious").write_text("precious")
    return small_folder(folder / name)


def _precious(folder: Path) -> str:
    return PASSED if (folder / "precious").read_text() == "precious" else "precious is lost"


def _untouched(folder: Path, arguments: tuple[str, ...], *words: str) -> str:
    """Return PASSED where the command refuses in one sentence and leaves the folder as it is."""
    original = everything(folder)
    completed = called(*arguments, folder=folder)
    current = everything(folder)
    changed = [name for name in original | current if original.get(name) != current.get(name)]
    fault = completed.refused(*words) or (f"{changed} changed" if changed else "")
    return f"{' '.join(arguments)}: {fault}" if fault else PASSED


def test_the_folder_of_a_new_file_is_synced_after_renaming(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A power failure leaves only the synced files and journals of a folder."""
    synced = list[bool]()
    sync = os.fsync

    def noted(descriptor: int) -> None:
        if os.path.samestat(os.fstat(descriptor), tmp_path.stat()):
            synced.append((tmp_path / "a.h5").exists())
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    small_folder(tmp_path)
    synced.clear()
    (tmp_path / "small.h5").rename(tmp_path / "b.h5")
    recording = Recording.load(tmp_path / "b.h5")
    recording.save(tmp_path / "a.h5")
    assert synced == [True]
    (tmp_path / "a.h5").unlink()
    with Journal.create(tmp_path / "a.h5", recording.scene, 1):
        assert synced == [True, True]
