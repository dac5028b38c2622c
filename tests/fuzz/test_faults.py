"""A full disk, files that go or change under way, kill -9: what is finished stays, is right, and resumes."""

import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest
from fuzz import batches
from fuzz.batches import Batch, batch, finished, until, without_progress, write_recording

from lampest import Recording, read_results
from tests.small_files import COMMAND

LONG = pytest.mark.soak
HERE = ["unshare", "--map-root-user", "--mount", "sh", "-c"]


def mounted(script: str) -> subprocess.CompletedProcess[str]:
    """A script that may mount what it likes, seen by nobody else."""
    if subprocess.run([*HERE, "mount -t tmpfs none /mnt"], capture_output=True).returncode:
        pytest.skip("this machine lets nobody mount")
    return subprocess.run([*HERE, script], capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Batch:
    return batch(tmp_path_factory.mktemp("batch"), 4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kilobytes",
    [0, pytest.param(8, marks=LONG), pytest.param(200, marks=pytest.mark.slow), pytest.param(600, marks=LONG)],
)
def test_a_disk_that_fills_leaves_nothing_half_written(made: Batch, tmp_path: Path, kilobytes: int) -> None:
    """One sentence for each case that could not be kept, no half file; those that were kept are readable."""
    out, kept = tmp_path / "out", tmp_path / "kept"
    out.mkdir()
    mount = f"mount -t tmpfs -o size={kilobytes + 4}k none {out}"
    run = f"{shlex.quote(str(COMMAND))} run {made.path} --out {out} --jobs 1"
    ended = mounted(f"{mount}; {run}; echo code $?; cp -a {out} {kept}")
    code = int(ended.stdout.split()[-1])
    assert code in (2, 3)
    assert "Traceback" not in ended.stderr
    assert all(line.startswith("lampest: ") for line in ended.stderr.splitlines())
    assert "No space left" in ended.stderr
    assert not list(kept.rglob("*.part"))
    for path in (*kept.glob("cases/*.h5"), *kept.glob("*.h5")):
        assert read_results(path).cases
    assert bool(finished(kept)) == (kilobytes > 100)


def test_folder_that_is_read_only(made: Batch, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    ended = mounted(
        f"mount --bind {out} {out}; mount -o remount,ro,bind {out}; {COMMAND} run {made.path} --out {out}/results"
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr == f"lampest: {out}/results: cannot be written (Read-only file system)\n"


def started(made: Batch, out: Path, jobs: int) -> "subprocess.Popen[str]":
    run = made.start(out, jobs)
    until(lambda: finished(out) >= 2 or run.poll() is not None)
    assert run.poll() is None
    return run


@pytest.mark.slow
def test_recording_that_is_deleted_under_way(tmp_path: Path) -> None:
    """Its cases fail with a sentence each; those that are finished, and those of the other recording, are complete."""
    made = batch(tmp_path, 12)
    run = started(made, tmp_path / "out", 1)
    (tmp_path / "two.h5").unlink()
    _, said = run.communicate(timeout=120)
    assert run.returncode == 3
    lines = without_progress(said)
    assert len(lines) == made.cases // 2
    for line in lines:
        assert line.startswith("lampest: two × ") and "two.h5" in line
    cases = read_results(tmp_path / "out" / "results.h5").cases
    assert [case.recording for case in cases] == ["one"] * (made.cases // 2)


@pytest.mark.slow
def test_recording_that_is_replaced_under_way(tmp_path: Path) -> None:
    """No result under the old recording's hash holds the new one's numbers."""
    made = batch(tmp_path, 12)
    before = Recording.load(tmp_path / "two.h5").readings().value[1:]
    run = started(made, tmp_path / "out", 1)
    write_recording(tmp_path / "new.h5", 12, 99)
    (tmp_path / "new.h5").replace(tmp_path / "two.h5")
    _, said = run.communicate(timeout=120)
    assert "Traceback" not in said
    for case in read_results(tmp_path / "out" / "results.h5").cases:
        assert case.recording == "one" or np.array_equal(case.measured, before)


@pytest.mark.slow
def test_killed_runs_resume(tmp_path: Path) -> None:
    assert batches.killed_again_and_again(tmp_path, batch(tmp_path, 2, (1e-4,)), 2, 1)["kills"] == 2


@pytest.mark.soak
def test_fifty_kills_lose_and_alter_no_result(tmp_path: Path) -> None:
    made = batch(tmp_path, 8, (1e-4, 1e-3, 1e-2))
    counts = batches.killed_again_and_again(tmp_path, made, 50, 2)
    print(f"\n{made.cases} cases; {dict(counts)}; no result lost, none altered")
    assert counts["kills"] == 50
