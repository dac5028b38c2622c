"""The list of statements: each stands in its page, and a test fails without it.

`docs/statements.yaml` has two lists for each page: statements with their tests (`tested`), and
sentences whose strong words promise no behaviour, with a reason (`no_behaviour`).
"""

import ast
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
PAGES = (
    ROOT / "README.md",
    ROOT / "docs" / "overview.md",
    ROOT / "docs" / "faq.md",
    *sorted((ROOT / "docs" / "theory").glob("*.md")),
    *sorted((ROOT / "docs" / "howto").glob("*.md")),
    *sorted((ROOT / "docs" / "howto" / "adding").glob("*.md")),
    *sorted((ROOT / "docs" / "apps").rglob("*.md")),
)
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
# Words that exclude every exception, or that say what lampest judges and allows for. "All", "every"
# and "only" mostly count or describe.
STRONG = re.compile(
    r"\b(never|always|cannot|nothing|nobody|exactly|in no case|not modelled|"
    r"(?:does|do) not depend|depends? on no|single (?:minimum|one)|judge[sd]?|allows? for|"
    r"no (?:frame|cell|result|reading|output|warning|error|step|bias|cost|other|estimate)s?)\b",
    re.IGNORECASE,
)
Entry = dict[str, Any]
LIST: dict[str, dict[str, list[Entry]]] = YAML(typ="safe").load(
    (ROOT / "docs" / "statements.yaml").read_text(encoding="utf-8")
)


def plain(text: str) -> str:
    """Text with single blanks."""
    return " ".join(text.split())


def prose(page: str) -> str:
    """A page in one line, without front matter, comments, blocks of code and headings."""
    text = re.sub(r"\A---\n.*?\n---\n", "", page, flags=re.DOTALL)
    text = re.sub(r"^( *)(```|~~~).*?^\1\2\s*$", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    return plain(re.sub(r"^#+ .*$", "", text, flags=re.MULTILINE))


def uncovered(text: str, statements: list[str]) -> list[str]:
    """Strong words, with what surrounds them, that stand within no statement."""
    covered = [
        (match.start(), match.end())
        for statement in statements
        for match in re.finditer(re.escape(plain(statement)), text)
    ]
    return [
        text[max(word.start() - 60, 0) : word.end() + 60]
        for word in STRONG.finditer(text)
        if not any(begin <= word.start() and word.end() <= end for begin, end in covered)
    ]


@cache
def functions(file: str) -> frozenset[str]:
    """Names of the tests of a file."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    names = (node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))
    return frozenset(name for name in names if name.startswith("test_"))


def test_the_list_names_every_page() -> None:
    assert sorted(LIST) == sorted(NAMES)
    assert all(set(entries) <= {"tested", "no_behaviour"} for entries in LIST.values())


@pytest.mark.parametrize("name", NAMES)
def test_statements_stand_in_their_page_and_strong_words_in_statements(name: str) -> None:
    entries = LIST[name]
    text = prose((ROOT / name).read_text(encoding="utf-8"))
    tested = entries.get("tested", [])
    others = entries.get("no_behaviour", [])
    statements = [entry["statement"] for entry in (*tested, *others)]
    assert len(set(map(plain, statements))) == len(statements)
    assert not [statement for statement in statements if plain(statement) not in text]
    assert all(set(entry) == {"statement", "tests"} and entry["tests"] for entry in tested)
    assert all(set(entry) == {"statement", "reason"} and entry["reason"] for entry in others)
    assert not uncovered(text, statements), "add an entry with its test to docs/statements.yaml"


def test_every_named_test_exists() -> None:
    named = {
        test
        for entries in LIST.values()
        for entry in entries.get("tested", [])
        for test in entry["tests"]
    }
    split = [(test, *test.partition("::")[::2]) for test in sorted(named)]
    assert not [
        test
        for test, file, function in split
        if not (ROOT / file).is_file() or function not in functions(file)
    ]


def test_the_check_notices_a_strong_word_without_an_entry() -> None:
    page = "# It never ends\n\nIt never\nfails. Nothing is lost.\n\n```\nalways\n```\n"
    assert [word.strip() for word in uncovered(prose(page), ["It never fails."])] == [
        "It never fails. Nothing is lost."
    ]
    assert not uncovered(prose(page), ["It never fails.", "Nothing is lost"])
