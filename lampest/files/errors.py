"""Exception for users' mistakes, and helpers for its messages."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from difflib import get_close_matches
from typing import Any

# What brings a module, where its package has another name or is in an extra that many parts of
# lampest need.
PACKAGES = {
    "matplotlib": "lampest[plots]",
    "serial": "pyserial",
    "ruamel": "ruamel.yaml",
    "paho": "paho-mqtt",
    "pythonosc": "python-osc",
    "PIL": "pillow",
    "dateutil": "python-dateutil",
}

# Raised by numpy, LAPACK, SuperLU and CasADi for numbers with which they cannot compute.
BROKEN = (ArithmeticError, ValueError, RuntimeError)


class InputError(ValueError):
    """Mistake of the user, described in one sentence; commands end with exit code 2.

    The message is one printable line whatever names and keys a file holds: control characters are
    written as escapes, and a long message is cut in its middle.

    >>> isinstance(lampest.InputError("no such file"), ValueError)
    True
    """

    def __init__(self, sentence: str) -> None:
        sentence = printable(sentence)
        if len(sentence) > 700:
            sentence = f"{sentence[:500]} ... {sentence[-200:]}"
        super().__init__(sentence)


def printable(text: str) -> str:
    """Return a text as one line without control characters, which are written as escapes."""
    return "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in text)


def meant(word: str, known: Iterable[str]) -> str:
    """Return '; did you mean reduced?' if a known word is similar to the typed one, else ''."""
    # One typing error in four letters or more.
    close = get_close_matches(word, list(known), 1, 0.65)
    return f"; did you mean {close[0]}?" if close else ""


def counted(number: int, noun: str) -> str:
    """Return a count with its noun, such as '1 recording' or '1,200 frames'."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def first_and_more(items: Sequence[Any], most: int = 10) -> str:
    """Return '3, 5 and 7 more': the first items, and the number of those beyond `most`."""
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(map(str, items[:most])) + more


def in_words(value: Any) -> str:
    """Return a value for messages: words and numbers unchanged, other values by their class."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    return (
        repr(value) if isinstance(value, str | int | float | None) else f"a {type(value).__name__}"
    )


def brief(value: Any) -> str:
    """Return a dataclass in one line, for notebooks.

    Arrays are given by their shapes, collections by their lengths.
    """
    parts = []
    for field in fields(value):
        content = getattr(value, field.name)
        if content is None:
            continue
        shape = getattr(content, "shape", None)
        if isinstance(shape, tuple) and shape:
            text = " × ".join(map(str, shape))
        elif isinstance(content, tuple | list | dict):
            text = counted(len(content), "item")
        elif isinstance(content, float):
            text = f"{content:.4g}"
        else:
            text = str(content) if isinstance(content, str | int) else type(content).__name__
        # Longer texts are files' contents, and sentences.
        if len(text) <= 40 and text.isprintable():
            parts.append(f"{field.name}={text}")
    shown = ", ".join(parts[:12]) + ", ..." * (len(parts) > 12)
    return f"{type(value).__name__}({shown})"


@contextmanager
def extra(name: str = "") -> Iterator[None]:
    """Raise InputError with the command that installs a library if its import fails.

    The import is one within the block. `name` is the extra that contains the library; '' for
    libraries of every installation, and for matplotlib.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("lampest"):
            raise
        module = error.name.partition(".")[0]
        brings = f"lampest[{name}]" if name else PACKAGES.get(module, module)
        raise InputError(
            f"{error.name} is not installed; pip install '{brings}' brings it"
        ) from error
