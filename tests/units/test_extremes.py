"""The atlas of extremes: what it measures is measured right, and nothing is passed over."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from docs.studies.extremes import extremes_figure
from lampest import Data, Estimator, Panel, Recording, Scene, Settings, Status, TwoPointReadout, two_point_resistance
from lampest.cost.given import Background, Given
from lampest.cost.terms import CellResistance, Gradient, Misfit, RelativeChange
from lampest.estimate.methods.method import OptimalMethod
from lampest.recording.readings import AT_LEAST, AT_MOST
from lampest.solvers.multistart import best_solution, evaluated
from lampest.studies.extremes.run import (
    CRASHED,
    Solve,
    _parts,
    atlas_remarks,
    atlas_rows,
    correct_digits,
    exact_residual,
    fifty_digits,
    mild,
    run_atlas,
    solves_of,
)
from lampest.studies.extremes.scenes import CASES, GRID, OPEN, AtlasFile, AtlasSample, Grid, recording_of
from lampest.studies.study import read_settings

ROOT = Path(__file__).parents[2]
Command = Callable[..., SimpleNamespace]
read_atlas = read_settings(AtlasFile)
TINY = """\
schema: 1
grid: {sizes: [3], decades: [1, 4], noise: [0, 1]}
structured: {sizes: [3], decades: [6], noise: [0]}
nodal: {sizes: [3], decades: [1], noise: [0]}
estimators: {plain: {terms: {misfit: {}}}, mine: {terms: {misfit: {}, gradient: {weight: 1e-3}}}}
executor: {kind: serial}
"""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> tuple[Solve, ...]:
    path = tmp_path_factory.mktemp("extremes") / "tiny.yaml"
    path.write_text(TINY)
    return run_atlas(read_atlas(path))


@pytest.mark.slow
def test_every_solve_ends_verified_or_with_a_sentence(tiny: tuple[Solve, ...]) -> None:
    assert {solve.case for solve in tiny} == set(CASES)
    assert {solve.formulation for solve in tiny} == {"reduced", "nodal"}
    sentences = {status.value for status in Status}
    for solve in tiny:
        assert solve.verified or (not solve.solved and solve.status in sentences), solve
        # A penalty of 10¹² multiplies the rounding of the gradient; there the step that is left decides.
        assert not solve.solved or solve.residual <= 1e-6 or solve.case == "weight 1e12"
        assert solve.forward_digits > 9, solve
        if mild(solve):
            assert solve.verified, solve
        assert solve.case != "log-uniform" or solve.method != "plain" or solve.excess < 1e-6


def test_baselines_are_judged_by_the_cost_that_they_minimise() -> None:
    """Relative methods solve theirs without the terms that compare with it."""
    found = run_atlas(read_tiny())
    assert {(solve.method, solve.part) for solve in found} >= {("LSR-dCR", "baseline"), ("LSR-gdCR", "baseline")}
    assert all(solve.verified for solve in found), found


def test_rows_count_what_the_solves_say() -> None:
    tiny = run_atlas(read_tiny())
    doctored = (
        replace(tiny[0], audited=1.0),
        replace(tiny[1], solved=False, status=f"{CRASHED}ValueError: no"),
        *tiny[2:],
    )
    found = atlas_rows(doctored)
    assert sum(row.solves for row in found) == len(tiny)
    assert (found[0].doubtful, found[0].crashed, found[0].verified, found[0].named) == (1, 1, 0, 0)
    for row in found:
        assert row.verified + row.named + row.doubtful + row.crashed == row.solves
    assert atlas_remarks(doctored)[0].startswith(f"{len(tiny) - 2} of {len(tiny)} solves end with a verified optimum")


def test_digits() -> None:
    one = np.array([1.0, 2.0])
    assert correct_digits(one, one) == 15
    assert correct_digits(one * (1 + 1e-6), one) == pytest.approx(6, abs=0.01)
    assert correct_digits(3 * one, one) == 0
    assert correct_digits(np.array([np.inf, 0.0]), np.array([np.inf, 0.0])) == 15
    assert np.isnan(correct_digits(np.array([np.nan, 1.0]), one))


@pytest.mark.parametrize("case", CASES)
def test_forward_map_of_every_case_against_fifty_digits(case: str) -> None:
    shape = (CASES[case].shapes or ((4, 3),))[0]
    recording, scene = recording_of(AtlasSample(case, *shape, 9.0, 0.01, 3))
    assert np.all(np.isfinite(recording.resistance))
    certified = fifty_digits(scene.cells[1])
    assert correct_digits(two_point_resistance(scene.cells[1]), certified) > 9.9
    broken = ~np.isfinite(certified)
    assert not np.any(broken) or scene.faults is not None


def test_scenes_are_usual_cells_times_what_they_are_called() -> None:
    usual, decades = np.full((2, 4, 3), 3000.0), 6.0

    def factors(case: str) -> np.ndarray:
        sample = AtlasSample(case, 4, 3, decades, 0.01, 3)
        both = CASES[case].make(usual, sample, np.random.default_rng(1)).cells / usual
        np.testing.assert_array_equal(both[0], both[1])
        return np.asarray(both[0])

    row, column = np.indices((4, 3))
    drawn = np.random.default_rng(1).uniform(-3, 3, (4, 3))
    np.testing.assert_allclose(factors(GRID), 10**drawn)
    np.testing.assert_allclose(factors("two clusters"), np.where((row < 2) | (column < 1), 1e3, 1e-3))
    np.testing.assert_allclose(factors("checkerboard"), np.where((row + column) % 2, 1e3, 1e-3))
    np.testing.assert_allclose(np.sort(factors("1 mOhm to 1 GOhm"), None), np.logspace(-3, 9, 12) / 3000)
    np.testing.assert_allclose(factors("all times 1e6"), 1e6)
    np.testing.assert_allclose(factors("open row"), np.where(row == 2, OPEN, 1))
    np.testing.assert_allclose(factors("open column"), np.where(column == 1, OPEN, 1))
    np.testing.assert_allclose(factors("shorted cell"), np.where((row == 2) & (column == 1), 1 / OPEN, 1))
    rails = np.where((row == 0) & (column == 0), 1e-6, np.where(row == 2, 1e6, 1))
    np.testing.assert_allclose(factors("codes at both rails"), rails)
    np.testing.assert_allclose(
        factors("at the series resistance"), np.where((row == 2) & (column == 1), 1e-3 / 3000, 1)
    )


def test_parts_of_a_solve_are_judged_by_their_own_frames() -> None:
    recording, _ = recording_of(AtlasSample("two clusters", 2, 3, 1.0, 0.01, 3))
    change = RelativeChange(weight=10.0)
    for terms, parts in (
        ((Misfit(),), [("baseline", slice(0, 1)), ("frame", slice(1, 2))]),
        ((Misfit(), change), [("pair", slice(0, 2))]),
    ):
        found = [*_parts(Estimator(terms, OptimalMethod("reduced", joint=True)), recording)]
        assert [(part.name, part.frames) for part in found] == parts
        assert [len(part.data.measured) for part in found] == [len(range(*frames.indices(2))) for _, frames in parts]


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


def test_shipped_atlas_is_in_order() -> None:
    atlas = read_atlas(ROOT / "configs" / "extremes.yaml")
    assert list(atlas.estimators) == ["LSM", "LSR-CR", "LSR-dCR", "LSR-gCR", "LSR-gdCR"]
    assert {task.sample.case for task in atlas.tasks} == set(CASES)
    solves = sum(len(task.formulations) for task in atlas.tasks) * 8  # of a scene: three of two parts, two of a pair
    assert solves >= 2000


def test_crashes_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(*arguments: object) -> None:
        raise KeyError("gone")

    monkeypatch.setattr("lampest.studies.extremes.run.first_stream", breaks)
    atlas = read_tiny()
    found = run_atlas(atlas)
    assert all(solve.crashed and "KeyError" in solve.status for solve in found)
    assert atlas_remarks(found)[0].startswith("0 of ")


def read_tiny() -> AtlasFile:
    from lampest.runs.executors import Serial

    return AtlasFile(1, Grid((2,), (1.0,), (0.0,)), Grid(()), solver=Settings(), executor=Serial())


def test_heat_map_has_a_square_for_every_scene_and_counts_failures(disk: SimpleNamespace) -> None:
    text = "schema: 1\ngrid: {sizes: [2], decades: [1, 2], noise: [0]}\nstructured: {sizes: []}\n"
    text += "estimators: {mine: {terms: {misfit: {}}}}\n"
    atlas = read_settings(AtlasFile)(disk.run(text, "edge.yaml"))
    solves = [solve for task in atlas.tasks for solve in solves_of(task)]
    failed = [replace(solve, solved=False, status="crashed: no") if solve.decades == 2 else solve for solve in solves]
    map_axes, bar = extremes_figure(failed).axes
    assert [label.get_text() for label in map_axes.get_yticklabels()] == ["2 × 2, 10¹", "2 × 2, 10²"]
    assert [text.get_text() for text in map_axes.texts] == ["2", "reduced"]
    assert "verified optimum" in bar.get_xlabel()
