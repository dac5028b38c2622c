"""Text for people is plain: no words of an idiom of our own, no sentence that nobody reads to its end.

User-facing text is the pages, README and CHANGELOG, comments of the shipped YAML, messages and docstrings.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
PAGES = sorted(
    path
    for path in [*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md"), REPOSITORY / "paper/paper.md"]
    if "_build" not in path.parts and path.name not in ("licences.md", "CODE_OF_CONDUCT.md")
)
CONFIGS = sorted((REPOSITORY / "configs").glob("*.yaml"))
CODE = sorted((REPOSITORY / "lampest").rglob("*.py"))
NOT_PLAIN = re.compile(
    r"\b(un?told|says nothing of|leaps?|leapt|torn|bends|gropes?|groping|what [^.,;:|\[]{1,40} what)\b",
    re.IGNORECASE,
)
NAMES = "fro,numer,tung,wakin"  # people, journals, and "to and fro"
MOST_WORDS = 25  # of a sentence of a page


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


def names(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


@pytest.mark.parametrize("page", PAGES, ids=names)
def test_pages_are_plain(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    prose = re.sub(r"`[^`\n]*`", "", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE))
    assert not [found[0] for found in NOT_PLAIN.finditer(prose)]


@pytest.mark.parametrize("page", PAGES, ids=names)
def test_sentences_are_short(page: Path) -> None:
    long = [
        sentence
        for paragraph in paragraphs(page.read_text(encoding="utf-8"))
        for sentence in sentences(paragraph)
        if len(re.findall(r"\w[\w.'’-]*", sentence)) > MOST_WORDS
    ]
    assert not long


@pytest.mark.parametrize("path", CONFIGS, ids=names)
def test_comments_of_configurations_are_plain(path: Path) -> None:
    comments = "\n".join(re.findall(r"(?:^|\s)#(.*)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE))
    assert not [found[0] for found in NOT_PLAIN.finditer(comments)]


def test_messages_and_docstrings_are_plain() -> None:
    found = [
        f"{names(path)}:{node.lineno}: {word[0]}"
        for path in CODE
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value
        for word in NOT_PLAIN.finditer(node.value)
    ]
    assert not found


def test_every_word_is_spelt_right() -> None:
    where = [
        "lampest",
        "docs",
        "configs",
        "paper",
        "README.md",
        "CHANGELOG.md",
        "CONTRIBUTING.md",
        "firmware/README.md",
    ]
    command = [
        sys.executable,
        "-m",
        "codespell_lib",
        "--ignore-words-list",
        NAMES,
        "--skip",
        "*_build*,*.svg,*.bib",
        *where,
    ]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_the_list_finds_what_it_should() -> None:
    assert NOT_PLAIN.search("the scene is told of it") is None or NOT_PLAIN.search("an untold error")
    assert NOT_PLAIN.search("readings that leap") and not NOT_PLAIN.search("a bending moment")
    assert list(sentences("One. Two `a. b` is here: Three.")) == ["One.", "Two code is here:", "Three."]
