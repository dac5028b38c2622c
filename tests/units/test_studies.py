"""The trade-off on tiny panels, shipped files of studies, the tables of pages. No timing is asserted."""

from pathlib import Path

import numpy as np
import pytest

from docs.studies.audit import Audited, audit_remarks, audit_rows
from docs.studies.audit_pages import MARKED, PAGE, rows_of, table, with_table
from lampest.runs.config import read_run
from lampest.studies.paper.page import PublishedNumber, counts, covered
from lampest.studies.paper.sides import FILE, read_published
from lampest.studies.tradeoff import Simulated, TradeoffFile, TradeoffFrame, label, read_plan, run_tradeoff
from lampest.studies.tradeoff_report import front, ladder_rows, on_front
from lampest.studies.weights import why_not
from tests.small_files import TRADEOFF

RUNGS = ["naive", "scaled", "linearised", "truncated 2", "reduced", "nodal"]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> list[TradeoffFrame]:
    path = tmp_path_factory.mktemp("tradeoff") / "tiny.yaml"
    path.write_text(TRADEOFF)
    return run_tradeoff(read_plan(path))


@pytest.mark.slow
def test_every_rung_is_measured_with_every_method_on_every_recording(found: list[TradeoffFrame]) -> None:
    names = {(one.recording, one.method, one.solver, one.frame) for one in found}
    assert len(names) == len(found) == 2 * 2 * (6 + 5) * 3
    assert {one.solver for one in found} == set(RUNGS)
    assert all(one.solved and one.seconds > 0 for one in found)


@pytest.mark.slow
def test_gap_is_judged_by_one_cost_and_is_zero_for_the_best(found: list[TradeoffFrame]) -> None:
    least: dict[tuple[str, str, int], float] = {}
    for one in found:
        key = (one.recording, one.method, one.frame)
        least[key] = min(least.get(key, np.inf), one.objective)
    for one in found:
        assert one.gap >= 0
        assert (one.gap == 0) == (one.objective == least[one.recording, one.method, one.frame])
        if one.solver == "nodal":
            assert one.gap < 1e-3
        if one.solver == "naive":
            assert one.gap > 1


@pytest.mark.slow
def test_no_reconstruction_errs_by_what_it_ignores(found: list[TradeoffFrame]) -> None:
    rows = {row.formulation: row for row in ladder_rows(found) if (row.rows, row.columns) == (8, 8)}
    assert rows["naive"].cell_error > 60
    assert rows["reduced"].reached > 0.9
    assert rows["reduced"].memory_mb is None


def test_front_holds_what_nothing_beats() -> None:
    assert front([(3, 1), (1, 5), (2, 5), (2, 2), (4, 1), (5, 0)]) == [1, 3, 0, 5]
    assert front([]) == []


@pytest.mark.slow
def test_fastest_rung_is_on_the_front(found: list[TradeoffFrame]) -> None:
    rows = [row for row in ladder_rows(found) if (row.rows, row.columns) == (8, 8)]
    assert min(rows, key=lambda row: row.frame_ms).formulation in on_front(rows)


@pytest.mark.slow
def test_shipped_file_is_valid() -> None:
    plan = read_plan(Path(__file__).parents[2] / "configs" / "tradeoff.yaml")
    assert {label(formulation) for formulation in plan.settings.ladder} >= set(RUNGS)
    assert {recording.scene.panel.shape for recording in plan.recordings} == {(10, 10), (16, 16), (32, 32), (100, 100)}


def test_a_tradeoff_compares_all_formulations_by_default_and_fewer_on_larger_panels() -> None:
    settings = TradeoffFile(1, simulated=Simulated((8,)))
    ladder = ["naive", "scaled", "linearised", "truncated 1", "truncated 2", "truncated 4", "reduced", "nodal"]
    assert [label(formulation) for formulation in settings.ladder] == [*ladder, "per_pixel"]
    assert [*settings.rungs((10, 2))] == [*ladder, "per_pixel"]
    assert [*settings.rungs((2, 16))] == ladder and [*settings.rungs((17, 2))] == ladder[:-1]
    assert [*settings.rungs((100, 100))] == ladder[:-1]
    names = ["LSM", "LSR-CR", "LSR-dCR", "LSR-gCR", "LSR-gdCR"]
    assert settings.methods((16, 2)) == names and settings.methods((2, 17)) == ["LSM", "LSR-CR", "LSR-gCR"]
    assert (settings.frames, settings.repeats, settings.patience_s, settings.memory) == (5, 3, 3.0, None)


def test_shipped_file_can_be_tuned() -> None:
    cases = read_run(Path(__file__).parents[2] / "configs" / "tune.yaml").cases
    assert len(cases) == 8
    assert all(case.estimator.automatic and why_not(case.estimator, 200) is None for case in cases)


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


CONFIGS = Path(__file__).parents[2] / "configs"


def test_table_one_is_the_same_in_the_shipped_run() -> None:
    """The run's file says it for `lampest compare`, the data file for `lampest study paper`."""
    beside = read_run(CONFIGS / "table1.yaml").published
    for row in read_published(FILE).errors:
        figures = getattr(beside[row.method], row.steps)
        assert (figures.time_s, figures.time_sd_s) == (row.time_s, row.time_sd_s)
        assert (figures.error_percent, figures.error_sd_percent) == (row.error_percent, row.error_sd_percent)


def test_a_quarter_is_of_the_published_number() -> None:
    row = PublishedNumber("Fig. 8-a", "measured", "%", -80.0, (-60.0, -59.9, -100.1, float("nan")))
    assert [row.reproduced(number) for number in range(4)] == [True, False, False, False]
    assert counts([row], ["one"]).endswith("1 of 1 (one).")


def test_a_mouth_covers_its_rim() -> None:
    change = np.full((8, 9), -5.0)
    change[2:6, 3:8] = -80.0
    change[3:5, 4:7], change[0, 0] = 300.0, -39.0
    assert covered(change) == (4, 5)


def test_an_audit_in_which_every_estimator_fails_keeps_no_promise() -> None:
    results = [Audited("nothing", seed, "LSM", failed="no error bars") for seed in (1, 2)]
    [row] = audit_rows(results)
    assert (row.verdict, row.failed, row.solved) == ("failed", 2, 0)
    assert "0 of 1 rows keep the promise; not: nothing × LSM" in audit_remarks(results)
