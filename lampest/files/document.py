"""Conversion between YAML text and validated objects; errors contain file, line and column."""

import csv
import dataclasses
import io
import json
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain, count
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import PydanticSchemaGenerationError, PydanticUserError, TypeAdapter, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from lampest.files.errors import InputError, in_words, meant
from lampest.files.whole import note_read

MAX_DEPTH = 50  # nested brackets: the parser's time grows with the square (tests/fuzz)
MAX_SIZE = 100_000  # bytes of a text, parsed within 4 s, and values of a document (tests/fuzz)
# Range of physical quantities in any unit: numbers beyond it lose their digits when they are
# squared.
MIN_NUMBER = 1e-30
MAX_NUMBER = 1e30
NO_MEASURE = f"must be zero or lie between {MIN_NUMBER:g} and {MAX_NUMBER:g}, whatever its sign"
UNKNOWN = "no such key"
INLINE = "inline"
Place = tuple[int | str, ...]  # keys of mappings and indices of lists, from the outermost on


@dataclass(frozen=True)
class Document:
    """Parsed YAML text.

    Attributes
    ----------
    content : object
        Content as mappings, lists, texts and numbers.
    source : str
        Name of the file or text in messages.
    marks : object
        Parsed nodes with the positions of their keys.
    """

    content: Any
    source: str
    marks: Any

    def position(self, location: Place) -> str:
        """Return 'file:line:column' of the deepest part of `location` that exists in the text."""
        node = self.marks
        line = 0
        column = 0
        for part in location:
            if isinstance(node, CommentedMap) and part in node:
                line, column = node.lc.key(part)
            elif isinstance(node, CommentedSeq) and isinstance(part, int) and part < len(node):
                line, column = node.lc.item(part)
            else:
                continue
            node = node[part]
        return f"{self.source}:{line + 1}:{column + 1}"

    def error(self, location: Place, message: str) -> InputError:
        """Return the error of a fault at `location`, for the caller to raise.

        A key at which the message begins is not said twice.
        """
        parts = [*map(str, location)]
        for depth in range(len(parts)):
            if re.match(rf"{re.escape('.'.join(parts[depth:]))}(?![\w-])", message):
                message = ".".join([*parts[:depth], message])
                break
        else:
            message = ": ".join([".".join(parts), message]) if parts else message
        return InputError(f"{self.position(location)}: {message}")

    def with_value(self, path: Sequence[str | int], value: Any) -> "Document":
        """Return a copy with `value` at `path` (keys of mappings, indices of lists).

        Missing mappings are created.

        Raises InputError if the path does not exist.
        """
        content = json.loads(json.dumps(self.content))
        node = content
        for depth, part in enumerate(path):
            index = place_in(node, part)
            if index is None or (isinstance(node, list) and index >= len(node)):
                dotted = ".".join(map(str, path))
                raise self.error((), f"no such place: '{dotted}' is not found in this document")
            if depth == len(path) - 1:
                node[index] = value
            else:
                node = node.setdefault(index, {}) if isinstance(node, dict) else node[index]
        return dataclasses.replace(self, content=content)


def entry_at(content: Any, place: Iterable[Any]) -> Any:
    """Return what mappings and lists hold at a place, None if there is no such place."""
    for part in place:
        try:
            content = content[part]
        except (LookupError, TypeError):
            return None
    return content


def place_in(node: Any, part: str | int) -> Any:
    """Return a part of a dotted path as a key of `node`.

    The key is a word for a mapping, an index for a list, and None for any other node.
    """
    if isinstance(node, dict):
        return part
    is_index = str(part).isascii() and str(part).isdigit()
    return int(part) if isinstance(node, list) and is_index else None


def read_document(path: Path, settings: Sequence[str] = ()) -> Document:
    """Return a YAML file with its tables, and with entries set by texts `PATH=VALUE`.

    Raises InputError.
    """
    document = parse_document(_text_of(path), str(path))
    for setting in settings:
        key, separator, value = setting.partition("=")
        if not separator or not key:
            raise InputError(f"'{setting}' is not of the form PATH=VALUE")
        document = document.with_value(
            tuple(key.split(".")), parse_document(value, f"'{value}'").content
        )
    for place in (("panel", "cells"), ("scene", "panel", "cells")):
        name = entry_at(document.content, place)
        if not isinstance(name, str):
            continue
        table = path.parent / name
        rows = list[list[float]]()
        for number, line in enumerate(csv.reader(io.StringIO(_text_of(table))), start=1):
            try:
                row = [int(text) if text.strip().isdecimal() else float(text) for text in line]
            except ValueError as error:
                if number == 1:
                    continue  # a header
                raise document.error(
                    place, f"{table}:{number}: {', '.join(line)} are not all numbers"
                ) from error
            rows += [row] if row else []
        document = document.with_value(place, rows)
    return document


def _text_of(path: Path) -> str:
    """Return the text of a file.

    Raises InputError if it cannot be read, is too large, or is not in UTF-8.
    """
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_SIZE + 1)
        note_read(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    except ValueError as error:  # a zero byte
        raise InputError(f"{path}: no such file") from error
    if len(content) > MAX_SIZE:
        raise InputError(f"{path}: larger than {MAX_SIZE} bytes, which no configuration is")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        kind = ", but HDF5, a recording or results; lampest info describes it"
        kind = kind if content.startswith(b"\x89HDF") else ""
        raise InputError(f"{path}: not a text in UTF-8{kind}") from error


def parse_document(text: str, source: str) -> Document:
    """Return YAML 1.2 text as a document.

    Raises InputError, also for duplicate keys, tags and several documents.
    """
    if len(text) > MAX_SIZE:
        raise InputError(f"{source}: larger than {MAX_SIZE} characters, which no configuration is")
    depth = np.cumsum([1 if sign in "[{" else -1 for sign in re.findall(r"[\[\]{}]", text)])
    if depth.max(initial=0) > MAX_DEPTH:
        raise InputError(f"{source}: brackets within brackets more than {MAX_DEPTH} times")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an anchor that is set twice
            marks = YAML(typ="rt").load(text)
        content = _plain(marks, count(1))
        # Half a sign, a surrogate, is an error.
        json.dumps(content, ensure_ascii=False).encode("utf-8")
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{source}:{mark.line + 1}:{mark.column + 1}" if mark else source
        problem = " ".join(str(error.problem or error.context).split()).replace(
            r"character '\t' that", "a tab, which"
        )
        if "alias" in problem:
            problem += "; in YAML a * begins an alias: write such a text in quotation marks"
        raise InputError(f"{where}: {problem}") from error
    except RecursionError as error:
        raise InputError(f"{source}: nested too deeply, or within itself") from error
    except (YAMLError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{source}: {' '.join(str(error).split())}") from error
    return Document(content, source, marks)


def _plain(node: Any, count: Iterator[int]) -> Any:
    """Return a parsed node as plain Python objects.

    Raises ValueError for tags and for texts that expand endlessly.
    """
    if next(count) > MAX_SIZE:
        raise ValueError(f"more than {MAX_SIZE} values")
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
    if node is None:
        return None
    raise ValueError(f"a value of type {type(node).__name__} has no place here")


@cache
def adapter(kind: Any) -> TypeAdapter[Any]:
    """Return the validator of a type."""
    return TypeAdapter(kind)


def validated(document: Document, kind: Any) -> Any:
    """Return the document's content as an object of `kind`.

    Raises InputError if a key is unknown, a type is wrong, or a number is out of any physical
    range.
    """
    out_of_range = next(_out_of_range(document.content, ()), None)
    if out_of_range:
        raise document.error(out_of_range, NO_MEASURE)
    try:
        return adapter(kind).validate_json(json.dumps(document.content), strict=True)
    except ValidationError as error:
        faults = error.errors(include_url=False)
        location, message, alternatives = _worst(faults, document.content)
        if message == UNKNOWN:
            message += _possible_keys(kind, document.content, location)
        else:
            message = _plain_words(message, document.content, location) + _meant_choice(
                alternatives
            )
        raise document.error(location, message) from error


PLAIN_WORDS = {
    "Input should be ": "must be ",
    "a valid number": "a number",
    "a valid integer": "a whole number",
    "a valid array": "a list",
    "a valid list": "a list",
    "a valid tuple": "a list",
    "a valid dictionary": "a mapping",
    "an object": "a mapping",
    "a valid string": "a text",
    "a valid boolean": "true or false",
}
# Resistors as on their labels: 3.3k, 4k7, '140 ohm', '3300'
LABELLED = re.compile(r"(\d+(?:\.\d+)?(?:[eE][+-]?\d+)?|\.\d+)\s*([kKMR]?)(\d*)\s*(?:ohms?|Ω|Ω)?")
FACTOR_OF_LETTER = {"": 1.0, "R": 1.0, "k": 1e3, "K": 1e3, "M": 1e6}


def _plain_words(message: str, content: Any, location: Sequence[Any]) -> str:
    """Return a validator's sentence in the words of a user's file, with the value.

    A number that was written as a text is followed by the way to write it.
    """
    if not message.startswith("Input should be "):
        return message
    for words, plain in PLAIN_WORDS.items():
        message = message.replace(words, plain)
    content = entry_at(content, location)
    if not isinstance(content, str | int | float):
        return message
    written = content.strip() if isinstance(content, str) and "number" in message else ""
    label = LABELLED.fullmatch(written)
    if label is None:
        return f"{message}, not {in_words(content)}"
    digits = f"{label[1]}.{label[3]}" if label[3] else label[1]
    message += f", not {content!r}"
    if digits.count(".") > 1:
        return message
    quoted = ", without quotation marks" if written == label[1] else ""
    return f"{message}: write {float(digits) * FACTOR_OF_LETTER[label[2]]:.12g}{quoted}"


def _out_of_range(content: Any, place: Place) -> Iterator[Place]:
    """Yield the places of finite, nonzero numbers outside the range of physical quantities."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key != "seed":  # a seed is no physical quantity
                yield from _out_of_range(value, (*place, key))
    elif isinstance(content, list | tuple):
        for index, value in enumerate(content):
            yield from _out_of_range(value, (*place, index))
    elif (
        isinstance(content, int | float)
        and abs(content) not in (0, inf)
        and not MIN_NUMBER <= abs(content) <= MAX_NUMBER
    ):
        yield place


@cache
def schema_of(kind: Any) -> TypeAdapter[Any] | None:
    """Return the validator of a type; None if YAML cannot express the type."""
    try:
        made = adapter(kind)
        # None for types that are imported for type checkers only
        return made if made.pydantic_complete else None
    except (PydanticSchemaGenerationError, PydanticUserError):
        return None


def conformed(validator: TypeAdapter[Any], value: Any) -> Any:
    """Return a Python value as an object of the validator's type, as strict as YAML.

    Raises InputError.
    """
    # NaN is reported by its class
    if value == value and next(_out_of_range(value, ()), None) is not None:
        raise InputError(NO_MEASURE)
    try:
        return validator.validate_python(value, strict=True)
    except ValidationError as error:
        faults = error.errors(include_url=False)
        # Further faults of the same union.
        repeating = ("union_tag_not_found", "model_attributes_type")
        message = _sentence_of(
            [fault for fault in faults if fault["type"] not in repeating] or faults
        )
        raise InputError(f"{message}, not {in_words(value)}{_meant_choice(faults)}") from error
    except (TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise InputError(
            f"{in_words(value)} does not fit ({' '.join(str(error).split())})"
        ) from error


def _possible_keys(kind: Any, content: Any, location: tuple[Any, ...]) -> str:
    """Return the words on the key that is similar to an unknown one, or else on the unused keys.

    Returns '' if there are no unused keys, or more than twelve.
    """
    schema = adapter(kind).json_schema()
    nodes = _alternatives(schema, schema)
    for part in location[:-1]:
        content = content[part]
        inner = (
            node.get("properties", {}).get(part)
            or node.get("additionalProperties")
            or node.get("items")
            for node in nodes
        )
        nodes = [
            each for node in inner if isinstance(node, dict) for each in _alternatives(node, schema)
        ]
    objects = [node["properties"] for node in nodes if "properties" in node]
    key = str(location[-1])
    # The only values of keys. Objects of another kind have another constant for a shared key.
    constants = [
        {
            name: node.get("enum", [node["const"]] if "const" in node else [])
            for name, node in properties.items()
        }
        for properties in objects
    ]
    others = chain.from_iterable(each.get("kind", ()) for each in constants if key in each)
    if named := ", ".join(others):
        return f" of this kind; it is a key of kind: {named}"
    keys = {
        name
        for each in constants
        if all(value in (each.get(entry) or [value]) for entry, value in content.items())
        for name in each
    }
    unused = sorted(keys - {*content})
    listed = f"; there are {', '.join(unused)}" if 0 < len(unused) <= 12 else ""
    # A setting on the command line may misspell a key that the file has.
    return meant(key, keys) or listed


def _alternatives(node: Any, schema: Any) -> list[Any]:
    """Return the alternative schemas of a value, without references."""
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
    inner = node.get("anyOf", node.get("oneOf", ()))
    return [each for part in inner for each in _alternatives(part, schema)] or [node]


def _worst(faults: list[Any], content: Any) -> tuple[tuple[Any, ...], str, list[Any]]:
    """Return the location of the most informative fault, and its sentence.

    The faults that the sentence names are returned, too. A misspelt key also leaves its field
    missing; the key is the part that the user can see. For a value of one of several types, the
    deepest fault belongs to the intended type.
    """
    for fault in faults:
        if fault["type"] == "unexpected_keyword_argument":
            return _location(fault, content), UNKNOWN, []
    places = [(_location(fault, content), fault) for fault in faults]
    within = places[0][0]
    inside = [(place, fault) for place, fault in places if place[: len(within)] == within]
    place, worst = max(inside, key=lambda pair: (len(pair[0]), pair[1]["type"] == "value_error"))
    if worst["type"] == "value_error":
        message = worst["msg"].removeprefix("Value error, ")
        # Keys below the place that the message names in its first word, such as readout.groups
        content = entry_at(content, place)
        named = []
        for key in message.split(" ", 1)[0].rstrip(":,;").split("."):
            if not isinstance(content, dict) or key not in content:
                break
            named.append(key)
            content = content[key]
        return (*place, *named), message.removeprefix(".".join(named) + ": "), []
    alternatives = [fault for where, fault in inside if where == place]
    return place, _sentence_of(alternatives), alternatives


def _sentence_of(faults: Sequence[Any]) -> str:
    """Return one sentence, free of the validator's terms, on the alternative faults of a value."""
    sentences = []
    for fault in faults:
        sentence = fault["msg"].removeprefix("Value error, ")
        if fault["type"] == "union_tag_invalid":
            kinds = fault["ctx"]["expected_tags"].replace("'", "")
            sentence = (
                f"there is no kind {fault['ctx']['tag']} in lampest or an installed package; "
                f"there are {kinds}"
            )
        elif fault["type"] == "union_tag_not_found":
            sentence = "Input should be a mapping with a 'kind'"
        sentences.append(sentence)
    first, *others = dict.fromkeys(sentences)
    return " or ".join([first, *(other.removeprefix("Input should be ") for other in others)])


def _meant_choice(faults: Sequence[Any]) -> str:
    """Return '; did you mean reduced?' if the value is similar to a known word, else ''.

    All faults are of one value, and the known words are a closed list.
    """
    choices = []
    words = []
    for fault in faults:
        context = fault.get("ctx", {})
        word = context.get("tag", fault["input"])
        words += [word] if isinstance(word, str) else []
        choices += re.findall(
            r"'([^']+)'", str(context.get("expected_tags", context.get("expected", "")))
        )
    return next(filter(None, (meant(word, choices) for word in words)), "")


def _location(fault: Any, content: Any) -> tuple[Any, ...]:
    """Return the location of a fault without the keys by which a validator names alternatives."""
    place = []
    parts = fault["loc"]
    chosen = None  # the mapping whose kind was passed: a kind may be called as one of its keys
    for number, part in enumerate(parts):
        if isinstance(content, dict) and content.get("kind") == part and chosen is not content:
            chosen = content
            continue
        inside = isinstance(content, list) and isinstance(part, int) and part < len(content)
        if inside or (isinstance(content, dict) and part in content):
            content = content[part]
        elif fault["type"] != "missing" or number < len(parts) - 1:
            continue
        place.append(part)
    return tuple(place)


def to_yaml(value: Any) -> str:
    """Return the YAML text of a dataclass, a mapping or a list, without entries that are None."""
    stream = io.StringIO()
    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style = False
    writer.width = 4096
    writer.dump(plain_content(value), stream)
    return stream.getvalue()


# Texts that YAML takes as such in braces without quotation marks.
PLAIN_TEXT = re.compile(r"(?!(?:null|true|false|yes|no|on|off|nan|inf)$)[A-Za-z_][\w./-]*", re.I)


def in_one_line(content: Any) -> str:
    """Return a mapping as one line of YAML, such as 'readout: {kind: grounded, sense: one}'."""
    if not isinstance(content, Mapping):
        return _scalar_or_list(content)
    return ", ".join(f"{key}: {_scalar_or_list(value)}" for key, value in content.items())


def _scalar_or_list(value: Any) -> str:
    """Return a number, a text, nothing, or a list of them in YAML."""
    if isinstance(value, Mapping):
        return f"{{{in_one_line(value)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_scalar_or_list, value))}]"
    if isinstance(value, float) and isfinite(value):
        return f"{value:.12g}"
    if isinstance(value, float):
        return {inf: ".inf", -inf: "-.inf"}.get(value, ".nan")
    if isinstance(value, str):
        return value if PLAIN_TEXT.fullmatch(value) else json.dumps(value)
    return "null" if value is None else str(value).lower()


def plain_content(value: Any) -> Any:
    """Return dataclasses, tuples, arrays and NumPy's numbers as plain objects.

    Dataclasses become mappings, tuples and arrays become lists, and NumPy's numbers plain ones.
    Entries that are None are omitted, and so are empty entries that are excluded from comparisons.
    Pairs (key, entry) of a field with the metadata INLINE are entries of its object.
    """
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        content = dict[str, Any]()
        for field in dataclasses.fields(value):
            entry = getattr(value, field.name)
            if field.metadata.get(INLINE):
                content |= dict(entry)
            elif field.compare or entry:
                content[field.name] = entry
        value = content
    if isinstance(value, dict):
        return {key: plain_content(item) for key, item in value.items() if item is not None}
    if isinstance(value, list | tuple):
        return [plain_content(item) for item in value]
    return value
