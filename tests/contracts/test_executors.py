"""Where a run's cases are solved: on a cluster that runs, without its library, with a wrong entry, and Ctrl-C."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lampest import read_results

Command = Callable[..., SimpleNamespace]
PROGRESS = r"lampest: (\d+ cases? to solve|\d+ of \d+).*\n"  # lines that a slow machine sees
INTERRUPTED = "lampest: interrupted; what was finished is kept\n"


@pytest.mark.slow
def test_a_running_cluster_is_used_by_its_address(disk: SimpleNamespace, lampest: Command) -> None:
    import distributed

    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0", host="127.0.0.1"
    ) as cluster:
        path = disk.run(disk.text + f"executor: {{kind: dask, address: '{cluster.scheduler_address}'}}\n")
        ended = lampest("run", path, "--out", disk.folder / "out", "--set", "formulation=reduced")
        assert (ended.code, re.sub(PROGRESS, "", ended.err)) == (0, "")
        assert "3 cases solved" in ended.out
        assert len(cluster.scheduler.workers) == 1


def test_missing_library_is_one_sentence(
    disk: SimpleNamespace, lampest: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    path = disk.run(disk.text + "executor: {kind: dask}\n")
    ended = lampest("run", path, "--out", disk.folder / "out")
    assert (ended.code, ended.out) == (2, "")
    assert ended.err == "lampest: distributed is not installed; pip install 'lampest[cluster]' brings it\n"
    assert not (disk.folder / "out").exists()
    assert lampest("run", path, "--out", disk.folder / "out", "--jobs", "1").code == 0


def interrupted(path: Path, out: Path, pattern: str, count: int) -> tuple[int, str, str]:
    """Code, output and errors of a run that Ctrl-C reaches, as all of its processes, once there are so many files."""
    run = subprocess.Popen(
        [Path(sys.executable).with_name("lampest"), "run", path, "--out", out],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Shells start background jobs with Ctrl-C ignored, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    deadline = time.monotonic() + 60
    while len(list((out / "cases").glob(pattern))) < count:
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(run.pid, signal.SIGINT)
    printed, complained = run.communicate(timeout=60)
    with pytest.raises(ProcessLookupError):  # nothing stays running
        while time.monotonic() < deadline + 60:
            os.killpg(run.pid, 0)
            time.sleep(0.05)
    return run.returncode, printed, re.sub(PROGRESS, "", complained)


def large(disk: SimpleNamespace, frames: int) -> None:
    scene = disk.scene.replace("rows: 3, columns: 4", "rows: 8, columns: 8")
    disk.recording(disk.folder / "small.h5", scene, (frames, 8, 8))


@pytest.mark.parametrize(
    "executor",
    ["serial", *(pytest.param(f"{kind}, workers: 2", marks=pytest.mark.slow) for kind in ("processes", "dask"))],
)
def test_interrupt_keeps_what_is_finished(executor: str, disk: SimpleNamespace) -> None:
    large(disk, 9)
    weights = [float(f"{weight:.3g}") for weight in np.geomspace(1e-5, 1e-1, 300)]
    sweep = f"sweep: {{estimators.LSR-CR.terms.cell_resistance.weight: {weights}}}\n"
    path, out = (
        disk.run(disk.text + sweep + f"formulation: reduced\nexecutor: {{kind: {executor}}}\n"),
        disk.folder / "out",
    )
    assert interrupted(path, out, "[!.]*.h5", 3) == (130, "", INTERRUPTED)
    finished = read_results(out / "results.h5").cases
    assert 3 <= len(finished) < 302 and all(case.solved.all() for case in finished)
    assert {path.stem for path in (out / "cases").glob("[!.]*.h5")} >= {case.case_id for case in finished}


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["serial", "processes, workers: 1"])
def test_a_case_that_is_broken_off_keeps_its_finished_frames(executor: str, disk: SimpleNamespace) -> None:
    large(disk, 1502)
    text = disk.text[: disk.text.index("  LSR-CR")] + f"formulation: nodal\nexecutor: {{kind: {executor}}}\n"
    out = disk.folder / "out"
    assert interrupted(disk.run(text), out, ".*_unfinished.h5", 1)[0] == 130
    (case,) = read_results(out / "results.h5").cases
    count = int(case.solved.sum())
    assert 0 < count < len(case.solved) and case.solved[:count].all()
    assert np.isnan(case.cell_resistance[count:]).all() and np.isfinite(case.cell_resistance[:count]).all()
    assert set(case.status[count:]) == {"the run was broken off before this frame"}
    assert not list((out / "cases").iterdir()), "an unfinished case is solved anew"
