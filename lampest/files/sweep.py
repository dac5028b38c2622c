"""Sweeps: combinations of a document with `sweep: {dotted.path: [values]}`."""

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from lampest.files.document import UNKNOWN, Document, place_in
from lampest.files.errors import InputError, meant

MAX_COMBINATIONS = 10_000


@dataclass(frozen=True)
class Combination:
    """One combination of a sweep.

    Attributes
    ----------
    entry : str
        Entry of those swept separately to which it belongs; '' without such entries.
    assignments : dict
        Values set by the sweep, by path.
    document : Document
        The document with these values in place.
    value : object
        The validated object.
    """

    entry: str
    assignments: dict[str, Any]
    document: Document
    value: Any


def combinations(
    document: Document,
    validate: Callable[[Document], Any],
    apart: str = "",
    fixed: Mapping[str, str] | None = None,
) -> list[Combination]:
    """Return every combination of a document's sweep, the last path fastest.

    Parameters
    ----------
    document : Document
        Document whose sweep maps paths to lists of values. A path consists of mapping keys and list
        indices. All but its last part exist in the document, or are mappings with defaults.
    validate : callable
        Function that returns the validated object of a document.
    apart : str
        Mapping of the document whose entries are swept separately: a path below one of them varies
        that entry only, and every other path varies each of them. Without such a path an entry has
        one combination.
    fixed : mapping
        Reasons by entries that cannot be swept.

    Raises
    ------
    InputError
        With its own position for a fault of the document; with the sweep's line if the sweep is
        malformed or too large, if a path does not exist, or if a value does not fit.
    """
    content = document.content if isinstance(document.content, dict) else {}
    sweep = _checked_sweep(document, content.get("sweep", {}), apart, fixed or {})
    entries = content.get(apart)
    names = list(entries) if isinstance(entries, dict) and entries else [""]
    swept: dict[str, dict[str, list[Any]]] = {name: {} for name in names}
    for path, listed in sweep.items():
        first, *inner = path.split(".")
        separate = first == apart and inner[0] in names
        for name in inner[:1] if separate else names:
            swept[name][path] = listed
    if sum(math.prod(map(len, paths.values())) for paths in swept.values()) > MAX_COMBINATIONS:
        raise document.error(("sweep",), f"more than {MAX_COMBINATIONS} combinations")
    combined = []
    for entry, paths in swept.items():
        for values in itertools.product(*paths.values()):
            assignments = dict(zip(paths, values, strict=True))
            varied = _assigned(document, assignments)
            try:
                value = validate(varied)
            except InputError as error:
                raise _blamed(document, assignments, validate, error) from error
            for path in assignments:
                if not _is_place(document.content, value, path.split(".")):
                    first, *inner = path.split(".")
                    close = meant(inner[0], names) if first == apart and inner else ""
                    raise document.error(("sweep", path), f"no such place in this document{close}")
            combined.append(Combination(entry, assignments, varied, value))
    return combined


def _checked_sweep(
    document: Document, sweep: Any, apart: str, fixed: Mapping[str, str]
) -> dict[str, list[Any]]:
    """Return a document's sweep. Raises InputError as `combinations` if it is malformed."""
    if not isinstance(sweep, dict):
        raise document.error(("sweep",), "must be a mapping of dotted paths to lists of values")
    for path, values in sweep.items():
        if not isinstance(values, list) or not values:
            raise document.error(("sweep", path), "must be a list of at least one value")
        first = path.split(".")[0]
        if first == "sweep" or path == apart:
            raise document.error(("sweep", path), "a sweep varies keys below, or beside, this one")
        if first in fixed:
            raise document.error(("sweep", path), fixed[first])
    return sweep


def _assigned(document: Document, assignments: dict[str, Any]) -> Document:
    """Return the document without its sweep, with all assignments.

    Raises InputError if a path does not exist.
    """
    varied = document
    if isinstance(document.content, dict):
        content = {key: item for key, item in document.content.items() if key != "sweep"}
        varied = dataclasses.replace(document, content=content)
    for path, value in assignments.items():
        try:
            varied = varied.with_value(path.split("."), value)
        except InputError as error:
            raise document.error(("sweep", path), _without_position(error)) from error
    return varied


def _is_place(content: Any, value: Any, parts: list[str]) -> bool:
    """Return whether a path consists of entries of the document, or of fields with defaults."""
    for part in parts:
        try:
            content = content[place_in(content, part)]
        except (LookupError, TypeError):
            if isinstance(value, dict):
                return False
            content = None
        if isinstance(value, list | tuple):
            value = value[int(part)] if part.isdigit() else None
        else:
            value = value.get(part) if isinstance(value, dict) else getattr(value, part, None)
    return True


def _blamed(
    document: Document,
    assignments: dict[str, Any],
    validate: Callable[[Document], Any],
    error: InputError,
) -> InputError:
    """Return the error, at the sweep's line if the document is valid without the assignments."""
    if not assignments or _fault(_assigned(document, {}), validate):
        return error
    for path, value in assignments.items():
        fault = _fault(_assigned(document, {path: value}), validate)
        if UNKNOWN in fault:
            return document.error(("sweep", path), fault)
        if fault:
            index = document.content["sweep"][path].index(value)
            return document.error(("sweep", path, index), fault)
    values = ", ".join(f"{path} = {value}" for path, value in assignments.items())
    return document.error(("sweep",), f"with {values}: {_without_position(error)}")


def _fault(document: Document, validate: Callable[[Document], Any]) -> str:
    """Return the fault of a document; '' if it is valid."""
    try:
        validate(document)
    except InputError as error:
        return _without_position(error)
    return ""


def _without_position(error: InputError) -> str:
    """Return the message of an error without file, line and column."""
    return re.sub(r"^.*?:\d+:\d+: ", "", str(error))
