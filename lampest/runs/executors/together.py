"""One function of many things, each on its own: in processes of this machine where that pays."""

from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any

from lampest.runs.executors.executor import Executor, Function
from lampest.runs.executors.processes import Processes
from lampest.runs.executors.serial import Serial

FEW = 12  # so many tasks of half a second end before processes have started


def each_of(
    function: Function,
    things: Sequence[Any],
    on_done: Callable[[int, int], None] = lambda done, total: None,
    here: bool = False,
) -> list[Any]:
    """What a function makes of every thing, in their order; the first exception that a call raised is raised here.

    function : one that a process can import. on_done : told how many of how many are done.
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
