"""Results that later versions must give again: the golden table, and the defaults of public classes.

python -m tests.golden.make                  # both
python -m tests.golden.make table            # public results of every room, see table.py
python -m tests.golden.make table report     # those of one room
python -m tests.golden.make defaults

Do so only where numbers are meant to change, and say in the commit why.
"""

import dataclasses
import json
import sys
from pathlib import Path

import lampest

HERE = Path(__file__).parent
DEFAULTS = HERE / "defaults.json"
DATA = HERE / "data"


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
    if what != "defaults":
        write_table(*rooms)


if __name__ == "__main__":
    main()
