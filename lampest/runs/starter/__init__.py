"""`lampest init`: commented starter files.

They are a run, a scene, a simulation and its recording, and the schema.
"""

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
RUN = "run.yaml"
SCENE = "scene.yaml"
SIMULATION = "simulation.yaml"
RECORDING = "example.h5"
SCHEMA = "lampest.schema.json"
MAT = "mat"  # a purpose
FILES = (SCENE, SIMULATION, SCHEMA, RECORDING, RUN)
# The simulated load: a lamprey's mouth on panels of at least 6 × 6 lines, else a weight.
MOUTH = """\
  - kind: oral_disc       # a lamprey's mouth
    centre_mm: {centre}     # x along a row, y down the columns, from cell (0, 0)
    diameter_mm: 35
    rim_width_mm: 6
    pressure_kpa: -12     # below the water's pressure, inside the rim
"""
WEIGHT = """\
  - {kind: rod, centre_mm: {centre}, diameter_mm: 15, mass_g: 200}   # x along a row, y down, from cell (0, 0)
"""  # noqa: E501


@dataclass(frozen=True)
class StarterCircuit:
    """A circuit of circuits.yaml.

    Attributes
    ----------
    kind : str
        Kind of its readout.
    sketch : str
        Sketch of the wiring.
    readout : str
        YAML lines of the scene's readout.
    software : str
        Wiring of the firmware, or the task of the user's own program.
    """

    kind: str
    sketch: str
    readout: str
    software: str


def circuit_called(word: str) -> StarterCircuit:
    """Return the circuit of a name. Raises InputError for an unknown name."""
    document = parse_document(_template("circuits.yaml"), "circuits.yaml")
    known: dict[str, StarterCircuit] = validated(document, dict[str, StarterCircuit])
    if word not in known:
        raise InputError(
            f"--readout: there is no {word!r}; there are {', '.join(known)}{meant(word, known)}"
        )
    return known[word]


def write_starter(
    folder: Path,
    circuit: str = "two_mux",
    rows: int = 10,
    columns: int = 10,
    purpose: str | None = None,
) -> tuple[Path, ...]:
    """Write all files for a circuit and a panel into a folder, and return them.

    The folder is created if necessary.

    Parameters
    ----------
    folder : Path
    circuit : str
        Name of a circuit of circuits.yaml.
    rows, columns : int
        Lines of the panel.
    purpose : str or None
        'mat' for a scene with contacts alone.

    Raises InputError, before any file is written, where one of them exists, and where the folder
    cannot be written or there is no such circuit or panel.
    """
    chosen = circuit_called(circuit)
    paths = {name: folder / name for name in FILES}
    for path in paths.values():
        if path.exists():
            raise InputError(
                f"{path}: is there already; name another folder: existing files are never replaced"
            )
    if purpose not in (None, MAT):
        raise InputError(f"--purpose: there is no {purpose!r}; there is {MAT}")
    wiring = {"sketch": indent(chosen.sketch, "#   "), "software": chosen.software}
    readout = chosen.readout.replace("{groups}", str(_halves(columns)))
    readout = readout.replace("{row_groups}", str(_halves(rows)))
    scene = _template(SCENE, rows=str(rows), columns=str(columns), readout=readout, **wiring)
    scene = scene.replace("# purpose: mat  ", "purpose: mat    ") if purpose else scene
    centre = f"[{max(5 * columns - 6, 0)}, {max(5 * rows - 4, 0)}]"  # the middle of the panel
    load = (MOUTH if min(rows, columns) >= 6 and not purpose else WEIGHT).replace(
        "{centre}", centre
    )
    simulation = _template(SIMULATION, load=load).replace(
        "scene: {}\n", "scene:\n" + indent(scene, "  ")
    )
    simulated: Simulation = validated(parse_document(simulation, SIMULATION), Simulation)
    simulate(simulated, paths[RECORDING].stem).save(paths[RECORDING])
    schema = json.dumps(json_schema(), indent=2) + "\n"
    for name, text in {
        SCENE: scene,
        SIMULATION: simulation,
        SCHEMA: schema,
        RUN: _template(RUN),
    }.items():
        write_whole(paths[name], text)
    return tuple(paths.values())


def _halves(lines: int) -> list[list[int]]:
    """Return the lines behind two multiplexers."""
    half = -(-lines // 2)
    return [list(range(first, min(first + half, lines))) for first in range(0, lines, half)]


def _template(name: str, **values: str) -> str:
    """Return the text of a template with {name} replaced; further braces belong to YAML."""
    text = (TEMPLATES / name).read_text(encoding="utf-8")
    for word, value in values.items():
        text = text.replace(f"{{{word}}}", value)
    return text
