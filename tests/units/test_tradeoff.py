"""The trade-off on tiny panels: what is measured and how it is judged. No timing is asserted."""

from pathlib import Path

import numpy as np
import pytest

from lampest.studies.tradeoff import Measured, label, read_plan, run_tradeoff
from lampest.studies.tradeoff_report import front, on_front, summary_rows
from tests.small_files import TRADEOFF

RUNGS = ["naive", "scaled", "linearised", "truncated 2", "region", "reduced", "nodal"]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Measured, ...]:
    path = tmp_path_factory.mktemp("tradeoff") / "tiny.yaml"
    path.write_text(TRADEOFF)
    return run_tradeoff(read_plan(path))


@pytest.mark.slow
def test_every_rung_is_measured_with_every_method_on_every_recording(found: tuple[Measured, ...]) -> None:
    names = {(one.subject.recording.name, one.method, one.formulation) for one in found}
    assert len(names) == len(found) == 2 * 2 * (7 + 6)
    assert {one.formulation for one in found} == set(RUNGS)
    for one in found:
        # A rung that takes long is not repeated.
        assert one.wall.shape == one.cpu.shape
        assert one.wall.shape[0] == 3
        assert one.wall.shape[1] in (1, 2)
        assert one.cell_error.shape == one.gap.shape == one.iterations.shape == (3,)
        assert one.solved.all()


@pytest.mark.slow
def test_gap_is_judged_by_one_cost_and_is_zero_for_the_best(found: tuple[Measured, ...]) -> None:
    least = {}
    for one in found:
        key = (one.subject.recording.name, one.method)
        least[key] = np.minimum(least.get(key, np.inf), one.objective)
    for one in found:
        assert np.all(one.gap >= 0)
        assert np.all((one.gap == 0) == (one.objective == least[one.subject.recording.name, one.method]))
        if one.formulation == "nodal":
            assert np.all(one.gap < 1e-3)
        if one.formulation == "naive":
            assert np.all(one.gap > 1)


def test_no_reconstruction_errs_by_what_it_ignores(found: tuple[Measured, ...]) -> None:
    rows = {row.formulation: row for row in summary_rows(found) if (row.rows, row.columns) == (8, 8)}
    assert rows["naive"].cell_error > 60
    assert rows["reduced"].reached > 0.9
    assert rows["reduced"].memory_mb is None


def test_front_holds_what_nothing_beats() -> None:
    assert front([(3, 1), (1, 5), (2, 5), (2, 2), (4, 1), (5, 0)]) == [1, 3, 0, 5]
    assert front([]) == []


def test_fastest_rung_is_on_the_front(found: tuple[Measured, ...]) -> None:
    rows = [row for row in summary_rows(found) if (row.rows, row.columns) == (8, 8)]
    assert min(rows, key=lambda row: row.frame_ms).formulation in on_front(rows)


@pytest.mark.slow
def test_shipped_file_is_valid() -> None:
    plan = read_plan(Path(__file__).parents[2] / "configs" / "tradeoff.yaml")
    assert {label(formulation) for formulation in plan.settings.ladder} >= set(RUNGS)
    assert {subject.shape for subject in plan.subjects} == {(10, 10), (16, 16), (32, 32), (100, 100)}
