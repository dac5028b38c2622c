"""`lampest init`: commented files to begin with: a run, a scene, a simulation and its recording, the schema."""

import json
from dataclasses import dataclass
from pathlib import Path
from textwrap import indent

from lampest.files.document import parse_document, validated
from lampest.files.errors import InputError, meant
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


# A lamprey's mouth where the panel has room for it, else a weight.
MOUTH = """\
  - kind: oral_disc       # a lamprey's mouth
    centre_mm: {centre}     # x along a row, y down the columns, from cell (0, 0)
    diameter_mm: 35
    rim_width_mm: 6
    pressure_kpa: -12     # below the water's pressure, inside the rim
"""
WEIGHT = """\
  - {kind: rod, centre_mm: {centre}, diameter_mm: 15, mass_g: 200}   # x along a row, y down, from cell (0, 0)
"""


@dataclass(frozen=True)
class StarterCircuit:
    """A circuit of circuits.yaml: the kind of its readout, a sketch of the wiring, YAML lines of the scene's readout.

    software : the firmware's wiring, or what the user's own program does. page : where the circuit is explained.
    """

    kind: str
    sketch: str
    readout: str
    software: str
    page: str


def circuit_called(word: str) -> StarterCircuit:
    """The circuit of that word. Raises InputError where there is none."""
    text = (TEMPLATES / "circuits.yaml").read_text(encoding="utf-8")
    known: dict[str, StarterCircuit] = validated(parse_document(text, "circuits.yaml"), dict[str, StarterCircuit])
    if word not in known:
        raise InputError(f"--readout: there is no {word!r}; there are {', '.join(known)}{meant(word, known)}")
    return known[word]


def write_starter(folder: Path, circuit: str = "two_mux", rows: int = 10, columns: int = 10) -> tuple[Path, ...]:
    """Write all files for a circuit and a panel into a folder, which is made where it is not there; returns them.

    Raises InputError where one of them is there already, before any is written, where the folder cannot be written, or
    where there is no such circuit or panel.
    """
    chosen, paths = circuit_called(circuit), {name: folder / name for name in FILES}
    for path in paths.values():
        if path.exists():
            raise InputError(f"{path}: is there already; name another folder, and nothing of yours is replaced")
    texts = {SCENE: starter_scene(chosen, rows, columns), RUN: (TEMPLATES / RUN).read_text(encoding="utf-8")}
    texts[SIMULATION] = simulation_text(texts[SCENE], rows, columns)
    texts[SCHEMA] = json.dumps(json_schema(), indent=2) + "\n"
    recording = simulate(validated(parse_document(texts[SIMULATION], SIMULATION), Simulation), paths[RECORDING].stem)
    for name, path in paths.items():
        if name == RECORDING:
            recording.save(path)
        else:
            write_whole(path, texts[name])
    return tuple(paths.values())


def starter_scene(circuit: StarterCircuit, rows: int, columns: int) -> str:
    """The scene's file: wiring, panel and readout."""
    values = {
        "page": circuit.page,
        "sketch": indent(circuit.sketch, "#   "),
        "software": circuit.software,
        "rows": str(rows),
        "columns": str(columns),
        "readout": circuit.readout,
    }
    return filled_in((TEMPLATES / SCENE).read_text(encoding="utf-8"), values)


def simulation_text(scene: str, rows: int, columns: int) -> str:
    """The simulation's file, whose `scene:` is the text of the scene's file, with a load in the middle of the panel."""
    centre = f"[{max(5 * columns - 6, 0)}, {max(5 * rows - 4, 0)}]"
    load = (MOUTH if min(rows, columns) >= 6 else WEIGHT).replace("{centre}", centre)
    template = filled_in((TEMPLATES / SIMULATION).read_text(encoding="utf-8"), {"load": load})
    return template.replace("scene: {}\n", "scene:\n" + indent(scene, "  "))


def filled_in(text: str, values: dict[str, str]) -> str:
    """A text with {name} replaced; other braces are YAML's."""
    for name, value in values.items():
        text = text.replace(f"{{{name}}}", value)
    return text
