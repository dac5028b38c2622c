"""Where tasks run: here, or in other processes. Each task is a call of one function with one argument."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Protocol

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
MOST_TRIES = 2


class Executor(Protocol):
    """Something that calls a function once for every argument."""

    def results(self, function: Callable[[Any], Any], arguments: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """(argument, result) pairs as they are finished; the result is an exception where the call raised one."""


@dataclass(frozen=True)
class Serial:
    """One call after the other in this process."""

    def results(self, function: Callable[[Any], Any], arguments: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """In the order of the arguments."""
        for argument in arguments:
            try:
                yield argument, function(argument)
            except Exception as error:
                yield argument, error


@dataclass(frozen=True)
class Processes:
    """`workers` fresh processes with one BLAS thread each; a process that dies costs its own tasks one more try."""

    workers: int

    def results(self, function: Callable[[Any], Any], arguments: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """In the order in which they are finished."""
        tries = dict.fromkeys(range(len(arguments)), 0)
        while tries:
            # After a death the tasks that were under way are tried alone, so that the guilty one is known.
            suspects = [number for number, count in tries.items() if count]
            batch = suspects[:1] or list(tries)
            for number, outcome in _pool_results(self.workers, function, arguments, batch):
                if not isinstance(outcome, BrokenProcessPool):
                    del tries[number]
                    yield arguments[number], outcome
                elif tries[number] + 1 < MOST_TRIES or len(batch) > 1:
                    tries[number] = 1
                else:
                    del tries[number]
                    yield arguments[number], RuntimeError("its process died twice")


def _pool_results(
    workers: int, function: Callable[[Any], Any], arguments: Sequence[Any], batch: Sequence[int]
) -> Iterator[tuple[int, Any]]:
    os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
    pool = ProcessPoolExecutor(min(workers, len(batch)), get_context("spawn"), initializer=ignore_interrupt)
    try:
        futures: dict[Future[Any], int] = {pool.submit(function, arguments[number]): number for number in batch}
        for future in as_completed(futures):
            error = future.exception()
            yield futures[future], future.result() if error is None else error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def ignore_interrupt() -> None:
    """Leave Ctrl-C to the process that collects the results."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
