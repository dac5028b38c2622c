"""Unions told apart by `kind`, so that a misspelt key is reported for the kind that was meant."""

import typing
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ByKind:
    """Marks Annotated[A | B, ByKind()]: validation picks the member whose `kind: Literal[...]` the input names."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """The tagged union of the members, one choice for each literal; called by the validating library."""
        choices = {
            name: handler.generate_schema(member)
            for member in typing.get_args(source)
            for name in typing.get_args(typing.get_type_hints(member)["kind"])
        }
        return {"type": "tagged-union", "discriminator": "kind", "choices": choices}
