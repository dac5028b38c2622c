"""Outputs that would write, empty or remove what is not theirs."""

import contextlib
import os
import shutil
import socket
from pathlib import Path

import numpy as np
import pytest
from attack.attack import HELD, Outcomes, Rng, attack, called, drawn, everything, small_folder

from lampest import Recording, Scene, TwoPointReadout, two_point_resistance

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
OVER_INPUTS = (
    ("tare", "small.h5", "--frames", "0:1", "--out"),
    ("export", "results.h5", "--to", "csv", "--out"),
    ("plot", "results.h5", "--out"),
)
# Command that names OUT, and the files that it reads besides what the command line names with a suffix.
TABLES = (
    ("simulate", "simulation.yaml", "--out", "OUT"),
    ("import", "table.csv", "--scene", "scene.yaml", "--out", "OUT"),
    ("tare", "small.h5", "--frames", "0:1", "--out", "OUT"),
    ("compare", "results.h5", "--csv", "OUT"),
    ("compare", "results.h5", "--report", "OUT"),
    ("plot", "results.h5", "--out", "OUT"),
    ("export", "results.h5", "--to", "csv", "--out", "OUT"),
    ("calibrate", "known.h5", "--known", "known.csv", "--out", "OUT"),
    ("calibrate", "known.h5", "--known", "known.npy", "--out", "OUT"),
    ("calibrate", "small.h5", "--loads", "loads.yaml", "--out", "OUT"),
    ("calibrate", "small.h5", "--loads", "loads.csv", "--out", "OUT"),
    ("record", "--scene", "scene.yaml", "--out", "OUT"),
    ("live", "--recording", "small.h5", "--config", "run.yaml", "--out", "OUT"),
)
# Command, and what it would write over: a file of that name that it reads, made of the second.
FOLDERS = (
    (("run", "OUT/results.h5", "--jobs", "1", "--out", "OUT"), "run.yaml"),
    (("run", "own.yaml", "--jobs", "1", "--out", "OUT"), "small.h5", "results.h5"),
    (("run", "own.yaml", "--jobs", "2", "--out", "OUT"), "small.h5", "results.h5"),
    (("study", "weights", "own.yaml", "--out", "OUT"), "small.h5", "tune.h5"),
    (("study", "weights", "OUT/tune.csv", "--out", "OUT"), "weights.yaml"),
    (("detect", "OUT/detections.h5", "--out", "OUT"), "results.h5"),
    (("plot", "OUT/contours_small.png", "--out", "OUT"), "results.h5"),
)
TWICE = (
    ("compare", "results.h5", "--csv", "z", "--report", "z"),
    ("compare", "results.h5", "--csv", "z", "--report", "./z"),
)
FILES = tuple(writer for writer in WRITERS if writer[0] not in ("run", "plot", "detect"))


@attack(18, 18)
def test_empty_and_root_paths_are_refused_as_outputs(rng: Rng, folder: Path, count: int) -> Outcomes:
    made = small_folder(folder / "work")
    for _, (writer, place) in drawn(rng, [(writer, place) for writer in WRITERS for place in ("", "/")], count):
        yield _untouched(made, (*writer, place))


@attack(12, 30)
def test_devices_pipes_sockets_folders_and_links_are_refused_as_outputs(rng: Rng, folder: Path, count: int) -> Outcomes:
    made = _beside_precious(folder, "work")
    os.mkfifo(made / "pipe.h5")
    (made / "folder.h5").mkdir()
    (made / "link.h5").symlink_to(folder / "precious")
    device, kinds = made / "device.h5", ["pipe", "folder", "link", "socket"]
    with socket.socket(socket.AF_UNIX) as server:
        with contextlib.chdir(made):  # the names of sockets are short
            server.bind("socket.h5")
        try:
            os.mknod(device, 0o600 | 0o020000, os.makedev(1, 3))
            kinds.append("device")
        except PermissionError:
            pass
        for _, (writer, kind) in drawn(rng, [(writer, kind) for writer in FILES for kind in kinds], count):
            yield _untouched(made, (*writer, f"{kind}.h5")) or _precious(folder)


@attack(6, 30)
def test_an_input_is_refused_as_the_output(rng: Rng, folder: Path, count: int) -> Outcomes:
    made = _inputs(folder / "work")
    shutil.copy(made / "results.h5", made / "detections.h5")
    tries = [(*writer, way) for writer in (*FILES, *OVER_INPUTS) if writer[0] != "record" for way in ("", "./", "hard")]
    for index, (*writer, way) in drawn(rng, tries, count):
        place = way + writer[1]
        if way == "hard":
            place = f"again{index}{Path(writer[1]).suffix}"
            (made / place).hardlink_to(made / writer[1])
        yield _untouched(made, (*writer, place), "is an input")
    yield _untouched(made, ("detect", "detections.h5"), "is an input")


@attack(6, 100)
def test_every_input_of_every_command_is_refused_as_its_output(rng: Rng, folder: Path, count: int) -> Outcomes:
    tries = [(words, read) for words in TABLES for read in words if "." in read]
    for index, (words, read) in drawn(rng, tries, count):
        made = _inputs(folder / f"work{index}")
        yield _untouched(made, tuple(read if word == "OUT" else word for word in words), read)


@pytest.mark.slow
@attack(3, len(FOLDERS))
def test_inputs_inside_an_output_folder_are_never_overwritten(rng: Rng, folder: Path, count: int) -> Outcomes:
    for index, (words, source, *names) in drawn(rng, FOLDERS, count):
        made = _inputs(folder / f"work{index}")
        (made / "OUT").mkdir()
        name = names[0] if names else Path(next(word for word in words if word.startswith("OUT/"))).name
        shutil.copy(made / source, made / "OUT" / name)
        own = (made / ("weights.yaml" if "weights" in words else "run.yaml")).read_text()
        (made / "own.yaml").write_text(own.replace("small.h5", f"OUT/{name}"))
        for config in ("run", "weights"):
            text = (made / f"{config}.yaml").read_text().replace("small.h5", "../small.h5")
            if source == f"{config}.yaml":
                (made / "OUT" / name).write_text(text)
        before = (made / "OUT" / name).read_bytes()
        ended = called(*words, folder=made)
        kept = (made / "OUT" / name).read_bytes() == before
        fault = ended.survived() if kept else f"{name} is lost"
        yield f"{' '.join(words)}: {fault}" if fault else HELD


@attack()
def test_two_outputs_of_one_name_are_refused(rng: Rng, folder: Path, count: int) -> Outcomes:
    made = small_folder(folder / "work")
    for words in TWICE:
        yield _untouched(made, words, "two outputs")


def _inputs(made: Path) -> Path:
    """A folder with all that commands read."""
    small_folder(made)
    (made / "scene.yaml").write_text("panel: {rows: 3, columns: 4}\n")
    scene = Recording.load(made / "small.h5").scene.panel
    known = np.full(scene.shape, 1000.0)
    np.savetxt(made / "known.csv", known, delimiter=",")
    np.save(made / "known.npy", known)
    read = np.tile(two_point_resistance(known) + 140.0, (9, 1, 1))
    recording = Recording(Scene(scene, TwoPointReadout(), 140.0), read, np.arange(9.0), np.ones(9, dtype=np.uint8))
    recording.save(made / "known.h5")
    (made / "loads.yaml").write_text("schema: 1\nloads: [{frames: [1, 2], pressure_kpa: 5}]\n")
    (made / "loads.csv").write_text("frames,pressure_kpa\n1:2,5\n")
    (made / "weights.yaml").write_text(
        "schema: 1\nrecordings: [small.h5]\nformulation: reduced\n"
        "estimators: {CR: {terms: {misfit: {}, cell_resistance: {weight: auto}}}}\n"
    )
    return made


@attack()
def test_a_lock_that_is_a_link_or_a_pipe_is_refused(rng: Rng, folder: Path, count: int) -> Outcomes:
    for kind in ("link", "pipe"):
        made = _beside_precious(folder, kind)
        (made / "out").mkdir()
        if kind == "link":
            (made / "out" / ".lock").symlink_to(folder / "precious")
        else:
            os.mkfifo(made / "out" / ".lock")
        yield _untouched(made, ("run", "run.yaml", "--jobs", "1", "--out", "out")) or _precious(folder)


@attack()
def test_a_folder_of_cases_that_is_a_link_is_refused(rng: Rng, folder: Path, count: int) -> Outcomes:
    for fresh in ((), ("--fresh",)):
        made, other = small_folder(folder / f"work{len(fresh)}"), folder / "other"
        other.mkdir(exist_ok=True)
        for name in (".theirs.h5.17.part", "theirs.h5"):
            (other / name).write_text("precious")
        (made / "out").mkdir()
        (made / "out" / "cases").symlink_to(other)
        before = everything(other)
        yield _untouched(made, ("run", "run.yaml", "--jobs", "1", "--out", "out", *fresh))
        yield HELD if everything(other) == before else "the other folder is another one"


@attack()
def test_unfinished_files_of_others_are_kept(rng: Rng, folder: Path, count: int) -> Outcomes:
    made = small_folder(folder / "work")
    for place in (made / "out", made / "out" / "cases"):
        place.mkdir()
        (place / ".theirs.h5.17.part").write_text("precious")
    ended = called("run", "run.yaml", "--jobs", "1", "--out", "out", folder=made)
    yield HELD if ended.code == 0 else ended.said("the run failed")
    kept = [path for path in made.rglob(".theirs.h5.17.part") if path.read_text() == "precious"]
    yield HELD if len(kept) == 2 else "an unfinished file of another is gone"


@pytest.mark.slow
@attack()
def test_results_and_pictures_that_are_links_are_refused(rng: Rng, folder: Path, count: int) -> Outcomes:
    made = _beside_precious(folder, "work")
    (made / "out").mkdir()
    (made / "out" / "results.h5").symlink_to(folder / "precious")
    ended = called("run", "run.yaml", "--jobs", "1", "--out", "out", folder=made)
    yield ended.refused("results.h5", "link") or _precious(folder)
    (made / "contours_small.png").symlink_to(folder / "precious")
    yield _untouched(made, ("plot", "results.h5")) or _precious(folder)


@attack()
def test_an_output_of_a_simulation_that_is_a_link_is_refused(rng: Rng, folder: Path, count: int) -> Outcomes:
    made = _beside_precious(folder, "work")
    (made / "simulation.h5").symlink_to(folder / "precious")
    yield _untouched(made, ("simulate", "simulation.yaml")) or _precious(folder)


def _beside_precious(folder: Path, name: str) -> Path:
    (folder / "precious").write_text("precious")
    return small_folder(folder / name)


def _precious(folder: Path) -> str:
    return HELD if (folder / "precious").read_text() == "precious" else "precious is lost"


def _untouched(folder: Path, arguments: tuple[str, ...], *words: str) -> str:
    """HELD where the command refuses in one sentence and leaves the folder as it is; locks that are empty may stay."""
    before = everything(folder)
    ended = called(*arguments, folder=folder)
    after = everything(folder)
    changed = [name for name in before | after if before.get(name) != after.get(name)]
    fault = ended.refused(*words) or ("" if not changed else f"{changed} changed")
    return f"{' '.join(arguments)}: {fault}" if fault else HELD
