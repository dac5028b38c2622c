"""Recordings too long for memory: their parts make one result, killed or not."""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest
from fuzz.batches import content, same
from promises import promise
from unclosed import unclosed_recording

import lampest
from lampest import Array, InputError, Recording, read_results, read_run
from lampest.apps.board.journal import repair
from lampest.estimate.sequence import Parts, asked_frames
from lampest.files import hdf5
from lampest.recording import stored
from lampest.report.info import checked_sentence
from lampest.runs import batch
from lampest.runs import task as tasks
from lampest.runs.batch import run_batch
from lampest.runs.executors import Serial

Command = Callable[..., SimpleNamespace]
SCENE = lampest.Scene(
    lampest.Panel(4, 5), lampest.TwoPointReadout(noise_lsb=0.7), series_resistance_ohm=140.0
)
WITH_FILM = replace(SCENE, film=lampest.Film(0.2, 0.05))
SMALL_SCENE = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout())
UNLOADED = 6
CONVERGED = 1e-9  # relative; parts of a recording are solved from the same starts
MAX_GROWTH = 1.02  # of the peak memory with four times the frames; measured 1.007
RUN = """
schema: 1
recordings: [long.h5]
formulation: reduced
estimators:
  auto:     {terms: {misfit: {weighting: noise}, gradient: {weight: auto}}}
  relative: {terms: {misfit: {weighting: noise}, gradient_of_relative_change: {weight: 1e-3}}}
  scaled:   {formulation: scaled, terms: {misfit: {weighting: noise}, gradient: {weight: 1e-4}}}
"""
# A run of small parts, which prints its peak of memory in kB.
SCRIPT = """
import re, sys
from pathlib import Path
from lampest.recording import stored
from lampest.runs.batch import run_batch
from lampest.runs.config import read_run
from lampest.runs.executors import Serial
stored.MAX_READINGS = stored.PART_READINGS = 20_000
run_batch(read_run(Path(sys.argv[1])), Path(sys.argv[2]), Serial())
print(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
"""


def frames(count: int, scene: lampest.Scene = SCENE) -> Array:
    """Ohm as the divider gives it, of a load that comes and goes."""
    rng = np.random.default_rng(3)
    readout = scene.readout
    shape = scene.panel.shape
    cells = 2000 * np.exp(0.2 * rng.standard_normal(shape)) * np.ones((count, *shape))
    pressed = 0.5 * (1 - np.cos(np.linspace(0, 2 * np.pi, count - UNLOADED)))[:, None, None]
    cells[UNLOADED:, 1:3, 2:4] *= np.exp(-pressed)
    exact = np.asarray(readout.to_recorded(readout.exact_reading(cells), scene))
    sigma = 0.0 if readout.noise_lsb is None else np.asarray(readout.sigma(exact))
    return exact + sigma * rng.standard_normal(exact.shape)


def save(folder: Path, values: Array, scene: lampest.Scene = SCENE, role: Any = None) -> None:
    count = len(values)
    kinds = np.arange(count) >= UNLOADED if role is None else role
    lampest.Recording(scene, values, 0.1 * np.arange(count), kinds.astype(np.uint8)).save(
        folder / "long.h5"
    )


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored, "MAX_READINGS", 600)
    monkeypatch.setattr(stored, "PART_READINGS", 400)


@pytest.mark.slow
def test_parts_give_the_results_of_the_whole_recording(
    tmp_path: Path, lampest: Command, small: None
) -> None:
    """A part without a measured frame, frames that cannot be read and outliers are among them."""
    values = frames(110)
    values[45:75] = np.nan
    values[20, 1, 1] *= 3
    role = (np.arange(110) >= UNLOADED) & ((np.arange(110) < 80) | (np.arange(110) >= 102))
    save(tmp_path, values, role=role)
    (tmp_path / "run.yaml").write_text(RUN)

    def run(name: str) -> SimpleNamespace:
        return lampest("run", tmp_path / "run.yaml", "--out", tmp_path / name, "--jobs", "1")

    completed = run("parts")
    assert (completed.code, completed.err) == (0, "")
    assert [file.suffix for file in (tmp_path / "parts" / "cases").iterdir()] == [".h5"] * 3
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stored, "MAX_READINGS", 10**6)
        run("whole")
    parts, complete = (read_results(tmp_path / name / "results.h5") for name in ("parts", "whole"))
    for actual, expected in zip(parts.cases, complete.cases, strict=True):
        assert actual.case_id == expected.case_id and actual.status == expected.status
        assert np.array_equal(actual.frame, expected.frame) and np.array_equal(
            actual.time, expected.time
        )
        np.testing.assert_allclose(actual.cell_resistance, expected.cell_resistance, rtol=CONVERGED)
        assert actual.cell_resistance_errors is not None or actual.estimator == "scaled"
    assert "0 cases solved, 3 were done before" in run("parts").out
    assert lampest("check", tmp_path / "parts" / "results.h5").code == 0


@pytest.mark.slow
def test_results_of_parts_record_automatic_weights(tmp_path: Path, small: None) -> None:
    save(tmp_path, frames(40))
    recording = stored.StoredRecording.of(tmp_path / "long.h5")
    terms = lampest.Misfit(weighting="noise"), lampest.Gradient()
    for weight in ("auto", 1e-3):
        estimator = lampest.Estimator(
            (terms[0], replace(terms[1], weight=weight)), "reduced", error_bars=False
        )
        parts = Parts.of(recording, estimator, asked_frames(recording)).estimates(
            lambda number: None
        )
        assert {estimates.automatic for _, estimates, _ in parts} == {weight == "auto"}


def test_a_long_recording_has_the_frame_period_of_its_first_part(
    tmp_path: Path, small: None
) -> None:
    time = np.concatenate([0.1 * np.arange(20), 10.0 + 0.7 * np.arange(20)])
    role = (np.arange(40) >= UNLOADED).astype(np.uint8)
    lampest.Recording(SCENE, frames(40), time, role).save(tmp_path / "long.h5")
    recording = stored.StoredRecording.of(tmp_path / "long.h5")
    assert len(recording.blocks) == 2
    parts = Parts.of(
        recording, lampest.Estimator((lampest.Misfit(),), "reduced"), asked_frames(recording)
    )
    assert parts.stream.period == pytest.approx(0.1) and parts.independent


@pytest.mark.slow
@pytest.mark.parametrize("apart", [True, False])
def test_an_ended_run_resumes_after_its_last_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, apart: bool
) -> None:
    """Parts that stand apart are solved in any order; the second of three is damaged."""
    progress: list[tuple[int, int]] = []

    class Backwards(Serial):
        def results(self, function: Any, arguments: Sequence[Any]) -> Any:
            return super().results(function, arguments[::-1])

    monkeypatch.setattr(stored, "MAX_READINGS", 100)
    monkeypatch.setattr(stored, "PART_READINGS", 96)
    save(tmp_path, frames(48, SMALL_SCENE), SMALL_SCENE)
    penalty = "gradient" if apart else "gradient_of_relative_change"
    entry = f"{{formulation: reduced, terms: {{misfit: {{}}, {penalty}: {{weight: 1e-3}}}}}}"
    (tmp_path / "run.yaml").write_text(
        f"schema: 1\nrecordings: [long.h5]\nestimators: {{one: {entry}}}\n"
    )
    run = read_run(tmp_path / "run.yaml")
    assert (
        run_batch(
            run,
            tmp_path / "whole",
            Backwards(),
            on_frames=lambda *frames, left_s: progress.append(frames),
        ).done
        == 1
    )
    assert progress[-1] == (48, 48) and progress == sorted(progress)
    write = tasks.write_carried
    written = list[str]()

    def counted(path: Path, carried: Any) -> None:
        if len(written) == 2:
            raise KeyboardInterrupt
        written.append(path.name)
        write(path, carried)

    monkeypatch.setattr(tasks, "write_carried", counted)
    with pytest.raises(KeyboardInterrupt):
        run_batch(run, tmp_path / "ended", Serial())
    task = tasks.Task(run.cases[0], tmp_path / "ended")
    assert written == ["000000_carried.h5", "000001_carried.h5"]
    assert (task.whole_parts, task.frames_done) == ([0, 1], 32)
    assert tasks.parts_to_solve(task) == ([2] if apart else [])
    task.carried(1).write_bytes(b"damaged")
    assert task.carried_over(0) is not None and task.carried_over(1) is None
    del written[:]
    monkeypatch.setattr(batch, "parts_to_solve", lambda task: [])
    monkeypatch.setattr(
        tasks,
        "write_carried",
        lambda path, carried: (written.append(path.name), write(path, carried)),
    )
    assert run_batch(run, tmp_path / "ended", Serial()).done == 1
    assert written == ["000001_carried.h5", "000002_carried.h5"]
    assert task.frames_done == 48 and not list(tmp_path.rglob("*.parts"))
    same(*(content(tmp_path / name / "results.h5") for name in ("whole", "ended")))


@pytest.mark.parametrize("fresh", [False, True])
def test_a_parts_folder_that_links_elsewhere_is_left_unchanged(
    tmp_path: Path, small: None, fresh: bool
) -> None:
    save(tmp_path, frames(40))
    (tmp_path / "run.yaml").write_text(RUN.split("  relative:")[0])
    run = read_run(tmp_path / "run.yaml")
    cases = tmp_path / "out" / "cases"
    elsewhere = tmp_path / "elsewhere"
    for folder in (cases, elsewhere):
        folder.mkdir(parents=True)
    (elsewhere / "000000.h5").write_text("mine")
    (cases / f"{run.cases[0].case_id}.parts").symlink_to(elsewhere)
    with pytest.raises(InputError, match="is a link that leads out"):
        run_batch(run, tmp_path / "out", Serial(), fresh=fresh)
    assert [file.read_text() for file in elsewhere.iterdir()] == ["mine"]


@promise("howto/batches: Memory does not grow with the number of frames")
@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="the system tells no peak of a process alone"
)
def test_memory_is_independent_of_the_number_of_frames(tmp_path: Path) -> None:
    """The 25 maps of the longer recording alone would be 48 MB."""
    scene = lampest.Scene(
        lampest.Panel(10, 10), lampest.TwoPointReadout(noise_lsb=0.7), series_resistance_ohm=140.0
    )
    run = (
        "schema: 1\nrecordings: [long.h5]\nformulation: naive\nestimators: {one: {terms: "
        "{misfit: {}}}}\n"
    )
    peaks = []
    for count in (600, 2400):
        (folder := tmp_path / str(count)).mkdir()
        save(folder, frames(count, scene), scene)
        (folder / "run.yaml").write_text(run)
        # Parts of 200 frames.
        words = [sys.executable, "-c", SCRIPT, str(folder / "run.yaml"), str(folder / "out")]
        completed = subprocess.run(words, capture_output=True, text=True, check=True)
        peaks.append(int(completed.stdout))
    assert peaks[1] < MAX_GROWTH * peaks[0]


def test_methods_that_need_all_frames_refuse_long_recordings(
    tmp_path: Path, lampest: Command, small: None
) -> None:
    robust = "misfit: {weighting: noise, loss: {kind: student, corner: 4}}"
    for entry, words, scene in (
        (f"{{formulation: smoother, terms: {{{robust}}}}}", "all frames together", SCENE),
        ("{tare: {}, terms: {misfit: {weighting: noise}}}", "zero is followed", SCENE),
        ("{terms: {misfit: {weighting: noise}}}", "film: what it remembers is followed", WITH_FILM),
    ):
        save(tmp_path, frames(40), scene)
        (tmp_path / "run.yaml").write_text(
            f"schema: 1\nrecordings: [long.h5]\nestimators:\n  one: {entry}\n"
        )
        completed = lampest("run", tmp_path / "run.yaml", "--out", tmp_path / "out", "--jobs", "1")
        assert (
            completed.code == 2
            and words in completed.err
            and "40 frames of 20 cells" in completed.err
        )
        assert not os.path.lexists(tmp_path / "out")


@pytest.mark.slow
def test_a_part_of_the_frames_is_read_alone(tmp_path: Path, lampest: Command) -> None:
    save(tmp_path, frames(30))
    (tmp_path / "run.yaml").write_text(RUN)
    assert lampest("run", tmp_path / "run.yaml", "--out", tmp_path / "out", "--jobs", "1").code == 0
    complete, part = (
        read_results(tmp_path / "out" / "results.h5", frames=of) for of in (None, range(11, 15))
    )
    for actual, expected in zip(part.cases, complete.cases, strict=True):
        assert np.array_equal(actual.cell_resistance, expected.cell_resistance[5:9])
        assert actual.status == expected.status[5:9]
        assert np.array_equal(actual.weights["misfit"], expected.weights["misfit"][5:9])
    recording, excerpt = (
        Recording.load(tmp_path / "long.h5", of) for of in (slice(None), slice(5, 9))
    )
    assert np.array_equal(excerpt.recorded, recording.recorded[5:9])
    assert excerpt.number is not None and list(excerpt.number) == [5, 6, 7, 8]


@pytest.mark.slow
def test_a_long_recording_is_closed_by_parts(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    for name in ("whole", "parts"):
        # Its σ is that of all their pairs.
        unclosed_recording(tmp_path / f"{name}.h5", SCENE, 50, unloaded=45)
        (tmp_path / "growing.h5").unlink()
    assert repair(tmp_path / "whole.h5") == (50, 0)
    request.getfixturevalue("small")
    assert repair(tmp_path / "parts.h5") == repair(tmp_path / "parts.h5") == (50, 0)
    same(*(content(tmp_path / f"{name}.h5") for name in ("whole", "parts")), 1e-12)
    with h5py.File(tmp_path / "whole.h5") as whole, h5py.File(tmp_path / "parts.h5") as parts:
        assert dict(whole.attrs) == dict(parts.attrs)
    assert checked_sentence(tmp_path / "parts.h5").count("agree with their checksums") == 1
    assert sorted(file.name for file in tmp_path.iterdir()) == ["parts.h5", "whole.h5"]


def test_parts_end_with_a_chunk_of_measured_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hdf5, "CHUNK", 4 * SCENE.panel.crossings)
    monkeypatch.setattr(stored, "PART_READINGS", 400)
    save(tmp_path, frames(97))
    long = stored.StoredRecording.of(tmp_path / "long.h5")
    ends = [block.stop for block in long.blocks]
    assert ends == [18, 38, 58, 78, 97] and long.blocks[-1].start == 78
    parts = [stored.measured_part(long, block, 0) for block in long.blocks]
    stored.save_parts(tmp_path / "joined.h5", [part for part in parts if part is not None])
    joined = Recording.load(tmp_path / "joined.h5")
    assert np.array_equal(joined.recorded, Recording.load(tmp_path / "long.h5").recorded[UNLOADED:])
    assert checked_sentence(tmp_path / "joined.h5").count("agree with their checksums") == 1


def test_a_check_refuses_files_of_other_programs_without_checksums(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "readings.h5", "w") as file:
        file["readings"] = np.full((3, 2, 2), 1e3)
    with pytest.raises(InputError, match=r"readings.h5: /entry/scene is missing"):
        checked_sentence(tmp_path / "readings.h5")


def test_commands_that_load_a_whole_recording_check_its_memory(
    tmp_path: Path, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    save(tmp_path, frames(2000))
    monkeypatch.setattr("lampest.recording.stored.MAX_READINGS", 600)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LAMPEST_MEMORY", "1000000")
    refusal = (
        "2000 frames of 20 cells at once: 1.83 MiB of memory are needed, and there are 977 KiB"
    )
    for command in (
        ("live", "--recording", "long.h5", "--estimator", "LSM"),
        ("tare", "long.h5", "--frames", "0:5", "--out", "tared.h5"),
    ):
        completed = lampest(*command)
        assert completed.code == 2 and f"long.h5: {refusal}" in completed.err
    assert not (tmp_path / "tared.h5").exists()
