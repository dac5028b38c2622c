"""What installed packages add to lampest: objects that they name in a group of entry points."""

from functools import cache
from importlib.metadata import entry_points
from typing import TypeVar

from lampest.files.errors import InputError

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
