"""The atlas of extremes: what it measures is measured right, and nothing is passed over."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from docs.studies.extremes import extremes_figure
from lampest import Estimator, Panel, Scene, Status
from lampest.cost.given import Background
from lampest.cost.terms import Gradient, Misfit
from lampest.runs.executors import Serial
from lampest.solvers.multistart import best_solution
from lampest.studies.extremes import (
    AtlasFile,
    AtlasSample,
    Grid,
    atlas_remarks,
    recording_of,
    run_atlas,
    solves_of,
)
from lampest.studies.study import read_settings


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
    assert all(solve.crashed and not solve.solved and "KeyError" in solve.status for solve in solves)
    assert atlas_remarks(solves)[0].startswith("0 of ")


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
