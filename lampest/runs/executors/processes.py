"""Executors: calls in this process, one after the other, or in processes of this machine, each given one at a time."""

import os
import pickle
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Literal, Protocol

from lampest.files.process import ENDING, EXPENDABLE, ONE_THREAD, interrupted, libraries_to_the_log
from lampest.files.typed import Configuration, check_ranges

MOST_TRIES = 4  # of a task whose process dies: whoever kills processes from outside may meet the same one again
DIED = f"its process died {MOST_TRIES} times"
HUNG = (
    "a frame went on far beyond solver.time_limit_s, in a step that nothing interrupts, so that its process was ended"
)
PATIENCE_SECONDS = 1.0  # for a call under way when nobody waits for it any more

Function = Callable[[Any], Any]
Pairs = Generator[tuple[Any, Any], None, None]


class LostError(RuntimeError):
    """Whoever hands out the tasks is gone: those without a result have not failed, they were not run."""


class Executor(Protocol):
    """Something that calls a function once for every argument."""

    def ready(self) -> None:
        """Raise InputError where this executor cannot run here."""

    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """(argument, result) pairs as they are finished; the result is an exception where the call raised one.

        Raises LostError where no further result will come. After the generator is closed no further call starts; a
        call under way ends or dies, and writes no half file.
        """


@contextmanager
def one_thread() -> Iterator[None]:
    """Processes that are started within have one BLAS thread: numpy reads the environment when it is imported."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))


@dataclass(frozen=True)
class Serial(Configuration):
    """One call after the other in this process."""

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
class Processes(Configuration):
    """`workers` fresh processes with one BLAS thread each, or as many as there are cores.

    A process that dies costs the task it was at one of a few more tries, and no other task anything. One that
    hangs beyond the time limit of a frame is ended, and its task with it.
    Raises ValueError where the number of workers is out of range.
    """

    workers: int | None = None
    kind: Literal["processes"] = "processes"

    def __post_init__(self) -> None:
        check_ranges(self, 1, 10_000, "workers")

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
