"""The audit's verdict without any estimate, and the table of its page: what audit.csv says, between its marks."""

from pathlib import Path

from docs.studies.audit import Audited, audit_remarks, audit_rows
from docs.studies.audit_pages import MARKED, PAGE, rows_of, table, with_table

ROWS = """effect,estimator,recordings,cells,change,pressure,alone,ratio,reported
as specified,LSM,4,97.4,96.0,100,95.2,1.04,0
as specified,LSR,4,96.6,95.4,98.4,94.8,0.97,0
noise 2,LSM,4,94.2,93.1,nan,95,1,4
noise 2,LSR,4,94.9,93.9,97.1,95,1,4
"""


def test_a_row_for_each_effect_and_a_column_for_each_estimator(tmp_path: Path) -> None:
    (tmp_path / "audit.csv").write_text(ROWS)
    lines = table(rows_of(tmp_path)).splitlines()
    assert lines[0] == "| not specified | LSM | LSR | own part, LSM | own part, LSR | reported |"
    assert lines[2] == "| as specified | 97 / 96 / 100 | 97 / 95 / 98 | 95 × 1.04 | 95 × 0.97 | 0 of 4 |"
    assert lines[3] == "| noise 2 | 94 / 93 / nan | 95 / 94 / 97 | 95 × 1.00 | 95 × 1.00 | 4 of 4 |"


def test_the_page_has_one_place_for_it() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert len(MARKED.findall(text)) == 1
    assert with_table(text, "| new |\n").count("| new |") == 1


def test_an_audit_in_which_every_estimator_fails_keeps_no_promise() -> None:
    results = [Audited("nothing", seed, "LSM", failed="no error bars") for seed in (1, 2)]
    [row] = audit_rows(results)
    assert (row.verdict, row.failed, row.solved) == ("failed", 2, 0)
    assert "0 of 1 rows keep the promise; not: nothing × LSM" in audit_remarks(results)
