"""What a stranger gets: the wheel alone, in an empty folder, and the sdist with all that proves it."""

import os
import re
import subprocess
import sys
import tarfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from zipfile import ZipFile

import h5py
import pytest

from lampest import InputError, datasets, read_run

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the sdist."""
    folder = tmp_path_factory.mktemp("dist")
    command = (sys.executable, "-m", "hatchling", "build", "-d", str(folder))
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=60)
    return folder


@pytest.mark.slow
def test_from_the_wheel_to_a_picture_in_three_commands(dist: Path, tmp_path: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    site, empty = tmp_path / "site", tmp_path / "empty"
    empty.mkdir()
    pip = (sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target", str(site), str(wheel))
    subprocess.run(pip, check=True, capture_output=True, timeout=60)
    surroundings = os.environ | {"PYTHONPATH": str(site)}

    def typed(*command: str) -> str:
        ended = subprocess.run(
            command, cwd=empty, env=surroundings, capture_output=True, text=True, timeout=120, check=False
        )
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    program = str(site / "bin" / "lampest")
    started = typed(sys.executable, program, "init")
    assert "lampest run run.yaml" in started and "lampest plot results/run/results.h5" in started
    typed(sys.executable, program, "run", "run.yaml", "--jobs", "1")
    (picture,) = typed(sys.executable, program, "plot", "results/run/results.h5").split()
    assert (empty / picture).read_bytes().startswith(b"\x89PNG")
    with h5py.File(empty / "results" / "run" / "results.h5") as file:
        assert set(file["entry/example"]) >= {"no_penalty", "smooth", "few_changes"}
    asked = "import lampest; print(lampest.__file__); print(lampest.datasets.load('lamprey_35mm').resistance.shape)"
    where, shape = typed(sys.executable, "-c", asked).splitlines()
    assert where.startswith(str(site)) and shape == "(24, 10, 10)"
    shipped = typed(sys.executable, "-c", "import lampest; print(lampest.datasets.folder())").strip()
    assert Path(shipped).is_relative_to(site)
    for folder in ("configs", "data"):
        files = {path.name for path in (ROOT / folder).iterdir()}
        assert {path.name for path in (Path(shipped) / folder).iterdir()} == files
    assert read_run(Path(shipped) / "configs" / "table1.yaml").cases
    entries = ("sizes=[2]", "frames=1", "repeats=1", "recordings=1", "memory=[]")
    words = [word for entry in entries for word in ("--set", entry)]
    said = typed(sys.executable, program, "study", "bench", *words)
    assert "nodal" in said and "results/bench/bench.csv" in said


def test_the_page_of_a_package_index_has_no_dead_links(dist: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    with ZipFile(wheel) as held:
        (name,) = (name for name in held.namelist() if name.endswith(".dist-info/METADATA"))
        text = held.read(name).decode()
    assert "removes crosstalk" in text and "Quick overview" in text and "Measured: a cross" in text
    assert [link for link in re.findall(r"\]\(([^)]*)\)", text) if not link.startswith("http")] == []


def test_the_sdist_carries_tests_and_pages(dist: Path) -> None:
    (archive,) = dist.glob("*.tar.gz")
    with tarfile.open(archive) as held:
        names = {name.partition("/")[2] for name in held.getnames()}
    for name in ("tests/contracts/test_wheel.py", "docs/index.md", "configs/table1.yaml", "data/rod.h5", "Makefile"):
        assert name in names
    assert not any(name.startswith(("results/", ".venv/", ".git/")) for name in names)


def test_a_start_replaces_nothing(tmp_path: Path, lampest: Callable[..., SimpleNamespace]) -> None:
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "run.yaml").write_text("mine")
    ended = lampest("init", tmp_path / "new")
    assert ended.code == 2 and "run.yaml: is there already" in ended.err
    assert [path.read_text() for path in (tmp_path / "new").iterdir()] == ["mine"]


def test_recordings_are_called_by_name() -> None:
    assert "lamprey_35mm" in datasets.names()
    for name in datasets.names():
        simulated = not name.startswith("insole")
        assert (datasets.load(name).truth_cell_resistance is not None) == simulated
    with pytest.raises(InputError, match=r"there is no recording 'lamprey'.*lamprey_25mm, lamprey_35mm"):
        datasets.load("lamprey")
