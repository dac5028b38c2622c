"""Libraries: messages where one is missing, and commands that import fewer."""

import ast
import itertools
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from promises import promise

import lampest
from lampest.apps.recognition.detect.answer import Detected
from lampest.apps.recognition.detect.output import tell
from lampest.files.errors import PACKAGES, InputError, extra

HOUSE = Path(__file__).parents[2]
PROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text())["project"]
EXTRAS = {"dask": "cluster", "hdmf": "export"}  # come with what an extra names
HEAVY = (
    "casadi",
    "numpy",
    "scipy",
    "h5py",
    "pydantic",
    "ruamel",
    "matplotlib",
    "xarray",
    "pandas",
    "serial",
)
DESCRIBE = (
    "from pathlib import Path; from lampest.report.info import describe; "
    "list(describe(Path('data/ring.h5')))"
)
LOAD_RECORDING = "import lampest; lampest.Recording.load('data/lamprey_35mm.h5')"
HELP = (
    "import contextlib, io, sys; from lampest import cli; sys.argv = ['lampest', '--help']\n"
    "with contextlib.redirect_stdout(io.StringIO()) as page, contextlib.suppress(SystemExit): "
    "cli.main()\n"
    "words = 'run simulate import compare plot show info'.split(); "
    "assert all(word in page.getvalue() for word in words)"
)
TERMS = (
    "import contextlib, io, sys; from lampest import cli; sys.argv = ['lampest', 'show', 'terms']\n"
    "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit): cli.main()\n"
    "import scipy.linalg"
)
ESTIMATE = (
    "import lampest; recording = lampest.Recording.load('tests/golden/recording.h5'); "
    "lampest.reconstruct(recording, [lampest.Misfit(), lampest.LogGradient()])"
)


def imported() -> set[str]:
    """The first names of all modules that lampest imports and Python does not bring."""
    names = set()
    for path in (HOUSE / "lampest").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module)
    return {name.partition(".")[0] for name in names} - sys.stdlib_module_names - {"lampest"}


@pytest.mark.slow
def test_every_optional_library_has_its_pip_name() -> None:
    requirements = [
        *PROJECT["dependencies"],
        *itertools.chain(*PROJECT["optional-dependencies"].values()),
    ]
    known = {
        match[0].lower() for text in requirements if (match := re.match(r"[\w.-]+", text))
    } | EXTRAS.keys()
    known |= {f"lampest[{name}]" for name in PROJECT["optional-dependencies"]}
    assert len(imported()) > 20, "imports were collected"
    assert not {module for module in imported() if PACKAGES.get(module, module) not in known}


@promise("faq: without one, the command that needs it names the extra")
def test_the_error_of_a_missing_library_names_its_extra_unlike_own_modules() -> None:
    for library, groups, brings in (
        ("serial", (), "pyserial"),
        ("paho.mqtt", ("streams",), r"lampest\[streams\]"),
    ):
        words = rf"^{library} is not installed; pip install '{brings}' brings it$"
        with pytest.raises(InputError, match=words), extra(*groups):
            raise ModuleNotFoundError(f"No module named '{library}'", name=library)
    for name in (None, "lampest.nothing"):
        with pytest.raises(ModuleNotFoundError, match=r"^no such module$"), extra("streams"):
            raise ModuleNotFoundError("no such module", name=name)


@pytest.mark.slow
def test_reports_lack_pictures_and_plots_name_the_extra_without_matplotlib(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = lampest.Recording.load(HOUSE / "tests" / "golden" / "recording.h5")
    estimate = lampest.reconstruct(recording, [lampest.Misfit(weighting="noise")], error_bars=False)
    for name in [*sys.modules]:
        if name.startswith("lampest.report.plots"):
            monkeypatch.delitem(sys.modules, name)
        if name.partition(".")[0] == "matplotlib":
            monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for plot in (recording.plot, estimate.plot):
        with pytest.raises(InputError, match=r"pip install 'lampest\[plots\]' brings it"):
            plot()
    monkeypatch.setattr("lampest.report.reconstruction.find_spec", lambda name: None)
    page = estimate._repr_html_()
    assert "<pre" in page and "<img" not in page


def test_detect_writes_everything_but_pictures_without_matplotlib(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("lampest.apps.recognition.detect.output.find_spec", lambda name: None)
    tell(
        [Detected.unknown("mat", "one frame shows no change; three are needed")],
        [],
        tmp_path,
        everything=False,
    )
    assert {path.name for path in tmp_path.iterdir()} == {"detections.h5", "visits.csv"}
    captured = capsys.readouterr()
    assert "lampest[plots]" in captured.out + captured.err


def test_detect_prints_its_warnings_before_it_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = list[str]()

    def draw(answers: Any, season: Any, folder: Path) -> list[Path]:
        printed.extend(capsys.readouterr())
        return [folder / "picture.png"]

    monkeypatch.setattr("lampest.apps.recognition.detect.output.draw", draw)
    answer = Detected.unknown("mat", "one frame shows no change; three are needed")
    tell([replace(answer, warnings=("of the check",))], [], tmp_path, everything=False)
    assert "of the check" in "".join(printed) and "picture.png" in capsys.readouterr().out


def loaded_modules(code: str) -> set[str]:
    """The modules that a fresh process holds after some code."""
    command = [sys.executable, "-c", f"{code}; import sys; print(*sys.modules)"]
    completed = subprocess.run(command, cwd=HOUSE, capture_output=True, text=True)
    assert completed.returncode == 0, completed.stderr
    return set(completed.stdout.split())


@pytest.mark.slow
def test_a_process_imports_only_needed_libraries() -> None:
    for code, absent in (
        (LOAD_RECORDING, ("scipy.linalg", "scipy.sparse", "casadi", "matplotlib", "pandas")),
        ("import lampest.panel.readouts.grounded", ("scipy.linalg", "scipy.special", "casadi")),
        (
            "import lampest.report.info, lampest.report.compare",
            ("scipy.linalg", "casadi", "lampest.estimate"),
        ),
        (DESCRIBE, ("scipy.optimize", "lampest.estimate", "lampest.formulation")),
        (DESCRIBE, ("scipy.sparse.csgraph", "scipy.sparse.linalg")),
        ("import lampest.apps.calibration.resistors", ("scipy.stats", "scipy.optimize")),
        (ESTIMATE, ("scipy.optimize", "scipy.ndimage", "scipy.stats", "matplotlib", "pandas")),
        ("import lampest; assert len(dir(lampest)) > 50", (*HEAVY, "lampest.panel", "lampest.cli")),
        (
            "import lampest; lampest.reconstruct; lampest.Recording; lampest.Misfit; "
            "lampest.Reconstruction",
            ("matplotlib", "xarray", "pandas", "typer"),
        ),
        (HELP, HEAVY),
        (TERMS, ("numpy.f2py",)),
        # of a command whose standard error is no terminal
        ("from lampest.cli.screen import progress; progress('frames').__enter__()", ("rich",)),
        ("import lampest.runs.batch, lampest.runs.executors", ("dask", "distributed")),
    ):
        assert not loaded_modules(code) & set(absent), code
