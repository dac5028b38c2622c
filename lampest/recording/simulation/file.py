"""Files of simulations: sweep, drawn numbers, and paths of the recordings.

A number may be given as `{uniform: [low, high]}`: it is drawn from a random stream of the seed and
of its place in the file, so that other drawn numbers do not affect it.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from lampest.files.document import Document, Place, entry_at, read_document, validated
from lampest.files.errors import InputError
from lampest.files.process import check_memory
from lampest.files.sweep import combinations
from lampest.files.typed import typed
from lampest.files.whole import check_room
from lampest.panel.scene import without_own_keys
from lampest.recording.simulation.measure import random_stream
from lampest.recording.simulation.simulation import Simulation, simulate


def run(
    path: Path,
    out: Path | None,
    on_frame: Callable[[int, int], None] = lambda done, frames: None,
    settings: tuple[str, ...] = (),
) -> list[Path]:
    """Simulate all recordings of a file and write them; return their paths.

    All recordings are computed before the first one is written. Raises InputError if a file or a
    value is invalid.

    Parameters
    ----------
    path : Path
        Simulation file.
    out : Path or None
        Path of a single recording, or folder of several ones; None: the paths in the file's
        `output`.
    on_frame : callable
        Called with the number of frames done and the number of all frames.
    settings : tuple of str
        Entries PATH=VALUE that override those of the file.
    """
    planned = read_simulations(path, settings)
    targets = _targets(path, out, [name for name, _ in planned])
    # Upper bounds in bytes: of a value with its truth and sums, and of a file.
    needed = sum(32 * simulation.values + 100_000 for _, simulation in planned)
    check_memory(needed, f"{path}: all recordings of the sweep at once")
    check_room(targets[0], needed)
    recordings = []
    done = count(1)
    frames = sum(simulation.all_frames for _, simulation in planned)
    for (name, simulation), target in zip(planned, targets, strict=True):
        try:
            recordings.append(
                simulate(simulation, target.stem, lambda: on_frame(next(done), frames))
            )
        except ValueError as error:
            raise InputError(f"{path}: {name}: {error}") from error
    for target, recording in zip(targets, recordings, strict=True):
        recording.save(target)
    return targets


@typed
def read_simulations(
    path: str | Path, settings: tuple[str, ...] = ()
) -> list[tuple[str, Simulation]]:
    """Return the pairs (output path, simulation) of all combinations of a file's sweep.

    The output path is as in the file. `settings` are entries PATH=VALUE that override those of the
    file. Raises InputError with line and column.

    >>> from pathlib import Path
    >>> text = "{schema: 1, seed: 1, scene: {panel: {rows: 2, columns: 3}}}"
    >>> _ = Path("simulation.yaml").write_text(text)
    >>> len(lampest.read_simulations("simulation.yaml"))
    1
    """
    path = Path(path)
    document = read_document(path, settings)
    simulations = {}
    planned = combinations(document, lambda varied: simulation_of(_drawn(varied)))
    for number, case in enumerate(planned, start=1):
        template = case.value.output or f"{path.stem}{'_{case:03d}' if len(planned) > 1 else ''}.h5"
        name = _filled(document, template, case.value.seed, number, case.assignments)
        if name in simulations:
            raise document.error(
                ("output",),
                f"two recordings would be written to {name}; name the swept values in it",
            )
        simulations[name] = replace(case.value, output=name)
    return list(simulations.items())


def simulation_of(document: Document) -> Simulation:
    """Return the simulation of a document, with the scene's keys of applications.

    Raises InputError as `validated`.
    """
    written = entry_at(document.content, ("scene",))
    own_keys: tuple[tuple[str, Any], ...] = ()
    if isinstance(written, dict):
        marks = document.marks.get("scene", document.marks)
        scene, own_keys = without_own_keys(replace(document, content=written, marks=marks))
        document = replace(document, content=document.content | {"scene": scene.content})
    simulation: Simulation = validated(document, Simulation)
    if not own_keys:
        return simulation
    return replace(simulation, scene=replace(simulation.scene, own_keys=own_keys))


def _drawn(document: Document) -> Document:
    """Return the document with a drawn number in place of every `{uniform: [low, high]}`.

    Raises InputError.
    """
    seed = entry_at(document.content, ("seed",))
    if type(seed) is not int or seed < 0:
        return document

    def walk(node: Any, place: Place) -> Any:
        if isinstance(node, list):
            return [walk(item, (*place, index)) for index, item in enumerate(node)]
        if not isinstance(node, dict):
            return node
        if set(node) != {"uniform"}:
            return {key: walk(item, (*place, key)) for key, item in node.items()}
        bounds = node["uniform"]
        numbers = isinstance(bounds, list) and all(type(bound) in (int, float) for bound in bounds)
        if not numbers or len(bounds) != 2 or not -1e12 < bounds[0] <= bounds[1] < 1e12:
            raise document.error(
                (*place, "uniform"), "must be a list of two numbers, the lower one first"
            )
        return round(float(random_stream(seed, ".".join(map(str, place))).uniform(*bounds)), 6)

    return replace(document, content=walk(document.content, ()))


def _filled(
    document: Document, template: str, seed: int, number: int, assignments: dict[str, Any]
) -> str:
    """Return the output's name with its placeholders replaced.

    Placeholders are {seed}, {case} and the last words of swept paths; {word:03d} pads a number.
    """
    values = {path.split(".")[-1]: value for path, value in assignments.items()} | {
        "seed": seed,
        "case": number,
    }

    def value(match: re.Match[str]) -> str:
        if match[1] not in values:
            raise document.error(
                ("output",), f"{{{match[1]}}} is none of {', '.join(sorted(values))}"
            )
        part = values[match[1]]
        return f"{part:0{match[2]}d}" if match[2] and isinstance(part, int) else str(part)

    name = re.sub(r"\{(\w+)(?::0([1-9])d)?\}", value, template)
    if "{" in name or "}" in name or not name.endswith(".h5"):
        raise document.error(
            ("output",),
            f"'{name}' is no name of a recording: it must end in .h5 and hold no braces",
        )
    return name


def _targets(path: Path, out: Path | None, names: list[str]) -> list[Path]:
    """Return the paths of the recordings.

    Raises InputError if `out` is a file for several, or a folder for one.
    """
    if out is None:
        return [(path.parent / name).parent.resolve() / Path(name).name for name in names]
    if len(names) == 1:
        if out.is_dir():
            raise InputError(f"{out}: is a folder; name the file for the one recording of {path}")
        return [out]
    if out.is_file() or out.suffix == ".h5":
        raise InputError(f"{out}: must be a folder, because {path} makes {len(names)} recordings")
    targets = [out / Path(name).name for name in names]
    if len(set(targets)) < len(targets):
        raise InputError(
            f"{path}: output names differ only by their folders; they cannot all go into {out}"
        )
    return targets
