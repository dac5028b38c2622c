"""Public names of the package document themselves, or inherit a docstring."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from typing import Any

import lampest


def documented(module: Any) -> Iterator[tuple[str, Any]]:
    """Yield (name, object) of a module's public classes, their methods, and functions."""
    for name, definition in vars(module).items():
        if name.startswith("_") or getattr(definition, "__module__", None) != module.__name__:
            continue
        if inspect.isclass(definition):
            yield name, definition
            for part, member in vars(definition).items():
                own = inspect.isfunction(member) or isinstance(
                    member, property | classmethod | staticmethod
                )
                # No default.
                if (
                    own
                    and not part.startswith("_")
                    and part not in inspect.get_annotations(definition)
                ):
                    yield f"{name}.{part}", getattr(definition, part)
        elif (
            callable(definition)
            and inspect.isfunction(inspect.unwrap(definition))
            and definition.__name__ == name
        ):
            yield name, definition


def test_public_names_are_documented() -> None:
    modules = [name for _, name, _ in pkgutil.walk_packages(lampest.__path__, "lampest.")]
    texts = {
        f"{name}.{member}": inspect.getdoc(definition) or ""
        for name in modules
        for member, definition in documented(importlib.import_module(name))
    }
    assert [member for member, text in texts.items() if not text] == []
    assert [member for member, text in texts.items() if text.startswith("What ")] == []
