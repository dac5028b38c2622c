"""Where the cases of a batch run: here, in processes of this machine, or on a Dask cluster."""

from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Annotated, Any

from lampest.files.typed import ByKind
from lampest.runs.executors.dask import Dask, Tls
from lampest.runs.executors.processes import Executor, Function, LostError, Processes, Serial, Worker, cores

__all__ = [
    "AnyExecutor",
    "Dask",
    "Executor",
    "LostError",
    "Processes",
    "Serial",
    "Tls",
    "Worker",
    "each_of",
    "local",
]
AnyExecutor = Annotated[Serial | Processes | Dask, ByKind()]
FEW = 12  # so many tasks of half a second end before processes have started


def local(workers: int | None, tasks: int, apart: bool = False) -> Executor:
    """The executor of this machine for that many workers (None: one for each core), no more than there are tasks.

    apart : not in this process even if there is one worker, so that one that hangs can be ended.
    """
    workers = min(workers or cores(), tasks)
    return Processes(workers) if workers > 1 or (apart and tasks) else Serial()


def each_of(
    function: Function,
    things: Sequence[Any],
    on_done: Callable[[int, int], None] = lambda done, total: None,
    here: bool = False,
) -> list[Any]:
    """What a function makes of every thing, in their order; the first exception that a call raised is raised here.

    function : one that a process can import. on_done : called with how many of how many are done.
    here : in this process however many there are, because another could not import what the things are of.
    """
    executor: Executor = Processes() if len(things) > FEW and not here else Serial()
    found: dict[int, Any] = {}
    with closing(
        executor.results(_numbered, [(function, number, thing) for number, thing in enumerate(things)])
    ) as ends:
        for (_, number, _), outcome in ends:
            if isinstance(outcome, BaseException):
                raise outcome
            found[number] = outcome
            on_done(len(found), len(things))
    return [found[number] for number in range(len(things))]


def _numbered(task: tuple[Function, int, Any]) -> Any:
    function, _, thing = task
    return function(thing)
