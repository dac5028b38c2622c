"""The atlas of extremes: what it measures is measured right, and nothing is passed over."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from docs.studies.extremes import extremes_figure
from lampest import Data, Estimator, Panel, Recording, Scene, Status, TwoPointReadout, two_point_resistance
from lampest.cost.given import Background, Given
from lampest.cost.terms import CellResistance, Gradient, Misfit, RelativeChange
from lampest.estimate.methods.method import OptimalMethod
from lampest.recording.readings import AT_LEAST, AT_MOST
from lampest.runs.executors import Serial
from lampest.solvers.multistart import best_solution, evaluated
from lampest.studies.certified import correct_digits, exact_residual, fifty_digits
from lampest.studies.extremes import (
    CASES,
    CRASHED,
    AtlasFile,
    AtlasSample,
    Grid,
    Solve,
    atlas_remarks,
    atlas_rows,
    judged,
    mild,
    recording_of,
    run_atlas,
    solves_of,
)
from lampest.studies.study import read_settings

ROOT = Path(__file__).parents[2]


read_atlas = read_settings(AtlasFile)


def test_baselines_are_judged_by_the_cost_that_they_minimise_and_crashes_are_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Relative methods solve theirs without the terms that compare with it."""
    atlas = AtlasFile(1, Grid((2,), (1.0,), (0.0,)), Grid(()), executor=Serial())
    solves = run_atlas(atlas)
    assert {(solve.method, solve.part) for solve in solves} >= {("LSR-dCR", "baseline"), ("LSR-gdCR", "baseline")}
    assert all(solve.verified for solve in solves), solves

    def breaks(*arguments: object) -> None:
        raise KeyError("gone")

    monkeypatch.setattr("lampest.studies.extremes.first_stream", breaks)
    solves = run_atlas(atlas)
    assert all(solve.crashed and "KeyError" in solve.status for solve in solves)
    assert atlas_remarks(solves)[0].startswith("0 of ")


def test_digits() -> None:
    one = np.array([1.0, 2.0])
    assert correct_digits(one, one) == 15
    assert correct_digits(one * (1 + 1e-6), one) == pytest.approx(6, abs=0.01)
    assert correct_digits(3 * one, one) == 0
    assert correct_digits(np.array([np.inf, 0.0]), np.array([np.inf, 0.0])) == 15
    assert np.isnan(correct_digits(np.array([np.nan, 1.0]), one))


def test_scenes_of_an_atlas_are_solved_by_both_formulations_where_its_file_says_so() -> None:
    atlas = AtlasFile(
        1,
        Grid((2, (3, 4)), (1.0, 9.0), (0.0, 10.0), seeds=2),
        Grid((3,), (6.0,), (1.0,)),
        nodal=Grid((2, 3), (1.0,), (0.0, 1.0)),
    )
    random = [sample for sample in atlas.samples if sample.case == "log-uniform"]
    known = [(sample.shape, sample.decades, sample.noise, sample.seed) for sample in random]
    assert known == [*product(((2, 2), (3, 4)), (1, 9), (0, 0.1), (0, 1))]
    assert [len(atlas.formulations(sample)) for sample in random] == [2, *15 * [1]]
    both = {sample.case for sample in atlas.samples if atlas.formulations(sample) == ("reduced", "nodal")}
    contrasted = {"two clusters", "checkerboard"}
    assert both == set(CASES) - contrasted - {"2 x 64"}, "of six decades, and of more than 99 cells, there are none"
    assert {sample.decades for sample in atlas.samples if sample.case in contrasted} == {6}
    assert {sample.shape for sample in atlas.samples if sample.case == "M x 1"} == {(9, 1)}
    assert atlas.audit_cells == 64 and not [*Grid(()).samples("1 x 1")]
    for sizes in ((0,), (65,)):
        with pytest.raises(ValueError, match=r"must|between|at"):
            Grid(sizes)
    shipped = read_atlas(ROOT / "configs" / "extremes.yaml")
    assert list(shipped.estimators) == ["LSM", "LSR-CR", "LSR-dCR", "LSR-gCR", "LSR-gdCR"]
    assert {sample.case for sample in shipped.samples} == set(CASES)
    scenes = sum(len(shipped.formulations(sample)) for sample in shipped.samples)
    assert scenes * 8 >= 2000, "solves: of a scene three of two parts, two of a pair"
    for wrong, sentence in (
        ({"estimators": {}}, "at least one"),
        ({"grid": Grid(()), "structured": Grid(())}, "no scene"),
    ):
        with pytest.raises(ValueError, match=sentence):
            replace(atlas, **wrong)


def test_fifty_digits_of_two_apart_and_of_a_loop() -> None:
    """1 ohm beside 2, 3 and 4 ohm in series; lines without a path between them have none."""
    np.testing.assert_allclose(fifty_digits(np.array([[1.0, np.inf], [np.inf, 2.0]])), [[1, np.inf], [np.inf, 2]])
    expected = [[1 * 9 / 10, 2 * 8 / 10], [3 * 7 / 10, 4 * 6 / 10]]
    np.testing.assert_allclose(fifty_digits(np.array([[1.0, 2.0], [3.0, 4.0]])), expected, rtol=1e-15)
    np.testing.assert_allclose(fifty_digits(np.array([[0.0, 2.0], [3.0, 4.0]]))[0], [0, 2 * 7 / 9], atol=1e-20)


def solve(**changes: Any) -> Solve:
    """A verified solve of a random panel."""
    known = {"case": "log-uniform", "rows": 3, "columns": 4, "decades": 6.0, "noise": 0.01, "seed": 0, "part": "frame"}
    known |= {"method": "LSM", "formulation": "reduced", "solved": True, "status": "optimum verified", "iterations": 4}
    known |= {"residual": 1e-9, "audited": 2e-9, "excess": -1.0, "model_digits": 11.0, "forward_digits": 12.0}
    return Solve(**known | changes)


def test_rows_and_remarks_of_an_atlas_count_solves() -> None:
    solves = [
        solve(),
        solve(audited=1e-3, residual=1e-10, excess=1e-3, model_digits=9.5, iterations=10),
        solve(
            solved=False, status="stopped: too many iterations", model_digits=np.nan, forward_digits=9.0, iterations=7
        ),
        solve(solved=False, status=f"{CRASHED}KeyError: no", residual=1.0),
        solve(case="open cell", decades=0.0),
        solve(case="open cell", decades=0.0, noise=0.1),
    ]
    assert [mild(one) for one in (solves[0], replace(solves[0], decades=7.0), solves[5])] == [True, False, False]
    row = atlas_rows(solves)[0]
    counts = {"solves": 4, "verified": 1, "named": 1, "doubtful": 1, "crashed": 1, "worse": 1}
    digits = {"forward_digits": 9, "model_digits": 9.5, "residual": 1e-9, "audited": 1e-3}
    for name, value in (counts | digits | {"iterations": 5.5, "most_iterations": 10}).items():
        assert getattr(row, name) == value, name
    assert row.statuses.startswith("2 × optimum verified; 1 × stopped")
    assert atlas_remarks(solves) == [
        "4 of 6 solves end with a verified optimum or a sentence (66.67 %)",
        "all: 3 of 6 verified (50.00 %)",
        "contrast up to 10⁶ or a single fault, noise up to 1 %: 2 of 5 verified (40.00 %)",
        "  log-uniform: 1 of 4 verified (25.00 %)",
        "  open cell: 1 of 1 verified (100.00 %)",
        "1 × stopped: too many iterations",
        "1 × crashed: KeyError: no",
    ]
    assert atlas_remarks([])[0].endswith("(none tried)")


def test_parts_of_a_solve_are_judged_by_their_own_frames() -> None:
    """Of cells that are true in one frame alone, the excess of the other one's estimate is far from nothing."""
    sample = AtlasSample("two clusters", 2, 3, 1.0, 0.0, 3)
    recording, cells = recording_of(sample)
    misfit = Misfit(weighting="noise")
    for terms, parts in (((misfit,), ["baseline", "frame"]), ((misfit, RelativeChange(weight=10.0)), ["pair"])):
        estimator = Estimator(terms, OptimalMethod("reduced", joint=True))
        right, wrong = (judged(sample, "mine", estimator, recording, truth, 64) for truth in (cells, cells[::-1]))
        assert [solve.part for solve in right] == parts
        assert all(abs(a.excess) < abs(b.excess) for a, b in zip(right, wrong, strict=True)), (right, wrong)


def test_audit_is_the_kkt_residual() -> None:
    rng = np.random.default_rng(2)
    cells = 3000 * np.exp(0.5 * rng.standard_normal((1, 3, 4)))
    measured = two_point_resistance(cells) * 1.1
    data = Data(Given(measured=measured, sigma=np.ones_like(measured)), measured / 2, 1.2 * cells)
    cost = Estimator((Misfit(), CellResistance(weight=0.1))).cost(Scene(Panel(3, 4)), 1)
    here = evaluated(cost, data, cells * 1.15)
    assert exact_residual(cost, data, here.cell_resistance) == pytest.approx(here.kkt_residual(np.zeros(0)), rel=1e-5)


@pytest.mark.parametrize("error", [np.linalg.LinAlgError, ValueError, FloatingPointError, RuntimeError])
def test_broken_arithmetic_is_a_status(error: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(*arguments: object) -> None:
        raise error("singular")

    recording, _ = recording_of(AtlasSample("log-uniform", 3, 3, 1.0, 0.0, 0))
    estimator = Estimator((Misfit(), Gradient(weight=1e-3)), "reduced")
    data = estimator.data(recording.readings()[0].alone(), Background(recording.scene))
    solver = estimator.problem(Scene(Panel(3, 3)), 1, 1.0)
    for place in (
        "lampest.solvers.projected_newton.newton_direction",
        "lampest.solvers.multistart.evaluated",
        "lampest.panel.readouts.two_point.convex_start",
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, breaks)
            found = best_solution(solver, data, None)
        if place.endswith("convex_start"):
            assert found.solved
        else:
            assert found.status is Status.BREAKDOWN
            assert np.all(np.isnan(found.cell_resistance))


def test_code_at_the_upper_rail_is_never_taken_for_zero() -> None:
    """There the noise of a resistance is larger than the resistance; that does not make it a small one."""
    readout = TwoPointReadout(readings=1)
    resistance = np.array([[[0.4, 2000.0, 3e5], [2.047e6, 6.8e5, 5000.0]]])
    scene = Scene(Panel(2, 3), readout)
    made = Recording(scene, resistance, np.zeros(1), np.ones(1, dtype=np.uint8))
    np.testing.assert_array_equal(made.readings().side[0], [[AT_MOST, 0, 0], [AT_LEAST, 0, 0]])


def test_heat_map_has_a_square_for_every_scene_and_counts_failures(disk: SimpleNamespace) -> None:
    text = "schema: 1\ngrid: {sizes: [2], decades: [1, 2], noise: [0]}\nstructured: {sizes: []}\n"
    text += "estimators: {mine: {terms: {misfit: {}}}}\n"
    atlas = read_settings(AtlasFile)(disk.run(text, "edge.yaml"))
    solves = [solve for sample in atlas.samples for solve in solves_of(atlas, sample)]
    failed = [replace(solve, solved=False, status="crashed: no") if solve.decades == 2 else solve for solve in solves]
    map_axes, bar = extremes_figure(failed).axes
    assert [label.get_text() for label in map_axes.get_yticklabels()] == ["2 × 2, 10¹", "2 × 2, 10²"]
    assert [text.get_text() for text in map_axes.texts] == ["2", "reduced"]
    assert "verified optimum" in bar.get_xlabel()
