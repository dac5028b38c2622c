"""Processes of this machine that call a function when they are asked to."""

import os
import pickle
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

from lampest.files.process import ENDING, EXPENDABLE, ONE_THREAD, libraries_to_the_log

Function = Callable[[Any], Any]


@dataclass(frozen=True, eq=False)
class Worker:
    """A fresh process with one BLAS thread, which knows one function, and this end of the pipe to it."""

    process: SpawnProcess
    connection: Connection

    @classmethod
    def start(cls, function: Function) -> "Worker":
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(function, theirs))
        with one_thread(), without_interrupts():
            process.start()
        theirs.close()
        return cls(process, ours)

    def send(self, argument: Any) -> None:
        """Hand over a task; a process that is dead already shows when its result is awaited."""
        with suppress(BrokenPipeError):
            self.connection.send(argument)

    @property
    def hung(self) -> bool:
        """Whether a process that has stopped was ended by `ended_where_hung`."""
        return self.process.exitcode == -signal.SIGALRM

    def kill(self) -> None:
        """End the process, whatever it is at."""
        self.connection.close()
        self.process.kill()
        self.process.join()


def _work(function: Function, connection: Connection) -> None:
    """The life of a worker: until nobody is at the other end."""
    EXPENDABLE.set(True)
    with suppress(EOFError, OSError), libraries_to_the_log():
        while True:
            connection.send_bytes(_answer(function, connection.recv()))


def _answer(function: Function, argument: Any) -> bytes:
    """The pickled result, or the pickled exception; where that cannot travel, its text."""
    try:
        return pickle.dumps(function(argument))
    except Exception as error:
        with suppress(Exception):
            pickle.loads(pickled := pickle.dumps(error))
            return pickled
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))


@contextmanager
def one_thread() -> Iterator[None]:
    """Processes that are started within have one BLAS thread: numpy reads the environment when it is imported."""
    before = {name: os.environ.pop(name, None) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            del os.environ[name]
            os.environ.update({} if value is None else {name: value})


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Processes started here never see Ctrl-C and its kin, not even while they import; here it comes a moment later."""
    # Starting the tracker unblocks them again, so it must be running before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))
