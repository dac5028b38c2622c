"""Calls in this process, one after the other, or in processes of this machine, each told one task after the other."""

import pickle
import signal
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, ClassVar, Literal

from lampest.files.process import ENDING, EXPENDABLE, interrupted, libraries_to_the_log
from lampest.files.typed import Validated
from lampest.runs.executors.executor import DIED, HUNG, MOST_TRIES, Function, Pairs, check_workers, cores, one_thread

PATIENCE_SECONDS = 1.0  # for a call under way when nobody waits for it any more


@dataclass(frozen=True)
class Serial(Validated):
    """One call after the other in this process."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["serial"] = "serial"

    def ready(self) -> None:
        """Always."""

    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """In the order of the arguments."""
        for argument in arguments:
            try:
                outcome = function(argument)
            except Exception as error:
                if interrupted(error):
                    raise KeyboardInterrupt from error
                outcome = error
            yield argument, outcome


@dataclass(frozen=True)
class Processes(Validated):
    """`workers` fresh processes with one BLAS thread each, or as many as there are cores.

    A process that dies costs the task it was at one of a few more tries, and no other task anything. One that
    hangs beyond the time limit of a frame is ended, and its task with it.
    Raises ValueError where the number of workers is out of range.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    workers: int | None = None
    kind: Literal["processes"] = "processes"

    def __post_init__(self) -> None:
        check_workers(self.workers)

    def ready(self) -> None:
        """Always."""

    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """In the order in which they are finished."""
        waiting = deque(range(len(arguments)))
        tries = Counter[int]()
        idle = [Worker.start(function) for _ in range(min(self.workers or cores(), len(arguments)))]
        busy: dict[Connection, tuple[Worker, int]] = {}
        try:
            while waiting or busy:
                while waiting and idle:
                    worker, number = idle.pop(), waiting.popleft()
                    worker.send(arguments[number])
                    busy[worker.connection] = worker, number
                ready = wait(list(busy))
                for connection in [connection for connection in busy if connection in ready]:
                    worker, number = busy.pop(connection)
                    try:
                        outcome = worker.connection.recv()
                    except (EOFError, OSError):
                        worker.stop()
                        idle.append(Worker.start(function))
                        tries[number] += 1
                        if worker.hung:
                            yield arguments[number], TimeoutError(HUNG)
                        elif tries[number] < MOST_TRIES:
                            waiting.appendleft(number)
                        else:
                            yield arguments[number], RuntimeError(DIED)
                        continue
                    idle.append(worker)
                    yield arguments[number], outcome
        finally:
            for worker in idle:
                worker.stop()
            for worker, _ in busy.values():
                worker.connection.close()
            patience = time.monotonic() + PATIENCE_SECONDS
            for worker, _ in busy.values():
                worker.leave(patience - time.monotonic())


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
