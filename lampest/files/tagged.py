"""Unions told apart by `kind`, with what installed packages add to them."""

import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from typing import Any, TypeVar

from lampest.files.errors import InputError
from lampest.files.typed import Configuration, Validated

Kind = TypeVar("Kind")


@cache
def installed(group: str, kind: type[Kind]) -> tuple[Kind, ...]:
    """The objects of a kind that installed packages name in a group, in the order of the names.

    Raises InputError where one cannot be loaded or is of another kind.
    """
    objects = []
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        try:
            thing = point.load()
        except Exception as error:  # whatever the package does when it is imported
            raise InputError(
                f"{group}: {point.name} = {point.value} of an installed package cannot be loaded ({error})"
            ) from error
        if not isinstance(thing, kind):
            raise InputError(f"{group}: {point.name} = {point.value} of an installed package is no {kind.__name__}")
        objects.append(thing)
    return tuple(objects)


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
        members = typing.get_args(source)
        choices = {
            kind: handler.generate_schema(member)
            for member in (*members, *_installed_members(members, self.group))
            for kind in kinds_of(member)
        }
        tag = self._tag if self.default else "kind"
        tagged = {"type": "tagged-union", "discriminator": tag, "choices": choices}
        base = _base(members)
        # From Python an object of a class that nothing names, derived in a notebook, is one of them, too.
        made = {"type": "is-instance", "cls": base}
        either = {"type": "union", "choices": [made, tagged], "mode": "left_to_right"}
        own = base not in (object, Configuration, Validated)
        return {"type": "json-or-python", "json_schema": tagged, "python_schema": either if own else tagged}

    def _tag(self, value: Any) -> Any:
        return value.get("kind", self.default) if isinstance(value, dict) else getattr(value, "kind", None)


def kinds_of(member: Any) -> tuple[str, ...]:
    """The words that a class's `kind: Literal[...]` allows; none where it has no such field."""
    return typing.get_args(typing.get_type_hints(member).get("kind"))


def shipped(union: Any) -> tuple[type[Any], ...]:
    """The classes of Annotated[A | B, ByKind(group)] without those of installed packages.

    For what is made when a module is imported: packages import that module themselves, and cannot be loaded before it.
    """
    return typing.get_args(typing.get_args(union)[0])


def members_of(union: Any) -> tuple[type[Any], ...]:
    """The classes of Annotated[A | B, ByKind(group)], those of installed packages included.

    Raises InputError where a package names something else, or a class without a word of its own as `kind`.
    """
    return (*shipped(union), *_installed_members(shipped(union), typing.get_args(union)[1].group))


def members_by_kind(union: Any) -> dict[str, type[Any]]:
    """kind → class, for every word of every member. Raises InputError as `members_of`."""
    return {kind: member for member in members_of(union) for kind in kinds_of(member)}


def _base(members: tuple[type[Any], ...]) -> type[Any]:
    """The nearest class that all members derive from."""
    return next(kind for kind in members[0].__mro__ if all(issubclass(member, kind) for member in members))


def _installed_members(members: tuple[type[Any], ...], group: str) -> Iterator[type[Any]]:
    """What installed packages add to the members of a union."""
    base = _base(members)
    taken = [kind for member in members for kind in kinds_of(member)]
    for added in installed(group, type) if group else ():
        named = f"{group}: {added.__name__} of an installed package"
        if not issubclass(added, base):
            raise InputError(f"{named} is no {base.__name__}")
        kinds = kinds_of(added)
        if not kinds or not set(kinds).isdisjoint(taken):
            raise InputError(f"{named} needs kind: Literal['...'] with a word other than {', '.join(taken)}")
        taken += kinds
        yield added
