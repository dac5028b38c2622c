"""What may come a few frames late is computed in a process of its own, while frames go on."""

import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from threading import Condition, Thread
from typing import Any, NamedTuple

from lampest.runs.executors.process import Worker


class Errand(NamedTuple):
    """ask : computes the answer, in the other process. then : takes the answer, or the exception, in a thread here.

    urgent : whether it may not be pushed aside by one that is not.
    """

    ask: Callable[[], Any]
    then: Callable[[Any], None]
    urgent: bool = False


class Beside:
    """Answers one question after the other; of each kind the newest waits. What it holds is its only state.

    A process that dies takes its questions with it: nothing is answered any more, and `gone` says so.
    """

    def __init__(self) -> None:
        self._changed = Condition()
        self._waiting: dict[str, Errand] = {}
        self._closed = self._gone = False
        self._worker: Worker | None = None
        self._thread = Thread(target=self._serve, name="lampest-beside", daemon=True)

    @property
    def gone(self) -> bool:
        """Whether nothing is answered any more."""
        return self._gone

    def ask(self, kind: str, question: Errand) -> None:
        """Never waits; the question takes the place of one of its kind that waits, unless that is urgent and it not."""
        with self._changed:
            waiting = self._waiting.get(kind)
            if waiting is None or question.urgent or not waiting.urgent:
                self._waiting[kind] = question
            if not self._thread.is_alive() and not self._closed and not self._gone:
                self._thread.start()
            self._changed.notify_all()

    def close(self) -> None:
        """Nothing more is asked, and what is open stays open."""
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
                worker = Worker.start(done_beside)
                end.callback(worker.kill)
                with self._changed:
                    self._worker = worker
                while (question := self._next()) is not None:
                    worker.send(question.ask)
                    question.then(worker.connection.recv())
            except (EOFError, OSError):
                self._gone = True

    def _next(self) -> Errand | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or bool(self._waiting))
            return None if self._closed else self._waiting.pop(next(iter(self._waiting)))


def done_beside(ask: Callable[[], Any]) -> Any:
    """The answer, by a process that lets others go first."""
    with suppress(AttributeError, OSError):  # Linux alone has it
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    return ask()
