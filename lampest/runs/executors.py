"""Executors of batches: this process, processes of this machine, or a Dask cluster.

An executor calls a function once for every argument, one call at a time on each worker, and yields
the results.
"""

import logging
import os
import signal
from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import astuple, dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

from lampest.files.errors import InputError, extra
from lampest.files.process import interrupted
from lampest.files.typed import ByKind, Configuration, check_not_negative, check_ranges
from lampest.runs.worker import TERMINAL, Function, Worker, WorkerDiedError, answered_first


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


# Tries of a task whose process dies; processes may be killed from outside, repeatedly by chance.
MAX_TRIES = 4
DIED = f"its process died {MAX_TRIES} times"
HUNG = (
    "a frame went on far beyond solver.time_limit_s, in a step that nothing interrupts, "
    "so that its process was ended"
)
MIN_TASKS = 12  # fewer tasks of half a second end before processes have started
# A Dask worker receives one task at a time where there are many.
SCHEDULING = {
    "distributed.scheduler.allowed-failures": MAX_TRIES - 1,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.work-stealing": False,
}
NOISY = ("distributed", "tornado", "asyncio")

Pairs = Generator[tuple[Any, Any], None, None]


class LostError(RuntimeError):
    """Loss of the scheduler: tasks without a result did not fail but were not run."""


@dataclass(frozen=True)
class Executor(Configuration):
    """Base of executors, which call a function once for every argument."""

    def beside(self, folder: Path) -> "Executor":
        """Return the executor with files relative to a folder."""
        return self

    def ready(self) -> None:
        """Raise InputError if this executor cannot run here."""

    @property
    def concurrent(self) -> bool:
        """Whether several calls may go on at the same time."""
        return True

    @abstractmethod
    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """Yield pairs of argument and result as they finish.

        The result may be the exception of the call.

        Raises LostError if no further results will come. After the generator is closed no call
        starts, and running ones are killed.
        """


@dataclass(frozen=True)
class Serial(Executor):
    """Sequential calls in this process, in the order of the arguments."""

    kind: Literal["serial"] = "serial"

    @property
    def concurrent(self) -> bool:
        """Whether several calls may go on at the same time: never."""
        return False

    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """Yield results, as `Executor.results`."""
        for argument in arguments:
            try:
                outcome = function(argument)
            except Exception as error:
                if interrupted(error):
                    raise KeyboardInterrupt from error
                outcome = error
            yield argument, outcome


@dataclass(frozen=True)
class Processes(Executor):
    """Fresh processes with one BLAS thread each, by default as many as there are cores.

    If a process dies, its task is tried again a few times, and no other task is affected. A process
    that hangs beyond the time limit of a frame is ended, and its task fails. Raises ValueError if
    the number of workers is out of range.
    """

    workers: int | None = None
    kind: Literal["processes"] = "processes"

    def __post_init__(self) -> None:
        check_ranges(self, 1, 10_000, "workers")

    @property
    def concurrent(self) -> bool:
        """Whether there are several workers."""
        return (self.workers or cores()) > 1

    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """Yield results, as `Executor.results`."""
        waiting = deque(range(len(arguments)))
        deaths = Counter[int]()
        with ExitStack() as stack:
            workers = min(self.workers or cores(), len(arguments))
            idle = [stack.enter_context(Worker()) for _ in range(workers)]
            busy: dict[Worker, int] = {}
            while waiting or busy:
                while waiting and idle:
                    worker = idle.pop()
                    number = waiting.popleft()
                    worker.begin(function, arguments[number])
                    busy[worker] = number
                for worker in answered_first(busy):
                    number = busy.pop(worker)
                    try:
                        outcome = worker.answer()
                    except WorkerDiedError:
                        idle.append(stack.enter_context(Worker()))
                        deaths[number] += 1
                        if not worker.hung and deaths[number] < MAX_TRIES:
                            waiting.append(number)
                            continue
                        outcome = TimeoutError(HUNG) if worker.hung else RuntimeError(DIED)
                    else:
                        idle.append(worker)
                    yield arguments[number], outcome


@dataclass(frozen=True)
class Tls(Configuration):
    """Files for the mutual authentication of a cluster.

    A scheduler without authentication runs the code of anybody who reaches it.

    Parameters
    ----------
    ca_file : certificate of the authority that signed those of all sides, PEM.
    cert_file, key_file : certificate of this side and its key, PEM.
    """

    ca_file: str
    cert_file: str
    key_file: str

    def beside(self, folder: Path) -> "Tls":
        """Return the files with paths relative to a folder.

        Raises InputError for unreadable files.
        """
        names = ("ca_file", "cert_file", "key_file")
        return Tls(*(_readable(folder / getattr(self, name), f"tls.{name}") for name in names))


@dataclass(frozen=True)
class Dask(Executor):
    """Workers of Dask distributed with one thread each; files must have the same paths everywhere.

    Parameters
    ----------
    workers : number of processes of this machine, by default that of its cores. Not with a
        scheduler.
    address : address of a running scheduler, such as tcp://host:8786; its workers: dask worker
        ADDRESS --nthreads 1.
    scheduler_file : file in which such a scheduler writes its address (dask scheduler
        --scheduler-file).
    wait_s : longest time in s until the first worker appears; jobs of a cluster may wait in a
        queue.
    tls : files for the authentication of scheduler, workers and this computer; an address then
        begins with tls://.

    Without address and file the workers are processes of this machine. The task of a worker that
    dies is tried again a few times, a number that a scheduler elsewhere determines. On processors
    of one kind the results are bitwise those of `Serial`. Raises ValueError where the parameters
    exclude each other.
    """

    kind: Literal["dask"] = "dask"
    workers: int | None = None
    address: str | None = None
    scheduler_file: str | None = None
    wait_s: float = 30.0
    tls: Tls | None = None

    def __post_init__(self) -> None:
        check_ranges(self, 1, 10_000, "workers")
        if sum(part is not None for part in (self.workers, self.address, self.scheduler_file)) > 1:
            raise ValueError(
                "address names a cluster that runs, and so does scheduler_file: "
                "one of them, without workers"
            )
        check_not_negative(self, "wait_s")

    def beside(self, folder: Path) -> "Dask":
        """Return the executor with files relative to a folder.

        Raises InputError for unreadable files.
        """
        file = self.scheduler_file and _readable(folder / self.scheduler_file, "scheduler_file")
        return replace(self, scheduler_file=file, tls=self.tls and self.tls.beside(folder))

    def ready(self) -> None:
        """Raise InputError if the extra is not installed or encryption does not fit the address."""
        if self.address is not None and (self.tls is not None) != self.address.startswith("tls://"):
            raise InputError(
                "executor: tls goes with an address that begins with tls://, "
                "and such an address with tls"
            )
        if self.tls is not None and not (self.address or self.scheduler_file):
            raise InputError(
                "executor: workers of this machine listen on its loopback address alone, "
                "without tls"
            )
        _library("distributed")

    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """Yield results, as `Executor.results`.

        Raises InputError also if no suitable worker answers.
        """
        if not arguments:
            return
        distributed = _library("distributed")
        with self._client(distributed, len(arguments)) as client:
            rounds = [dict(enumerate(arguments))]
            for tasks in rounds:
                numbers = {
                    client.submit(function, task, pure=False): number
                    for number, task in tasks.items()
                }
                for future in distributed.as_completed(list(numbers), loop=client.loop):
                    number = numbers.pop(future)
                    outcome = _outcome(distributed, client, future)
                    if not isinstance(outcome, distributed.KilledWorker):
                        yield arguments[number], outcome
                    # Dask attributes the death of a worker to all of its tasks: try each alone
                    elif len(tasks) > 1:
                        rounds.append({number: arguments[number]})
                    else:
                        yield arguments[number], RuntimeError(DIED)

    @contextmanager
    def _client(self, distributed: Any, tasks: int) -> Iterator[Any]:
        """Yield a client; a cluster that was started for it is closed with it."""
        with ExitStack() as stack:
            stack.enter_context(_silence())
            stack.enter_context(_library("dask").config.set(SCHEDULING))
            where = {"address": self.address, "scheduler_file": self.scheduler_file}
            place = self.address or self.scheduler_file
            if place is None:
                workers = min(self.workers or cores(), tasks)
                cluster = distributed.LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    memory_limit=0,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",  # any free port: the default may be in use
                    silence_logs=logging.CRITICAL,
                    preload=[__name__],
                )
                where = {"address": stack.enter_context(cluster)}
            if self.tls is not None:
                names = ("tls_ca_file", "tls_client_cert", "tls_client_key")
                files = dict(zip(names, astuple(self.tls), strict=True))
                where["security"] = distributed.Security(**files, require_encryption=True)
            try:
                client = stack.enter_context(
                    distributed.Client(**where, timeout=self.wait_s, set_as_default=False)
                )
                client.wait_for_workers(1, timeout=self.wait_s)
            except (OSError, TimeoutError) as error:
                raise InputError(
                    f"executor: no Dask scheduler with workers answers at {place} "
                    f"within {self.wait_s:g} s"
                ) from error
            for worker, threads in client.nthreads().items():
                if threads != 1:
                    raise InputError(
                        f"executor: the worker {worker} has {threads} threads; "
                        "start it with --nthreads 1"
                    )
            yield client
            if place is None:
                # Closed while it starts a worker anew, a nanny raises AssertionError (distributed
                # 2026.8).
                with suppress(TimeoutError):
                    client.wait_for_workers(workers, timeout=self.wait_s)


def _outcome(distributed: Any, client: Any, future: Any) -> Any:
    """Return the result or the exception of a finished call. Raises LostError."""
    try:
        return future.result()
    except distributed.CancelledError as error:
        raise LostError(f"the Dask scheduler {client.scheduler.address} is gone") from error
    except Exception as error:
        return error
    finally:
        future.release()


def dask_setup(worker: Any) -> None:
    """Ignore Ctrl-C and a closed terminal, which concern the collecting process.

    Dask calls this by its name.
    """
    for number in TERMINAL:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def _silence() -> Iterator[None]:
    """Silence Dask, which reports a lost scheduler in dozens of lines."""
    known = logging.root.manager.loggerDict
    names = {*NOISY, *(name for name in known if name.partition(".")[0] in NOISY)}
    before = {logger: logger.level for logger in map(logging.getLogger, names)}
    try:
        for logger in before:
            logger.setLevel(logging.CRITICAL + 1)
        yield
    finally:
        for logger, level in before.items():
            logger.setLevel(level)


def _readable(path: Path, key: str) -> str:
    """Return the absolute path of a file of an executor. Raises InputError if it is unreadable."""
    if path.exists() and not path.is_file():
        raise InputError(f"executor.{key}: {path}: is no regular file")
    try:
        path.open("rb").close()
    except OSError as error:
        raise InputError(f"executor.{key}: {path}: cannot be read ({error.strerror})") from error
    return str(path.absolute())


def _library(name: str) -> Any:
    """Import a module of the extra. Raises InputError if it is missing."""
    with extra("cluster"):
        return import_module(name)


AnyExecutor = Annotated[Serial | Processes | Dask, ByKind()]


def local(workers: int | None, tasks: int, *, separate: bool = False) -> Executor:
    """Return the executor of this machine.

    Parameters
    ----------
    workers : int or None
        Number of workers, at most one for each task; None: one for each core.
    tasks : int
        Number of tasks.
    separate : bool
        Whether even a single worker is another process, which can be ended if it hangs.
    """
    workers = min(workers or cores(), tasks)
    return Processes(workers) if workers > 1 or (separate and tasks) else Serial()


def each_of(
    function: Function,
    items: Sequence[Any],
    on_done: Callable[..., None] = lambda done, total: None,
    executor: Executor | None = None,
    lost: Callable[[Any, BaseException], Any] | None = None,
) -> list[Any]:
    """Return the results of a function for all items in order.

    Raises InputError if the executor cannot run here.

    Parameters
    ----------
    function : Function
        Importable by other processes.
    items : sequence
        Its arguments, one each.
    on_done : callable
        Receives the numbers of finished and of all items, at the beginning and after each.
    executor : Executor or None
        By default processes if there are many items. Serial for items whose classes other processes
        cannot import.
    lost : callable or None
        Makes a result from an item and the exception of its call; by default the first exception is
        raised.
    """
    executor = executor or (Processes() if len(items) > MIN_TASKS else Serial())
    executor.ready()
    results = {}
    on_done(0, len(items))
    with closing(executor.results(function, items)) as ends:
        for item, outcome in ends:
            if isinstance(outcome, BaseException):
                if lost is None:
                    raise outcome
                outcome = lost(item, outcome)
            results[id(item)] = outcome
            on_done(len(results), len(items))
    return [results[id(item)] for item in items]
