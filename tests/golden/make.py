"""Results that later versions must give again: one small file for each estimator of run.yaml, the table, defaults.

python -m tests.golden.make                  # all of them
python -m tests.golden.make table            # public results of every room, see table.py
python -m tests.golden.make table report     # those of one room
python -m tests.golden.make defaults         # defaults of the public classes

Do so only where numbers are meant to change, and say in the commit why.
"""

import dataclasses
import io
import json
import shutil
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from unittest.mock import patch

import h5py

import lampest as package
from lampest import cli
from lampest.runs.results import read_results, write_results

HERE = Path(__file__).parent
RECORDING = "recording.h5"
DEFAULTS = HERE / "defaults.json"
DATA = HERE / "data"


def defaults() -> dict[str, dict[str, str]]:
    """Return class → field → default, as Python writes it, of every public configuration."""
    public = {name: getattr(package, name) for name in package.__all__}
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


def lampest(*words: str | Path) -> None:
    """The command within this process, without a word unless it fails."""
    with patch.object(sys, "argv", ["lampest", *map(str, words)]), redirect_stdout(io.StringIO()):
        try:
            cli.main()
        except SystemExit as end:
            assert not end.code, f"lampest ended with code {end.code}"


def simulated(folder: Path) -> Path:
    """The recording that scene.yaml describes, made in `folder`."""
    target = folder / RECORDING
    lampest("simulate", HERE / "scene.yaml", "--out", target)
    return target


def reconstructed(recording: Path, folder: Path) -> dict[str, Path]:
    """Estimator → its results file, made in `folder` from the recording."""
    for source in (recording, HERE / "run.yaml"):
        shutil.copy(source, folder / source.name)
    lampest("run", folder / "run.yaml", "--out", folder / "out", "--jobs", "1")
    cases = read_results(folder / "out" / "results.h5").cases
    for number, case in enumerate(cases):
        write_results(folder / f"{number}.h5", [case])
    return {case.estimator: folder / f"{number}.h5" for number, case in enumerate(cases)}


def keep(results: Path, target: Path) -> None:
    """Write what is compared, and nothing else: a third of a results file, and the same bytes each time."""
    with h5py.File(results) as source, h5py.File(target, "w", libver=("earliest", "v110")) as file:

        def copy(path: str, item: h5py.Group | h5py.Dataset) -> None:
            if isinstance(item, h5py.Dataset) and not path.endswith("_time"):
                file[path] = item[()]
            for name in item.attrs.keys() & {"baseline_status", "joint_start"}:
                file.require_group(path).attrs[name] = item.attrs[name]

        source.visititems(copy)


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
    if what != "all":
        return
    with tempfile.TemporaryDirectory() as name:
        recording = simulated(HERE)
        for file in {*HERE.glob("*.h5")} - {recording}:
            file.unlink()
        for estimator, results in reconstructed(recording, Path(name)).items():
            keep(results, HERE / f"{estimator}.h5")


if __name__ == "__main__":
    main()
