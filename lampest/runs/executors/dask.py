"""Calls on a Dask cluster: one of this machine, one that runs already, or one of SLURM jobs."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

from lampest.files.errors import InputError
from lampest.runs.executors.cluster import Slurm, Tls, cluster_module
from lampest.runs.executors.executor import (
    DIED,
    MOST_TRIES,
    ONE_THREAD,
    Function,
    Pairs,
    check_workers,
    cores,
    one_thread,
)

PATIENCE_S = 30
# A worker is handed one task at a time where there are many.
SCHEDULING = {
    "distributed.scheduler.allowed-failures": MOST_TRIES - 1,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.scheduler.work-stealing": False,
}


@dataclass(frozen=True)
class Dask:
    """Workers of Dask distributed with one thread each; files must have the same paths everywhere.

    Parameters
    ----------
    workers : how many there are at most; as many as this machine has cores by default. Not with an address.
    address : of a scheduler that runs, such as tcp://host:8786; its workers: dask worker ADDRESS --nthreads 1.
    slurm : what a SLURM job asks for; the scheduler runs here.
    tls : files by which scheduler, workers and this computer know each other; with an address it begins with tls://.

    Without address and slurm the workers are processes of this machine. A worker that dies costs the task it was at one
    more try (as many as the scheduler grants at an address). Results are those of `Serial` bit for bit where the
    processors are of one kind. Raises ValueError where the parameters exclude each other.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["dask"] = "dask"
    workers: int | None = None
    address: str | None = None
    slurm: Slurm | None = None
    tls: Tls | None = None

    def __post_init__(self) -> None:
        check_workers(self.workers)
        if self.address is not None and (self.slurm is not None or self.workers is not None):
            raise ValueError("address names a cluster that runs; it goes with neither workers nor slurm")

    def beside(self, folder: Path) -> "Dask":
        """The same with its files taken from that folder. Raises InputError where one cannot be read."""
        return self if self.tls is None else replace(self, tls=self.tls.beside(folder))

    def ready(self) -> None:
        """Raise InputError where the extra is not installed, or files for encryption stand without a use for them."""
        if self.address is not None and (self.tls is not None) != self.address.startswith("tls://"):
            raise InputError("executor: tls goes with an address that begins with tls://, and such an address with tls")
        if self.tls is not None and self.address is None and self.slurm is None:
            raise InputError("executor: workers of this machine listen on its loopback address alone, without tls")
        cluster_module("distributed")
        if self.slurm is not None:
            cluster_module("dask_jobqueue")

    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """In the order in which they are finished. Raises InputError where no fit worker answers."""
        if not arguments:
            return
        distributed = cluster_module("distributed")
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
            stack.enter_context(cluster_module("dask").config.set(SCHEDULING))
            stack.enter_context(one_thread())
            place: Any = self.address
            if place is None:
                place = stack.enter_context(self._cluster(distributed, min(self.workers or cores(), tasks)))
            try:
                security = None if self.tls is None else self.tls.security()
                client = stack.enter_context(
                    distributed.Client(place, timeout=PATIENCE_S, set_as_default=False, security=security)
                )
                client.wait_for_workers(1, timeout=None if self.slurm else PATIENCE_S)
            except (OSError, TimeoutError) as error:
                raise InputError(f"executor: no Dask scheduler with workers answers at {self.address}") from error
            _check_threads(client)
            yield client

    def _cluster(self, distributed: Any, workers: int) -> Any:
        if self.slurm is None:
            return distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=0,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # any free port: without one it is 8787, taken by whoever came first
                silence_logs=logging.CRITICAL,
                env=ONE_THREAD,
                preload=["lampest.runs.executors.worker"],
            )
        cluster = self.slurm.cluster(self.tls)
        cluster.adapt(minimum_jobs=1, maximum_jobs=-(-workers // self.slurm.workers_per_job))
        return cluster


def _outcomes(distributed: Any, client: Any, function: Function, tasks: dict[int, Any]) -> Iterator[tuple[int, Any]]:
    """(number, result or exception) of numbered tasks as they are finished."""
    numbers = {client.submit(function, argument, pure=False): number for number, argument in tasks.items()}
    for future in distributed.as_completed(list(numbers), loop=client.loop):
        try:
            outcome = future.result()
        except Exception as error:
            outcome = error
        future.release()
        yield numbers.pop(future), outcome


def _check_threads(client: Any) -> None:
    """Raise InputError where a worker would run two cases at once, or one on several threads."""
    for worker, threads in client.nthreads().items():
        if threads != 1:
            raise InputError(f"executor: the worker {worker} has {threads} threads; start it with --nthreads 1")
