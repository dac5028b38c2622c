"""Tools around the package: hooks, the workflow, the first screen of the help, Excel."""

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import openpyxl
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from ruamel.yaml import YAML
from support import invented_case

import lampest as lp

ROOT = Path(__file__).parents[2]
LAST_DIGITS = 1e-14  # relative, of numbers that pass through text
OTHER_VERSIONS = 0.08  # of libraries: how much their sizes may differ, relative
Command = Callable[..., SimpleNamespace]


def constraint(name: str) -> str:
    match = re.search(rf"^{name}==(.+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    assert match is not None
    return match[1]


def test_hooks_use_the_versions_of_the_constraints() -> None:
    hooks = YAML(typ="safe").load(ROOT / ".pre-commit-config.yaml")["repos"][0]["hooks"]
    needed = {text for hook in hooks for text in hook["additional_dependencies"]}
    assert needed == {f"ruff=={constraint('ruff')}", f"codespell=={constraint('codespell')}"}


def test_the_workflow_covers_the_supported_systems_and_versions() -> None:
    workflow = YAML(typ="safe").load(ROOT / ".github" / "workflows" / "tests.yml")
    matrix = workflow["jobs"]["tests"]["strategy"]["matrix"]
    assert matrix["system"] == ["ubuntu-latest", "macos-latest", "windows-latest"]
    least = re.search(r'requires-python = ">=(.+)"', (ROOT / "pyproject.toml").read_text())
    assert least is not None and matrix["python"][0] == least[1]
    commands = [step.get("run", "") for step in workflow["jobs"]["wheel"]["steps"]]
    assert any("twine check" in command for command in commands)
    assert any("check-wheel-contents" in command for command in commands)


def test_the_first_screen_of_the_help_lists_the_first_commands(lampest: Command) -> None:
    shown = lampest("--help").out
    words = re.findall(r"^│ (\w+) ", shown, re.MULTILINE)
    assert {"init", "import", "run", "detect", "info", "plot", "live"} <= set(words)
    assert not {"study", "show"} & set(words)
    assert "lampest study --help" in shown and lampest("study", "--help").code == 0
    assert lampest("show", "terms").code == 0


def test_an_excel_workbook_holds_cells_units_and_meanings(lampest: Command, tmp_path: Path) -> None:
    cases = [
        invented_case("=LSM", "mouth", (3, 4, 5), failed=(1,)),
        invented_case("LSM:a", "other", (2, 3, 6)),
    ]
    lp.write_results(tmp_path / "r.h5", cases)
    assert lampest("export", tmp_path / "r.h5", "--to", "xlsx").code == 0
    book = openpyxl.load_workbook(tmp_path / "r.xlsx", read_only=True)
    units = {line[0]: line[1] for line in book["columns"].iter_rows(values_only=True)}
    assert units["cell_resistance_ohm"] == "ohm" and units["time_s"] == "s"
    assert len(book.sheetnames) == 3
    for sheet, case in zip(book.sheetnames[1:], cases, strict=True):
        names, *lines = book[sheet].iter_rows(values_only=True)
        place = names.index("cell_resistance_ohm")
        cells = [np.nan if line[place] is None else line[place] for line in lines]
        expected = case.cell_resistance.ravel().tolist()
        assert cells == pytest.approx(expected, rel=LAST_DIGITS, nan_ok=True)
        assert not any(
            isinstance(value, str) and value.startswith("=") for line in lines for value in line
        )


def test_numpy_functions_accept_the_symbols_of_a_term_silently() -> None:
    @dataclass(frozen=True)
    class Level(lp.Term):
        kind = "level"
        unit: ClassVar[str] = "1"
        weight: lp.Weight = 1e-3

        def residual(self, state: lp.State) -> Any:
            return np.log(state.cell_resistance)

    recording = lp.Recording.from_array(np.full((2, 3, 4), 500.0), baseline=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert lp.reconstruct(recording, [lp.Misfit(), Level()]).solved.all()


def test_every_extra_is_documented() -> None:
    text = (
        (ROOT / "pyproject.toml")
        .read_text(encoding="utf-8")
        .partition("[project.optional-dependencies]")[2]
    )
    extras = set(re.findall(r"^(\w+) = \[", text.partition("\n# The sdist")[0], re.MULTILINE))
    table = (ROOT / "docs" / "faq.md").read_text(encoding="utf-8").partition("## Which extras")[2]
    named = {
        name
        for row in re.findall(r"^\| (`[^|]+) \|", table, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", row)
    }
    assert named == extras


def installed_megabytes(*extras: str) -> float:
    """MB of lampest's requirements with these extras, and all that they require.

    The MB are those on a disk with blocks of 4 kB.
    """
    pending: list[tuple[str, frozenset[str]]] = [("lampest", frozenset(extras))]
    visited: set[tuple[str, frozenset[str]]] = set()
    sizes: dict[str, int] = {}
    while pending:
        name, requested = pending.pop()
        if (name, requested) in visited:
            continue
        visited.add((name, requested))
        try:
            package = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue  # of another platform, or vendored
        places = (Path(str(file.locate())) for file in package.files or [] if name != "lampest")
        sizes[name] = sum(
            -(-place.stat().st_size // 4096) * 4096 for place in places if place.is_file()
        )
        for text in package.requires or []:
            needed = Requirement(text)
            if needed.marker is None or any(
                needed.marker.evaluate({"extra": extra}) for extra in (*requested, "")
            ):
                pending.append((canonicalize_name(needed.name), frozenset(needed.extras)))
    package_files = [
        file for file in (ROOT / "lampest").rglob("*") if file.is_file() and file.suffix != ".pyc"
    ]
    return (sum(sizes.values()) + sum(file.stat().st_size for file in package_files)) / 1e6


@pytest.mark.slow
def test_an_installation_takes_as_much_room_as_the_readme_says() -> None:
    text = re.search(
        r"Without `\[plots\]`, (\d+) MB in place of (\d+)", (ROOT / "README.md").read_text()
    )
    assert text is not None
    without = installed_megabytes()
    with_plots = installed_megabytes("plots")
    assert without < 600, "with the files that are compiled at the first start"
    assert without == pytest.approx(float(text[1]), rel=OTHER_VERSIONS)
    assert with_plots - without == pytest.approx(
        float(text[2]) - float(text[1]), rel=2.5 * OTHER_VERSIONS
    )


@pytest.mark.slow
def test_the_help_of_init_the_readme_and_the_guide_have_the_same_words_for_circuits(
    lampest: Command, tmp_path: Path
) -> None:
    template = ROOT / "lampest" / "runs" / "starter" / "circuits.yaml"
    lines = {word: entry["line"] for word, entry in YAML(typ="safe").load(template).items()}
    assert len(lines) == len(set(lines.values())) == 13
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    guide = (ROOT / "docs" / "howto" / "readouts.md").read_text(encoding="utf-8")
    shown = " ".join(lampest("init", "--help").out.split())
    assert "`lampest init --help` lists thirteen circuits" in " ".join(readme.split())
    for word, line in lines.items():
        assert f"{word}: {line}" in shown
        assert f" | `{word}` | [" in guide
    assert set(re.findall(r"^\| .* \| `(\w+)` \| \[", guide, re.MULTILINE)) == set(lines)
    circuits = list(lines)
    kinds = set()
    for circuit in circuits:
        assert (
            lampest(
                "init", tmp_path / circuit, "--readout", circuit, "--rows", 3, "--columns", 3
            ).code
            == 0
        )
        kinds.add(lp.read_scene(tmp_path / circuit / "scene.yaml").readout)
    assert len(kinds) == 13
