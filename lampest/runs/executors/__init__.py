"""Where the cases of a batch run: here, in processes of this machine, or on a Dask cluster."""

from typing import Annotated

from lampest.files.tagged import ByKind
from lampest.runs.executors.cluster import Slurm, Tls
from lampest.runs.executors.dask import Dask
from lampest.runs.executors.executor import ONE_THREAD, Executor, cores
from lampest.runs.executors.processes import Processes
from lampest.runs.executors.serial import Serial
from lampest.runs.executors.together import each_of

__all__ = ["ONE_THREAD", "AnyExecutor", "Dask", "Executor", "Processes", "Serial", "Slurm", "Tls", "each_of", "local"]
AnyExecutor = Annotated[Serial | Processes | Dask, ByKind()]


def local(workers: int | None, tasks: int, apart: bool = False) -> Executor:
    """The executor of this machine for that many workers (None: one for each core), no more than there are tasks.

    apart : not in this process even if there is one worker, so that one that hangs can be ended.
    """
    workers = min(workers or cores(), tasks)
    return Processes(workers) if workers > 1 or (apart and tasks) else Serial()
