"""Results that later versions must give again: the golden table, defaults and constants.

python -m tests.golden.make                  # all
python -m tests.golden.make table            # public results of every room, see table.py
python -m tests.golden.make table report     # those of one room
python -m tests.golden.make defaults         # defaults of public classes, constants of all modules

Rows that agree with the stored ones, by the tolerances of their quantities, stay as they are: the
last digits of one machine never enter. Make results anew only where numbers are meant to change,
and say in the commit why.
"""

import dataclasses
import importlib
import inspect
import json
import pkgutil
import re
import sys
import warnings
from pathlib import Path

import lampest

GOLDEN_FOLDER = Path(__file__).parent
DEFAULTS = GOLDEN_FOLDER / "defaults.json"
DATA = GOLDEN_FOLDER / "data"
CONSTANTS = GOLDEN_FOLDER / "constants.json"
MAX_LENGTH = 400  # characters of a constant; longer ones are lists whose entries have rows


def defaults() -> dict[str, dict[str, str]]:
    """Return class → field → default, as Python writes it, of every public configuration."""
    public = {name: getattr(lampest, name) for name in lampest.__all__}
    kinds = {name: kind for name, kind in public.items() if hasattr(kind, "__pydantic_config__")}
    table = {
        name: {
            field.name: repr(
                field.default
                if field.default_factory is dataclasses.MISSING
                else field.default_factory()
            )
            for field in dataclasses.fields(kind)
            if (field.default, field.default_factory) != (dataclasses.MISSING, dataclasses.MISSING)
        }
        for name, kind in sorted(kinds.items())
    }
    return {name: fields for name, fields in table.items() if fields}


def constants() -> dict[str, dict[str, list[str]]]:
    """Return room → numbers of constants, fields and arguments with a default, by their names.

    A room's modules are one name space, so that a constant may move from one to another.
    """
    table: dict[str, dict[str, list[str]]] = {}
    for entry in pkgutil.walk_packages(lampest.__path__, "lampest."):
        module = importlib.import_module(entry.name)
        room = table.setdefault(re.match(r"lampest\.((apps\.)?\w+)", entry.name)[1], {})
        own = [
            value
            for value in vars(module).values()
            if getattr(value, "__module__", "") == entry.name
        ]
        named = {
            name: value
            for name, value in vars(module).items()
            if name.isupper() and name != "TYPE_CHECKING"
        }
        for kind in (value for value in own if isinstance(value, type)):
            methods = [
                getattr(value, "__func__", value)
                for name, value in vars(kind).items()
                if name[:2] != "__"
            ]
            own += [value for value in methods if inspect.isfunction(value)]
            named |= {
                f"{kind.__name__}.{name}": value
                for name, value in vars(kind).items()
                if name[0] != "_"
            }
        for function in (value for value in own if inspect.isfunction(value)):
            arguments = inspect.signature(function).parameters.items()
            named |= {
                f"{function.__qualname__}({name})": value.default for name, value in arguments
            }
        for name, value in named.items():
            text = repr(value)
            if (
                has_number(value)
                and len(text) < MAX_LENGTH
                and "<" not in text
                and text not in room.get(name, ())
            ):
                room.setdefault(name, []).append(text)
    return table


def has_number(value: object) -> bool:
    """Whether a value is a number or a record with numbers."""
    inner = (
        value.values()
        if isinstance(value, dict)
        else value
        if isinstance(value, tuple | list)
        else ()
    )
    return isinstance(value, int | float) or is_record(value) or any(map(has_number, inner))


def is_record(value: object) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def write_table(*rooms: str) -> None:
    """Write the results of rooms, or of all, a line a row."""
    sys.path.insert(0, str(GOLDEN_FOLDER.parent))
    from golden.content import content, difference
    from golden.table import table

    for room, rows in table().items():
        if rooms and room not in rooms:
            continue
        path = DATA / f"{room}.json"
        stored = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        lines = []
        for name, row in rows.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                computed = json.loads(json.dumps(content(row())))
            kept = computed if difference(stored.get(name), computed) else stored[name]
            lines.append(f"{json.dumps(name)}: {json.dumps(kept, ensure_ascii=False)}")
        path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def main() -> None:
    """Replace the files of this folder."""
    target, *rooms = sys.argv[1:] or ["all"]
    if target != "table":
        DEFAULTS.write_text(json.dumps(defaults(), indent=1) + "\n")
        lines = (
            f"{json.dumps(room)}: {json.dumps(values)}" for room, values in constants().items()
        )
        CONSTANTS.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    if target != "defaults":
        write_table(*rooms)


if __name__ == "__main__":
    main()
