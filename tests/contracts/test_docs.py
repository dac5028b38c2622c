"""The pages are true: examples run as a stranger would run them, and the names in them exist.

Every page of docs/howto/adding is played in a copy of the house. A block that begins with a path is
written to it. A diff is applied; `...` below its class is the body that stands above. A line after
a dollar sign is typed, and its output must stand below, with ... for any text.

Text for people is plain: pages, README and CHANGELOG, comments of the shipped YAML, messages and
docstrings.
"""

import ast
import builtins
import doctest
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import lampest
from lampest import read_run, read_scene

REPOSITORY = Path(__file__).parents[2]
README = REPOSITORY / "README.md"
DOCS = REPOSITORY / "docs"
ADDING = sorted((DOCS / "howto" / "adding").glob("*.md"))
READOUTS = DOCS / "howto" / "readouts.md"
PAGES = (
    README,
    REPOSITORY / "CONTRIBUTING.md",
    REPOSITORY / "firmware" / "README.md",
    *sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts),
)
COPIED = ("lampest", "tests", "docs/studies", "pyproject.toml", "README.md", "LICENSE")
TOOLS = {
    "lampest": f"{sys.executable} -c 'from lampest.cli import main; main()'",
    "python": sys.executable,
    "ruff": f"{sys.executable} -m ruff",
    "mypy": f"{sys.executable} -m mypy",
}
PROSE = sorted(
    path
    for path in [
        *REPOSITORY.glob("*.md"),
        *(REPOSITORY / "docs").rglob("*.md"),
        REPOSITORY / "paper/paper.md",
    ]
    if "_build" not in path.parts and path.name not in ("licences.md", "CODE_OF_CONDUCT.md")
)
NOT_PLAIN = re.compile(
    r"\b(un?told|says nothing of|leaps?|leapt|torn|bends|gropes?|groping|what [^.,;:|\[]{1,40} "
    r"what)\b",
    re.IGNORECASE,
)
NAMES = "fro,numer,tung,wakin"  # people, journals, and "to and fro"
MAX_WORDS = 25  # of a sentence of a page
MAX_PAGE_WORDS = 1500


class Fence(NamedTuple):
    """A fenced block of a page."""

    language: str
    text: str

    @property
    def file(self) -> str:
        """The path in its first line, or nothing."""
        named = re.match(r"# ([\w./]+\.(?:py|yaml|toml))\n", self.text)
        return named[1] if named else ""

    def commands(self) -> Iterator[tuple[str, str]]:
        """Commands of a console with their answers."""
        parts = (
            re.split(r"^\$ ", self.text, flags=re.MULTILINE)[1:]
            if self.language == "console"
            else []
        )
        for command, _, answer in (part.partition("\n") for part in parts):
            yield command, answer


def fences(page: Path) -> tuple[Fence, ...]:
    """The fenced blocks of a page."""
    blocks = re.finditer(
        r"^```(\w+)\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    return tuple(Fence(*block.groups()) for block in blocks)


def with_bodies(blocks: tuple[Fence, ...]) -> tuple[Fence, ...]:
    """Blocks with the body of the page's class in place of the `...` below a diff's class."""

    def with_body(match: re.Match[str]) -> str:
        head = match[1].removeprefix("+")
        body = next(
            text.partition(head)[2]
            for language, text in blocks
            if f"\n{head}" in f"\n{text}" and language == "python"
        )
        lines = re.match(r"(?:(?: {4}.*)?\n)*", body)
        assert lines is not None
        return match[1] + textwrap.indent(lines[0].rstrip() + "\n", "+", lambda line: True)

    written_out = r"^(\+class .*\n)\+    \.\.\.\n"
    return tuple(
        Fence(language, re.sub(written_out, with_body, text, flags=re.MULTILINE))
        for language, text in blocks
    )


EXAMPLES = {
    page.stem: with_bodies(fences(page)) for page in (*ADDING, DOCS / "howto" / "amplifiers.md")
}


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the house with its tests, and the tools as one would type them."""
    for name in COPIED:
        source = REPOSITORY / name
        target = tmp_path / name
        if source.is_dir():
            shutil.copytree(source, target)  # with what is compiled, which stays true of the copy
        else:
            shutil.copy(source, target)
    for name in ("configs", "data"):
        (tmp_path / name).symlink_to(REPOSITORY / name)
    (tmp_path / "bin").mkdir()
    for name, command in TOOLS.items():
        tool = tmp_path / "bin" / name
        tool.write_text(f'#!/bin/sh\nexec {command} "$@"\n')
        tool.chmod(0o755)
    return tmp_path


def run(folder: Path, command: str) -> str:
    """Return the output of a command in a copy of the house; it must succeed."""
    paths = os.pathsep.join((str(folder / "bin"), os.environ.get("PATH", "")))
    environment = os.environ | {"PYTHONPATH": str(folder), "PATH": paths}
    options = {
        "cwd": folder,
        "env": environment,
        "capture_output": True,
        "text": True,
        "timeout": 300,
    }
    completed = subprocess.run(command, shell=True, **options)
    assert completed.returncode == 0, f"$ {command}\n{completed.stdout}{completed.stderr}"
    return completed.stdout


def apply(folder: Path, fence: Fence) -> None:
    """Write a block where its first line says, or apply its diff.

    The removed text must stand there once.
    """
    if fence.file:
        (folder / fence.file).parent.mkdir(parents=True, exist_ok=True)
        (folder / fence.file).write_text(fence.text.partition("\n")[2], encoding="utf-8")
    if fence.language != "diff":
        return
    first, *lines = fence.text.splitlines(keepends=True)
    path = folder / first.removeprefix("--- ").strip()
    text = path.read_text(encoding="utf-8")
    for hunk in "".join(lines).split("@@\n"):
        parts = [(line[0], line[1:]) for line in hunk.splitlines(keepends=True)]
        old, new = ("".join(part for mark, part in parts if mark in (" ", side)) for side in "-+")
        assert text.count(old) == 1, f"{first}{old}stands there {text.count(old)} times"
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_print_the_output_of_their_page(name: str, copy: Path) -> None:
    checker = doctest.OutputChecker()
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    for fence in EXAMPLES[name]:
        apply(copy, fence)
        for command, answer in fence.commands():
            output = run(copy, command)
            assert checker.check_output(answer, output, options), f"$ {command}\n{output}"


@pytest.mark.slow
def test_all_examples_together_keep_the_rules_of_the_house(copy: Path) -> None:
    new = []
    for fence in (fence for blocks in EXAMPLES.values() for fence in blocks):
        apply(copy, fence)
        for command, _ in fence.commands():
            if command.startswith("mv "):
                run(copy, command)
                new.append(command.split()[-1])
        new += (
            re.findall(r"^\+class (\w+)", fence.text, flags=re.MULTILINE)
            if fence.language == "diff"
            else []
        )
    outside = {
        "constraint",
        "program",
        "application",
        "amplifiers",
    }  # these stay outside of the house
    joining = set(EXAMPLES) - outside
    assert len(new) == len(joining), "each page moves one file or one class into the house"
    run(
        copy,
        "python -m pytest -q -x tests/contracts/test_architecture.py -k 'keeps_the_rule or reached "
        "or twelve'",
    )
    run(copy, "ruff check lampest && ruff format --check lampest")
    run(copy, "mypy")


def indented(page: Path) -> list[str]:
    """The blocks of a page that are set in by four blanks, without these."""
    blocks = re.findall(
        r"(?:^    .*\n|^\n(?=    ))+", page.read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    return [textwrap.dedent(block).strip() + "\n" for block in blocks]


@pytest.mark.parametrize(
    "page",
    [README, pytest.param(DOCS / "howto" / "python.md", marks=pytest.mark.slow)],
    ids=lambda page: page.name,
)
def test_python_of_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = [block for language, block in fences(page) if language == "python"]
    blocks += [block for block in indented(page) if block.startswith("import lampest")]
    assert blocks
    for name in ("configs", "data"):
        (tmp_path / name).symlink_to(REPOSITORY / name)
    monkeypatch.chdir(tmp_path)
    exec("\n".join(blocks), {"__name__": "page"})


def test_keys_of_a_run_on_any_page_are_read(tmp_path: Path) -> None:
    """Blocks of YAML that begin with estimators, sweep or executor stand in a run's file."""
    blocks = (block for page in PAGES for language, block in fences(page) if language == "yaml")
    entries = [block for block in blocks if re.match("estimators:|sweep:|executor:", block)]
    assert len(entries) > 6, "the pages have such blocks"
    for block in entries:
        for named in re.findall(r"_file: ([\w.-]+)", block):
            (tmp_path / named).touch()
        run = tmp_path / "run.yaml"
        estimators = (
            ""
            if block.startswith("estimators:")
            else "estimators: {LSR-gCR: {terms: {misfit: {}}}}\n"
        )
        run.write_text(
            f"schema: 1\nrecordings: [{REPOSITORY}/data/rod.h5]\n{estimators}{block}",
            encoding="utf-8",
        )
        assert read_run(run).cases


def test_links_exist() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
            path, _, anchor = target.partition("#")
            if not re.match(r"[a-z]+:", target):
                linked = page if not path else page.parent / path
                assert linked.exists(), f"{page}: {target}"
                assert not anchor or anchor in anchors(linked), f"{page}: {target}"


def test_named_paths_exist() -> None:
    examples = "".join(example.read_text(encoding="utf-8") for example in ADDING)
    moved_files = set(re.findall(r"^\$ mv \S+ (\S+)$", examples, re.MULTILINE))
    for page in PAGES:
        for path in re.findall(
            r"(?<![\w/.-])(?:lampest|tests|configs|docs|firmware)/[\w./*-]*\w",
            page.read_text(encoding="utf-8"),
        ):
            built = path.startswith("docs/_build/")
            assert built or path in moved_files or any(REPOSITORY.glob(path)), f"{page}: {path}"


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    """Every link inside it leads somewhere, and everything that its pages show has run."""
    command = (
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "--keep-going",
        "-b",
        "html",
        "-d",
        str(tmp_path / "read"),
    )
    completed = subprocess.run(
        (*command, str(DOCS), str(tmp_path / "html")),
        capture_output=True,
        text=True,
        timeout=1800,
        cwd=REPOSITORY,
    )
    assert completed.returncode == 0, completed.stderr
    pages = [path.read_text(encoding="utf-8") for path in (tmp_path / "html").rglob("*.html")]
    assert len(pages) > 15, "the site has its pages"
    assert not [
        reference
        for page in pages
        for reference in re.findall(r"<(?:script|link|img)[^>]+https?://[^>]+>", page)
    ]


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_architecture_names_every_room_of_the_core_once() -> None:
    text = (DOCS / "reference" / "architecture.md").read_text(encoding="utf-8")
    chapter = text.partition("\n## Rooms\n")[2].partition("\n## ")[0]
    named = re.findall(r"^\| `(\w+)` \|", chapter, flags=re.MULTILINE)
    house = REPOSITORY / "lampest"
    rooms = {path.parent.name for path in house.glob("*/__init__.py")} - {"apps"}
    assert sorted(named) == sorted(rooms)


def test_places_named_by_the_architecture_hold_the_names_beside_them() -> None:
    text = (DOCS / "reference" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [^|]+ \| ([^|]+) \|$", text, flags=re.MULTILINE)
    places = [place for row in rows for place in re.findall(r"([^;]*?)`(lampest/[\w/]+\.py)`", row)]
    assert len(places) > 15, "the table was read"
    for names, path in places:
        module = (REPOSITORY / path).read_text(encoding="utf-8")
        for name in re.findall(r"`(\w+)`", names):
            assert re.search(rf"^(?:class|def) {name}\b", module, flags=re.MULTILINE), (path, name)


# Names of other programs, of processors, of files' contents, and of examples.
FOREIGN_NAMES = {
    "AttributeManager",
    "COM3",
    "F12",
    "FBT",
    "Haswell",
    "NPY_DISABLE_CPU_FEATURES",
    "PLR0913",
    "Prescott",
    "R3",
    "REC_RAW",
    "RatioGradient",
    "Sandybridge",
    "SkylakeX",
    "blocks_sha256",
    "c3_r0",
    "cell_0_3",
    "cells_0_0",
    "d_norm",
    "h5ds",
    "kind_2",
    "normalized",
    "pressure_0_0",
    "x0y0",
}


TEXTS = re.compile(
    r'''r?"""(?:[^\\]|\\.)*?"""|#[^\n]*|("(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*')''', re.DOTALL
)


def texts_and_code(path: Path) -> tuple[str, str]:
    """The docstrings and comments of a module, and everything else in it."""
    texts: list[str] = []

    def removed(match: re.Match[str]) -> str:
        if not match[1]:
            texts.append(match[0])
        return match[1] or ""

    code = TEXTS.sub(removed, path.read_text(encoding="utf-8"))
    return "\n".join(texts), code


def test_names_in_back_ticks_exist() -> None:
    """Every dotted name in back-ticks, in pages and in docstrings, stands in code or in a file."""
    folders = [REPOSITORY / name for name in ("lampest", "tests", "docs", "configs", "firmware")]
    files = [path for folder in folders for path in folder.rglob("*") if "_build" not in path.parts]
    modules = {path: texts_and_code(path) for path in files if path.suffix == ".py"}
    kinds = (".yaml", ".json", ".c", ".h", ".ino", ".js", ".html", ".css")
    contents = [path.read_text(encoding="utf-8") for path in files if path.suffix in kinds]
    words = set(re.findall(r"\w+", "\n".join([*contents, *(code for _, code in modules.values())])))
    known = words | {*dir(builtins), *FOREIGN_NAMES} | {path.stem for path in files}
    pages = {
        page: re.sub(
            r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
        )
        for page in PAGES
    }
    texts = {path: text for path, (text, _) in modules.items() if "lampest" in path.parts} | pages
    dead = []
    for path, text in texts.items():
        for name in re.findall(r"`([A-Za-z_][\w.]*)`", text):
            is_file = re.search(r"\.(md|py|h5|csv|png|toml|cff)$", name)
            if not is_file and not known.issuperset(filter(None, name.split("."))):
                dead.append(f"{path.relative_to(REPOSITORY)}: {name}")
    assert not dead


def test_the_glossary_names_where_things_are_defined() -> None:
    glossary = (DOCS / "theory" / "glossary.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\|.*\| `(lampest/[\w./]+)`(?:: (.+?))? \|$", glossary, re.MULTILINE)
    assert 30 <= len(rows) <= 40, "the table of the glossary was read, and is short"
    for path, names in rows:
        text = (REPOSITORY / path).read_text(encoding="utf-8")
        for name in re.findall(r"`([^`]+)`", names):
            assert all(re.search(rf"\b{part}\b", text) for part in name.split(".")), (
                f"{path}: {name}"
            )


def test_the_readouts_page_shows_every_kind_with_a_valid_scene_and_a_drawing(
    tmp_path: Path,
) -> None:
    page = READOUTS.read_text(encoding="utf-8")
    blocks = fences(READOUTS)
    kinds = [
        getattr(lampest, name).kind
        for name in dir(lampest)
        if name.endswith("Readout") and name != "Readout"
    ]
    assert len(blocks) >= len(kinds) >= 4 and all(f"kind: {kind}" in page for kind in kinds)
    for fence in blocks:
        (tmp_path / "scene.yaml").write_text(fence.text, encoding="utf-8")
        assert read_scene(tmp_path / "scene.yaml").readout is not None, fence.text
    drawings = re.findall(r"\]\((circuits/\w+\.svg)\)", page)
    assert drawings and all((READOUTS.parent / drawing).is_file() for drawing in drawings)


def test_example_scripts_are_twelve_short_and_public() -> None:
    texts = [path.read_text(encoding="utf-8") for path in (DOCS / "examples").glob("plot_*.py")]
    assert len(texts) == 12 and all(len(text.splitlines()) < 40 for text in texts)
    assert not any(re.search(r"from lampest\.|import lampest\.", text) for text in texts)


def paragraphs(page: str) -> Iterator[str]:
    """Running text of a page in Markdown: no code, tables, headings, directives and formulas."""
    text = re.sub(r"\A---\n.*?\n---\n", "", page, flags=re.DOTALL)
    text = re.sub(r"^( *)(```|:::+|~~~).*?^\1\2\s*$", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\$\$.*?\$\$|<!--.*?-->", "", text, flags=re.DOTALL)
    for block in re.split(r"\n\s*\n|\n(?=\s*[-*] |\s*\d+\. |\|)", text):
        if block.strip() and not re.match(r"\s*\||#| {4}|!\[", block.lstrip("\n")):
            yield " ".join(block.split())


def sentences(paragraph: str) -> Iterator[str]:
    """Its sentences; code and the targets of links count as one word."""
    plain = re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "code", paragraph))
    yield from re.split(r"(?<=[.!?])\s+(?=[^a-z]|lampest\b|code\b)|(?<=[;:])\s+", plain)


def test_pages_are_plain_and_their_sentences_short() -> None:
    for page in PROSE:
        text = page.read_text(encoding="utf-8")
        prose = re.sub(
            r"`[^`\n]*`", "", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
        )
        assert not [match[0] for match in NOT_PLAIN.finditer(prose)], page
        every = (sentence for paragraph in paragraphs(text) for sentence in sentences(paragraph))
        assert not [
            sentence for sentence in every if len(re.findall(r"\w[\w.'’-]*", sentence)) > MAX_WORDS
        ], page


def test_a_page_is_read_in_ten_minutes() -> None:
    for page in PAGES:
        tokens = page.read_text(encoding="utf-8").split()
        words = [token for token in tokens if any(map(str.isalnum, token))]
        assert len(words) <= MAX_PAGE_WORDS, page


def test_comments_messages_and_docstrings_are_plain() -> None:
    comments = (
        (path, comment)
        for path in (REPOSITORY / "configs").glob("*.yaml")
        for comment in re.findall(
            r"(?:^|\s)#(.*)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE
        )
    )
    texts = (
        (path, node.value)
        for path in (REPOSITORY / "lampest").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value
    )
    assert not [
        (path, word[0]) for path, text in (*comments, *texts) for word in NOT_PLAIN.finditer(text)
    ]


def test_every_word_is_spelt_right() -> None:
    pages = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "firmware/README.md"]
    options = ["--ignore-words-list", NAMES, "--skip", "*_build*,*.svg,*.bib"]
    command = [
        sys.executable,
        "-m",
        "codespell_lib",
        *options,
        "lampest",
        "docs",
        "configs",
        "paper",
        *pages,
    ]
    completed = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True)
    assert completed.returncode == 0, completed.stdout


# The way of mats, insoles and skins, and pages beside other programs.

OF_MATS = (
    "tutorial/mats.md",
    "tutorial/own_panel.md",
    "howto/readouts.md",
    "howto/outlines.md",
    "apps/foreign/import.md",
    "apps/board/flexitac.md",
    "apps/live/ros.md",
)


@pytest.mark.parametrize(
    "page", [README, *(DOCS / name for name in OF_MATS)], ids=lambda page: page.name
)
def test_the_path_for_mats_mentions_mats_alone(page: Path) -> None:
    assert not re.search("lamprey", page.read_text(encoding="utf-8"), re.IGNORECASE)


def test_the_page_for_mats_links_such_pages_and_names_existing_columns() -> None:
    page = DOCS / "tutorial" / "mats.md"
    text = page.read_text(encoding="utf-8")
    linked = {
        (page.parent / target).resolve()
        for target in re.findall(r"[^!]\[[^]]*\]\(([^)#]+\.md)", text)
    }
    assert linked <= {DOCS / name for name in OF_MATS}
    table = text.partition("| column | unit")[2].partition("\n\n")[0]
    named = re.findall(r"^\| (`[^|]+) \|", table, re.MULTILINE)
    names = {name for cells in named for name in re.findall(r"`(\w+)`", cells)}
    recording = lampest.Recording.from_array(np.full((3, 2, 2), 500.0), baseline=1)
    estimate = lampest.reconstruct(
        replace(recording, sigma=np.ones((2, 2))), [lampest.Misfit(weighting="noise")]
    )
    assert names - {"reading_model"} <= set(estimate.to_dataframe().columns)


def test_the_ros_example_turns_a_message_into_an_image(tmp_path: Path) -> None:
    (code,) = (
        block
        for language, block in fences(DOCS / "apps" / "live" / "ros.md")
        if language == "python"
    )
    names: dict[str, Any] = {}
    exec(compile(code, "cells.py", "exec"), names)
    message = {"panel": {"rows": 2, "columns": 3}, "cells": [1.5, 2.5, None, 4.0, 5.0, 6.0]}
    image = names["image"](json.dumps(message))
    cells = np.frombuffer(image["data"], dtype="<f4").reshape(image["height"], image["width"])
    np.testing.assert_array_equal(cells, [[1.5, 2.5, np.nan], [4, 5, 6]])
    assert (image["step"], image["encoding"]) == (12, "32FC1")
    assert names["image"](json.dumps(message | {"cells": None})) is None
