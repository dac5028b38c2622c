"""Promises stand in their pages, and the table of promises is that of the tests' marks."""

import re

from promises import ROOT, TABLE, promises, table

from docs.studies.promises import BREAKS, broken, path_of

PROMISES = promises()


def prose(page: str) -> str:
    """A page in one line, without front matter, comments, blocks of code and headings."""
    text = re.sub(r"\A---\n.*?\n---\n", "", page, flags=re.DOTALL)
    text = re.sub(r"^( *)(```|~~~).*?^\1\2\s*$", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    return " ".join(re.sub(r"^#+ .*$", "", text, flags=re.MULTILINE).split())


def test_a_promise_is_a_sentence_of_its_page() -> None:
    pages = {item.page: prose((ROOT / item.page).read_text(encoding="utf-8")) for item in PROMISES}
    assert [item for item in PROMISES if item.sentence not in pages[item.page]] == []


def test_the_table_of_promises_is_that_of_the_marks() -> None:
    assert len(PROMISES) >= 40
    assert TABLE.read_text(encoding="utf-8") == table(), "python -m tests.promises"


def test_the_study_can_break_a_promise() -> None:
    for item in PROMISES:
        change = BREAKS[item.test.partition("::test_")[2]]
        source = (ROOT / path_of(change)).read_text(encoding="utf-8")
        assert broken(source, change) != source, item
