"""Several threads estimate at the same time: the same cells as one after the other.

Cancellation and forks do not change them.

CasADi corrupts the heap where this is wrong, so each scene runs in a process of its own whose end
is looked at. The threads of BLAS are a state of the process.
"""

import subprocess
import sys
import textwrap
from threading import Barrier, Thread
from weakref import ref

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  (its BLAS is another one than NumPy's)
from threadpoolctl import ThreadpoolController, threadpool_limits

import lampest
from lampest.cost.problem import Data
from lampest.estimate.modules import begin_stream
from lampest.files.process import ONE_BLAS_THREAD
from lampest.panel.compiled import CasadiOwner, guarded
from lampest.panel.panel import EachModule, Modules

SCENE = """
import gc
import os
import signal
import sys
import threading
import numpy as np
import lampest

WAYS = {
    "squares": ({}, [lampest.Misfit(), lampest.LogGradient(weight=1.0)]),
    "absolute": ({}, [lampest.Misfit(), lampest.TotalVariation(weight=1.0)]),
    "program": (
        {"formulation": "nodal"},
        [lampest.Misfit(loss=lampest.Huber(3.0)), lampest.CellResistance(1e-3)],
    ),
    "student": (
        {},
        [lampest.Misfit(loss=lampest.Student(corner=3.0)), lampest.CellResistance(1e-3)],
    ),
}
def recording(number):
    # Panels of one shape share what is compiled, and each process starts without any.
    rows = 3 + number % 2
    cells = 1000 * np.exp(0.05 * np.random.default_rng(number).standard_normal((4, rows, 3)))
    scene = lampest.Scene(lampest.Panel(rows, 3), readout=lampest.TwoPointReadout(noise_lsb=0.7))
    return lampest.Recording(scene, cells, np.arange(4.0), np.array([0, 1, 1, 1], dtype=np.uint8))

def estimate(number, way, more=()):
    options, terms = WAYS[way]
    options = {"error_bars": False, **options}
    return lampest.reconstruct(recording(number), [*terms, *more], **options).cell_resistance

def begun(count, work):
    threads = [threading.Thread(target=work, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    return threads

def ended(threads):
    for thread in threads:
        thread.join(timeout=80)
        assert not thread.is_alive(), "a thread hangs"

def forks(count, seconds, work):
    # The codes of processes that are forked now; an alarm ends a process that waits for a lock
    # without an owner.
    for number in range(count):
        child = os.fork()
        if not child:
            signal.alarm(seconds)
            os._exit(0 if work(number) else 1)
        yield os.waitpid(child, 0)[1]
"""
COMPARISON = """
count, ways = int(sys.argv[1]), sys.argv[2].split(",")
estimates = {}
def work(number):
    gc.collect()  # frees what other threads dropped
    estimates[number] = estimate(number, ways[number % len(ways)])
ended(begun(count, work))
for number in range(count):
    alone = estimate(number, ways[number % len(ways)])
    np.testing.assert_allclose(estimates[number], alone, rtol=1e-12)
"""


def run(text: str, *arguments: object) -> None:
    """Run a scene in a process of its own, which must end well."""
    command = [
        sys.executable,
        "-X",
        "faulthandler",
        "-c",
        SCENE + textwrap.dedent(text),
        *map(str, arguments),
    ]
    completed = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert (completed.returncode, completed.stderr) == (0, ""), (
        f"{completed.returncode}: {completed.stderr[-3000:]}"
    )


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 8, pytest.param(32, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "ways", ["squares", "absolute,student", "program", "squares,absolute,program,student"]
)
def test_several_threads_give_the_cells_of_one_thread(count: int, ways: str) -> None:
    run(COMPARISON, count, ways)


@pytest.mark.slow
def test_a_failing_or_cancelled_thread_harms_no_other() -> None:
    run(
        """
        import ctypes
        from dataclasses import dataclass
        from typing import ClassVar, Literal

        @dataclass(frozen=True)
        class Failing(lampest.Term):
            unit: ClassVar[str] = "ohm"
            weight: float = 1.0

            def residual(self, state):
                symbols = [state.cell_resistance * number for number in range(200)]
                raise RuntimeError(f"no residual from {len(symbols)}")

        class Cancelled(Exception):
            pass

        estimates, raised = {}, []
        # An exception that comes from outside may break an import, whoever imports.
        estimate(0, "squares")
        def work(number):
            more = [Failing()] if number % 4 == 1 else []
            try:
                for _ in range(3):
                    estimates[number] = estimate(number, "squares", more)
            except (lampest.InputError, Cancelled) as error:
                raised.append(error)  # kept by a thread that is not the one that made the symbols

        threads = begun(12, work)
        for thread in threads[2::4]:
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(thread.ident), ctypes.py_object(Cancelled)
            )
        ended(threads)
        assert sum("no residual" in str(error) for error in raised) == 3
        raised.clear()
        for number in range(0, 12, 4):
            np.testing.assert_allclose(estimates[number], estimate(number, "squares"), rtol=1e-12)
        """
    )


def test_a_dropped_owner_waits_for_a_guarded_call_and_runs_no_python_code_meanwhile() -> None:
    owner = CasadiOwner()
    reference = ref(owner)
    events: list[str] = []
    sys.setprofile(lambda frame, event, argument: events.append(event))
    del owner
    sys.setprofile(None)
    assert events == ["c_call"], "besides the last call of setprofile, code of Python ran"
    assert reference() is not None, "freed without the lock"
    guarded(int)()
    assert reference() is None, "never freed"


@pytest.mark.slow
def test_processes_forked_during_estimates_can_estimate() -> None:
    """Python 3.11 locks cached properties while they are computed."""
    run(
        """
        over = threading.Event()
        estimate(0, "squares")  # so that the libraries, whose locks are their own, are loaded
        def work(number):
            while not over.is_set():
                estimate(number, "absolute")
        threads = begun(4, work)
        codes = list(forks(6, 60, lambda number: np.isfinite(estimate(number, "squares")).all()))
        over.set()
        ended(threads)
        assert codes == [0] * 6, codes
        """
    )


@pytest.mark.slow
def test_processes_forked_while_threads_limit_blas_can_limit_it() -> None:
    run(
        """
        from lampest.files.process import ONE_BLAS_THREAD
        over = threading.Event()
        def limited(number):
            with ONE_BLAS_THREAD:
                return True
        def work(number):
            while not over.is_set():
                limited(number)
        begun(2, work)
        codes = list(forks(20, 10, limited))
        over.set()
        assert codes == [0] * 20, codes
        """
    )


@pytest.mark.slow
def test_ctrl_c_ends_only_the_main_thread() -> None:
    run(
        """
        estimates = {}
        # Python's locks of modules stay taken if an exception from outside ends an import.
        estimate(7, "squares")
        def work(number):
            estimates[number] = estimate(number, "squares")
        threads = begun(6, work)
        # A process in the background begins without it.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        try:
            while True:
                estimate(7, "squares")
        except KeyboardInterrupt:
            pass
        ended(threads)
        assert len(estimates) == 6
        """
    )


def blas_threads() -> set[int]:
    """How many each BLAS of this process has."""
    return {
        library["num_threads"]
        for library in ThreadpoolController().info()
        if library["user_api"] == "blas"
    }


@pytest.mark.parametrize(
    "panel", [lampest.Panel(3, 4), lampest.Panel(modules=Modules(1, 2, EachModule(3, 4)))]
)
def test_a_stream_and_an_estimate_from_python_use_one_thread_of_blas(
    panel: lampest.Panel, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = lampest.Scene(panel, lampest.TwoPointReadout(), series_resistance_ohm=140.0)
    recorded = np.full((3, *panel.shape), 640.0)
    role = np.array([0, 0, 1], dtype=np.uint8)
    readings = lampest.Readings.of(scene, recorded[0])
    during = list[set[int]]()
    networks = Data.networks
    monkeypatch.setattr(
        Data, "networks", lambda *given: (during.append(blas_threads()), networks(*given))[1]
    )
    estimator = lampest.Estimator((lampest.Misfit(),), "reduced")
    with threadpool_limits(2, "blas"):
        stream = begin_stream(estimator, scene, 0.1, readings)
        stream.tared(readings).push(readings)
        alone = len(during)
        lampest.reconstruct(
            lampest.Recording(scene, recorded, np.arange(3.0), role), estimator.terms
        )
        assert (
            0 < alone < len(during)
            and all(threads == {1} for threads in during)
            and blas_threads() == {2}
        )


def test_the_last_leaving_thread_restores_the_threads_of_blas() -> None:
    entered = Barrier(2)
    leaving = Barrier(2)
    during = list[set[int]]()

    def first() -> None:
        with ONE_BLAS_THREAD:
            entered.wait()
        leaving.wait()

    with threadpool_limits(2, "blas"):
        worker = Thread(target=first)
        worker.start()
        with ONE_BLAS_THREAD:
            entered.wait()
            leaving.wait()
            during.append(blas_threads())
        worker.join()
        assert during == [{1}] and blas_threads() == {2}
