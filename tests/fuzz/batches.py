"""A batch in processes of its own, to be killed; the results that it must leave behind."""

import os
import re
import signal
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import psutil
from support import until

from lampest import Panel, Recording, Scene, TwoPointReadout, two_point_resistance
from lampest.files.checksums import BLOCKS, DATASETS
from tests.small_files import COMMAND

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]
VICTIMS = ("command", "all", "worker")
TIMES = ("solve_time", "error_bar_time", "baseline_solve_time_s")
RUN = """\
schema: 1
recordings: [one.h5, two.h5]
estimators:
  LSM: {terms: {misfit: {}}}
  LSR-CR: {terms: {misfit: {}, cell_resistance: {weight: 1e-3}}, formulation: reduced}
  LSR-gdCR: {terms: {misfit: {}, gradient_of_relative_change: {weight: 10}}}
"""


def default_signals() -> None:
    """Set the signals that a terminal gives a program, however the tests were started.

    Children inherit ignored signals: shells start background jobs without Ctrl-C, nohup ignores
    SIGHUP.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


@dataclass(frozen=True)
class Batch:
    """A run's file and the count of its cases."""

    path: Path
    count: int

    def start(self, out: Path, jobs: int | None = None) -> subprocess.Popen[str]:
        """Start the command as the leader of a session, so that its processes are known."""
        command = [
            COMMAND,
            "run",
            self.path,
            "--out",
            out,
            *([] if jobs is None else ["--jobs", str(jobs)]),
        ]
        options = {
            "stdout": subprocess.PIPE,
            "stderr": subprocess.PIPE,
            "text": True,
            "start_new_session": True,
        }
        options |= {"preexec_fn": default_signals}
        return subprocess.Popen(command, **options)

    def finish(self, out: Path, jobs: int = 1) -> dict[str, Any]:
        """Run to the end and return the content of the results."""
        run = self.start(out, jobs)
        _, stderr = run.communicate(timeout=300)
        assert (run.returncode, without_progress(stderr)) == (0, []), (run.returncode, stderr)
        return content(out / "results.h5")


def without_progress(stderr: str) -> list[str]:
    """Lines on standard error; a slow machine prints lines of progress, too."""
    return [
        line
        for line in stderr.splitlines()
        if not re.match(r"lampest: (\d+ cases? to solve|\d+ of \d+)", line)
    ]


def batch(folder: Path, frames: int = 6, weights: tuple[float, ...] = (1e-4, 1e-2)) -> Batch:
    """Two recordings, three estimators, a sweep."""
    for number, name in enumerate(("one", "two")):
        write_recording(folder / f"{name}.h5", frames, number)
    path = folder / "run.yaml"
    path.write_text(
        RUN
        + f"sweep: {{solver.tolerance: [1e-8, 1e-9], bounds.upper: {[1e6 / w for w in weights]}}}\n"
    )
    return Batch(path, 2 * 3 * 2 * len(weights))


def write_recording(path: Path, frames: int, seed: int) -> None:
    """One unloaded frame and measured ones, of 6 × 7 cells."""
    rng = np.random.default_rng(seed)
    scene = Scene(Panel(6, 7), TwoPointReadout(), 140.0)
    cells = 3000 * np.exp(0.3 * rng.standard_normal((frames + 1, 6, 7)))
    volt = 5 * 1000 / (1000 + 140 + two_point_resistance(cells))
    resistance = TwoPointReadout().recorded_from_volt(np.round(volt * 4096) / 4096)
    role = (np.arange(frames + 1) > 0).astype(np.uint8)
    Recording(scene, resistance, np.arange(frames + 1.0), role, truth_cell_resistance=cells).save(
        path
    )


def session(leader: int) -> list[int]:
    """The living processes of a session."""
    living = []
    for process in psutil.process_iter(["status"]):
        with suppress(ProcessLookupError):
            if os.getsid(process.pid) == leader and process.info["status"] not in (
                "zombie",
                "dead",
            ):
                living.append(process.pid)
    return living


def content(path: Path) -> dict[str, Any]:
    """All of a file but times: path → values of datasets and attributes."""
    values: dict[str, Any] = {}

    def add(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and name.rpartition("/")[2] not in TIMES:
            values[name] = node[()]
        for key, value in node.attrs.items():
            # Digests of times, too.
            if key not in (*TIMES, "REFERENCE_LIST", "DIMENSION_LIST", BLOCKS, DATASETS):
                values[f"{name}@{key}"] = value

    with h5py.File(path) as file:
        add("/", file)
        file.visititems(add)
    return values


def same(actual: dict[str, Any], reference: dict[str, Any], tolerance: float = 0.0) -> None:
    """Assert equality bit by bit, or to the tolerance of a solver.

    The solver is one that a cached factor saves some iterations.
    """
    assert set(actual) == set(reference)
    for name, value in actual.items():
        if tolerance and name.endswith(("/iterations", "/starts", "/kkt_residual", "@model_check")):
            continue
        value = np.asarray(value)
        expected = np.asarray(reference[name])
        assert value.dtype == expected.dtype, name
        if value.dtype.kind == "f":
            np.testing.assert_allclose(
                value, expected, rtol=tolerance, atol=tolerance, err_msg=name
            )
        else:
            assert np.array_equal(value, expected), name


def finished(out: Path) -> int:
    """The count of cases that have their result."""
    return len(list((out / "cases").glob("[!.]*.h5")))


def killed_again_and_again(tmp_path: Path, cases: Batch, kills: int) -> None:
    """Kill the command, all its processes or a worker so often, and resume each time.

    Compare every complete folder.
    """
    rng = np.random.default_rng(kills)
    count = 0
    folder = 0
    begin = time.monotonic()
    undisturbed = cases.finish(tmp_path / "undisturbed", 2)
    longest = time.monotonic() - begin
    while count < kills:
        out = tmp_path / f"out{folder}"
        previous = finished(out)
        run = cases.start(out, int(rng.integers(1, 3)))
        time.sleep(float(rng.uniform(0.1 * longest, longest)))
        if run.poll() is None:
            victim = VICTIMS[int(rng.integers(len(VICTIMS)))]
            count = count + 1
            workers = [number for number in session(run.pid) if number != run.pid]
            single = [int(rng.choice(workers))] if victim == "worker" and workers else [run.pid]
            for target in [run.pid, *workers] if victim == "all" else single:
                with suppress(ProcessLookupError):
                    os.kill(target, signal.SIGKILL)
        _, stderr = run.communicate(timeout=300)
        assert "Traceback" not in stderr
        until(lambda leader=run.pid: not session(leader))
        assert finished(out) >= previous
        if run.returncode == 0:
            same(content(out / "results.h5"), undisturbed)
            folder += 1
    same(cases.finish(tmp_path / f"out{folder}"), undisturbed)
    assert not list(tmp_path.rglob("*.part"))
