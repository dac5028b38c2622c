"""Applications can be deleted, and strangers can add them.

A copy of the package works without each folder of `lampest/apps`: commands of the core run, the
help lacks the commands of that folder alone, and what needs it gets one sentence that names it.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from promises import promise

ROOT = Path(__file__).parents[2]
APPS = ROOT / "lampest" / "apps"
NAMES = sorted(path.parent.name for path in APPS.glob("*/__init__.py"))
# Tests of the core that load no application, nor helpers that do.
OF_THE_CORE = (
    "tests/laws/test_chain.py",
    "tests/laws/test_crosstalk.py",
    "tests/laws/test_kirchhoff.py",
    "tests/laws/test_networks.py",
    "tests/laws/test_preconditioners.py",
    "tests/laws/test_variance_components.py",
    "tests/oracles/test_certainty.py",
    "tests/oracles/test_certificate.py",
    "tests/oracles/test_program.py",
    "tests/oracles/test_starmesh.py",
    "tests/units/test_solver_parts.py",
)
SCENE = "panel: {rows: 3, columns: 4, pitch_mm: 10}\nreadout: {kind: two_point}\n"
# Every use of an application by the core → the application that its sentence names.
ASKED = {
    "read_scene": "film",
    "read purpose": "recognition",
    "tare": "film",
    "compare --report": "page",
    "export --to c": "microcontroller",
    "check --repair": "board",
    "import_file": "foreign",
    "from_dataframe": "foreign",
    "from_xarray": "foreign",
}
# Run in the copy: prints the commands of the help, and the sentence of every use above.
SCRIPT = """
import contextlib, io, json, sys
import numpy as np
import lampest
from lampest.cli import main

def command(*words):
    sys.argv = ["lampest", *words]
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as end:
        return end.code or 0, out.getvalue(), err.getvalue()
    return 0, out.getvalue(), err.getvalue()

def sentence(call, *arguments, **options):
    try:
        call(*arguments, **options)
    except lampest.InputError as error:
        return str(error)
    except Exception as error:
        return repr(error)
    return ""

def of_command(*words):
    code, out, err = command(*words)
    return err if code == 2 else f"code {code}"

from lampest.cli.program import app
import typer
program = typer.main.get_command(app)
words = {name: sorted(getattr(group, "commands", ())) for name, group in program.commands.items()}
values = 500.0 + np.arange(36.0).reshape(3, 3, 4)
recording = lampest.Recording.from_array(values, "ohm", baseline=1)
recording.save("mine.h5")
for line in (["run", "run.yaml", "--out", "out"], ["info", "mine.h5"], ["info", "out/results.h5"],
             ["compare", "out/results.h5"], ["plot", "out/results.h5", "--out", "one.svg"],
             ["export", "out/results.h5", "--to", "csv"], ["check", "out/results.h5"], ["--help"]):
    code, out, err = command(*line)
    assert code == 0, (line, out, err)
sentences = {
    "read_scene": sentence(lampest.read_scene, "film.yaml"),
    "read purpose": sentence(lampest.read_scene, "purpose.yaml"),
    "tare": sentence(lampest.reconstruct, recording, tare=lampest.Tare()),
    "compare --report": of_command("compare", "out/results.h5", "--report", "page.html"),
    "export --to c": of_command("export", "out/results.h5", "--to", "c", "--out", "c"),
    "check --repair": of_command("check", "mine.h5", "--repair"),
    "import_file": sentence(lambda: lampest.import_file("mine.csv", 3, 4)),
    "from_dataframe": sentence(lampest.Recording.from_dataframe, None, rows=3, columns=4),
    "from_xarray": sentence(lampest.Recording.from_xarray, None),
}
print(json.dumps([words, sentences]))
"""
MISSING = "the application '{}' is not installed"


@cache
def needs_of(name: str) -> set[str]:
    """The applications that one says that it imports."""
    script = (
        "import json; from lampest.files.applications import applications; "
        "print(json.dumps({name: each.needs for name, each in applications().usable.items()}))"
    )
    completed = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return set(json.loads(completed.stdout)[name])


class Copy:
    """A copy of the package from which applications are taken away."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(ROOT / "lampest", folder / "lampest")
        for name in ("tests", "data", "configs", "pyproject.toml"):
            (folder / name).symlink_to(ROOT / name)

    def python(self, *words: str, cwd: Path | None = None) -> str:
        """The output of Python, which must succeed, with the package of this copy."""
        options = {"cwd": cwd or self.folder, "capture_output": True, "text": True}
        environment = os.environ | {"PYTHONPATH": str(self.folder)}
        completed = subprocess.run([sys.executable, *words], env=environment, **options)
        assert completed.returncode == 0, f"{completed.stdout}\n{completed.stderr}"
        return completed.stdout

    def without(self, gone: set[str], work: Path) -> tuple[dict[str, list[str]], dict[str, str]]:
        """The commands, and the sentences of all uses, without some applications."""
        (work / "film.yaml").write_text(f"{SCENE}film: {{hysteresis: 0.1}}\n")
        (work / "purpose.yaml").write_text(f"{SCENE}purpose: mat\n")
        (work / "run.yaml").write_text(
            "schema: 1\nrecordings: [mine.h5]\nestimators: {LSM: {terms: {misfit: {}}}}\n"
            "check: none\n"
        )
        (work / "mine.csv").write_text("1,2,3,4\n5,6,7,8\n9,10,11,12\n")
        hidden = self.folder / "hidden"
        hidden.mkdir()
        try:
            for name in gone:
                (self.folder / "lampest" / "apps" / name).rename(hidden / name)
            words, sentences = json.loads(self.python("-c", SCRIPT, cwd=work).splitlines()[-1])
        finally:
            for path in hidden.iterdir():
                path.rename(self.folder / "lampest" / "apps" / path.name)
            hidden.rmdir()
        return words, sentences


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Copy]:
    """One copy of the package for all tests."""
    yield Copy(tmp_path_factory.mktemp("copy"))


CORE = {"init", "simulate", "tare", "run", "info", "compare", "plot", "export", "check", "show"}
WORDS = {
    "board": {"record"},
    "calibration": {"calibrate"},
    "foreign": {"import"},
    "live": {"live"},
    "recognition": {"detect"},
    "studies": {"study"},
}


def check(gone: set[str], words: dict[str, list[str]], sentences: dict[str, str]) -> None:
    """Without some applications, the help lacks their commands alone, and each use names one."""
    lost = set().union(*(WORDS.get(name, set()) for name in gone))
    remaining = set().union(*(WORDS.get(name, set()) for name in NAMES)) - lost
    assert set(words) == CORE | remaining
    for use, name in ASKED.items():
        named = MISSING.format(name)
        assert (named in sentences[use]) == (name in gone), f"{use}: {sentences[use]}"
        if name in gone:
            assert sentences[use].count("\n") <= 1 and "Error(" not in sentences[use]


@promise("howto/adding/application: works without each of them")
def test_the_core_runs_without_any_application_and_names_the_missing_one(
    copied: Copy, tmp_path: Path
) -> None:
    check(set(NAMES), *copied.without(set(NAMES), tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_core_runs_without_an_application_and_those_that_need_it(
    name: str, copied: Copy, tmp_path: Path
) -> None:
    gone = {name} | {user for user in NAMES if name in needs_of(user)}
    gone |= {user for user in NAMES if needs_of(user) & gone}
    assert name != "recognition" or gone == {"recognition", "live", "calibration"}
    check(gone, *copied.without({name}, tmp_path))


@pytest.mark.slow
def test_tests_of_the_core_pass_without_any_application(copied: Copy) -> None:
    apps = copied.folder / "lampest" / "apps"
    apps.rename(copied.folder / "apps")
    try:
        options = ("-q", "-x", "-p", "no:cacheprovider", "-m", "not slow and not long")
        copied.python("-m", "pytest", *options, *OF_THE_CORE)
    finally:
        (copied.folder / "apps").rename(apps)
