"""`lampest init`: commented starter files.

The files are a run, a scene, a simulation and its recording, and the schema.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import indent

from lampest.audit.widths import NOISE, Width, simulated_widths
from lampest.files.document import parse_document, validated
from lampest.files.errors import InputError, meant
from lampest.files.whole import write_whole
from lampest.panel.readouts import KINDS
from lampest.recording.simulation import simulate
from lampest.recording.simulation.file import simulation_of
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
COMMON_PARTS = {
    "inl_lsb": ("0.5", "sd of the converter's curve; an ATmega328P's is 0.5 (data sheet)"),
    "wire_ohm_per_cell": (
        "0.2",
        "sd of thread or printed silver; of copper: 0",
    ),
}
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
    line : str
        One line on its idle driven lines and on its sensed lines, the same on every page.
    sketch : str
        Sketch of the wiring.
    readout : str
        YAML lines of the scene's readout.
    parts : mapping
        Key of `systematic` → its size, and the parts whose errors it is, with their source.
    software : str
        Wiring of the firmware, or the task of the user's own program.
    """

    kind: str
    line: str
    sketch: str
    readout: str
    parts: Mapping[str, tuple[str, str]]
    software: str


def circuits() -> dict[str, StarterCircuit]:
    """Return the circuits by their words; those of a kind that is not installed are left out."""
    document = parse_document(_template("circuits.yaml"), "circuits.yaml")
    every = validated(document, dict[str, StarterCircuit])
    return {word: circuit for word, circuit in every.items() if circuit.kind in KINDS}


def circuit_called(word: str) -> StarterCircuit:
    """Return the circuit of a word. Raises InputError for an unknown one."""
    known = circuits()
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
    named = {"rows": str(rows), "columns": str(columns), "readout": readout, **wiring}
    centre = f"[{max(5 * columns - 6, 0)}, {max(5 * rows - 4, 0)}]"  # the middle of the panel
    load = (MOUTH if min(rows, columns) >= 6 and not purpose else WEIGHT).replace(
        "{centre}", centre
    )

    def files(widths: Sequence[Width]) -> tuple[str, str]:
        scene = _template(SCENE, **named, systematic=_systematic(chosen.parts, widths))
        scene = scene.replace("# purpose: mat  ", "purpose: mat    ") if purpose else scene
        return scene, _template(SIMULATION, load=load).replace(
            "scene: {}\n", "scene:\n" + indent(scene, "  ")
        )

    _, simulation = files(())
    simulated = simulation_of(parse_document(simulation, SIMULATION))
    recording = simulate(simulated, paths[RECORDING].stem)
    recording.save(paths[RECORDING])
    scene, simulation = files(simulated_widths(recording))
    schema = json.dumps(json_schema(), indent=2) + "\n"
    texts = {SCENE: scene, SIMULATION: simulation, SCHEMA: schema, RUN: _template(RUN)}
    for name, text in texts.items():
        write_whole(paths[name], text)
    return tuple(paths.values())


def _systematic(parts: Mapping[str, tuple[str, str]], widths: Sequence[Width]) -> str:
    """Return the lines of `systematic`, each with its source and its part of the variance."""
    lines = ["# Errors that all frames share. They widen error bars, and change no estimate."]
    if widths:
        noise = ", ".join(f"{width.what} {width.share(NOISE)}" for width in widths)
        lines += [
            "# Percent: part of the variance in example.h5 (no penalty). Noise makes the rest,",
            f"# {noise}. lampest info prints the parts of a recording.",
        ]
    lines.append("systematic:")
    for key, (size, source) in {**parts, **COMMON_PARTS}.items():
        known = [width for width in widths if key in width.shares]
        shares = ", ".join(f"{width.what} {width.share(key)}" for width in known)
        entry = f"  {key}: {size}"
        lines.append(f"{entry:30} # {shares and f'{shares}: '}{source}")
    return "\n".join(lines) + "\n"


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
