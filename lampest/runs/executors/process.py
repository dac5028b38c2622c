"""A process of this machine that answers one question after the other, by one function."""

import pickle
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

from lampest.files.interrupts import ENDING, EXPENDABLE
from lampest.files.log import libraries_to_the_log
from lampest.runs.executors.executor import Function, one_thread


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

    def stop(self) -> None:
        """Wait until the process has ended what it is at."""
        self.connection.close()
        self.process.join()

    @property
    def hung(self) -> bool:
        """Whether a process that has stopped was ended by `ended_where_hung`."""
        return self.process.exitcode == -signal.SIGALRM

    def leave(self, seconds: float) -> None:
        """Wait so long for what the process is at, then end it."""
        self.connection.close()
        self.process.join(max(seconds, 0.0))
        self.kill()

    def kill(self) -> None:
        """End the process, whatever it is at."""
        self.process.kill()
        self.stop()


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Processes started here never see Ctrl-C and its kin, not even while they import; here it comes a moment later."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    # Starting the tracker unblocks them again, so it must be running before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
        try:
            text = pickle.dumps(error)
            pickle.loads(text)
        except Exception:
            text = pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
        return text
