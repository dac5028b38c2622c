"""The table of the audit's page: what audit.csv says, between its marks."""

from pathlib import Path

from tests.studies.audit_pages import MARKED, PAGE, rows_of, table, with_table

ROWS = """effect,estimator,recordings,cells,change,pressure,chi_square,told
as told,LSM,4,97.4,96.0,100,0.922657,0
as told,LSR,4,96.6,95.4,98.4,0.922657,0
noise 2,LSM,4,94.2,93.1,nan,3.32,4
noise 2,LSR,4,94.9,93.9,97.1,3.32,4
"""


def test_a_row_for_each_effect_and_a_column_for_each_estimator(tmp_path: Path) -> None:
    for name, rows in (("first", ROWS), ("again", "\n".join(ROWS.splitlines()[:2]))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "audit.csv").write_text(rows)
    lines = table([rows_of(tmp_path / "first"), rows_of(tmp_path / "again")]).splitlines()
    assert lines[0] == "| not told | LSM | LSR | LSM, again | χ² | told |"
    assert lines[2] == "| as told | 97 / 96 / 100 | 97 / 95 / 98 | 97 / 96 / 100 | 0.923 | 0 of 4 |"
    assert lines[3] == "| noise 2 | 94 / 93 / nan | 95 / 94 / 97 |  | 3.32 | 4 of 4 |"


def test_the_page_has_one_place_for_it() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert len(MARKED.findall(text)) == 1
    assert with_table(text, "| new |\n").count("| new |") == 1
