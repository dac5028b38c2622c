"""What a batch asks of an executor, and what all of them share. A task is a call of one function with one argument."""

import os
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

from lampest.files.process import ONE_THREAD

MOST_TRIES = 4  # of a task whose process dies: whoever kills processes from outside may meet the same one again
DIED = f"its process died {MOST_TRIES} times"
HUNG = (
    "a frame went on far beyond solver.time_limit_s, in a step that nothing interrupts, so that its process was ended"
)

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


def check_workers(workers: int | None) -> None:
    """Raise ValueError unless the number of workers is positive, or None."""
    if workers is not None and not 1 <= workers <= 10_000:
        raise ValueError("workers must lie between 1 and 10000")
