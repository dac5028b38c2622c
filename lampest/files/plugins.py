"""What installed packages add to lampest: objects that they name in a group of entry points."""

from functools import cache
from importlib.metadata import entry_points
from typing import Any, TypeVar

from lampest.files.errors import InputError

Kind = TypeVar("Kind")


def installed(group: str, kind: type[Kind]) -> tuple[Kind, ...]:
    """The objects of a kind that installed packages name in a group, in the order of the names.

    Raises InputError where one cannot be loaded or is of another kind.
    """
    for text, thing in loaded(group):
        if not isinstance(thing, kind):
            raise InputError(f"{group}: {text} of an installed package is no {kind.__name__}")
    return tuple(thing for _, thing in loaded(group))


@cache  # looking through all packages takes tens of milliseconds
def loaded(group: str) -> tuple[tuple[str, Any], ...]:
    """(name = where it is, object) of everything that is named in a group. Raises InputError as `installed`."""
    objects = []
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        text = f"{point.name} = {point.value}"
        try:
            objects.append((text, point.load()))
        except Exception as error:  # whatever the package does when it is imported
            raise InputError(f"{group}: {text} of an installed package cannot be loaded ({error})") from error
    return tuple(objects)
