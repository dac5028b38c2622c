"""The keys of YAML files as a page, from the JSON schemas that the files are validated with."""

import json
import re
from typing import Any

from docstrings import markdown

from lampest.files.document import adapter
from lampest.panel.scene import Scene
from lampest.recording.simulation.simulation import Simulation
from lampest.runs.config import RunFile

FILES = {"A run": RunFile, "A scene": Scene, "A simulation": Simulation}


def keys_page() -> str:
    """A chapter for every kind of file; parts that several have are described in the first."""
    described: set[str] = set()
    chapters = []
    for title, kind in FILES.items():
        schema = adapter(kind).json_schema()
        described.add(schema["title"])
        labels = headings(schema)
        parts = [f"({anchor(schema['title'])})=", f"## {title}", content(schema, labels)]
        for name, part in sorted(schema.get("$defs", {}).items()):
            if name not in described and "properties" in part:
                described.add(name)
                parts += [f"({anchor(name)})=", f"### {labels[name]}", content(part, labels)]
        chapters += parts
    return "\n\n".join(part for part in chapters if part)


def anchor(name: str) -> str:
    """Return the name by which links refer to a part."""
    return f"key-{name.lower()}"


def headings(schema: dict[str, Any]) -> dict[str, str]:
    """Name of a part → the word by which a file chooses it, else the keys that hold it.

    A file names no class.
    """
    parts = schema.get("$defs", {})
    keys: dict[str, list[str]] = {}
    for part in (schema, *parts.values()):
        for key, value in part.get("properties", {}).items():
            for name in re.findall(r"#/\$defs/(\w+)", json.dumps(value)):
                keys.setdefault(name, []).append(key)
    return {name: _label(part, keys.get(name, [name])) for name, part in parts.items()}


def _label(part: dict[str, Any], keys: list[str]) -> str:
    kind = part.get("properties", {}).get("kind", {})
    chosen = [kind["const"]] if "const" in kind else kind.get("enum", [])
    return ", ".join(f"`{word}`" for word in chosen or dict.fromkeys(keys))


def content(part: dict[str, Any], labels: dict[str, str]) -> str:
    """Return the description of a part, and a table of its keys."""
    rows = [
        f"| `{key}` | {words(value, labels)} | "
        f"{'required' if key in part.get('required', ()) else default(value)} |"
        for key, value in part["properties"].items()
    ]
    return "\n\n".join(
        (
            markdown(part.get("description", "")),
            "\n".join(("| key | value | default |", "|---|---|---|", *rows)),
        )
    )


def default(value: dict[str, Any]) -> str:
    """The value of a key that is not written."""
    if value.get("default") is None:
        return "absent"
    text = json.dumps(value["default"], ensure_ascii=False).replace('"', "").replace("|", "\\|")
    return f"`{text}`"


def words(value: dict[str, Any], labels: dict[str, str]) -> str:
    """Return the values that a key may hold."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{labels[name]}](#{anchor(name)})"
    choices = value.get("anyOf") or value.get("oneOf")
    if choices:
        return ", ".join(
            dict.fromkeys(
                words(choice, labels) for choice in choices if choice.get("type") != "null"
            )
        )
    if "const" in value or "enum" in value:
        return ", ".join(f"`{word}`" for word in value.get("enum", [value.get("const")]))
    return container(value, labels)


def container(value: dict[str, Any], labels: dict[str, str]) -> str:
    """A list, a mapping, or one value with its limits."""
    kind = value.get("type", "anything")
    if isinstance(kind, list):
        return ", ".join(kind)
    if kind == "array":
        inside = value.get("items") or (value.get("prefixItems") or [{}])[0]
        return f"list of {words(inside, labels)}" if inside else "list"
    if kind == "object":
        inside = value.get("additionalProperties")
        return (
            f"mapping of names to {words(inside, labels)}"
            if isinstance(inside, dict)
            else "mapping"
        )
    limits = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    return " ".join(
        (kind, *(f"{sign} {value[limit]}" for limit, sign in limits.items() if limit in value))
    )
