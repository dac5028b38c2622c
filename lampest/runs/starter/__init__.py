"""`lampest init`: commented files to begin with: a run, a scene, a simulation and its recording, the schema."""

import json
from pathlib import Path
from textwrap import indent

from lampest.files.document import parse_document, validated
from lampest.files.errors import InputError
from lampest.files.whole import write_whole
from lampest.recording.simulation import Simulation, simulate
from lampest.runs.config import json_schema

TEMPLATES = Path(__file__).parent
RUN, SCENE, SIMULATION, RECORDING, SCHEMA = (
    "run.yaml",
    "scene.yaml",
    "simulation.yaml",
    "example.h5",
    "lampest.schema.json",
)
FILES = (SCENE, SIMULATION, SCHEMA, RECORDING, RUN)


def write_starter(folder: Path) -> tuple[Path, ...]:
    """Write all files into a folder, which is made where it is not there; returns them.

    Raises InputError where one of them is there already, before any is written, or where the folder cannot be written.
    """
    paths = {name: folder / name for name in FILES}
    for path in paths.values():
        if path.exists():
            raise InputError(f"{path}: is there already; name another folder, and nothing of yours is replaced")
    texts = {name: (TEMPLATES / name).read_text(encoding="utf-8") for name in (SCENE, RUN)}
    texts[SIMULATION] = simulation_text(texts[SCENE])
    texts[SCHEMA] = json.dumps(json_schema(), indent=2) + "\n"
    recording = simulate(validated(parse_document(texts[SIMULATION], SIMULATION), Simulation), paths[RECORDING].stem)
    for name, path in paths.items():
        if name == RECORDING:
            recording.save(path)
        else:
            write_whole(path, texts[name])
    return tuple(paths.values())


def simulation_text(scene: str) -> str:
    """The simulation's file, whose `scene:` is the text of the scene's file."""
    template = (TEMPLATES / SIMULATION).read_text(encoding="utf-8")
    return template.replace("scene: {}\n", "scene:\n" + indent(scene, "  "))
