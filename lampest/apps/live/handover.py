"""Hand-over between threads: the newest item of a series, and tasks for another process."""

import os
from collections.abc import Callable
from contextlib import suppress
from contextvars import ContextVar
from threading import Condition, Thread
from typing import Any, Generic, NamedTuple, TypeVar

from lampest.files.errors import InputError
from lampest.runs.worker import Worker, WorkerDiedError

NICENESS = 10  # of processes beside: a tenth of the time of one that estimates, where both need it
FAREWELL_SECONDS = 1.0  # time for the last item to reach a listener
DESK = ContextVar[Callable[[Any], Any]]("desk")  # function of a process that answers tasks
T = TypeVar("T")


class News(NamedTuple, Generic[T]):
    """Item and its number in the series, from 1 on.

    A reader that saw n before skipped number − n − 1 items.
    """

    number: int
    item: T


class Newest(Generic[T]):
    """Holder of the newest item of a series; after `close` no more items come."""

    def __init__(self, first: T) -> None:
        self._changed = Condition()
        self._news = News(0, first)
        self.closed = False

    def put(self, item: T) -> None:
        """Replace the item."""
        self.change(lambda _: item)

    def change(self, changed: Callable[[T], T]) -> None:
        """Replace the item by `changed(item)` atomically."""
        with self._changed:
            self._news = News(self._news.number + 1, changed(self._news.item))
            self._changed.notify_all()

    def close(self) -> None:
        """Declare that no more items will come."""
        with self._changed:
            self.closed = True
            self._changed.notify_all()

    @property
    def item(self) -> T:
        """The current item."""
        return self._news.item

    def after(self, number: int, timeout: float | None = None) -> News[T] | None:
        """Wait for an item newer than that number.

        Return None after `timeout` s or at the end of the series.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._news.number > number or self.closed, timeout)
            return self._news if self._news.number > number else None


class Beside(Generic[T]):
    """Process of low priority that answers tasks one after the other.

    A thread waits for the answers. If the process dies, its tasks are lost, `gone` becomes True and
    `on_gone` is called.

    Parameters
    ----------
    desk : callable
        Task → answer, called in the process.
    queued : callable
        (new task, waiting tasks) → waiting tasks.
    on_answer : callable
        Receives task and answer, or an exception, from the thread.
    on_gone : callable
        Called when the process has died.
    """

    def __init__(
        self,
        desk: Callable[[T], Any],
        queued: Callable[[T, list[T]], list[T]],
        on_answer: Callable[[T, Any], None],
        on_gone: Callable[[], None] = lambda: None,
    ) -> None:
        self._queued = queued
        self._on_answer = on_answer
        self._on_gone = on_gone
        self._changed = Condition()
        self._ending = False
        self.gone = False
        self._waiting: list[T] = []
        self._worker = Worker(_open_desk, (desk,))
        self._thread = Thread(target=self._serve, name="lampest-beside", daemon=True)
        self._thread.start()

    def ask(self, task: T) -> None:
        """Queue a task without waiting."""
        with self._changed:
            self._waiting = self._queued(task, self._waiting)
            self._changed.notify_all()

    def finish(self) -> None:
        """Wait until all tasks are answered."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()
        self._thread.join()

    def close(self) -> None:
        """Drop waiting tasks and end the process."""
        with self._changed:
            self._waiting = []
        self._worker.kill()
        self.finish()

    def _serve(self) -> None:
        """Hand tasks to the worker and its answers on, until the end or its death."""
        try:
            with self._worker:
                while (task := self._next()) is not None:
                    self._worker.begin(_at_desk, task)
                    self._on_answer(task, self._worker.answer())
        except (WorkerDiedError, InputError):
            self.gone = True
            self._on_gone()

    def _next(self) -> T | None:
        """Wait for a task, and return it; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._ending or bool(self._waiting))
            return self._waiting.pop(0) if self._waiting else None


def _open_desk(desk: Callable[[Any], Any]) -> None:
    """Lower the priority of this process, and keep the function that answers tasks.

    The function keeps its state between tasks.
    """
    with suppress(AttributeError, OSError):  # available on Linux only
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    os.nice(NICENESS)
    DESK.set(desk)


def _at_desk(task: Any) -> Any:
    return DESK.get()(task)


class Errand(NamedTuple):
    """Task of a kind.

    The newest of each kind waits, and an urgent one is replaced by urgent ones only.
    """

    kind: str
    run: Callable[[], Any]
    urgent: bool = False

    def queued(self, waiting: "list[Errand]") -> "list[Errand]":
        """Return the waiting tasks with this one."""
        for place, errand in enumerate(waiting):
            if errand.kind == self.kind:
                newest = errand if errand.urgent and not self.urgent else self
                return [*waiting[:place], newest, *waiting[place + 1 :]]
        return [*waiting, self]
