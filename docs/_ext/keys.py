"""The keys of YAML files as a page, from the JSON schemas that the files are validated with."""

import json
from typing import Any

from docstrings import markdown

from lampest.files.document import adapter
from lampest.panel.scene import Scene
from lampest.recording.simulation.simulation import Simulation
from lampest.runs.config import RunFile

FILES = {"A run": RunFile, "A scene": Scene, "A simulation": Simulation}


def keys_page() -> str:
    """A chapter for every kind of file; what stands in several is told once, in the first."""
    told: set[str] = set()
    chapters = []
    for title, kind in FILES.items():
        schema = adapter(kind).json_schema()
        told.add(schema["title"])
        parts = [f"({anchor(schema['title'])})=", f"## {title}", content(schema)]
        for name, part in sorted(schema.get("$defs", {}).items()):
            if name not in told and "properties" in part:
                told.add(name)
                parts += [f"({anchor(name)})=", f"### {heading(name, part)}", content(part)]
        chapters += parts
    return "\n\n".join(part for part in chapters if part)


def anchor(name: str) -> str:
    """What a part is linked to by."""
    return f"key-{name.lower()}"


def heading(name: str, part: dict[str, Any]) -> str:
    """The word by which a file chooses a part, where it does; else the part's name."""
    kind = part["properties"].get("kind", {})
    words = [kind["const"]] if "const" in kind else kind.get("enum", [])
    return ", ".join(f"`{word}`" for word in words) or name


def content(part: dict[str, Any]) -> str:
    """What a part says of itself, and a table of its keys."""
    rows = [
        f"| `{key}` | {words(value)} | {'required' if key in part.get('required', ()) else default(value)} |"
        for key, value in part["properties"].items()
    ]
    return "\n\n".join(
        (markdown(part.get("description", "")), "\n".join(("| key | value | default |", "|---|---|---|", *rows)))
    )


def default(value: dict[str, Any]) -> str:
    """The value of a key that is not written."""
    if value.get("default") is None:
        return "absent"
    text = json.dumps(value["default"], ensure_ascii=False).replace('"', "").replace("|", "\\|")
    return f"`{text}`"


def words(value: dict[str, Any]) -> str:
    """What a key may hold."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{anchor(name)})"
    choices = value.get("anyOf") or value.get("oneOf")
    if choices:
        return ", ".join(dict.fromkeys(words(one) for one in choices if one.get("type") != "null"))
    if "const" in value or "enum" in value:
        return ", ".join(f"`{word}`" for word in value.get("enum", [value.get("const")]))
    return container(value)


def container(value: dict[str, Any]) -> str:
    """A list, a mapping, or one value with its limits."""
    kind = value.get("type", "anything")
    if kind == "array":
        inside = value.get("items") or (value.get("prefixItems") or [{}])[0]
        return f"list of {words(inside)}" if inside else "list"
    if kind == "object":
        inside = value.get("additionalProperties")
        return f"mapping of names to {words(inside)}" if isinstance(inside, dict) else "mapping"
    limits = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    return " ".join((kind, *(f"{sign} {value[limit]}" for limit, sign in limits.items() if limit in value)))
