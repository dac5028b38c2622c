"""Every configuration of the package, recognised by its type, and examples of each.

The types of the fields alone determine the examples.

A new configuration, and a new member of a union (a term, a loss, a load, a method, an executor, a
readout), is seen here without being named.
"""

import dataclasses
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

import lampest
from lampest.files.document import INLINE
from lampest.files.typed import ByKind, shipped

# Ordinary numbers, the ends of usual ranges, and such as lose digits or change type where text is
# careless.
NUMBERS: dict[type, tuple[Any, ...]] = {
    bool: (True, False),
    int: (2, 3, 8, 1, 5, 12, 0, 64),
    float: (0.25, 2.0, 1 / 3, 8.0, 25.0, 1e-3, -2.5, -12.0, 60.0, 0.0, 1e16, 1.7e-29),
}
# Names, and words that YAML would take for something else than a text.
TEXTS = (
    "LSM",
    "a b",
    "yes",
    "null",
    "1e-3",
    "007",
    "12:30",
    "~",
    "a: b # c",
    "λ",
    "",
    " led",
    "two\nlines",
    "'\"",
)
# a field → those that follow from it
DECIDED = {"modules": ("rows", "columns", "pitch_mm", "cells")}
# a field → those that have to be there for it
NEEDED = {
    "idle_volt": ("idle_ohm", "driven_groups"),
    "idle_load_volt": ("idle_load_ohm",),
    "driven_groups": ("idle_ohm", "idle_volt"),
    "drive_volt": ("polarity",),
    "converter_volt": ("polarity",),
    "groups": ("measured_across",),
    "idle_stays": ("idle_ohm", "idle_volt", "diode"),
    "idle_load_ohm": ("sense",),
}
TRIES = 2000


@cache
def configurations() -> tuple[type, ...]:
    """Every class of the package that YAML is validated into, in the order of modules."""
    modules = [
        import_module(info.name) for info in pkgutil.walk_packages(lampest.__path__, "lampest.")
    ]
    return tuple(
        kind
        for module in modules
        for kind in vars(module).values()
        if isinstance(kind, type) and kind.__module__ == module.__name__
        if hasattr(kind, "__pydantic_config__")
        and dataclasses.is_dataclass(kind)
        and not inspect.isabstract(kind)
    )


def hints(kind: type) -> dict[str, Any]:
    """Field → type of a configuration, but for keys that installed applications add."""
    types = get_type_hints(kind, include_extras=True)
    fields = (field for field in dataclasses.fields(kind) if not field.metadata.get(INLINE))
    return {field.name: types[field.name] for field in fields}


def parts(hint: Any) -> Iterator[Any]:
    """A type and all types within it."""
    yield hint
    if get_origin(hint) is not Literal:
        for part in shipped(hint) if is_by_kind(hint) else get_args(hint):
            yield from parts(part)


def is_by_kind(hint: Any) -> bool:
    """Whether a type is a union whose members differ by `kind`."""
    return get_origin(hint) is Annotated and isinstance(get_args(hint)[1], ByKind)


@cache
def unions() -> tuple[tuple[type, ...], ...]:
    """Return the members of every union whose members differ by `kind`."""
    members = [
        shipped(part)
        for kind in configurations()
        for hint in hints(kind).values()
        for part in parts(hint)
        if is_by_kind(part)
    ]
    return tuple(dict.fromkeys(members))


def members_of(hint: Any) -> tuple[type, ...]:
    """The classes that a field of this type takes; None, where it takes that, is none."""
    return tuple(
        part for part in parts(hint) if dataclasses.is_dataclass(part) and isinstance(part, type)
    )


def words(member: type) -> tuple[str, ...]:
    """The kinds by which a member of a union goes."""
    return get_args(hints(member)["kind"])


def is_open(field: dataclasses.Field[Any]) -> bool:
    """Whether a field has no default."""
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


@cache
def examples(kind: type) -> tuple[Any, ...]:
    """Return configurations of a class, the first one with its defaults.

    For every field another configuration differs there.
    """
    rng = np.random.default_rng(1)
    first = attempted(lambda: kind(**arguments(kind, rng)), lambda made: True)
    return (
        first,
        *(
            varied(first, name, hint, rng)
            for name, hint in hints(kind).items()
            if not is_settled(hint)
        ),
    )


def arguments(kind: type, rng: np.random.Generator) -> dict[str, Any]:
    """A value for every field without a default and for few of the others, if one is needed."""
    types = hints(kind)
    fields = (field for field in dataclasses.fields(kind) if field.name in types)
    given = (field.name for field in fields if is_open(field) or rng.random() < 0.1)
    return {name: value(types[name], rng) for name in given}


def is_settled(hint: Any) -> bool:
    """Whether a field of this type can have one value alone, as a `kind` of one word has."""
    return get_origin(hint) is Literal and len(get_args(hint)) == 1


def varied(first: Any, name: str, hint: Any, rng: np.random.Generator) -> Any:
    """The same with another value of one field, and of those that it decides."""
    decided = {
        field.name: field.default
        for field in dataclasses.fields(first)
        if field.name in DECIDED.get(name, ())
    }
    needed = [field for field in NEEDED.get(name, ()) if field in hints(type(first))]

    def drawn() -> dict[str, Any]:
        """Return values of half of the needed fields, and defaults of the others."""
        defaults = {field.name: field.default for field in dataclasses.fields(first)}
        return {
            field: value(hints(type(first))[field], rng) if rng.random() < 0.5 else defaults[field]
            for field in needed
        }

    return attempted(
        lambda: dataclasses.replace(first, **decided, **drawn(), **{name: value(hint, rng)}),
        lambda candidate: getattr(candidate, name) != getattr(first, name),
    )


def attempted(make: Callable[[], Any], fits: Callable[[Any], bool]) -> Any:
    """Return a random example as soon as it keeps its own rules and fits."""
    for _ in range(TRIES):
        try:
            made = make()
        except ValueError:
            continue
        if fits(made):
            return made
    raise AssertionError(f"no example after {TRIES} tries; give its types more values")


def value(hint: Any, rng: np.random.Generator) -> Any:
    """Some value of a type."""
    origin = get_origin(hint)
    inner = get_args(hint)
    if hint is NoneType:
        return None
    if hint in NUMBERS:
        return chosen(NUMBERS[hint], rng)
    if hint in (str, Any):
        return chosen(TEXTS, rng)
    if is_by_kind(hint):
        return value(chosen(shipped(hint), rng), rng)
    if origin is Annotated:
        return value(inner[0], rng)
    if origin in (Union, UnionType):
        return value(chosen(inner, rng), rng)
    if origin is Literal:
        return chosen(inner, rng)
    if origin is dict:
        return {chosen(TEXTS, rng): value(inner[1], rng) for _ in range(rng.integers(3))}
    if origin is list or (origin is tuple and inner[-1] is Ellipsis):
        return origin(value(inner[0], rng) for _ in range(rng.integers(3)))
    if origin is tuple:
        return tuple(value(part, rng) for part in inner)
    assert dataclasses.is_dataclass(hint), f"values of {hint} cannot be made"
    return chosen(examples(hint), rng)


def chosen(values: tuple[Any, ...], rng: np.random.Generator) -> Any:
    """One of them."""
    return values[rng.integers(len(values))]
