"""The trade-off on tiny panels, shipped files of studies, tables of pages, atlas of extremes."""

from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from docs.studies.all_pages import commands, with_commit
from docs.studies.audit import Audited, audit_remarks, audit_rows
from docs.studies.audit_pages import MARKED, PAGE, rows_of, table, with_table
from docs.studies.extremes import extremes_figure
from docs.studies.paper_figures import FILE, Side, read_published
from docs.studies.weights import why_not
from lampest import Estimator, InputError, Panel, Recording, Scene, Status
from lampest.apps.studies import common, tradeoff
from lampest.apps.studies.extreme_scenes import AtlasSample, Grid, recording_of
from lampest.apps.studies.extremes import AtlasFile, atlas_remarks, run_atlas, solves_of
from lampest.apps.studies.study import read_settings
from lampest.apps.studies.tradeoff import Plan, read_plan, run_tradeoff
from lampest.cost.given import Background
from lampest.cost.terms import Gradient, Misfit
from lampest.runs.config import read_run
from lampest.runs.executors import Serial
from lampest.solvers.multistart import best_solution
from tests.small_files import write_recording

TINY = """\
schema: 1
recordings: [small.h5]
estimators: {LSM: {terms: {misfit: {}}}}
formulations: [naive, reduced]
frames: 2
repeats: 3
patience_s: 1000
"""
ROWS = """effect,estimator,recordings,cells,change,pressure,alone,ratio,reported
as specified,LSM,4,97.4,96.0,100,95.2,1.04,0
as specified,LSR,4,96.6,95.4,98.4,94.8,0.97,0
noise 2,LSM,4,94.2,93.1,nan,95,1,4
noise 2,LSR,4,94.9,93.9,97.1,95,1,4
"""
CONFIGS = Path(__file__).parents[3] / "configs"


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """An unloaded and two measured frames of 3 × 4 cells, without noise."""
    folder = tmp_path_factory.mktemp("tiny")
    write_recording(folder / "small.h5")
    (folder / "tiny.yaml").write_text(TINY)
    return read_plan(folder / "tiny.yaml")


def test_a_measured_time_is_the_minimum_of_all_turns(
    tiny: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each frame of turn n takes 5 − n s: of a block of frames each has its share."""
    solve = tradeoff.reconstruct
    turns = count()
    solved = list[str]()

    def timed(recording: Recording, estimator: Any, *on_frame: Any) -> Any:
        estimates = solve(recording, estimator, *on_frame)
        turn = next(turns) // 2
        solved.append(estimator.method.kind)
        steps = tuple(replace(step, seconds=5.0 - turn) for step in estimates.steps)
        return replace(
            estimates, steps=steps, baseline=replace(estimates.baseline, seconds=7.0 - turn)
        )

    monkeypatch.setattr(tradeoff, "reconstruct", timed)
    frames = run_tradeoff(tiny)
    assert solved == ["naive", "reduced"] * 3 and all(
        frame.iterations >= 0 and frame.solved for frame in frames
    )
    assert [frame.seconds for frame in frames] == [3] * 4 and {
        frame.baseline_s for frame in frames
    } == {5}
    run_tradeoff(tiny._replace(settings=replace(tiny.settings, patience_s=0.0)))
    assert solved[6:] == ["naive", "reduced"], "no turn begins after the patience"
    steps = list[tuple[int, int]]()
    joint = tiny._replace(settings=replace(tiny.settings, repeats=1))
    run_tradeoff(joint, lambda *at: steps.append(at))
    assert steps == [(1, 1)]
    monkeypatch.setattr(
        tradeoff, "reconstruct", lambda *task: replace(timed(*task), joint_start=True)
    )
    assert {frame.baseline_s for frame in run_tradeoff(joint)} == {0}, (
        "it is solved with the first frame"
    )


def test_the_time_of_a_call_is_the_lesser_of_wall_and_processor_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for wall, cpu in ((3.0, 2.0), (2.0, 3.0)):
        clocks = {"perf_counter": iter([10.0, 10.0 + wall]), "process_time": iter([1.0, 1.0 + cpu])}
        for name, times in clocks.items():
            monkeypatch.setattr(common, name, times.__next__)
        assert common.clocked(lambda: "done") == ("done", 2.0)


@pytest.mark.slow
def test_a_shipped_study_file_is_valid() -> None:
    plan = read_plan(Path(__file__).parents[3] / "configs" / "tradeoff.yaml")
    assert {*plan.settings.ladder} >= {
        "naive",
        "scaled",
        "linearised",
        "truncated 2",
        "reduced",
        "nodal",
    }
    assert {recording.scene.panel.shape for recording in plan.recordings} == {
        (10, 10),
        (16, 16),
        (32, 32),
        (100, 100),
    }


def test_cases_of_the_shipped_tuning_file_can_be_tuned() -> None:
    cases = read_run(Path(__file__).parents[3] / "configs" / "tune.yaml").cases
    assert len(cases) == 8
    assert all(case.estimator.automatic and why_not(case.estimator, 200) is None for case in cases)


def test_a_page_names_the_commit_of_its_last_run_once() -> None:
    text = (
        "# A page\n\n    lampest run a.yaml   # first\n    python -m docs.studies.mats [--seed "
        "1] --kinds 'a b'\n"
    )
    marked = with_commit(text, "abc", "1 May 2026")
    assert marked.startswith(text) and marked.endswith("ran at commit abc, 1 May 2026.\n")
    assert with_commit(marked, "def", "2 May 2026") == marked.replace("abc", "def").replace(
        "1 May", "2 May"
    )
    page = PAGE.with_name("bench.md")
    assert commands(page)[0] == "python -m docs.studies.bench configs/bench.yaml"


def test_the_audit_table_has_a_row_per_effect_and_a_column_per_estimator(tmp_path: Path) -> None:
    (tmp_path / "audit.csv").write_text(ROWS)
    lines = table(rows_of(tmp_path)).splitlines()
    assert lines[0] == "| not specified | LSM | LSR | reported |"
    assert lines[2] == "| as specified | 97/96/100 | 97/95/98 | 0 of 4 |"
    assert lines[3] == "| noise 2 | 94/93/nan | 95/94/97 | 4 of 4 |"
    text = PAGE.read_text(encoding="utf-8")
    assert len(MARKED.findall(text)) == with_table(text, "| new |\n").count("| new |") == 1


def test_table_one_agrees_with_the_shipped_run() -> None:
    """The run's file says it for `lampest compare`, the data file for `docs.studies.paper`."""
    published = read_run(CONFIGS / "table1.yaml").published
    for row in read_published(FILE).errors:
        figures = getattr(published[row.method], row.steps)
        assert (figures.time_s, figures.time_sd_s) == (row.time_s, row.time_sd_s)
        assert (figures.error_percent, figures.error_sd_percent) == (
            row.error_percent,
            row.error_sd_percent,
        )


def test_a_published_method_without_results_gives_one_sentence() -> None:
    with pytest.raises(InputError, match="clean scenes: there are no results of mine"):
        Side("clean scenes", "clean", [], {}, {}, {}).change("mine")


def test_an_audit_in_which_every_estimator_fails_keeps_no_promise() -> None:
    results = [Audited("nothing", seed, "LSM", failed="no error bars") for seed in (1, 2)]
    [row] = audit_rows(results)
    assert (row.verdict, row.failed, row.solved) == ("failed", 2, 0)
    assert "0 of 1 rows keep the promise; not: nothing × LSM" in audit_remarks(results)


def test_baselines_are_judged_by_their_own_cost_and_crashes_are_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Relative methods solve theirs without the terms that compare with it."""
    atlas = AtlasFile(1, Grid((2,), (1.0,), (0.0,)), Grid(()), executor=Serial())
    solves = run_atlas(atlas)
    assert {(solve.method, solve.part) for solve in solves} >= {
        ("LSR-dCR", "baseline"),
        ("LSR-gdCR", "baseline"),
    }
    assert all(solve.verified for solve in solves), solves

    def breaks(*arguments: object) -> None:
        raise KeyError("gone")

    monkeypatch.setattr("lampest.apps.studies.extremes.first_stream", breaks)
    solves = run_atlas(atlas)
    assert all(
        solve.crashed and not solve.solved and "KeyError" in solve.status for solve in solves
    )
    assert atlas_remarks(solves)[0].startswith("0 of ")


@pytest.mark.parametrize(
    "error", [np.linalg.LinAlgError, ValueError, FloatingPointError, RuntimeError]
)
def test_broken_arithmetic_gives_a_status(
    error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(*arguments: object) -> None:
        raise error("singular")

    recording, _ = recording_of(AtlasSample("log-uniform", 3, 3, 1.0, 0.0, 0))
    estimator = Estimator((Misfit(), Gradient(weight=1e-3)), "reduced")
    data = estimator.data(recording.readings()[0].alone(), Background(recording.scene))
    solver = estimator.problem(Scene(Panel(3, 3)), 1, 1.0)
    for place in (
        "lampest.solvers.multistart.check",
        "lampest.solvers.multistart.evaluated",
        "lampest.panel.readouts.two_point.convex_start",
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, breaks)
            solution = best_solution(solver, data, None)
        if place.endswith("convex_start"):
            assert solution.solved
        else:
            assert solution.status is Status.BREAKDOWN
            assert np.all(np.isnan(solution.cell_resistance))


def test_the_heat_map_has_a_square_for_every_scene_and_counts_failures(
    disk: SimpleNamespace,
) -> None:
    text = "schema: 1\ngrid: {sizes: [2], decades: [1, 2], noise: [0]}\nstructured: {sizes: []}\n"
    text += "estimators: {mine: {terms: {misfit: {}}}}\n"
    atlas = read_settings(AtlasFile)(disk.run(text, "edge.yaml"))
    solves = [solve for sample in atlas.samples for solve in solves_of(atlas, sample)]
    failed = [
        replace(solve, solved=False, status="crashed: no") if solve.decades == 2 else solve
        for solve in solves
    ]
    map_axes, bar = extremes_figure(failed).axes
    assert [label.get_text() for label in map_axes.get_yticklabels()] == [
        "2 × 2, 10¹",
        "2 × 2, 10²",
    ]
    assert [text.get_text() for text in map_axes.texts] == ["2", "reduced"]
    assert "verified optimum" in bar.get_xlabel()
