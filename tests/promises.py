"""Promises of the pages, each marked in the test that proves it.

    @promise("README: It verifies every estimate")
    def test_...

A promise is a page and a sentence of it, or a part of a sentence: "README" is `README.md`, any
other page stands in `docs/`, such as "theory/circuit". `python -m tests.promises` writes the table
`docs/reference/promises.md`. `python -m docs.studies.promises` breaks each promise in a copy of the
package and shows that its test fails.
"""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs" / "reference" / "promises.md"
HEAD = """# Promises

What a user of lampest can rely on, and the test that proves it. The tests carry the promises as
marks, from which `python -m tests.promises` writes this table. [A study](../studies/promises.md)
breaks each promise in a copy of the package, and shows that its test fails.

| page | promise | test |
|---|---|---|
"""


class Promise(NamedTuple):
    """A sentence of a page, and the test that proves it.

    Attributes
    ----------
    page : str
        Path of the page, from the root of the checkout.
    sentence : str
        Text of the page, with single blanks.
    test : str
        Identifier of the test for pytest, without variants.
    """

    page: str
    sentence: str
    test: str


def promise(statement: str) -> pytest.MarkDecorator:
    """Mark a test as the proof of a promise, "page: sentence"."""
    return pytest.mark.promise(statement)


def path_of(page: str) -> str:
    """Return the path of a page that a mark names."""
    return "README.md" if page == "README" else f"docs/{page}.md"


@cache
def promises() -> tuple[Promise, ...]:
    """Return the promises of all tests, sorted by page and sentence."""
    marked = []
    for file in (ROOT / "tests").rglob("test_*.py"):
        source = file.read_text(encoding="utf-8")
        if "@promise(" in source:
            marked += list(_promises_of(source, str(file.relative_to(ROOT))))
    return tuple(sorted(marked))


def _promises_of(source: str, file: str) -> Iterator[Promise]:
    """Yield the promises that decorate the functions of a file."""
    for function in ast.parse(source).body:
        if not isinstance(function, ast.FunctionDef):
            continue
        for decorator in function.decorator_list:
            match decorator:
                case ast.Call(func=ast.Name("promise"), args=[ast.Constant(str(statement))]):
                    page, _, sentence = statement.partition(": ")
                    yield Promise(path_of(page), sentence, f"{file}::{function.name}")


def table() -> str:
    """Return the page of all promises."""
    rows = []
    for page, sentence, test in promises():
        title = Path(page).stem
        # Pages of the site do not lead to a file outside of it.
        link = title if page == "README.md" else f"[{title}](../{page.removeprefix('docs/')})"
        rows.append(f"| {link} | {sentence} | `{test.removeprefix('tests/')}` |")
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    TABLE.write_text(table(), encoding="utf-8")
