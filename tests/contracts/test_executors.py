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


@pytest.mark.slow
def test_a_running_cluster_is_used_by_its_address(disk: SimpleNamespace, lampest: Command) -> None:
    import distributed

    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0", host="127.0.0.1"
    ) as cluster:
        path = disk.run(disk.text + f"executor: {{kind: dask, address: '{cluster.scheduler_address}'}}\n")
        ended = lampest("run", path, "--out", disk.folder / "out", "--set", "formulation=reduced")
        progress = r"lampest: (\d+ cases? to solve|\d+ of \d+).*\n"  # lines that a slow machine sees
        assert (ended.code, re.sub(progress, "", ended.err)) == (0, "")
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{kind: procesess}", "run.yaml:10:1: executor: "),
        ("{kind: processes, workers: 0}", "executor: workers must lie between 1 and 10000"),
        ("{kind: serial, workers: 2}", "executor.workers: no such key"),
        ("{kind: dask, address: 'tcp://a:1', workers: 2}", "address names a cluster that runs"),
    ],
)
def test_wrong_executors_are_named(text: str, message: str, disk: SimpleNamespace, lampest: Command) -> None:
    ended = lampest("run", disk.run(disk.text + f"executor: {text}\n"), "--out", disk.folder / "out")
    assert (ended.code, ended.out) == (2, "")
    assert message in ended.err
    assert not (disk.folder / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["processes, workers: 2", "dask, workers: 2"], ids=["processes", "dask"])
def test_interrupt_keeps_what_is_finished(executor: str, disk: SimpleNamespace) -> None:
    """Ctrl-C reaches every process of the terminal's group."""
    weights = [float(f"{weight:.3g}") for weight in np.geomspace(1e-5, 1e-1, 300)]
    disk.recording(
        disk.folder / "small.h5", disk.scene.replace("rows: 3, columns: 4", "rows: 8, columns: 8"), (9, 8, 8)
    )
    sweep = f"sweep: {{estimators.LSR-CR.terms.cell_resistance.weight: {weights}}}\n"
    path = disk.run(disk.text + sweep + f"formulation: reduced\nexecutor: {{kind: {executor}}}\n")
    out = disk.folder / "out"
    run = subprocess.Popen(
        [Path(sys.executable).with_name("lampest"), "run", path, "--out", out],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    deadline = time.monotonic() + 60
    while len(list((out / "cases").glob("[!.]*.h5"))) < 3:
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(run.pid, signal.SIGINT)
    written, error = run.communicate(timeout=60)
    assert (run.returncode, written) == (130, "")
    assert error == "lampest: interrupted; what was finished is kept\n"
    finished = read_results(out / "results.h5").cases
    assert 3 <= len(finished) < 300
    assert {path.stem for path in (out / "cases").glob("[!.]*.h5")} >= {case.case_id for case in finished}
