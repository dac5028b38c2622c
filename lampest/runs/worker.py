"""A process that answers one task after the other, and ends with its parent."""

import os
import pickle
import signal
from collections.abc import Callable, Collection
from contextlib import suppress
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from threading import Thread
from typing import Any

from lampest.files.errors import InputError
from lampest.files.process import ENDING, EXPENDABLE, check_address_space, libraries_to_the_log

Function = Callable[[Any], Any]
LIVENESS_SECONDS = 1.0  # between questions whether processes live
TERMINAL = {*ENDING} - {signal.SIGTERM}  # signals that a terminal sends to workers as well


class WorkerDiedError(RuntimeError):
    """Death of a worker, or a process that could not be started, so that its task has no result."""


class Worker:
    """Fresh process that answers one task after the other.

    The process ignores Ctrl-C, and is killed at the end. Parent and process share a pipe and
    nothing else: no thread, queue or semaphore that could fail by itself. Only the process holds
    the pipe's other end, so that its death ends every reading.

    Parameters
    ----------
    begun : callable, or None
        Called in the new process, with the arguments.
    arguments : tuple

    Attributes
    ----------
    pipe : Connection
        Readable once there is an answer or the process is dead; there is none before the first
        task.
    process : SpawnProcess, or None
        The process, once it has started.
    """

    def __init__(
        self, begun: Callable[..., None] | None = None, arguments: tuple[Any, ...] = ()
    ) -> None:
        self._begun = begun
        self._arguments = arguments
        self._killed = False
        self.pipe: Connection
        self.process: SpawnProcess | None = None

    def begin(self, function: Function, argument: Any) -> None:
        """Hand a task to the process, which the first task starts; `answer` waits for the result.

        Raises InputError if no process can be started.
        """
        if self.process is None:
            # Signals of the terminal are blocked, so that even the imports of a process are
            # undisturbed, and the tracker does not die before them.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL)
            try:
                resource_tracker.ensure_running()
                # Which the start of the tracker undid.
                signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL)
                self.pipe, theirs = get_context("spawn").Pipe()
                with theirs:
                    process = get_context("spawn").Process(
                        target=_serve, args=(theirs, self._begun, self._arguments)
                    )
                    process.start()
            except (OSError, MemoryError) as error:
                reason = getattr(error, "strerror", None) or "not enough memory"
                raise InputError(
                    f"cannot start a further process ({reason}); --jobs 1 needs none"
                ) from error
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
            if self._killed:
                process.kill()
            self.process = process
        with suppress(OSError):  # it died after its last task, as `answer` will notice
            self.pipe.send((function, argument))

    @property
    def ready(self) -> bool:
        """Whether `answer` returns, or raises, without waiting for the task."""
        return self.pipe.poll() or self.process is None or not self.process.is_alive()

    def answer(self) -> Any:
        """Wait for the result of the task, or the exception that it raised, and return it.

        Raises WorkerDiedError if the process died.
        """
        answered_first([self])
        if not self.pipe.poll():  # dead, and a child of it holds the pipe
            raise WorkerDiedError("a worker process has died")
        try:
            return pickle.loads(self.pipe.recv_bytes())
        except (EOFError, OSError) as error:
            raise WorkerDiedError("a worker process has died") from error

    def kill(self) -> None:
        """Kill the process."""
        self._killed = True
        if self.process is not None:
            self.process.kill()

    @property
    def hung(self) -> bool:
        """Whether the process, which is dead, was ended by the alarm of `ended_where_hung`."""
        assert self.process is not None
        self.process.join()
        return self.process.exitcode == -signal.SIGALRM

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()
        if self.process is not None:
            self.process.join()
            self.pipe.close()


def answered_first(workers: Collection[Worker]) -> list[Worker]:
    """Wait until some workers have answered or are dead, and return them.

    A pipe says both. That each process lives is asked as well, in case a child of a dead one holds
    its pipe.
    """
    while True:
        readable = wait([worker.pipe for worker in workers], LIVENESS_SECONDS)
        answered = [worker for worker in workers if worker.pipe in readable or worker.ready]
        if answered:
            return answered


def _serve(pipe: Connection, begun: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    """Answer tasks in a new process, which ends with its parent.

    A parent that is killed ends no running task.
    """
    # No further thread can be started: the process ends after its task.
    with suppress(RuntimeError):
        Thread(target=_end_with_parent, daemon=True).start()
    if begun is not None:
        begun(*arguments)
    EXPENDABLE.set(True)
    check_address_space()
    with suppress(EOFError):
        while True:
            pipe.send_bytes(_answer(pipe.recv_bytes()))


def _end_with_parent() -> None:
    """End this process when its parent ends."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _answer(task: bytes) -> bytes:
    """Return the pickled result or exception; the text of an exception that cannot be pickled."""
    try:
        with libraries_to_the_log():
            function, argument = pickle.loads(task)
            return pickle.dumps(function(argument))
    except Exception as error:
        with suppress(Exception):
            pickled = pickle.dumps(error)
            pickle.loads(pickled)  # some exceptions can be pickled, but not read again
            return pickled
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
