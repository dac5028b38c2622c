"""One call after the other, here."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from lampest.files.interrupts import interrupted
from lampest.runs.executors.executor import Function, Pairs


@dataclass(frozen=True)
class Serial:
    """One call after the other in this process."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    kind: Literal["serial"] = "serial"

    def ready(self) -> None:
        """Always."""

    def results(self, function: Function, arguments: Sequence[Any]) -> Pairs:
        """In the order of the arguments."""
        for argument in arguments:
            try:
                outcome = function(argument)
            except Exception as error:
                if interrupted(error):
                    raise KeyboardInterrupt from error
                outcome = error
            yield argument, outcome
