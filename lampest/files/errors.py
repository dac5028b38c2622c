"""The one exception that stands for a user's mistake."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

# module → the package that brings it, where their names differ
PACKAGES = {
    "serial": "pyserial",
    "ruamel": "ruamel.yaml",
    "paho": "paho-mqtt",
    "pythonosc": "python-osc",
    "PIL": "pillow",
    "dateutil": "python-dateutil",
}


class InputError(ValueError):
    """What the user gave is wrong; the message is one clear sentence. Commands end with exit code 2.

    The sentence stays one printable line whatever a file's names and keys hold: other signs are written as escapes, and
    what is too long is cut in its middle.

    >>> issubclass(lampest.InputError, ValueError)
    True
    """

    def __init__(self, sentence: str) -> None:
        sentence = printable(sentence)
        if len(sentence) > 700:
            sentence = f"{sentence[:500]} ... {sentence[-200:]}"
        super().__init__(sentence)


def printable(text: str) -> str:
    """A text on one line that does nothing to a terminal: other signs are written as escapes."""
    return "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in text)


def meant(word: str, known: Iterable[str]) -> str:
    """'; did you mean reduced?' where one of the known words is close to what was typed, else nothing."""
    close = get_close_matches(word, list(known), 1, 0.65)  # one slip of the finger in four letters or more
    return f"; did you mean {close[0]}?" if close else ""


def in_words(value: Any) -> str:
    """What a user gave in place of something else: words and numbers as they are, of all else its class."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    return repr(value) if isinstance(value, str | int | float | None) else f"a {type(value).__name__}"


@contextmanager
def extra(name: str = "") -> Iterator[None]:
    """Imports of libraries that may be missing. Raises InputError where one is, with how it is installed.

    name : of the extra that brings them; '' for what every installation brings.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("lampest"):
            raise
        module = error.name.partition(".")[0]
        brings = f"lampest[{name}]" if name else PACKAGES.get(module, module)
        raise InputError(f"{error.name} is not installed; pip install '{brings}' brings it") from error
