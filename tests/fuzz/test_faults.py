"""Recordings that go or change during a run, and runs that are killed."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from fuzz.batches import batch, finished, killed_again_and_again, without_progress, write_recording
from support import until

from lampest import Recording, read_results


@pytest.mark.slow
@pytest.mark.parametrize("replaced", [False, True])
def test_a_recording_lost_or_changed_during_a_run_costs_only_its_own_cases(
    tmp_path: Path, replaced: bool
) -> None:
    """Cases of a deleted recording fail with a sentence each."""
    cases = batch(tmp_path, 12)
    out = tmp_path / "out"
    previous = Recording.load(tmp_path / "two.h5").readings().value[1:]
    run = cases.start(out, 1)
    until(lambda: finished(out) >= 2 or run.poll() is not None)
    assert run.poll() is None
    if replaced:
        write_recording(tmp_path / "new.h5", 12, 99)
        (tmp_path / "new.h5").replace(tmp_path / "two.h5")
    else:
        (tmp_path / "two.h5").unlink()
    _, stderr = run.communicate(timeout=120)
    assert "Traceback" not in stderr
    results = read_results(out / "results.h5").cases
    half = cases.count // 2
    assert [case.recording for case in results][:half] == ["one"] * half
    assert all(np.array_equal(case.measured, previous) for case in results[half:])
    if not replaced:
        lines = without_progress(stderr)
        assert run.returncode == 3 and len(lines) == half == len(results)
        assert all(line.startswith("lampest: two × ") and "two.h5" in line for line in lines)


@pytest.mark.parametrize(
    ("frames", "weights", "kills"),
    [
        pytest.param(2, (1e-4,), 2, marks=pytest.mark.slow),
        pytest.param(8, (1e-4, 1e-3, 1e-2), 50, marks=pytest.mark.soak),
    ],
)
def test_killed_runs_resume_without_losing_or_altering_results(
    tmp_path: Path, frames: int, weights: tuple[float, ...], kills: int
) -> None:
    killed_again_and_again(tmp_path, batch(tmp_path, frames, weights), kills)


@pytest.mark.slow
@pytest.mark.parametrize("fate", ["moved", "removed", "covered", "another", "linked"])
def test_a_folder_that_goes_during_a_run_costs_one_sentence_and_no_finished_case(
    tmp_path: Path, fate: str
) -> None:
    cases = batch(tmp_path, 12)
    out = tmp_path / "out"
    moved = tmp_path / "moved"
    run = cases.start(out, 1)
    until(lambda: finished(out) >= 1 or run.poll() is not None)
    assert run.poll() is None
    if fate == "removed":
        shutil.rmtree(out, ignore_errors=True)
    else:
        out.rename(moved)
    if fate == "covered":
        out.write_text("another file")
    if fate == "another":
        out.mkdir()
    if fate == "linked":
        (tmp_path / "elsewhere").mkdir()
        out.symlink_to(tmp_path / "elsewhere")
    _, stderr = run.communicate(timeout=120)
    lines = without_progress(stderr)
    assert "Traceback" not in stderr and run.returncode == 2
    assert all(line.startswith("lampest: ") for line in lines) and "out" in lines[-1]
    if fate in ("another", "linked"):
        assert not list(out.iterdir())
    if fate == "covered":
        assert out.read_text() == "another file"
    if fate != "removed":
        assert finished(moved) >= 1
        assert cases.finish(moved)
