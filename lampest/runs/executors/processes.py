"""Calls in processes of this machine, each told its next task when it has sent its last result."""

import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, ClassVar, Literal

from lampest.runs.executors.executor import DIED, HUNG, MOST_TRIES, Function, Pairs, check_workers, cores
from lampest.runs.executors.process import Worker

PATIENCE_SECONDS = 1.0  # for a call under way when nobody waits for it any more


@dataclass(frozen=True)
class Processes:
    """`workers` fresh processes with one BLAS thread each, or as many as there are cores.

    A process that dies costs the task it was at one more try, and no other task anything. One that hangs beyond the
    time limit of a frame is ended, and its task with it.
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
