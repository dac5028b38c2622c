"""The threads of BLAS, which are a state of the process."""

from threading import Barrier, Thread

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  (its BLAS is another one than NumPy's)
from threadpoolctl import ThreadpoolController, threadpool_limits

import lampest
from lampest.cost.problem import Data
from lampest.estimate.modules import begin_stream
from lampest.estimate.stream import Stream
from lampest.files.process import ONE_BLAS_THREAD
from lampest.panel.panel import EachModule, Modules


def threads() -> set[int]:
    """How many each BLAS of this process has."""
    return {library["num_threads"] for library in ThreadpoolController().info() if library["user_api"] == "blas"}


def test_an_estimate_from_python_uses_one_thread_of_blas(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = lampest.Scene(lampest.Panel(3, 4), lampest.TwoPointReadout(), series_resistance_ohm=140.0)
    recording = lampest.Recording(scene, np.full((3, 3, 4), 640.0), np.arange(3.0), np.array([0, 0, 1], dtype=np.uint8))
    during, push = list[set[int]](), Stream.push
    monkeypatch.setattr(Stream, "push", lambda *given: (during.append(threads()), push(*given))[1])
    with threadpool_limits(2, "blas"):
        lampest.reconstruct(recording, [lampest.Misfit()])
        assert during == [{1}]
        assert threads() == {2}


@pytest.mark.parametrize("panel", [lampest.Panel(3, 4), lampest.Panel(modules=Modules(1, 2, EachModule(3, 4)))])
def test_a_stream_uses_one_thread_of_blas(panel: lampest.Panel, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = lampest.Scene(panel, lampest.TwoPointReadout(), series_resistance_ohm=140.0)
    readings, during, networks = lampest.Readings.of(scene, np.full(panel.shape, 640.0)), set[int](), Data.networks
    monkeypatch.setattr(Data, "networks", lambda *given: (during.update(threads()), networks(*given))[1])
    estimator = lampest.Estimator((lampest.Misfit(),), "reduced")
    with threadpool_limits(2, "blas"):
        stream = begin_stream(estimator, scene, 0.1, readings)
        stream.tared(readings).push(readings)
        assert during == {1} and threads() == {2}


def test_the_last_thread_that_leaves_restores_the_threads_of_blas() -> None:
    entered, left, during = Barrier(2), Barrier(2), list[set[int]]()

    def first() -> None:
        with ONE_BLAS_THREAD:
            entered.wait()
        left.wait()

    with threadpool_limits(2, "blas"):
        worker = Thread(target=first)
        worker.start()
        with ONE_BLAS_THREAD:
            entered.wait()
            left.wait()
            during.append(threads())
        worker.join()
        assert during == [{1}] and threads() == {2}
