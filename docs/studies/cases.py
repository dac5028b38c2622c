"""Measurements of the cases of a run, for studies that read a run's file."""

from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

from lampest.apps.studies.study import OnStep
from lampest.files.errors import InputError
from lampest.runs.config import Case, Run
from lampest.runs.executors import Serial, each_of

Measured = TypeVar("Measured")


class Cases(NamedTuple, Generic[Measured]):
    """Measurements of the cases of a run, and sentences on omitted cases."""

    measured: Sequence[Measured]
    left_out: Sequence[str]


def of_cases(
    function: Callable[[Case], Sequence[Measured] | str],
    run: Run,
    on_step: OnStep,
    purpose: str = "measure",
) -> Cases[Measured]:
    """Return the measurements of a function for all cases of a run in order.

    If the function returns a text, the case is omitted for this reason. `on_step` receives the
    numbers of finished and of all cases. Raises InputError if all cases are omitted.
    """
    results = each_of(function, run.cases, on_step, Serial())
    names = [f"{case.recording}/{case.name}" for case in run.cases]
    measured = [record for result in results if not isinstance(result, str) for record in result]
    left_out = {name: why for name, why in zip(names, results, strict=True) if isinstance(why, str)}
    if not measured:
        raise InputError(
            f"nothing to {purpose}: {'; '.join(f'{name}: {why}' for name, why in left_out.items())}"
        )
    return Cases(measured, [f"{name} left out: {why}" for name, why in left_out.items()])
