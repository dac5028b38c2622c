"""Libraries that not everybody has: the extras of `pip install 'lampest[...]'`."""

from collections.abc import Iterator
from contextlib import contextmanager

from lampest.files.errors import InputError


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Imports of an extra's libraries. Raises InputError where one is not installed, with how to install it."""
    try:
        yield
    except ImportError as error:
        raise InputError(f"{error.name} is not installed; pip install lampest[{name}] brings it") from error
