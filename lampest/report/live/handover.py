"""What threads hand over: the newest of a series, and work for another process."""

import os
from collections.abc import Callable
from contextlib import suppress
from threading import Condition, Thread
from typing import Any, Generic, NamedTuple, TypeVar

from lampest.runs.executors import Worker

T = TypeVar("T")


class News(NamedTuple, Generic[T]):
    """A thing and its number in the series, from 1 on: a reader that saw n before skipped number − n − 1 things."""

    number: int
    thing: T


class Newest(Generic[T]):
    """One place that holds one thing. What it holds, and whether more will come (`closed`), is its only state."""

    def __init__(self, first: T) -> None:
        self._changed = Condition()
        self._news = News(0, first)
        self.closed = False

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
            self.closed = True
            self._changed.notify_all()

    @property
    def thing(self) -> T:
        """What it holds now."""
        return self._news.thing

    def after(self, number: int, timeout: float | None = None) -> News[T] | None:
        """Wait for something newer than that number; None after so many s, or where nothing more will come."""
        with self._changed:
            self._changed.wait_for(lambda: self._news.number > number or self.closed, timeout)
            return self._news if self._news.number > number else None


class Beside(Generic[T]):
    """One process, polite to others, in which `desk` answers one task after the other, and a thread that waits for it.

    queued : (one more, those that wait) → those that wait then. on_answer : gets task and answer or exception, from
    that thread. A process that dies takes its tasks with it: nothing is answered any more; `gone` says so, and on_gone.
    """

    def __init__(
        self,
        desk: Callable[[T], Any],
        queued: Callable[[T, list[T]], list[T]],
        on_answer: Callable[[T, Any], None],
        on_gone: Callable[[], None] = lambda: None,
    ) -> None:
        self._queued, self._on_answer, self._on_gone = queued, on_answer, on_gone
        self._changed, self._ending, self.gone = Condition(), False, False
        self._waiting: list[T] = []
        self._worker = Worker.start(Polite(desk))
        self._thread = Thread(target=self._serve, name="lampest-beside", daemon=True)
        self._thread.start()

    def ask(self, task: T) -> None:
        """Never waits."""
        with self._changed:
            self._waiting = self._queued(task, self._waiting)
            self._changed.notify_all()

    def finish(self) -> None:
        """Wait for the answer to all that came."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()
        self._thread.join()

    def close(self) -> None:
        """Drop what waits."""
        with self._changed:
            self._waiting = []
        self._worker.process.kill()
        self.finish()

    def _serve(self) -> None:
        try:
            while (task := self._next()) is not None:
                self._worker.send(task)
                self._on_answer(task, self._worker.connection.recv())
        except (EOFError, OSError):
            self.gone = True
            self._on_gone()
        finally:
            self._worker.kill()

    def _next(self) -> T | None:
        with self._changed:
            self._changed.wait_for(lambda: self._ending or bool(self._waiting))
            return self._waiting.pop(0) if self._waiting else None


class Polite(Generic[T]):
    """A function of one argument, called by a process that lets others go first."""

    def __init__(self, function: Callable[[T], Any]) -> None:
        self._function = function

    def __call__(self, argument: T) -> Any:
        with suppress(AttributeError, OSError):  # Linux alone has it
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        return self._function(argument)


class Errand(NamedTuple):
    """Something to run; of each kind the newest waits, an urgent one is replaced by urgent ones alone."""

    kind: str
    run: Callable[[], Any]
    urgent: bool = False

    def queued(self, waiting: "list[Errand]") -> "list[Errand]":
        """Those that wait with this one."""
        same = [one for one in waiting if one.kind == self.kind]
        if any(one.urgent and not self.urgent for one in same):
            return waiting
        return [self if one in same else one for one in waiting] if same else [*waiting, self]

    def done(self) -> Any:
        """What running it gives."""
        return self.run()
