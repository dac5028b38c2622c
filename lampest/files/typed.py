"""Type checks of arguments at construction, and unions by `kind` that installed packages extend."""

import inspect
import json
from abc import ABCMeta
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache, cached_property, partial, wraps
from itertools import chain
from math import inf
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    ParamSpec,
    Self,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from lampest.files.applications import GROUPS, applications, entry_points_of, loaded
from lampest.files.document import MAX_NUMBER, MIN_NUMBER, adapter, conformed, schema_of
from lampest.files.errors import InputError, in_words

P = ParamSpec("P")
R = TypeVar("R")
Kind = TypeVar("Kind")


class Checked(ABCMeta):
    """Metaclass that validates the arguments of dataclasses and their subclasses by field types."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        """Return an object.

        Raises InputError if an argument has another type, is missing, unknown, or out of range.
        """
        try:
            if issubclass(cls, Completed):
                kwargs = cls.completed(kwargs)
            return super().__call__(**_arguments(cls, cls.__name__, args, kwargs))
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{cls.__name__}: {error}") from error

    @property
    def __signature__(cls) -> inspect.Signature:
        """Signature of the fields, for editors and documentation."""
        return _signature(cls)


class ReadOnlyArrays:
    """Mixin of frozen objects: arrays of fields and of cached properties are read-only.

    Those of copies and pickles are as well. Other names of the same arrays stay as they are.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for attribute in vars(cls).values():
            if isinstance(attribute, cached_property):
                attribute.func = partial(_read_only_result, attribute.func)

    def __post_init__(self) -> None:
        self.__setstate__(vars(self))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update({name: read_only(value) for name, value in state.items()})


def _read_only_result(method: Callable[[Any], Any], owner: Any) -> Any:
    """Return the result of an object's method with read-only arrays."""
    return read_only(method(owner))


class Validated(ReadOnlyArrays, metaclass=Checked):
    """Base of dataclasses that validate their arguments in Python.

    YAML is validated by pydantic itself.
    """


class Configuration(Validated):
    """Base of dataclasses made from YAML; unknown keys and numbers out of range are errors."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}


class Completed(Configuration):
    """Base of configurations whose content is completed before it is validated."""

    @classmethod
    def completed(cls, content: Any) -> Any:
        """Return arguments, or the content of a file, with what follows from other entries."""
        return content


class Extensible(Completed):
    """Base of configurations to which installed packages add keys.

    A subclass has a field `own` of pairs (key, value), with the metadata INLINE.
    """

    own: tuple[tuple[str, Any], ...]

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """Return the schema of the fields, with further keys in `own`. Called by pydantic."""
        completed = {"type": "no-info", "function": cls.completed}
        return {"type": "function-before", "function": completed, "schema": handler(source)}

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> Any:
        """Return the JSON schema, with added keys in the place of `own`. Called by pydantic."""
        made = handler(schema)
        properties = handler.resolve_ref_schema(made)["properties"]
        if properties.pop("own", None) is not None:
            properties |= {key: {} for key in cls.added_keys()}
        return made

    @classmethod
    def added_keys(cls) -> Iterable[str]:
        """Return the keys that installed packages add."""
        return ()

    @classmethod
    def completed(cls, content: Any) -> Any:
        """Return arguments, or the content of a file, with added keys in `own`."""
        if not isinstance(content, dict):
            return content
        unknown = content.keys() - _signature(cls).parameters.keys()
        added = unknown.intersection(cls.added_keys()) if unknown else unknown
        if not added:
            return content
        own = (*content.get("own", ()), *((key, content[key]) for key in content if key in added))
        return {key: content[key] for key in content if key not in added} | {"own": own}

    def entry(self, key: str) -> Any:
        """Return the value of a key, also of an added one; None without it."""
        return dict(self.own).get(key, getattr(self, key, None))

    def size(self, key: str) -> float:
        """Return the number of a key, also of an added one; 0 without it."""
        return float(self.entry(key) or 0.0)

    def with_entries(self, entries: Mapping[str, Any]) -> Self:
        """Return the configuration with other values of some keys, also of added ones."""
        fields = _signature(type(self)).parameters
        plain = {key: value for key, value in entries.items() if key in fields}
        own = dict(self.own) | {key: value for key, value in entries.items() if key not in plain}
        made: Any = self
        return cast(Self, replace(made, **plain, own=tuple(own.items())))


def typed(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that raises InputError if an argument has another type than annotated."""

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        made: Callable[..., R] = function
        return made(**_arguments(function, function.__name__, args, kwargs))

    return called


def check_range(
    name: str, numbers: float | Iterable[float], low: float, high: float, unit: str = ""
) -> None:
    """Raise ValueError unless a number, or each of several, lies within a range."""
    for number in [numbers] if isinstance(numbers, int | float) else numbers:
        if not low <= number <= high:
            raise ValueError(f"{name} must lie between {low:.15g} and {high:.15g}{unit}")


def check_ranges(owner: Any, low: float, high: float, *names: str) -> None:
    """Raise ValueError unless each named field of an object is None or lies within a range."""
    for name in names:
        value = getattr(owner, name)
        if value is not None:
            check_range(name, value, low, high)


def check_positive_fields(owner: Any, *names: str) -> None:
    """Raise ValueError unless each named field of an object is None, or positive and finite."""
    for name in names:
        value = getattr(owner, name)
        if value is not None and not 0 < value < inf:
            raise ValueError(f"{name} must be positive and finite")


def check_not_negative(owner: Any, *names: str) -> None:
    """Raise ValueError unless each named field is None, or zero or positive, and finite.

    The fields are those of an object.
    """
    for name in names:
        value = getattr(owner, name)
        if value is not None and not 0 <= value < inf:
            raise ValueError(f"{name} must be zero or positive, and finite")


def real_array(values: Any, label: str) -> NDArray[Any]:
    """Return numbers as an array.

    Raises InputError for complex, masked and ragged arrays, and for other objects.
    """
    if isinstance(values, np.ma.MaskedArray):
        raise InputError(f"{label}: a masked array; fill it with NaN: values.filled(numpy.nan)")
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InputError(f"{label}: {in_words(values)} is no array of numbers") from error
    if array.dtype.kind not in "iufb" or values is None:
        kind = "complex numbers" if array.dtype.kind == "c" else in_words(values)
        raise InputError(f"{label}: {kind}, where an array of real numbers is needed")
    return as_double(array)


def read_only(value: Any) -> Any:
    """Return read-only views of an array or of those in a tuple or dict; else the value itself."""
    if type(value) is tuple:
        return tuple(map(read_only, value))
    if type(value) is dict:
        return {name: read_only(item) for name, item in value.items()}
    if not isinstance(value, np.ndarray) or not value.flags.writeable:
        return value
    view = value.view()
    view.flags.writeable = False
    return view


def as_double(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array without extended precision (`longdouble`).

    No solver and no linear algebra takes that.
    """
    is_extended = array.dtype.kind == "f" and array.dtype.itemsize > 8
    return array.astype(np.float64) if is_extended else array


def _arguments(
    owner: Any, name: str, args: Sequence[Any], kwargs: dict[str, Any]
) -> dict[str, Any]:
    """Return validated arguments by parameter."""
    signature = _signature(owner)
    arguments = kwargs
    # `dataclasses.replace` names all of them
    if args or kwargs.keys() != signature.parameters.keys():
        try:
            arguments = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            raise InputError(f"{name}: {error}") from error
    checks = _checks(owner)
    return {
        word: checks[word](value, f"{name}: {word}") if word in checks else value
        for word, value in arguments.items()
    }


@cache
def _signature(owner: Any) -> inspect.Signature:
    """Return the signature of a function, or that of a class's `__init__` without self."""
    if not isinstance(owner, type):
        return inspect.signature(owner)
    made: Any = owner
    return inspect.Signature(list(inspect.signature(made.__init__).parameters.values())[1:])


@cache
def _checks(owner: Any) -> dict[str, Callable[[Any, str], Any]]:
    """Return functions (value, label) → validated value by parameter."""
    try:
        hints = get_type_hints(owner, include_extras=True)
    except NameError:  # a class in a notebook, or types that are imported for type checkers only
        return {}
    return {word: _check_of(hint) for word, hint in hints.items()}


def _check_of(hint: Any) -> Callable[[Any, str], Any]:
    """Return a function (value, label) → validated argument of a type.

    The schema of the type is made when an argument needs it.
    """
    parts = _alternatives(hint)
    kinds = tuple(part for part in parts if isinstance(part, type))
    is_array = any(get_origin(part) is np.ndarray for part in parts)
    dtype = np.float64 if "float64" in str(hint) else None
    finished = _finished(parts)
    # Types of the items of the one sequence among the alternatives
    sequences = [
        get_args(part)[0]
        for part in parts
        if get_origin(part) is Sequence or get_args(part)[1:] == (Ellipsis,)
    ]
    parts_of_item = _alternatives(sequences[0]) if len(sequences) == 1 else ()
    items = _finished(parts_of_item)

    def checked(value: Any, label: str) -> Any:
        if isinstance(value, finished) or _is_plain(value, parts):
            return value
        if (
            parts_of_item
            and type(value) in (list, tuple)
            and all(isinstance(item, items) or _is_plain(item, parts_of_item) for item in value)
        ):
            return tuple(value)
        if is_array:
            return np.asarray(real_array(value, label), dtype)
        validator = schema_of(hint)
        if validator is None:
            if not kinds or isinstance(value, kinds):
                return value
            needed = " or ".join(kind.__name__ for kind in kinds)
            raise InputError(f"{label}: {needed} is needed, not {in_words(value)}")
        written = _plain(value, label)
        try:
            return conformed(validator, written)
        except InputError as error:
            raise InputError(f"{label}: {error}") from error

    return checked


def _is_plain(value: Any, parts: tuple[Any, ...]) -> bool:
    """Return whether a number or a text is of one of the types as it is; a schema says the same.

    A number out of any physical range is of none.
    """
    kind = type(value)
    if kind is str:
        return str in parts or value in _words(parts)
    if kind is float or kind is int:
        size = abs(value)
        return kind in parts and (size in (0, inf) or MIN_NUMBER <= size <= MAX_NUMBER)
    return kind is bool and bool in parts


@cache
def _words(parts: tuple[Any, ...]) -> frozenset[str]:
    """Return the texts that types list as a `Literal`."""
    listed = [part for part in parts if get_origin(part) is Literal]
    words = chain.from_iterable(map(get_args, listed))
    return frozenset(word for word in words if isinstance(word, str))


def _finished(parts: Iterable[Any]) -> tuple[type, ...]:
    """Return those of the types whose objects need no validation: None, and dataclasses.

    Dataclasses have validated their own arguments. An object of such a type needs no schema of all
    that it contains.
    """
    finished = []
    for part in parts:
        if part is type(None) or (isinstance(part, type) and is_dataclass(part)):
            finished.append(part)
        elif get_origin(part) is Annotated and isinstance(part.__metadata__[0], ByKind):
            finished += _finished(_alternatives(part.__origin__))
    return tuple(finished)


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """Return the types of a union, or the type."""
    is_union = get_origin(hint) in (Union, UnionType)
    return get_args(hint) if is_union else (hint,)


def _plain(value: Any, label: str) -> Any:
    """Return lists and arrays as tuples, and NumPy's numbers as Python's, as from YAML."""
    if isinstance(value, np.ndarray):
        return _plain(real_array(value, label).tolist(), label)
    if isinstance(value, np.generic):
        return value.item()
    if type(value) in (list, tuple):
        return tuple(_plain(item, label) for item in value)
    return value


@cache
def installed(group: str, kind: type[Kind]) -> tuple[Kind, ...]:
    """Return the objects of a class that applications and installed packages add to lampest.

    Packages register objects in a group of entry points, and are ordered by name.

    Raises InputError if an object cannot be loaded, or is of another class.
    """
    objects = []
    for point in entry_points_of(group):
        named = f"{group}: {point.name} = {point.value} of an installed package"
        try:
            member = point.load()
        except Exception as error:  # any error of the package while it is imported
            raise InputError(f"{named} cannot be loaded ({error})") from error
        if not isinstance(member, kind):
            raise InputError(f"{named} is no {kind.__name__}")
        objects.append(member)
    return (*(applications().members(group) if group in GROUPS else ()), *objects)


def of_kind(kind: str, noun: str, members: Sequence[Kind]) -> Kind:
    """Return the object with this `kind`.

    Raises InputError, with a noun such as 'plot', unless exactly one has it.
    """
    kinds = [str(getattr(member, "kind", "")) for member in members]
    if kinds.count(kind) != 1:
        count = f"there are two {noun}s" if kind in kinds else f"there is no {noun}"
        raise InputError(f"{count} '{kind}'; there are {', '.join(dict.fromkeys(kinds))}")
    return members[kinds.index(kind)]


@dataclass(frozen=True)
class ByKind:
    """Marker of Annotated[A | B, ByKind()], or of Annotated[Base, ByKind(members={...})].

    Validation selects the member by the `kind: Literal[...]` of the input.

    Attributes
    ----------
    group : str
        Group of entry points by which installed packages add members; '' for none.
    default : str
        Kind of an input without one; '' if the input must have one.
    members : mapping of str to str
        'module:Class' by kind, of members that are imported when an input has their kind; empty
        where a union lists the members.
    """

    group: str = ""
    default: str = ""
    members: Mapping[str, str] = field(default_factory=dict, hash=False)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Return the tagged union of the members for pydantic, one choice for each literal."""
        union = Annotated[source, self]
        named = {"type": "with-info", "function": self._validated}
        later = {"type": "function-plain", "function": named}
        choices = dict.fromkeys(self.members, later)
        for member in (*_listed(union), *_installed_members(union)):
            for kind in kinds_of(member):
                choices[kind] = handler.generate_schema(member)
        tag = self._tag if self.default else "kind"
        tagged = {"type": "tagged-union", "discriminator": tag, "choices": choices}
        base = _base(union)
        # In Python, objects of an unregistered subclass, such as one in a notebook, are members,
        # too.
        made = {"type": "is-instance", "cls": base}
        either = {"type": "union", "choices": [made, tagged], "mode": "left_to_right"}
        registered = base not in (object, Configuration, Validated)
        return {
            "type": "json-or-python",
            "json_schema": tagged,
            "python_schema": either if registered else tagged,
        }

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> Any:
        """Return the JSON schema, with those of all members. Called by pydantic."""
        tagged = schema["json_schema"]
        choices = tagged["choices"] | {
            kind: adapter(loaded(target)).core_schema for kind, target in self.members.items()
        }
        return handler(tagged | {"choices": choices})

    def _validated(self, value: Any, info: Any) -> Any:
        """Return an input as an object of the member that has its kind."""
        member = loaded(self.members[self._tag(value)])
        validator = adapter(member).validator
        if issubclass(member, Completed) and not isinstance(value, member):
            value = member.completed(value)
        if info.mode == "json":
            return validator.validate_json(json.dumps(value), strict=True)
        return validator.validate_python(value, strict=True)

    def _tag(self, value: Any) -> Any:
        """Return the kind that an input names; that of a mapping without one is the default."""
        if isinstance(value, dict):
            return value.get("kind", self.default)
        return getattr(value, "kind", None)


_hints = cache(get_type_hints)


def kinds_of(member: Any) -> tuple[str, ...]:
    """Return the values of a class's `kind: Literal[...]`; () without such a field."""
    return get_args(_hints(member).get("kind"))


def _marker(union: Any) -> ByKind:
    """Return the marker of Annotated[..., ByKind(...)]."""
    return cast(ByKind, get_args(union)[1])


def _listed(union: Any) -> tuple[type, ...]:
    """Return the classes that Annotated[A | B, ByKind()] lists; () where the marker names them."""
    return () if _marker(union).members else _alternatives(get_args(union)[0])


def shipped(union: Any) -> tuple[type[Any], ...]:
    """Return the classes of a union by kind without those of installed packages.

    Code that runs while a module is imported needs this function, because packages import that
    module and cannot be loaded before it.
    """
    named = dict.fromkeys(_marker(union).members.values())
    return (*map(loaded, named), *_listed(union))


def members_of(union: Any) -> tuple[type[Any], ...]:
    """Return the classes of a union by kind, those of installed packages included.

    Raises InputError if a package registers another object, or a class without a `kind` of its own.
    """
    return (*shipped(union), *_installed_members(union))


@cache
def members_by_kind(union: Any) -> dict[str, type]:
    """Return the classes of a union by kind. Raises InputError as `members_of`."""
    return {kind: member for member in members_of(union) for kind in kinds_of(member)}


def member_of_kind(union: Any, kind: str) -> type | None:
    """Return the class of a union that has a kind, or None; other named members stay unloaded."""
    target = _marker(union).members.get(kind)
    return members_by_kind(union).get(kind) if target is None else cast(type, loaded(target))


def _base(union: Any) -> type:
    """Return the nearest class from which all members of a union derive."""
    members: tuple[type, ...] = _alternatives(get_args(union)[0])
    return next(
        kind for kind in members[0].__mro__ if all(issubclass(member, kind) for member in members)
    )


def _installed_members(union: Any) -> Iterator[type]:
    """Yield the members that installed packages add to a union."""
    marker = _marker(union)
    base = _base(union)
    used = [*marker.members, *chain.from_iterable(map(kinds_of, _listed(union)))]
    for added in installed(marker.group, type) if marker.group else ():
        named = f"{marker.group}: {added.__name__} of an installed package"
        if not issubclass(added, base):
            raise InputError(f"{named} is no {base.__name__}")
        kinds = kinds_of(added)
        if not kinds or not set(kinds).isdisjoint(used):
            raise InputError(
                f"{named} needs kind: Literal['...'] with a word unlike {', '.join(used)}"
            )
        used += kinds
        yield added
