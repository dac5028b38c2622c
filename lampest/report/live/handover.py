"""What threads hand over: the newest of a series, and work for another process."""

import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from threading import Condition, Thread
from typing import Any, Generic, NamedTuple, TypeVar

from lampest.runs.executors import Worker

T = TypeVar("T")


class News(NamedTuple, Generic[T]):
    """A thing and its number in the series, from 1 on: a reader that saw n before skipped number − n − 1 things."""

    number: int
    thing: T


class Newest(Generic[T]):
    """One place that holds one thing. What it holds, and whether more will come, is its only state."""

    def __init__(self, first: T) -> None:
        self._changed = Condition()
        self._news = News(0, first)
        self._closed = False

    def put(self, thing: T) -> None:
        """Let `thing` take the place."""
        self.change(lambda _: thing)

    def change(self, changed: Callable[[T], T]) -> None:
        """Let `changed(thing)` take the place; no other change comes between."""
        with self._changed:
            self._news = News(self._news.number + 1, changed(self._news.thing))
            self._changed.notify_all()

    def close(self) -> None:
        """Nothing more will come."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def thing(self) -> T:
        """What it holds now."""
        return self._news.thing

    @property
    def closed(self) -> bool:
        """Whether nothing more will come."""
        return self._closed

    def after(self, number: int, timeout: float | None = None) -> News[T] | None:
        """Wait for something newer than that number; None after so many s, or where nothing more will come."""
        with self._changed:
            self._changed.wait_for(lambda: self._news.number > number or self._closed, timeout)
            return self._news if self._news.number > number else None


class Errand(NamedTuple):
    """run : in the other process. then : takes answer or exception here. urgent : replaced by urgent ones alone."""

    run: Callable[[], Any]
    then: Callable[[Any], None]
    urgent: bool = False


class Beside:
    """One process that runs one task after the other; of each kind the newest waits.

    A process that dies takes its tasks with it: nothing is answered any more, and `gone` says so.
    """

    def __init__(self) -> None:
        self._changed = Condition()
        self._waiting: dict[str, Errand] = {}
        self._closed = self._gone = False
        self._worker: Worker | None = None
        self._thread = Thread(target=self._serve, name="lampest-background", daemon=True)

    @property
    def gone(self) -> bool:
        """Whether nothing is answered any more."""
        return self._gone

    def ask(self, kind: str, task: Errand) -> None:
        """Never waits; the task replaces one of its kind that waits, unless that is urgent and it not."""
        with self._changed:
            waiting = self._waiting.get(kind)
            if waiting is None or task.urgent or not waiting.urgent:
                self._waiting[kind] = task
            if not self._thread.is_alive() and not self._closed and not self._gone:
                self._thread.start()
            self._changed.notify_all()

    def close(self) -> None:
        """Drop all tasks."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            worker = self._worker
        if worker is not None:
            worker.process.kill()
        if self._thread.is_alive():
            self._thread.join()

    def _serve(self) -> None:
        with ExitStack() as end:
            try:
                worker = Worker.start(run_politely)
                end.callback(worker.kill)
                with self._changed:
                    self._worker = worker
                while (task := self._next()) is not None:
                    worker.send(task.run)
                    task.then(worker.connection.recv())
            except (EOFError, OSError):
                self._gone = True

    def _next(self) -> Errand | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or bool(self._waiting))
            return None if self._closed else self._waiting.pop(next(iter(self._waiting)))


def politely() -> None:
    """Let other processes go first."""
    with suppress(AttributeError, OSError):  # Linux alone has it
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def run_politely(run: Callable[[], Any]) -> Any:
    """The answer, by a process that lets others go first."""
    politely()
    return run()
