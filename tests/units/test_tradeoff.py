"""The trade-off on tiny panels: what is measured and how it is judged. No timing is asserted."""

from pathlib import Path

import numpy as np
import pytest

from lampest.studies.tradeoff import TradeoffFrame, label, read_plan, run_tradeoff
from lampest.studies.tradeoff_report import front, ladder_rows, on_front
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
