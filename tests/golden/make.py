"""Results that later versions must give again: the golden table, defaults and constants.

python -m tests.golden.make                  # all
python -m tests.golden.make table            # public results of every room, see table.py
python -m tests.golden.make table report     # those of one room
python -m tests.golden.make defaults         # defaults of public classes, constants of all modules

Rounding differs from processor to processor. The table is computed on several of them, which this
one emulates, and numbers that differ take a tolerance. Processors whose instructions this one lacks
are left out, and their tolerances stay.

Make results anew only where numbers are meant to change, and say in the commit why.
"""

import dataclasses
import importlib
import inspect
import json
import os
import pkgutil
import re
import signal
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

import lampest
from tests.golden.content import content, unsteady

GOLDEN_FOLDER = Path(__file__).parent
DEFAULTS = GOLDEN_FOLDER / "defaults.json"
DATA = GOLDEN_FOLDER / "data"
CONSTANTS = GOLDEN_FOLDER / "constants.json"
TOLERANCES = GOLDEN_FOLDER / "tolerances.json"
# Other processors, as environment variables: kernels of OpenBLAS, instructions of NumPy, and a
# second thread
OLD_PROCESSOR = {"NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL"}
PROCESSORS = (
    *({"OPENBLAS_CORETYPE": kernel} for kernel in ("Prescott", "Nehalem", "SkylakeX")),
    *(
        {"OPENBLAS_CORETYPE": kernel} | OLD_PROCESSOR
        for kernel in ("Sandybridge", "Haswell", "Cooperlake")
    ),
    {"OPENBLAS_NUM_THREADS": "2"},
)
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
    """Write the results of rooms, or of all, a line a row, and tolerances.

    The tolerances are those of the results that other processors change.
    """
    tolerances = json.loads(TOLERANCES.read_text()) if TOLERANCES.exists() else {}
    with TemporaryDirectory() as folder:

        def compute(number: int, variables: dict[str, str]) -> bool:
            command = [
                sys.executable,
                "-m",
                "tests.golden.make",
                "rows",
                f"{folder}/{number}.json",
                *rooms,
            ]
            completed = subprocess.run(
                command, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"} | variables
            )
            if completed.returncode == -signal.SIGILL and variables:
                return False
            completed.check_returncode()
            return True

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            computed = list(pool.map(compute, count(), ({}, *PROCESSORS)))
        stored, *variants = (
            json.loads(Path(folder, f"{number}.json").read_text())
            for number, done in enumerate(computed)
            if done
        )
    left_out = [
        variables for variables, done in zip(PROCESSORS, computed[1:], strict=True) if not done
    ]
    if left_out:
        names = ", ".join(variables["OPENBLAS_CORETYPE"] for variables in left_out)
        print(
            f"Left out, because this processor lacks their instructions: {names}. Their tolerances "
            "stay."
        )
    for room, rows in stored.items():
        lines = (
            f"{json.dumps(name)}: {json.dumps(row, ensure_ascii=False)}"
            for name, row in rows.items()
        )
        (DATA / f"{room}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        previous = tolerances.get(room, {}) if left_out else {}
        tolerances[room] = {}
        for name, row in rows.items():
            places: dict[str, float | None] = previous.get(name, {})
            for variant in variants:
                for place, share in unsteady(row, variant[room][name]):
                    widest = places.get(place, 0.0)
                    places[place] = None if share is None or widest is None else max(share, widest)
            if places:
                tolerances[room][name] = places
    TOLERANCES.write_text(json.dumps(tolerances, indent=1) + "\n")


def write_rows(path: str, *rooms: str) -> None:
    """Write the rows of rooms, or of all, as this process computes them."""
    sys.path.insert(0, str(GOLDEN_FOLDER.parent))
    from golden.table import table

    chosen = {room: rows for room, rows in table().items() if room in rooms or not rooms}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        results = {
            room: {name: content(row()) for name, row in rows.items()}
            for room, rows in chosen.items()
        }
    Path(path).write_text(json.dumps(results))


def main() -> None:
    """Replace the files of this folder."""
    target, *rooms = sys.argv[1:] or ["all"]
    if target == "rows":
        write_rows(*rooms)
        return
    if target != "table":
        DEFAULTS.write_text(json.dumps(defaults(), indent=1) + "\n")
        rooms = (
            f"{json.dumps(room)}: {json.dumps(values)}" for room, values in constants().items()
        )
        CONSTANTS.write_text("{\n" + ",\n".join(rooms) + "\n}\n")
    if target != "defaults":
        write_table(*rooms)


if __name__ == "__main__":
    main()
