"""Public names of the package document themselves, or inherit a docstring."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from typing import Any

import pytest

import lampest

MODULES = [name for _, name, _ in pkgutil.walk_packages(lampest.__path__, "lampest.")]


def documented(module: Any) -> Iterator[tuple[str, Any]]:
    """(name, object) of the public classes and functions that a module defines, and of the classes' methods."""
    for name, thing in vars(module).items():
        if name.startswith("_") or getattr(thing, "__module__", None) != module.__name__:
            continue
        if inspect.isclass(thing):
            yield name, thing
            for part, member in vars(thing).items():
                own = inspect.isfunction(member) or isinstance(member, property | classmethod | staticmethod)
                if own and not part.startswith("_") and part not in inspect.get_annotations(thing):  # no default
                    yield f"{name}.{part}", getattr(thing, part)
        elif callable(thing) and inspect.isfunction(inspect.unwrap(thing)) and thing.__name__ == name:
            yield name, thing


@pytest.mark.parametrize("name", MODULES)
def test_public_names_are_documented(name: str) -> None:
    module = importlib.import_module(name)
    texts = {member: inspect.getdoc(thing) or "" for member, thing in documented(module)}
    assert [member for member, text in texts.items() if not text] == []
    assert [member for member, text in texts.items() if text.startswith("What ")] == []
