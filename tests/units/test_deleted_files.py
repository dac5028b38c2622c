"""An effect or a kind of readout is gone with its file: the core runs without it."""

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

import lampest
from lampest.panel.effects import LISTED_SHARED
from lampest.panel.readouts import KINDS
from lampest.panel.sizes import LISTED, LISTED_AT_LINES
from lampest.recording.simulation.measure import OF_EFFECTS
from lampest.runs.starter import circuits

BASES = {"__init__", "line_effect", "sized_effect"}
FOLDER = Path("panel") / "effects"
FILES = sorted(
    path.stem
    for path in (Path(lampest.__file__).parent / FOLDER).glob("*.py")
    if path.stem not in BASES
)
# `make test` takes these: no other file of the core imported as many of their constants.
FAST = ("channels", "creep")
TEXT = """\
schema: 1
seed: 1
scene: {{panel: {{rows: 6, columns: 5}}, readout: {{kind: two_point, adc_bits: 12}}{scene}}}
baseline_frames: 5
frames: 3
loads: [{{kind: rod, centre_mm: [30, 20], diameter_mm: 15, mass_g: 2000}}]
{further}
"""
SCRIPT = """
import json, sys
import lampest
from lampest.audit.advice import Audit
from lampest.cli import main
from lampest.files.document import adapter, parse_document
from lampest.inference.prepared import Prepared
from lampest.recording.simulation import simulate
from lampest.recording.simulation.file import simulation_of

plain, named, gone = json.loads(sys.argv[1])
made = [simulate(simulation_of(parse_document(text, "s.yaml")), "s") for text in (plain, *named)]
for text in gone:
    try:
        simulation_of(parse_document(text, "s.yaml"))
    except lampest.InputError as error:
        print(error)
    else:
        raise AssertionError(f"{text} is understood")
assert adapter(lampest.Scene).json_schema()
assert "verified" in lampest.reconstruct(made[0], [lampest.Misfit()]).status[-1]
assert Audit(Prepared(made[0])).verdict.mark == "yes"
for recording in made[1:]:
    lampest.reconstruct(recording, [lampest.Misfit(weighting="noise")])
made[0].save("mine.h5")
sys.argv = ["lampest", "info", "mine.h5"]
main()
"""


CORE = {"two_point", "driven"}  # kinds of which the core itself makes circuits
PRESETS = sorted(KINDS.keys() - CORE)
WORDS = {kind: [word for word, each in circuits().items() if each.kind == kind] for kind in KINDS}
READOUT_SCRIPT = """
import json, sys
import lampest
from lampest.audit.advice import Audit
from lampest.files.document import adapter
from lampest.inference.prepared import Prepared
from lampest.runs.starter import circuit_called, circuits

kind, others, *words = sys.argv[1:]
assert f'"{kind}"' not in json.dumps(adapter(lampest.Scene).json_schema())
assert " ".join(circuits()) == others
for word in words:
    try:
        circuit_called(word)
    except lampest.InputError as error:
        assert word not in str(error).partition("there are")[2].split(", ")
    else:
        raise AssertionError("the word is offered")
readout = lampest.DrivenReadout(load_ohm=4700.0, drive_ohm=40.0, adc_bits=12, readings=1)
rod = lampest.Rod(centre_mm=(25.0, 25.0), diameter_mm=30.0, mass_g=500.0)
scene = lampest.Scene(lampest.Panel(6, 5), readout)
recording = lampest.simulate(lampest.Simulation(1, 1, scene, frames=3, loads=(rod,)))
assert "verified" in lampest.reconstruct(recording, [lampest.Misfit()]).status[-1]
assert Audit(Prepared(recording)).verdict.mark == "yes"
"""


def file_of(path: str) -> str:
    """Return the name of the file of 'module:class'."""
    return path.partition(":")[0].rpartition(".")[2]


def texts(name: str) -> list[object]:
    """Return a simulation, some whose scenes name all effects but one, and some that name it."""
    plain = {effect.key: effect.path for effect in (*LISTED, *LISTED_AT_LINES) if effect.key}
    left = [f"{key}: estimated" for key, path in plain.items() if file_of(path) != name]
    shared = [f"{key}: estimated" for key, path in LISTED_SHARED.items() if file_of(path) != name]
    named = [
        f", systematic: {systematic}, {', '.join(left)}"
        for systematic in ("typical", f"{{{', '.join(shared)}}}")
    ]
    scenes = [f", {key}: estimated" for key, path in plain.items() if file_of(path) == name]
    systematic = [key for key, path in LISTED_SHARED.items() if file_of(path) == name]
    scenes += [
        f", systematic: {{{key}: {size}}}" for key in systematic for size in (0.1, "estimated")
    ]
    simulated = [key for key, path in OF_EFFECTS.items() if file_of(path) == name] + systematic
    gone = [TEXT.format(scene=scene, further="") for scene in scenes]
    gone += [TEXT.format(scene="", further=f"unmodelled: {{{key}: 0.1}}") for key in simulated]
    return [
        TEXT.format(scene="", further=""),
        [TEXT.format(scene=scene, further="") for scene in named],
        gone,
    ]


def run_without(folder: Path, deleted: Sequence[Path], script: str, *words: str) -> str:
    """Return what a script prints by a copy of the package that lacks some files."""
    house = folder / "lampest"
    shutil.copytree(Path(lampest.__file__).parent, house)  # with what is compiled
    for file in deleted:
        (house / file).unlink(missing_ok=True)
    command = [sys.executable, "-c", script, *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name in FAST else [pytest.mark.slow]) for name in FILES],
)
def test_an_effect_is_gone_with_its_file(name: str, tmp_path: Path) -> None:
    plain, named, gone = texts(name)
    deleted = (FOLDER / f"{name}.py", Path("inference") / "effects" / f"{name}.py")
    printed = run_without(tmp_path, deleted, SCRIPT, json.dumps([plain, named, gone]))
    for sentence in printed.splitlines()[: len(gone)]:
        assert "no installed effect has this key" in sentence or "no such key" in sentence


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=[pytest.mark.slow] if kind != "grounded" else [])
        for kind in PRESETS
    ],
)
def test_a_preset_is_gone_with_its_file(kind: str, tmp_path: Path) -> None:
    assert WORDS[kind], "no word of init has the kind"
    others = " ".join(word for word in circuits() if word not in WORDS[kind])
    deleted = (Path("panel") / "readouts" / f"{kind}.py",)
    run_without(tmp_path, deleted, READOUT_SCRIPT, kind, others, *WORDS[kind])
