"""Calls on a Dask cluster: of this machine, or any whose scheduler runs already."""

import logging
import signal
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from lampest.files.errors import InputError, extra
from lampest.files.process import ENDING, ONE_THREAD
from lampest.files.typed import Configuration, check_not_negative, check_ranges
from lampest.runs.executors.processes import (
    DIED,
    MOST_TRIES,
    Function,
    LostError,
    Pairs,
    cores,
    one_thread,
)

# A worker is handed one task at a time where there are many.
SCHEDULING = {
    "distributed.scheduler.allowed-failures": MOST_TRIES - 1,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.work-stealing": False,
}


@dataclass(frozen=True)
class Tls(Configuration):
    """Files by which all sides of a cluster know each other; without them whoever reaches a scheduler runs code on it.

    Parameters
    ----------
    ca_file : the authority that signed the certificates of all sides, PEM.
    cert_file, key_file : the certificate of this side and its key, PEM.
    """

    ca_file: str
    cert_file: str
    key_file: str

    def beside(self, folder: Path) -> "Tls":
        """The same with paths from that folder on. Raises InputError where a file cannot be read."""
        names = ("ca_file", "cert_file", "key_file")
        return Tls(**{name: readable(folder / getattr(self, name), f"tls.{name}") for name in names})

    def security(self) -> Any:
        """What Dask takes: an encrypted connection or none."""
        return library("distributed.security").Security(
            tls_ca_file=self.ca_file,
            tls_client_cert=self.cert_file,
            tls_client_key=self.key_file,
            require_encryption=True,
        )


@dataclass(frozen=True)
class Dask(Configuration):
    """Workers of Dask distributed with one thread each; files must have the same paths everywhere.

    Parameters
    ----------
    workers : how many processes of this machine; as many as it has cores by default. Not with a scheduler.
    address : of a scheduler that runs, such as tcp://host:8786; its workers: dask worker ADDRESS --nthreads 1.
    scheduler_file : the file in which such a scheduler says its address (dask scheduler --scheduler-file).
    wait_s : how many seconds its first worker may take to come; jobs of a cluster may stand in a queue.
    tls : files by which scheduler, workers and this computer know each other; with an address it begins with tls://.

    Without address and file the workers are processes of this machine. A worker that dies costs the task it was at one
    of a few more tries (as many as a scheduler elsewhere grants). Results are those of `Serial` bit for bit where the
    processors are of one kind. Raises ValueError where the parameters exclude each other.
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
                "address names a cluster that runs, and so does scheduler_file: one of them, without workers"
            )
        check_not_negative(self, "wait_s")

    @property
    def _place(self) -> str | None:
        """Where a scheduler runs already; None: workers of this machine."""
        return self.address or self.scheduler_file

    def beside(self, folder: Path) -> "Dask":
        """The same with its files taken from that folder. Raises InputError where one cannot be read."""
        file = self.scheduler_file and readable(folder / self.scheduler_file, "scheduler_file")
        return replace(self, scheduler_file=file, tls=None if self.tls is None else self.tls.beside(folder))

    def ready(self) -> None:
        """Raise InputError where the extra is not installed, or files for encryption stand without a use for them."""
        if self.address is not None and (self.tls is not None) != self.address.startswith("tls://"):
            raise InputError("executor: tls goes with an address that begins with tls://, and such an address with tls")
        if self.tls is not None and self._place is None:
            raise InputError("executor: workers of this machine listen on its loopback address alone, without tls")
        library("distributed")

    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """In the order in which they are finished. Raises InputError where no fit worker answers, LostError."""
        if not arguments:
            return
        distributed = library("distributed")
        with self._client(distributed, len(arguments)) as client:
            suspects = []
            for number, outcome in _outcomes(distributed, client, function, dict(enumerate(arguments))):
                if isinstance(outcome, distributed.KilledWorker):
                    suspects.append(number)
                else:
                    yield arguments[number], outcome
            # Dask blames every task that was given to a worker that died: each of them is tried alone.
            for suspect in suspects:
                for number, outcome in _outcomes(distributed, client, function, {suspect: arguments[suspect]}):
                    guilty = isinstance(outcome, distributed.KilledWorker)
                    yield arguments[number], RuntimeError(DIED) if guilty else outcome

    @contextmanager
    def _client(self, distributed: Any, tasks: int) -> Iterator[Any]:
        """A client whose cluster is closed with it unless it ran before."""
        with ExitStack() as stack:
            stack.enter_context(_silence())
            stack.enter_context(library("dask").config.set(SCHEDULING))
            stack.enter_context(one_thread())
            where: dict[str, Any] = {"address": self.address, "scheduler_file": self.scheduler_file}
            if self._place is None:
                workers = min(self.workers or cores(), tasks)
                where = {"address": stack.enter_context(_of_this_machine(distributed, workers))}
            security = None if self.tls is None else self.tls.security()
            try:
                client = stack.enter_context(
                    distributed.Client(**where, timeout=self.wait_s, set_as_default=False, security=security)
                )
                client.wait_for_workers(1, timeout=self.wait_s)
            except (OSError, TimeoutError) as error:
                raise InputError(
                    f"executor: no Dask scheduler with workers answers at {self._place} within {self.wait_s:g} s"
                ) from error
            for worker, threads in client.nthreads().items():
                if threads != 1:
                    raise InputError(f"executor: the worker {worker} has {threads} threads; start it with --nthreads 1")
            yield client


def _of_this_machine(distributed: Any, workers: int) -> Any:
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        memory_limit=0,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",  # any free port: without one it is 8787, taken by whoever came first
        silence_logs=logging.CRITICAL,
        env=ONE_THREAD,
        preload=[__name__],
    )


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C and a closed terminal to the process that collects the results; Dask calls this by its name."""
    for number in ENDING:
        if number != signal.SIGTERM:
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def _silence() -> Iterator[None]:
    """Dask reports a lost scheduler in dozens of lines of its own; a user reads one sentence."""
    noisy = ("distributed", "tornado", "asyncio")
    names = [*noisy, *(name for name in logging.root.manager.loggerDict if name.partition(".")[0] in noisy)]
    before = {name: logging.getLogger(name).level for name in names}
    try:
        for name in names:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


def _outcomes(distributed: Any, client: Any, function: Function, tasks: dict[int, Any]) -> Iterator[tuple[int, Any]]:
    """(number, result or exception) of numbered tasks as they are finished."""
    numbers = {client.submit(function, argument, pure=False): number for number, argument in tasks.items()}
    for future in distributed.as_completed(list(numbers), loop=client.loop):
        try:
            outcome = future.result()
        except distributed.CancelledError as error:
            raise LostError(f"the Dask scheduler {client.scheduler.address} is gone") from error
        except Exception as error:
            outcome = error
        future.release()
        yield numbers.pop(future), outcome


def readable(path: Path, key: str) -> str:
    """The absolute path of a file that an executor names. Raises InputError where it cannot be read."""
    try:
        path.open("rb").close()
    except OSError as error:
        raise InputError(f"executor.{key}: {path}: cannot be read ({error.strerror})") from error
    return str(path.absolute())


def library(name: str) -> Any:
    """A module of the extra, imported where it is used. Raises InputError where it is missing."""
    with extra("cluster"):
        return import_module(name)
