"""A kind of readout is gone with its file: the others estimate, and no word offers it."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import lampest
from lampest.panel.readouts import KINDS
from lampest.runs.starter import circuits

CORE = {"two_point", "driven"}  # kinds of which the core itself makes circuits
PRESETS = sorted(KINDS.keys() - CORE)
WORDS = {kind: [word for word, each in circuits().items() if each.kind == kind] for kind in KINDS}
SCRIPT = """
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
    house = tmp_path / "lampest"
    shutil.copytree(Path(lampest.__file__).parent, house)  # with what is compiled
    (house / "panel" / "readouts" / f"{kind}.py").unlink()
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    others = " ".join(word for word in circuits() if word not in WORDS[kind])
    done = subprocess.run(
        [sys.executable, "script.py", kind, others, *WORDS[kind]],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
