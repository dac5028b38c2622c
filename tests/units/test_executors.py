"""The place where cases run changes nothing but time."""

import ctypes
import dataclasses
import json
import logging
import multiprocessing
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from promises import promise

from lampest import CaseResult, InputError, read_results
from lampest.files import process
from lampest.runs import executors
from lampest.runs.batch import run_batch
from lampest.runs.checks import CheckTask
from lampest.runs.config import json_schema, read_run
from lampest.runs.executors import Dask, LostError, Processes, Serial, Tls
from lampest.runs.task import Task, solve_task

ONE_WORKER: Any = {
    "n_workers": 1,
    "threads_per_worker": 1,
    "dashboard_address": ":0",
    "host": "127.0.0.1",
}
EXIT_OF_WORKER = "__import__('os')._exit(9)"
EXECUTORS = [Serial(), Processes(2), Dask(workers=2)]
NAMES = [executor.kind for executor in EXECUTORS]
# An exception that cannot travel.
UNPICKLABLE_ERROR = "(_ for _ in ()).throw(type('Odd', (Exception,), {})('strange'))"
# Of a worker: whether every process of its cluster listens on the loopback address alone.
LISTENING = (
    "{c.laddr.ip for p in (lambda top: [top, *top.children(recursive=True)])"
    "(__import__('psutil').Process().parent().parent()) for c in p.net_connections('inet') if "
    "c.status == 'LISTEN'}"
)
CHILD_SECONDS = 60.0  # life of a child that holds the pipe of its dead parent open
HANG_SECONDS = 600.0  # of a task that is to be ended long before


def dying_once(task: Task | CheckTask) -> Any:
    """Does a task, but the first process that meets LSR-CR dies in the middle of writing."""
    mark = task.folder / "died"
    if isinstance(task, Task) and task.case.name == "LSR-CR" and not mark.exists():
        task.file.parent.mkdir(exist_ok=True)
        mark.touch()
        task.file.with_name(f".{task.file.name}.1.part").write_text("half")
        os.kill(os.getpid(), signal.SIGKILL)
    return solve_task(task)


def test_ctrl_c_during_a_hand_over_leaves_no_busy_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    hand_over = executors.Worker.begin

    def interrupted(worker: executors.Worker, function: Any, argument: Any) -> Any:
        hand_over(worker, function, argument)
        raise KeyboardInterrupt

    monkeypatch.setattr(executors.Worker, "begin", interrupted)
    # As is its frame, so that no collector ends the worker.
    with pytest.raises(KeyboardInterrupt) as held:
        list(Processes(2).results(time.sleep, [60, 60]))
    assert held and not multiprocessing.active_children()


@promise(
    "howto/batches: The results are identical bytes wherever they are computed, except for "
    "solve times."
)
@pytest.mark.slow
@pytest.mark.exact
@pytest.mark.parametrize("executor", EXECUTORS[1:], ids=NAMES[1:])
def test_results_equal_those_of_serial_even_if_a_worker_dies(
    executor: Any, disk: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk.recording(
        disk.folder / "wide.h5",
        disk.scene.replace("rows: 3, columns: 4", "rows: 2, columns: 5"),
        (3, 2, 5),
    )
    run = read_run(disk.run(disk.text.replace("[small.h5]", '["*.h5"]') + "formulation: reduced\n"))
    reference = run_batch(run, disk.folder / "one", Serial())
    monkeypatch.setattr("lampest.runs.batch.solve_task", dying_once)
    report = run_batch(run, disk.folder / "two", executor)
    assert (disk.folder / "two" / "died").exists()
    assert (report.done, report.skipped, report.failed) == (6, 0, ())
    case_lists = [read_results(folder.results).cases for folder in (reference, report)]
    assert len(case_lists[1]) == 6
    for actual, expected in zip(*case_lists, strict=True):
        for field in dataclasses.fields(CaseResult):
            if field.name not in ("solve_time", "baseline_solve_time", "error_bar_time"):
                np.testing.assert_equal(
                    getattr(actual, field.name), getattr(expected, field.name), err_msg=field.name
                )
    run_batch(run, disk.folder / "two", Serial())
    assert not list((disk.folder / "two" / "cases").glob(".*"))


@pytest.mark.slow
def test_errors_stay_with_their_task() -> None:
    answers = {"1 + 1": "2", "1 / 0": "division by zero", "2 + 2": "4"}
    for executor in EXECUTORS:
        executor.ready()
        assert {
            text: str(outcome) for text, outcome in executor.results(eval, list(answers))
        } == answers
        assert list(executor.results(eval, [])) == []
    ((_, outcome),) = Processes(1).results(eval, [UNPICKLABLE_ERROR])
    assert str(outcome) == "Odd: strange"


@pytest.mark.slow
@pytest.mark.parametrize("executor", EXECUTORS[1:], ids=NAMES[1:])
def test_a_task_that_kills_its_worker_costs_no_other(executor: Any) -> None:
    answers = {f"{number} + 0": str(number) for number in range(6)}
    outcomes = {
        text: str(outcome)
        for text, outcome in executor.results(eval, ["0 + 0", EXIT_OF_WORKER, *list(answers)[1:]])
    }
    assert outcomes == answers | {EXIT_OF_WORKER: "its process died 4 times"}


def half_written(mark: Path) -> str:
    """Die in the middle of writing a result, the first time."""
    if not mark.exists():
        mark.touch()
        frame: Any = sys._getframe()
        while "pipe" not in frame.f_locals:
            frame = frame.f_back
        os.write(frame.f_locals["pipe"].fileno(), struct.pack("!i", 1_000_000) + b"begun")
        os.kill(os.getpid(), signal.SIGKILL)
    return "whole"


@pytest.mark.slow
def test_a_worker_that_dies_while_sending_blocks_no_process(tmp_path: Path) -> None:
    marks = [tmp_path / name for name in "ab"]
    assert sorted(Processes(2).results(half_written, marks)) == [(mark, "whole") for mark in marks]


NO_THREADS = """
import errno, os, sys, threading
from lampest import InputError
from lampest.runs.executors import Processes

def no_thread(self):
    raise RuntimeError("can't start new thread")

def no_process(*arguments):
    raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

threading.Thread.start = no_thread
print(sorted(result for _, result in Processes(2).results(abs, [-1, -2])))
from multiprocessing import util
util.spawnv_passfds = no_process
try:
    list(Processes(2).results(abs, [-1, -2]))
except InputError as error:
    print(error)
"""


@pytest.mark.slow
def test_a_batch_needs_no_thread_and_reports_a_failed_process_start() -> None:
    completed = subprocess.run(
        [sys.executable, "-c", NO_THREADS], capture_output=True, text=True, timeout=60
    )
    sentence = (
        "cannot start a further process (Resource temporarily unavailable); --jobs 1 needs none"
    )
    assert (completed.stdout.splitlines(), completed.stderr) == (["[1, 2]", sentence], "")


def leaving_a_child(seconds: float) -> None:
    """Die, and leave a child that holds the pipe of the results open."""
    if os.fork():
        os._exit(9)
    time.sleep(seconds)
    os._exit(0)


@pytest.mark.slow
def test_a_dead_worker_with_a_living_child_causes_no_wait() -> None:
    begin = time.monotonic()
    ((_, outcome),) = Processes(1).results(leaving_a_child, [CHILD_SECONDS])
    assert str(outcome) == executors.DIED and time.monotonic() - begin < CHILD_SECONDS - 10.0


def test_ctrl_c_caught_by_compiled_code_ends_a_batch() -> None:
    def compiled(cause: BaseException | None) -> Any:
        raise SystemError("returned a result with an exception set") from cause

    with pytest.raises(KeyboardInterrupt):
        list(Serial().results(compiled, [KeyboardInterrupt()]))
    [(_, outcome)] = Serial().results(compiled, [ValueError()])
    assert isinstance(outcome, SystemError)


@pytest.mark.slow
def test_a_scheduler_is_located_by_its_file_and_threaded_workers_are_refused(
    tmp_path: Path,
) -> None:
    import distributed

    with distributed.LocalCluster(**ONE_WORKER | {"threads_per_worker": 2}) as cluster:
        (tmp_path / "scheduler.json").write_text(json.dumps(cluster.scheduler.identity()))
        with pytest.raises(InputError, match="has 2 threads; start it with --nthreads 1"):
            list(Dask(scheduler_file=str(tmp_path / "scheduler.json")).results(eval, ["1"]))


def hanging(seconds: float) -> float:
    """Waits in a call that no Python code interrupts, under a limit that is far shorter."""
    with mock.patch.object(process, "HUNG_SECONDS", 0.3), process.ended_where_hung(1e-3):
        ctypes.PyDLL(None).usleep(int(1e6 * seconds))
    return seconds


def test_workers_end_with_their_killed_command() -> None:
    """Workers hold the output of the command open, so that its reader would wait forever."""
    script = (
        "import os, time; from lampest.runs.executors import Worker; busy, idle = Worker(), "
        "Worker()"
    )
    script += (
        "; busy.begin(time.sleep, 100), idle.begin(abs, 2), idle.answer(), os.kill(os.getpid(), 9)"
    )
    completed = subprocess.run([sys.executable, "-c", script], stdout=subprocess.PIPE, timeout=60)
    assert completed.returncode == -signal.SIGKILL


@pytest.mark.slow
def test_a_hanging_task_is_ended_and_costs_no_other() -> None:
    begin = time.monotonic()
    outcomes = {
        seconds: str(outcome)
        for seconds, outcome in Processes(1).results(hanging, [0.0, HANG_SECONDS, 0.01])
    }
    assert time.monotonic() - begin < HANG_SECONDS / 2
    assert (outcomes[0.0], outcomes[0.01]) == ("0.0", "0.01")
    assert outcomes[HANG_SECONDS].startswith("a frame went on far beyond solver.time_limit_s")


def test_an_irreplaceable_process_is_not_ended() -> None:
    original = signal.getsignal(signal.SIGALRM)
    assert hanging(0.5) == 0.5 and signal.getsignal(signal.SIGALRM) == original


class Lost(Serial):
    """Loses its scheduler once a worker has written the second result and before it says so."""

    def results(self, function: Any, arguments: Sequence[Any]) -> Any:
        yield from super().results(function, arguments[:1])
        function(arguments[1])
        raise LostError("the scheduler is gone")


@pytest.mark.slow
def test_a_lost_scheduler_costs_no_finished_case(disk: SimpleNamespace) -> None:
    run = read_run(disk.run(disk.text + "formulation: reduced\n"))
    report = run_batch(run, disk.folder / "out", Lost())
    assert (report.done, report.failed, report.not_run, report.lost) == (
        2,
        (),
        1,
        "the scheduler is gone",
    )
    assert report.results is not None and len(read_results(report.results).cases) == 2
    second_report = run_batch(run, disk.folder / "out", Serial())
    assert (second_report.done, second_report.skipped, second_report.not_run) == (1, 2, 0)


def test_calls_unknown_to_the_scheduler_count_as_lost() -> None:
    import distributed

    client: Any = SimpleNamespace(scheduler=SimpleNamespace(address="tcp://a:1"))
    future = mock.Mock(**{"result.side_effect": distributed.CancelledError("key")})
    with pytest.raises(LostError, match=r"^the Dask scheduler tcp://a:1 is gone$"):
        executors._outcome(distributed, client, future)
    future.release.assert_called_once()


def test_an_executor_changes_no_case_id(disk: SimpleNamespace) -> None:
    ids = {
        tuple(case.case_id for case in read_run(disk.run(disk.text + text)).cases)
        for text in ("", "executor: {kind: serial}\n", "executor: {kind: processes, workers: 3}\n")
    }
    assert len(ids) == 1 and "executor" in json_schema()["properties"]


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder, its name with a blank and a quote, with certificates of an authority."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificates")
    folder = tmp_path_factory.mktemp("it's mine")
    for words in (
        "req -x509 -newkey rsa:2048 -nodes -keyout ca.key -out ca.pem -days 2 -subj /CN=authority",
        "req -newkey rsa:2048 -nodes -keyout me.key -out me.csr -subj /CN=me",
        "x509 -req -in me.csr -CA ca.pem -CAkey ca.key -CAcreateserial -out me.pem -days 2",
    ):
        subprocess.run(["openssl", *words.split()], cwd=folder, check=True, capture_output=True)
    return folder


@pytest.mark.slow
def test_a_local_cluster_listens_only_on_the_loopback_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = logging.getLogger("distributed.scheduler")
    monkeypatch.setattr(log, "level", logging.ERROR)
    outcomes = Dask(workers=1).results(eval, [LISTENING])
    assert next(outcomes) == (LISTENING, {"127.0.0.1"}) and not log.isEnabledFor(logging.CRITICAL)
    assert not list(outcomes) and log.level == logging.ERROR


@pytest.mark.slow
def test_a_scheduler_with_certificates_needs_their_files(keys: Path) -> None:
    import distributed

    tls = Tls("ca.pem", "me.pem", "me.key").beside(keys)
    options = ONE_WORKER | {"host": "tls://127.0.0.1"}
    own = {
        f"tls_{side}_{part}": file
        for side in ("client", "scheduler", "worker")
        for part, file in (("cert", tls.cert_file), ("key", tls.key_file))
    }
    every_side = distributed.Security(tls_ca_file=tls.ca_file, require_encryption=True, **own)
    with distributed.LocalCluster(**options, protocol="tls://", security=every_side) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        assert list(Dask(address=address, tls=tls).results(eval, ["6 * 7"])) == [("6 * 7", 42)]
        with pytest.raises(InputError, match="no Dask scheduler with workers answers"):
            list(Dask(address=address.replace("tls", "tcp"), wait_s=1.0).results(eval, ["1"]))
