"""The public names of lampest as a page: their meaning, fields and methods."""

import dataclasses
import inspect
from collections.abc import Iterator
from typing import Any

from docstrings import documentation

import lampest

ROOMS = {
    "recording": "Recordings and readings",
    "panel": "Panel, circuit and scene",
    "estimate": "Estimators and methods",
    "cost": "Terms and losses",
    "report": "Results, tables and pictures",
    "runs": "Runs and results files",
    "loads": "Loads",
    "solvers": "How a solve ended",
    "files": "Errors",
}


def names_page() -> str:
    """All public names under the rooms they come from."""
    rooms: dict[str, list[str]] = {room: [] for room in ROOMS}
    for name in sorted(lampest.__all__, key=str.lower):
        rooms[room_of(name)].append(name)
    return "\n\n".join(
        f"## {ROOMS[room]}\n\n" + "\n\n".join(entry(name) for name in names)
        for room, names in rooms.items()
    )


def room_of(name: str) -> str:
    """Return the room that a name comes from.

    An object that is no class has the room of the module that defines its type.
    """
    if name == "reconstruct":
        return "report"
    thing = getattr(lampest, name)
    home = (
        getattr(thing, "__name__" if inspect.ismodule(thing) else "__module__", None)
        or "lampest.recording"
    )
    room = home.partition("lampest.")[2].partition(".")[0]
    return room if room in ROOMS else "panel"


def entry(name: str) -> str:
    """One name with its signature, as a directive of Sphinx's domain for Python."""
    thing = getattr(lampest, name)
    if inspect.isclass(thing):
        return (
            "::::::{py:class} "
            f"lampest.{name}{signature(thing)}\n{documentation(thing)}\n\n{members(thing)}\n::::::"
        )
    if inspect.isroutine(thing):
        return (
            "::::::{py:function} "
            f"lampest.{name}{signature(thing)}\n{documentation(thing)}\n::::::"
        )
    if inspect.ismodule(thing):
        inside = [
            each
            for each in vars(thing).values()
            if getattr(each, "__module__", "") == thing.__name__
        ]
        shown = [
            each
            for each in inside
            if inspect.isfunction(each) and not each.__name__.startswith("_")
        ]
        return "\n\n".join(
            "::::::{py:function} "
            f"lampest.{name}.{each.__name__}{signature(each)}\n{documentation(each)}\n::::::"
            for each in shown
        )
    return f"::::::{{py:data}} lampest.{name}\n`{thing!r}`\n::::::"


def signature(thing: Any) -> str:
    """(a, b=1): parameters with their defaults; types stand in the table of fields."""
    try:
        header = inspect.signature(thing)
    except ValueError:  # an exception's, for one
        return ""
    parameters = [
        each.replace(annotation=each.empty)
        for each in header.parameters.values()
        if each.name != "self"
    ]
    shown = [
        p.replace(default=Shown(p.default)) if p.default is not p.empty else p for p in parameters
    ]
    return str(header.replace(parameters=shown, return_annotation=header.empty))


class Shown:
    """A default as a reader would type it, without the addresses of objects."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __repr__(self) -> str:
        text = repr(self.value)
        return "..." if "<" in text or len(text) > 40 else text


def members(kind: type) -> str:
    """The fields of a dataclass, then methods and properties that the package documents."""
    parts = [*fields(kind)]
    for name, member in sorted(inspect.getmembers_static(kind)):
        plain = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        home = (
            getattr(
                getattr(plain, "fget", None) or getattr(plain, "func", None) or plain,
                "__module__",
                "",
            )
            or ""
        )
        if name.startswith("_") or not home.startswith("lampest") or not inspect.getdoc(plain):
            continue
        if inspect.isfunction(plain):
            parts.append(
                f":::::{{py:method}} {name}{signature(plain)}\n{documentation(plain)}\n:::::"
            )
        elif not inspect.isclass(plain):
            parts.append(f":::::{{py:property}} {name}\n{documentation(plain)}\n:::::")
    return "\n\n".join(parts)


def fields(kind: type) -> Iterator[str]:
    """A table of a dataclass's fields with their types and defaults."""
    if not dataclasses.is_dataclass(kind):
        return
    rows = [
        f"| `{field.name}` | `{kind_of(field.type)}` | {default(field)} |"
        for field in dataclasses.fields(kind)
        if not field.name.startswith("_") and field.init
    ]
    if rows:
        yield "\n".join(("| field | type | default |", "|---|---|---|", *rows))


def kind_of(annotation: Any) -> str:
    """A type as it is written, without the modules it comes from."""
    text = annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)
    words = text.replace(
        "numpy.ndarray[tuple[typing.Any, ...], numpy.dtype[numpy.float64]]", "Array"
    )
    for module in ("typing.", "collections.abc.", "numpy.", "pathlib."):
        words = words.replace(module, "")
    return " ".join(
        part.rpartition(".")[2] if part.startswith("lampest.") else part for part in words.split()
    ).replace("|", "\\|")


def default(field: Any) -> str:
    """A field's default, or nothing."""
    if field.default is not dataclasses.MISSING:
        return f"`{Shown(field.default)!r}`".replace("|", "\\|")
    return "" if field.default_factory is dataclasses.MISSING else "`...`"
