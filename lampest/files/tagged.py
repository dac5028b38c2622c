"""Unions told apart by `kind`, so that a misspelt key is reported for the kind that was meant."""

import typing
from dataclasses import dataclass
from typing import Any

from lampest.files.plugins import installed


@dataclass(frozen=True)
class ByKind:
    """Marks Annotated[A | B, ByKind()]: validation picks the member whose `kind: Literal[...]` the input names.

    group : of entry points by which installed packages add members; '' for none. default : the kind that is meant where
    the input names none; '' where it must.
    """

    group: str = ""
    default: str = ""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """The tagged union of the members, one choice for each literal; called by the validating library."""
        choices = {
            name: handler.generate_schema(member)
            for member in (*typing.get_args(source), *extra(self.group))
            for name in kinds_of(member)
        }
        tag = self._tag if self.default else "kind"
        return {"type": "tagged-union", "discriminator": tag, "choices": choices}

    def _tag(self, value: Any) -> Any:
        return value.get("kind", self.default) if isinstance(value, dict) else getattr(value, "kind", None)


def kinds_of(member: Any) -> tuple[str, ...]:
    """The words that a class's `kind: Literal[...]` allows."""
    return typing.get_args(typing.get_type_hints(member)["kind"])


def members_of(union: Any) -> tuple[type[Any], ...]:
    """The classes of Annotated[A | B, ByKind(group)], those of installed packages included."""
    inner, mark = typing.get_args(union)
    return (*typing.get_args(inner), *extra(mark.group))


def extra(group: str) -> tuple[type[Any], ...]:
    """The classes that installed packages name in a group of entry points; none without a group."""
    return installed(group, type) if group else ()
