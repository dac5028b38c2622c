"""A batch in processes of its own, to be killed and starved; what it must leave behind."""

import os
import re
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import psutil

from lampest import Panel, Recording, Scene, TwoPointReadout, two_point_resistance
from tests.small_files import COMMAND

WHOM = ("command", "all", "worker")
TIMES = ("solve_time", "error_bar_time", "baseline_solve_time_s")
RUN = """\
schema: 1
recordings: [one.h5, two.h5]
estimators:
  LSM: {terms: {misfit: {}}}
  LSR-CR: {terms: {misfit: {}, cell_resistance: {weight: 1e-3}}, formulation: reduced}
  LSR-gdCR: {terms: {misfit: {}, gradient_of_relative_change: {weight: 10}}}
"""


@dataclass(frozen=True)
class Batch:
    """A run's file and how many cases it makes."""

    path: Path
    cases: int

    def start(self, out: Path, jobs: int) -> subprocess.Popen[str]:
        """The command as the leader of a session, so that its processes are known."""
        command = [str(COMMAND), "run", str(self.path), "--out", str(out), "--jobs", str(jobs)]
        return subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    def finish(self, out: Path, jobs: int = 1) -> str:
        """Run to the end; what was printed."""
        run = self.start(out, jobs)
        printed, said = run.communicate(timeout=300)
        assert (run.returncode, without_progress(said)) == (0, []), (run.returncode, said)
        return printed


def without_progress(said: str) -> list[str]:
    """Lines on standard error; a machine that is slow sees how far a run is, too."""
    return [line for line in said.splitlines() if not re.match(r"lampest: (\d+ cases? to solve|\d+ of \d+)", line)]


def batch(folder: Path, frames: int = 6, weights: tuple[float, ...] = (1e-4, 1e-2)) -> Batch:
    """Two recordings, three estimators, a sweep."""
    for number, name in enumerate(("one", "two")):
        write_recording(folder / f"{name}.h5", frames, number)
    path = folder / "run.yaml"
    path.write_text(RUN + f"sweep: {{solver.tolerance: [1e-8, 1e-9], bounds.upper: {[1e6 / w for w in weights]}}}\n")
    return Batch(path, 2 * 3 * 2 * len(weights))


def write_recording(path: Path, frames: int, seed: int) -> None:
    """One unloaded frame, then others, of 6 × 7 cells."""
    rng, scene = np.random.default_rng(seed), Scene(Panel(6, 7), TwoPointReadout(), 140.0)
    cells = 3000 * np.exp(0.3 * rng.standard_normal((frames + 1, 6, 7)))
    volt = 5 * 1000 / (1000 + 140 + two_point_resistance(cells))
    resistance = TwoPointReadout().recorded_from_volt(np.round(volt * 4096) / 4096)
    role = (np.arange(frames + 1) > 0).astype(np.uint8)
    Recording(scene, resistance, np.arange(frames + 1.0), role, truth_cell_resistance=cells).save(path)


def session(leader: int) -> list[int]:
    """The living processes of a session."""
    living = []
    for process in psutil.process_iter(["status"]):
        with suppress(ProcessLookupError):
            if os.getsid(process.pid) == leader and process.info["status"] not in ("zombie", "dead"):
                living.append(process.pid)
    return living


def until(true: Callable[[], Any], seconds: float = 60.0) -> None:
    """Wait until it is."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def content(path: Path) -> dict[str, Any]:
    """All that a file holds but times: path → values of datasets and attributes."""
    held: dict[str, Any] = {}

    def keep(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and name.rpartition("/")[2] not in TIMES:
            held[name] = node[()]
        for key, value in node.attrs.items():
            if key not in (*TIMES, "REFERENCE_LIST", "DIMENSION_LIST"):
                held[f"{name}@{key}"] = value

    with h5py.File(path) as file:
        keep("/", file)
        file.visititems(keep)
    return held


def same(ours: dict[str, Any], theirs: dict[str, Any], tolerance: float = 0.0) -> None:
    """Equal bit by bit, or to the tolerance of a solver, which a kept factor may save some iterations."""
    assert set(ours) == set(theirs)
    for name, value in ours.items():
        if tolerance and name.endswith(("/iterations", "/starts", "/kkt_residual", "@model_check")):
            continue
        value, other = np.asarray(value), np.asarray(theirs[name])
        assert value.dtype == other.dtype, name
        if value.dtype.kind == "f":
            np.testing.assert_allclose(value, other, rtol=tolerance, atol=tolerance, err_msg=name)
        else:
            assert np.array_equal(value, other), name


def finished(out: Path) -> int:
    """How many cases have their result."""
    return len(list((out / "cases").glob("[!.]*.h5")))


def kill(process: subprocess.Popen[str], whom: str, rng: np.random.Generator) -> None:
    """SIGKILL to the command alone, to all its processes, or to one of its workers."""
    workers = [number for number in session(process.pid) if number != process.pid]
    single = [int(rng.choice(workers))] if whom == "worker" and workers else [process.pid]
    for target in [process.pid, *workers] if whom == "all" else single:
        with suppress(ProcessLookupError):
            os.kill(target, signal.SIGKILL)


def killed_again_and_again(tmp_path: Path, made: Batch, kills: int, seed: int) -> Counter[str]:
    """Kill as often, resume each time, and compare every folder that gets done; how often what happened."""
    rng, counts, folder = np.random.default_rng(seed), Counter[str](), 0
    begin = time.monotonic()
    made.finish(tmp_path / "undisturbed", 2)
    longest = time.monotonic() - begin
    undisturbed = content(tmp_path / "undisturbed" / "results.h5")
    while counts["kills"] < kills:
        out = tmp_path / f"out{folder}"
        before = finished(out)
        run = made.start(out, int(rng.integers(1, 3)))
        whom = WHOM[int(rng.integers(len(WHOM)))]
        time.sleep(float(rng.uniform(0.1 * longest, longest)))
        alive = run.poll() is None
        if alive:
            kill(run, whom, rng)
            counts.update({"kills": 1, whom: 1})
        _, said = run.communicate(timeout=300)
        assert "Traceback" not in said
        until(lambda leader=run.pid: not session(leader))
        assert finished(out) >= before
        if run.returncode == 0:
            same(content(out / "results.h5"), undisturbed)
            folder, counts = folder + 1, counts + Counter(done=1)
    made.finish(tmp_path / f"out{folder}")
    same(content(tmp_path / f"out{folder}" / "results.h5"), undisturbed)
    assert not list(tmp_path.rglob("*.part"))
    return counts
