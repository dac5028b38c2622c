"""YAML text ↔ validated objects: the only place that knows YAML. Errors name file, line and column."""

import csv
import dataclasses
import io
import json
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import count
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import PydanticSchemaGenerationError, PydanticUserError, TypeAdapter, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from lampest.files.errors import InputError, in_words, meant
from lampest.files.whole import note_read

DEEPEST = 50  # brackets within brackets: the parser's time grows with their square
MOST_BYTES = 100_000  # of a text, which take up to 4 s; and so many values at most
# In any unit: what is smaller or larger is no measure of anything, and loses its digits as soon as it is squared.
SMALLEST, LARGEST = 1e-30, 1e30
NO_MEASURE = f"must be zero or lie between {SMALLEST:g} and {LARGEST:g}, whatever its sign"
WITHOUT_UNIT = ("seed",)  # keys whose numbers measure nothing
SHOULD_BE = "Input should be "
UNKNOWN = "no such key"
TABLES = (("panel", "cells"), ("scene", "panel", "cells"))  # which a file of their own may hold
OF_TAGS = ("union_tag_not_found", "model_attributes_type")  # beside what says which objects are meant
UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")


@dataclass(frozen=True)
class Document:
    """A parsed YAML text: its plain content, where it came from, and the positions of its keys."""

    content: Any
    source: str
    marks: Any

    def position(self, location: tuple[int | str, ...]) -> str:
        """'file:line:column' of the deepest part of `location` that the text holds."""
        node, line, column = self.marks, 0, 0
        for part in location:
            if isinstance(node, CommentedMap) and part in node:
                line, column = node.lc.key(part)
            elif isinstance(node, CommentedSeq) and isinstance(part, int) and part < len(node):
                line, column = node.lc.item(part)
            else:
                continue
            node = node[part]
        return f"{self.source}:{line + 1}:{column + 1}"

    def error(self, location: tuple[int | str, ...], message: str) -> InputError:
        """The sentence for a fault at `location`, for the caller to raise."""
        path = ".".join(str(part) for part in location)
        return InputError(f"{self.position(location)}: {path + ': ' if path else ''}{message}")

    def with_value(self, path: Sequence[str | int], value: Any) -> "Document":
        """A copy whose entry at `path` (keys of mappings, indices of lists) is `value`; missing mappings are made.

        Raises InputError where the path leads nowhere.
        """
        content = json.loads(json.dumps(self.content))
        node = content
        for depth, part in enumerate(path):
            index = place_in(node, part)
            if index is None or (isinstance(node, list) and index >= len(node)):
                dotted = ".".join(str(one) for one in path)
                raise self.error((), f"no such place: '{dotted}' is not found in this document")
            if depth == len(path) - 1:
                node[index] = value
            else:
                node = node.setdefault(index, {}) if isinstance(node, dict) else node[index]
        return dataclasses.replace(self, content=content)


def place_in(node: Any, part: str | int) -> Any:
    """`part` of a dotted path as a key of `node`: a word in a mapping, a number in a list, None elsewhere."""
    number = isinstance(node, list) and str(part).isascii() and str(part).isdigit()
    return part if isinstance(node, dict) else int(part) if number else None


def read_document(path: Path, settings: Sequence[str] = ()) -> Document:
    """Parse a YAML file, its tables too, and set `PATH=VALUE` entries. Raises InputError where that cannot be done."""
    document = parse_document(_text_of(path), str(path))
    for setting in settings:
        key, separator, value = setting.partition("=")
        if not separator or not key:
            raise InputError(f"'{setting}' is not of the form PATH=VALUE")
        document = document.with_value(tuple(key.split(".")), parse_document(value, f"'{value}'").content)
    for place in TABLES:
        document = _with_table(document, place)
    return document


def _with_table(document: Document, place: tuple[str, ...]) -> Document:
    """The document with the rows of the table that stands at a place by its name, relative to the document."""
    value = document.content
    for key in place:
        value = value.get(key) if isinstance(value, dict) else None
    if not isinstance(value, str):
        return document
    path, rows = Path(document.source).parent / value, list[list[float]]()
    for number, line in enumerate(csv.reader(io.StringIO(_text_of(path))), start=1):
        try:
            rows += [[int(text) if text.strip().isdecimal() else float(text) for text in line]] if line else []
        except ValueError as error:
            if number > 1:  # the first may be a header
                raise document.error(place, f"{path}:{number}: {', '.join(line)} are not all numbers") from error
    return document.with_value(place, rows)


def _text_of(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            content = stream.read(MOST_BYTES + 1)
        note_read(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except ValueError as error:  # a zero byte
        raise InputError(f"{path}: no such file") from error
    if len(content) > MOST_BYTES:
        raise InputError(f"{path}: larger than {MOST_BYTES} bytes, which no configuration is")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text in UTF-8") from error


def parse_document(text: str, source: str) -> Document:
    """Parse YAML 1.2 text; duplicate keys, tags and more than one document are errors. Raises InputError."""
    if len(text) > MOST_BYTES:
        raise InputError(f"{source}: larger than {MOST_BYTES} characters, which no configuration is")
    depth = np.cumsum([1 if sign in "[{" else -1 for sign in re.findall(r"[\[\]{}]", text)])
    if depth.max(initial=0) > DEEPEST:
        raise InputError(f"{source}: brackets within brackets more than {DEEPEST} times")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an anchor that is set twice
            marks = YAML(typ="rt").load(text)
        content = _plain(marks, count(1))
        json.dumps(content, ensure_ascii=False).encode("utf-8")  # half a sign, a surrogate, is an error
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{source}:{mark.line + 1}:{mark.column + 1}" if mark else source
        raise InputError(f"{where}: {' '.join(str(error.problem or error.context).split())}") from error
    except RecursionError as error:
        raise InputError(f"{source}: nested too deeply, or within itself") from error
    except (YAMLError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{source}: {' '.join(str(error).split())}") from error
    return Document(content, source, marks)


def _plain(node: Any, count: Iterator[int]) -> Any:
    """The content as plain Python objects; refuses tags and texts that unfold without end."""
    if next(count) > MOST_BYTES:
        raise ValueError(f"more than {MOST_BYTES} values")
    if isinstance(node, CommentedMap | CommentedSeq) and node.tag.value is not None:
        raise ValueError(f"the tag {node.tag.value} has no place here")
    if isinstance(node, CommentedMap):
        if not all(isinstance(key, str | int | float) for key in node):
            raise ValueError("a key must be a plain word or number")
        return {str(key): _plain(value, count) for key, value in node.items()}
    if isinstance(node, CommentedSeq):
        return [_plain(item, count) for item in node]
    if isinstance(node, int) and node.bit_length() > 1000:
        raise ValueError("a whole number of more than 1000 bits")
    for kind in (bool, int, float, str):
        if isinstance(node, kind):
            return kind(node)
    if node is not None:
        raise ValueError(f"a value of type {type(node).__name__} has no place here")
    return None


@cache
def adapter(kind: Any) -> TypeAdapter[Any]:
    """The validator of a type."""
    return TypeAdapter(kind)


def validated(document: Document, kind: Any) -> Any:
    """The document's content as an object of `kind`.

    Raises InputError where a key is unknown, a type is wrong, or a number measures nothing.
    """
    if out := next(_out_of_range(document.content, ()), None):
        raise document.error(out, NO_MEASURE)
    try:
        return adapter(kind).validate_json(json.dumps(document.content), strict=True)
    except ValidationError as error:
        location, message = _worst(error.errors(include_url=False), document.content)
        if message == UNKNOWN:
            known = _known_keys(kind, document.content, location)
            some = f"; there are {', '.join(sorted(known))}" if 0 < len(known) <= 12 else ""
            message += meant(str(location[-1]), known) or some
        raise document.error(location, message) from error


def _out_of_range(content: Any, place: tuple[int | str, ...]) -> Iterator[tuple[int | str, ...]]:
    """Where numbers stand that are finite, not zero, and larger or smaller than any measure."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key not in WITHOUT_UNIT:
                yield from _out_of_range(value, (*place, key))
    elif isinstance(content, list | tuple):
        for index, value in enumerate(content):
            yield from _out_of_range(value, (*place, index))
    elif isinstance(content, int | float) and abs(content) not in (0, inf) and not SMALLEST <= abs(content) <= LARGEST:
        yield place


def schema_of(kind: Any) -> TypeAdapter[Any] | None:
    """The validator of a type; None where it is nothing that YAML could say."""
    try:
        made = adapter(kind)
        return made if made.pydantic_complete else None  # not where it names what type checkers alone import
    except (PydanticSchemaGenerationError, PydanticUserError):
        return None


def conformed(validator: TypeAdapter[Any], value: Any) -> Any:
    """A Python value as an object of the validator's type, as strictly as YAML. Raises InputError with one sentence."""
    if value == value and next(_out_of_range(value, ()), None) is not None:  # of NaN its class knows a better sentence
        raise InputError(NO_MEASURE)
    try:
        return validator.validate_python(value, strict=True)
    except ValidationError as error:
        faults = error.errors(include_url=False)
        faults = [fault for fault in faults if fault["type"] not in OF_TAGS] or faults
        first, *others = dict.fromkeys(_sentence(fault).removeprefix("Value error, ") for fault in faults)
        said = " or ".join([first, *(text.removeprefix(SHOULD_BE) for text in others)])
        close = meant(value, re.findall(r"'(\w+)'", said)) if isinstance(value, str) else ""
        raise InputError(f"{said}, not {in_words(value)}{close}") from error
    except (TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise InputError(f"{in_words(value)} does not fit ({' '.join(str(error).split())})") from error


def _known_keys(kind: Any, content: Any, location: tuple[Any, ...]) -> set[str]:
    """The keys that could stand in place of an unknown one: of those objects of a type that look most like its own."""
    for part in location[:-1]:
        content = content[part]
    there = {key: value for key, value in content.items() if key != location[-1]}
    schema = adapter(kind).json_schema()
    objects = [item.get("properties", {}) for item in (schema, *schema.get("$defs", {}).values())]
    # Of another kind are those with another word for one of the keys.
    alike = [
        -1 if any(known[key].get("const", there[key]) != there[key] for key in shared) else len(shared)
        for known in objects
        for shared in [known.keys() & there.keys()]
    ]
    keys = {key for known, like in zip(objects, alike, strict=True) if like == max(alike) for key in known}
    return keys - {*there, location[-1]}


def _worst(faults: list[Any], content: Any) -> tuple[tuple[Any, ...], str]:
    """Where the fault is that says most to a user, and its sentence.

    A misspelt key also leaves its field missing; the key is what the user can see. Of a value that may be of several
    types the deepest fault says which of them was meant.
    """
    if first := next((fault for fault in faults if fault["type"] in UNKNOWN_KEY), None):
        return _location(first, content), UNKNOWN
    within = _location(faults[0], content)
    inside = [(_location(fault, content), fault) for fault in faults]
    inside = [(place, fault) for place, fault in inside if place[: len(within)] == within]
    place, worst = max(inside, key=lambda pair: (len(pair[0]), pair[1]["type"] == "value_error"))
    if worst["type"] == "value_error":
        return place, worst["msg"].removeprefix("Value error, ")
    alternatives = [_sentence(fault) for where, fault in inside if where == place]
    return place, " or ".join([alternatives[0], *(text.removeprefix(SHOULD_BE) for text in alternatives[1:])])


def _sentence(fault: Any) -> str:
    """What is wrong, without the words of the validating library for kinds."""
    if fault["type"] != "union_tag_invalid":
        return str(fault["msg"])
    known = fault["ctx"]["expected_tags"].replace("'", "")
    return f"there is no kind {fault['ctx']['tag']} here or in an installed package; there are {known}"


def _location(fault: Any, content: Any) -> tuple[Any, ...]:
    """Where a fault is, without what the validator says of the alternatives of a type: keys that are not there."""
    place: list[Any] = []
    parts = fault["loc"]
    for number, part in enumerate(parts):
        inside = isinstance(content, list) and isinstance(part, int) and part < len(content)
        if inside or (isinstance(content, dict) and part in content):
            content = content[part]
        elif fault["type"] != "missing" or number < len(parts) - 1:
            continue
        place.append(part)
    return tuple(place)


def to_yaml(value: Any) -> str:
    """YAML text of a dataclass, a mapping or a list; entries that are None are left out."""
    stream = io.StringIO()
    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style = False
    writer.width = 4096
    writer.dump(plain_content(value), stream)
    return stream.getvalue()


def plain_content(value: Any) -> Any:
    """Dataclasses as mappings, tuples and arrays as lists, numpy's numbers as plain ones.

    Left out are None, and empty entries that take no part in comparing.
    """
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        entries = ((field, getattr(value, field.name)) for field in dataclasses.fields(value))
        value = {field.name: entry for field, entry in entries if field.compare or entry}
    if isinstance(value, dict):
        return {key: plain_content(item) for key, item in value.items() if item is not None}
    if isinstance(value, list | tuple):
        return [plain_content(item) for item in value]
    return value
