"""The wheel, and the sdist with all tests, in the hands of a stranger."""

import os
import re
import runpy
import subprocess
import sys
import tarfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from zipfile import ZipFile

import h5py
import pytest
from packaging.requirements import Requirement
from promises import promise
from supply import LICENCES, audit_verdict, locked, plain

from lampest import InputError, datasets, read_run

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = {"requirements.lock": ["plots"], "requirements-dev.lock": ["dev", "docs", "cluster"]}


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the sdist."""
    folder = tmp_path_factory.mktemp("dist")
    command = (sys.executable, "-m", "hatchling", "build", "-d", str(folder))
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=60)
    return folder


@promise(
    "README: This writes a simulated recording and a run file into the current folder, "
    "reconstructs the cells and draws them"
)
@pytest.mark.slow
def test_three_commands_lead_from_the_wheel_to_a_picture(dist: Path, tmp_path: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    site = tmp_path / "site"
    empty = tmp_path / "empty"
    empty.mkdir()
    pip = (
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--no-deps",
        "--no-index",
        "--target",
        str(site),
        str(wheel),
    )
    subprocess.run(pip, check=True, capture_output=True, timeout=60)

    def run(*command: object) -> str:
        options = {"cwd": empty, "env": os.environ | {"PYTHONPATH": str(site)}, "timeout": 120}
        completed = subprocess.run(
            [str(word) for word in command], **options, capture_output=True, text=True, check=False
        )
        assert completed.returncode == 0, completed.stderr
        return completed.stdout

    lampest = (sys.executable, site / "bin" / "lampest")
    started = run(*lampest, "init")
    assert "lampest run run.yaml" in started and "lampest plot results/run/results.h5" in started
    run(*lampest, "run", "run.yaml", "--jobs", "1")
    (picture,) = run(*lampest, "plot", "results/run/results.h5").split()
    assert (empty / picture).read_bytes().startswith(b"\x89PNG")
    with h5py.File(empty / "results" / "run" / "results.h5") as file:
        assert set(file["entry/example"]) >= {"no_penalty", "smooth", "few_changes"}
    code = (
        "from lampest import datasets as data; print(data.load('rod').recorded.ndim, "
        "data.folder(), sep=';')"
    )
    shape, place = run(sys.executable, "-c", code).strip().split(";")
    shipped = Path(place)
    assert shipped.is_relative_to(site) and shape == "3"
    for folder in ("configs", "data"):
        # Runs of other tests keep their checks beside the recordings.
        here, there = (
            {path.name for path in place.iterdir() if ".lampest-check" not in path.suffixes}
            for place in (ROOT / folder, shipped / folder)
        )
        assert here == there
    assert read_run(shipped / "configs" / "table1.yaml").cases
    entries = ("sizes=[2]", "frames=1", "repeats=1", "recordings=1")
    table = run(
        *lampest, "study", "bench", *(word for entry in entries for word in ("--set", entry))
    )
    assert "nodal" in table and "results/bench/bench.csv" in table


@pytest.mark.slow
def test_the_package_page_has_no_dead_links_and_the_sdist_holds_tests_and_pages(dist: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    (archive,) = dist.glob("*.tar.gz")
    with ZipFile(wheel) as held:
        (name,) = (name for name in held.namelist() if name.endswith(".dist-info/METADATA"))
        text = held.read(name).decode()
    assert (
        "removes crosstalk" in text and "Quick overview" in text and "heel, arch and ball" in text
    )
    assert all(link.startswith("http") for link in re.findall(r"\]\(([^)]*)\)", text))
    with tarfile.open(archive) as held:
        names = {name.partition("/")[2] for name in held.getnames()}
    files = (
        "tests/contracts/test_wheel.py",
        "docs/index.md",
        "configs/table1.yaml",
        "data/rod.h5",
        "Makefile",
    )
    assert names.issuperset(files) and not any(
        name.startswith(("results/", ".venv/", ".git/")) for name in names
    )


def test_init_replaces_no_file(tmp_path: Path, lampest: Callable[..., SimpleNamespace]) -> None:
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "run.yaml").write_text("mine")
    completed = lampest("init", tmp_path / "new")
    assert completed.code == 2 and "run.yaml: is there already" in completed.err
    assert [path.read_text() for path in (tmp_path / "new").iterdir()] == ["mine"]


def test_datasets_load_by_name() -> None:
    assert "lamprey_35mm" in datasets.names()
    for name in datasets.names():
        simulated = not name.startswith("insole")
        assert (datasets.load(name).truth_cell_resistance is not None) == simulated
    with pytest.raises(
        InputError, match=r"there is no recording 'lamprey'.*lamprey_25mm, lamprey_35mm"
    ):
        datasets.load("lamprey")


@pytest.mark.parametrize("name", EXTRAS)
def test_the_lock_pins_all_requirements_within_the_constraints_with_hashes(name: str) -> None:
    pinned = locked(ROOT / name)
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    constraints = [Requirement(line) for line in lines if line.strip()]
    further = (text for extra in EXTRAS[name] for text in PROJECT["optional-dependencies"][extra])
    for requirement in map(Requirement, [*PROJECT["dependencies"], *further]):
        assert plain(requirement.name) in pinned, f"{requirement}: run make lock"
        assert pinned[plain(requirement.name)] in requirement.specifier, (
            f"{requirement}: run make lock"
        )
    for package, version in pinned.items():
        versions = {str(each.specifier) for each in constraints if plain(each.name) == package}
        assert not versions or f"=={version}" in versions, f"{package}: run make lock"
    blocks = re.split(r"\n(?=\S)", (ROOT / name).read_text().strip())
    assert len(blocks) > 20, "the packages of the lock were read"
    for block in blocks:
        first, *hashes = [line.strip().removesuffix("\\").strip() for line in block.splitlines()]
        assert re.fullmatch(r"[A-Za-z0-9_.\[\]-]+==\S+( ;.*)?", first), first
        assert hashes and all(
            re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", digest) for digest in hashes
        ), first


def test_set_up_installs_only_packages_with_a_hash() -> None:
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    recipes = re.search(
        r"\$\(VENV\)/\.installed: .*?(?=\$\(VENV\)/\.installed-supply)", text, re.DOTALL
    )
    installs = [
        line for line in recipes[0].splitlines() if "pip install" in line or "$(LOCKED)" in line
    ]
    assert len(installs) == 3
    assert all(
        "$(LOCKED)" in line or "--no-deps --no-build-isolation --editable" in line
        for line in installs
    )
    assert "LOCKED = $(BIN)/python -m pip install $(QUIETLY) --require-hashes" in text


def test_licences_are_listed_and_none_is_copyleft_for_users() -> None:
    rows = re.findall(
        r"^\| (\S+) \| (\S+) \| (.+?) \|", LICENCES.read_text(encoding="utf-8"), re.MULTILINE
    )
    listed = {
        plain(name): licence
        for name, _, licence in rows
        if name != "Name" and not name.startswith("-")
    }
    # What one platform alone or the set-up needs is not always there where the list is made.
    missing = set(locked(ROOT / "requirements.lock")) - set(listed)
    assert missing <= {"setuptools", "colorama", "tzdata"}, "run make licences"
    for name, licence in listed.items():
        weak = "Lesser" in licence or "LGPL" in licence
        assert weak or not re.search(r"GPL|GNU General|Affero|UNKNOWN", licence), (
            f"{name}: {licence}"
        )


@pytest.mark.slow
def test_the_wheel_holds_only_the_package_and_no_gpl(dist: Path) -> None:
    (wheel,) = dist.glob("*.whl")
    with ZipFile(wheel) as archive:
        names = archive.namelist()
        assert {name.split("/")[0] for name in names} == {
            "lampest",
            f"lampest-{PROJECT['version']}.dist-info",
            f"lampest-{PROJECT['version']}.data",
        }
        of_environment = [name for name in names if ".data/" in name]
        assert of_environment == [f"lampest-{PROJECT['version']}.data/scripts/lampest"]
        for name in names:
            text = (
                archive.read(name).partition(b"\n\n")[0]
                if name.endswith("/METADATA")
                else archive.read(name)
            )
            assert not re.search(rb"GNU General Public|GPL-[23]|simavr\.h", text), name


def test_processes_of_a_run_do_not_run_the_command_again() -> None:
    """They import the script of the main process by another name."""
    names = runpy.run_path(str(ROOT / "scripts" / "lampest"), run_name="__mp_main__")
    assert "main" not in names


def test_an_audit_names_unchecked_packages(capsys: pytest.CaptureFixture[str]) -> None:
    fine = {"name": "good", "version": "1", "vulns": []}
    bad = {"name": "bad", "version": "2", "vulns": [{"id": "CVE-1", "fix_versions": ["3"]}]}
    strange = {"name": "odd", "skip_reason": "not found"}
    for packages, code, sentence in (
        (None, 1, "could not be reached; nothing was checked (no route)"),
        ([], 1, "nothing was checked"),
        ([strange], 1, "nothing was checked"),
        ([fine], 0, "1 packages checked, 0 known vulnerabilities"),
        ([fine, strange], 1, "not in the database, so not checked: odd"),
        ([fine, bad], 1, "bad 2: CVE-1, mended in 3"),
    ):
        assert (
            audit_verdict(None if packages is None else {"dependencies": packages}, "no route")
            == code
        )
        assert sentence in capsys.readouterr().out
