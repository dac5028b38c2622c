"""Results that later versions must give again: the golden table, defaults and constants.

python -m tests.golden.make                  # all
python -m tests.golden.make table            # public results of every room, see table.py
python -m tests.golden.make table report     # those of one room
python -m tests.golden.make defaults         # defaults of public classes, and constants of all modules

Do so only where numbers are meant to change, and say in the commit why.
"""

import dataclasses
import importlib
import inspect
import json
import pkgutil
import sys
from pathlib import Path

import lampest

HERE = Path(__file__).parent
DEFAULTS = HERE / "defaults.json"
DATA = HERE / "data"
CONSTANTS = HERE / "constants.json"
LONGEST = 400  # characters of a constant; longer ones are lists whose entries have rows


def defaults() -> dict[str, dict[str, str]]:
    """Return class → field → default, as Python writes it, of every public configuration."""
    public = {name: getattr(lampest, name) for name in lampest.__all__}
    kinds = {name: kind for name, kind in public.items() if hasattr(kind, "__pydantic_config__")}
    table = {
        name: {
            field.name: repr(field.default if field.default_factory is dataclasses.MISSING else field.default_factory())
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
        module, room = importlib.import_module(entry.name), table.setdefault(entry.name.split(".")[1], {})
        own = [value for value in vars(module).values() if getattr(value, "__module__", "") == entry.name]
        named = {name: value for name, value in vars(module).items() if name.isupper() and name != "TYPE_CHECKING"}
        for kind in (value for value in own if isinstance(value, type)):
            methods = [getattr(value, "__func__", value) for name, value in vars(kind).items() if name[:2] != "__"]
            own += [value for value in methods if inspect.isfunction(value)]
            named |= {f"{kind.__name__}.{name}": value for name, value in vars(kind).items() if name[0] != "_"}
        for function in (value for value in own if inspect.isfunction(value)):
            arguments = inspect.signature(function).parameters.items()
            named |= {f"{function.__qualname__}({name})": value.default for name, value in arguments}
        for name, value in named.items():
            text = repr(value)
            if has_number(value) and len(text) < LONGEST and "<" not in text and text not in room.get(name, ()):
                room.setdefault(name, []).append(text)
    return table


def has_number(value: object) -> bool:
    """Whether a value is a number or a record with numbers."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, tuple | list) else ()
    return isinstance(value, int | float) or is_record(value) or any(map(has_number, inner))


def is_record(value: object) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def write_table(*rooms: str) -> None:
    """Write the results of rooms, or of all, a line a row."""
    sys.path.insert(0, str(HERE.parent))
    from golden.content import content
    from golden.table import table

    for room, rows in table().items():
        if room in rooms or not rooms:
            lines = (
                f"{json.dumps(name)}: {json.dumps(content(row()), ensure_ascii=False)}" for name, row in rows.items()
            )
            (DATA / f"{room}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def main() -> None:
    """Replace the files of this folder."""
    what, *rooms = sys.argv[1:] or ["all"]
    if what != "table":
        DEFAULTS.write_text(json.dumps(defaults(), indent=1) + "\n")
        rooms = (f"{json.dumps(room)}: {json.dumps(values)}" for room, values in constants().items())
        CONSTANTS.write_text("{\n" + ",\n".join(rooms) + "\n}\n")
    if what != "defaults":
        write_table(*rooms)


if __name__ == "__main__":
    main()
