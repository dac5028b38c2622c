"""Sweeps: one document with `sweep: {dotted.path: [values]}` → every combination as a validated object."""

import dataclasses
import itertools
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from lampest.files.document import UNKNOWN, Document, place_in
from lampest.files.errors import InputError

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Combination(Generic[Kind]):
    """One combination: what the sweep set, path → value, the document with it in place, and the validated object."""

    assignments: dict[str, Any]
    document: Document
    value: Kind


def expanded(document: Document) -> list[tuple[dict[str, Any], Document]]:
    """The Cartesian product of a document's sweep, the last path fastest: (path → value, document without the sweep).

    Paths lead through mapping keys and list indices; all but the last part must exist in the document, or be mappings
    that it leaves to their defaults. Raises InputError at the sweep's line where it is malformed or too large.
    """
    if not isinstance(document.content, dict) or "sweep" not in document.content:
        return [({}, document)]
    sweep = document.content["sweep"]
    if not isinstance(sweep, dict):
        raise document.error(("sweep",), "must be a mapping of dotted paths to lists of values")
    for path, values in sweep.items():
        if not isinstance(values, list) or not values:
            raise document.error(("sweep", path), "must be a list of at least one value")
        if path.split(".")[0] == "sweep":
            raise document.error(("sweep", path), "a sweep cannot vary itself")
    if math.prod(len(values) for values in sweep.values()) > 10_000:
        raise document.error(("sweep",), "more than 10000 combinations")
    rest = {key: item for key, item in document.content.items() if key != "sweep"}
    base = dataclasses.replace(document, content=rest)
    combinations = (dict(zip(sweep, values, strict=True)) for values in itertools.product(*sweep.values()))
    return [(assignments, with_assignments(base, assignments)) for assignments in combinations]


def combinations(document: Document, validate: Callable[[Document], Kind]) -> list[Combination[Kind]]:
    """Every combination of the document's sweep as what `validate` makes of it.

    Raises InputError: at its own position for a fault of the document, at the sweep's line for a path that names no
    place or a value that does not fit there.
    """
    return [
        Combination(assignments, varied, _validated(document, assignments, varied, validate))
        for assignments, varied in expanded(document)
    ]


def with_assignments(document: Document, assignments: dict[str, Any]) -> Document:
    """A copy with each dotted path set to its value. Raises InputError at a sweep's path that leads nowhere."""
    for path, value in assignments.items():
        try:
            document = document.with_value(path.split("."), value)
        except InputError as error:
            raise document.error(("sweep", path), _without_position(error)) from error
    return document


def _validated(
    document: Document, assignments: dict[str, Any], varied: Document, validate: Callable[[Document], Kind]
) -> Kind:
    try:
        value = validate(varied)
    except InputError as error:
        _blame(document, assignments, validate, error)
        raise
    for path in assignments:
        if not _is_place(document.content, value, path.split(".")):
            raise document.error(("sweep", path), "no such place in this document")
    return value


def _is_place(content: Any, value: Any, parts: list[str]) -> bool:
    """Whether the path leads through what the document holds or, where it is silent, through fields with defaults."""
    for part in parts:
        index = place_in(content, part)
        held = index is not None and (index in content if isinstance(content, dict) else index < len(content))
        if not held and isinstance(value, dict):
            return False
        content = content[index] if held else None
        if dataclasses.is_dataclass(value):
            value = getattr(value, part, None)
        elif isinstance(value, dict):
            value = value.get(part)
        else:
            value = None if not isinstance(value, list | tuple) or not isinstance(index, int) else value[index]
    return True


def _blame(
    document: Document, assignments: dict[str, Any], validate: Callable[[Document], Any], error: InputError
) -> None:
    """Raise at the sweep's line where the assignments spoil a document that is in order without them."""
    if not assignments:
        return
    base = dataclasses.replace(document, content={k: item for k, item in document.content.items() if k != "sweep"})
    if _fault(base, validate) is not None:
        return
    for path, value in assignments.items():
        fault = _fault(with_assignments(base, {path: value}), validate)
        if fault is not None:
            index = document.content["sweep"][path].index(value)
            location = ("sweep", path) if UNKNOWN in fault else ("sweep", path, index)
            raise document.error(location, fault) from error
    values = ", ".join(f"{path} = {value}" for path, value in assignments.items())
    raise document.error(("sweep",), f"with {values}: {_without_position(error)}") from error


def _fault(document: Document, validate: Callable[[Document], Any]) -> str | None:
    try:
        validate(document)
    except InputError as error:
        return _without_position(error)
    return None


def _without_position(error: InputError) -> str:
    return re.sub(r"^.*?:\d+:\d+: ", "", str(error), count=1)
