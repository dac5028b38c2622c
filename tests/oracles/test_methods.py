"""Rungs of the ladder against closed forms and the full solution, and the paper's own solver."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from promises import promise

from docs.studies.as_published import Weights, left_by_solver
from lampest import (
    Array,
    Estimates,
    Method,
    Panel,
    Recording,
    Scene,
    Settings,
    Status,
    Stream,
    TwoPointReadout,
    two_point_resistance,
)
from lampest.cost.losses import Huber
from lampest.cost.terms import CellResistance, Gradient, Misfit, RelativeChange, Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.approximate import LinearisedMethod, TruncatedMethod
from lampest.estimate.methods.method import OptimalMethod
from lampest.estimate.sequence import reconstruct
from lampest.solvers.posed import Bounds
from tests.estimates import recording_of

LSM: tuple[Term, ...] = (Misfit(),)
RIDGE: tuple[Term, ...] = (Misfit(), CellResistance(weight=1e-6))
SMOOTH: tuple[Term, ...] = (Misfit(), Gradient(weight=1e-7))
REDUCED = OptimalMethod("reduced")
CONVERGED = 1e-6  # relative, of cells
ROUNDING = 1e-9
SMALL = 1e-2  # change of log r
OF_ONE_STEP = (
    0.07  # of a change by log 0.7: a step errs by half of its square, 0.064; measured 0.041
)
STOPPED = 0.02  # relative, of cells where the published stopping rules end


def resting(shape: tuple[int, int]) -> Array:
    return np.asarray(3000 * np.exp(0.2 * np.random.default_rng(3).standard_normal(shape)))


def recording(*cells: Array, noise: float = 0.0) -> Recording:
    """Return frames of readings with a relative noise, which σ states."""
    exact = two_point_resistance(np.stack(cells))
    readings = exact * (1 + noise * np.random.default_rng(7).standard_normal(exact.shape))
    return recording_of(Scene(Panel(*cells[0].shape)), readings, 1, sigma=exact * max(noise, 1e-6))


def estimate_by(
    method: Method, data: Recording, terms: tuple[Term, ...] = LSM, **options: Any
) -> Estimates:
    estimate = reconstruct(data, Estimator(terms, method, **options))
    assert all(step.solution.solved for step in estimate.steps)
    return estimate


@pytest.mark.parametrize("terms", [LSM, RIDGE, SMOOTH, (Misfit(), RelativeChange(weight=10))])
def test_many_steps_reach_the_optimum(terms: tuple[Term, ...]) -> None:
    data = recording(resting((5, 6)), 1.1 * resting((5, 6)), 1.2 * resting((5, 6)), noise=1e-4)
    reached, optimum = (
        estimate_by(method, data, terms) for method in (TruncatedMethod(steps=100), REDUCED)
    )
    assert_allclose(reached.cell_resistance, optimum.cell_resistance, rtol=CONVERGED)


@pytest.mark.parametrize("terms", [LSM, RIDGE, SMOOTH, (Misfit(loss=Huber(corner=5.0)),)])
def test_one_step_from_the_baseline_errs_by_the_square_of_the_change(
    terms: tuple[Term, ...],
) -> None:
    errors = []
    direction = np.random.default_rng(2).standard_normal((6, 7))
    for size in (SMALL, SMALL / 10):
        data = recording(resting((6, 7)), resting((6, 7)) * np.exp(size * direction))
        linearised, optimum = (
            estimate_by(method, data, terms).cell_resistance[0]
            for method in (LinearisedMethod(), REDUCED)
        )
        errors.append(np.max(np.abs(np.log(linearised / optimum))))
    assert errors[0] < SMALL
    assert errors[1] < errors[0] / (10**2 / 2), "of second order, a hundredth"


def test_one_step_recovers_a_single_cell_without_a_factorisation() -> None:
    """Conjugate gradients resolve a single cell although lines outweigh it in their objective."""
    shape = (30, 30)
    single = resting(shape)
    single[11, 17] *= 0.7
    estimate = estimate_by(LinearisedMethod(), recording(resting(shape), single)).cell_resistance[0]
    assert estimate[11, 17] / resting(shape)[11, 17] == pytest.approx(0.7, abs=OF_ONE_STEP)
    assert np.median(np.abs(estimate / single - 1)) < CONVERGED


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "term"),
    [
        ("LSR-CR", CellResistance(weight=1e-2)),
        ("LSR-gCR", Gradient(weight=1e-2)),
        ("LSR-dCR", RelativeChange(weight=1.0)),
    ],
)
def test_the_converged_published_method_reaches_the_verified_optimum(
    method: str, term: CellResistance
) -> None:
    """The middle of the panel is pressed harder from frame to frame; readings have 0.1 % noise."""
    rng = np.random.default_rng(4)
    panel = Panel(4, 5)
    cells = np.stack([2000 * np.exp(0.2 * rng.standard_normal(panel.shape))] * 3)
    cells[1:, 1:3, 1:4] *= np.array([0.6, 0.4])[:, None, None]
    readings = TwoPointReadout().exact_reading(cells) * np.exp(
        1e-3 * rng.standard_normal(cells.shape)
    )
    measured = recording_of(Scene(panel, TwoPointReadout()), readings, 1)
    weights = Weights(absolute=1e-2, relative=1.0, start=1.5)
    published = left_by_solver(method, panel, measured.recorded[0], measured.recorded[1:], weights)
    formulation = OptimalMethod("reduced", joint=True)
    estimate = reconstruct(
        measured, Estimator((Misfit(), term), formulation, bounds=Bounds(upper="none"))
    )
    assert set(published.why) <= {"cost", "step", "gradient"} and published.joint == (
        method == "LSR-dCR"
    )
    assert published.baseline == pytest.approx(estimate.baseline_resistance, rel=STOPPED)
    assert published.cells == pytest.approx(estimate.cell_resistance, rel=STOPPED)
    assert published.change == pytest.approx(estimate.relative_change, abs=100 * STOPPED)
    model = TwoPointReadout().exact_reading(published.cells)
    assert published.data_error == pytest.approx(
        100 * np.abs(model / measured.recorded[1:] - 1), abs=ROUNDING
    )


@promise(
    "theory/inverse_problem: the frame is compared with an unloaded panel whose own solve was not "
    "verified."
)
def test_the_status_says_that_the_unloaded_panel_of_a_comparison_is_not_verified() -> None:
    cells = resting((4, 5))
    data = recording(cells, cells * 0.9, noise=1e-3)
    unloaded, loaded = data.readings()[0], data.readings()[1]
    for terms, status in (((Misfit(), RelativeChange()), Status.UNCOMPARED), (LSM, Status.OPTIMUM)):
        estimator = Estimator(terms, OptimalMethod("nodal"))
        stopped = replace(estimator, solver=Settings(max_iterations=1))
        stream = Stream.begin(stopped, data.scene, 1.0, unloaded)
        assert not stream.rested
        after, step = replace(stream, estimator=estimator).push(loaded)
        assert step.solution.status is status and step.solution.solved
        assert after.verified(loaded, after, step)[1].solution.status is status
    rested = Stream.begin(Estimator((Misfit(), RelativeChange()), "nodal"), data.scene, 1, unloaded)
    assert rested.push(loaded)[1].solution.status is Status.OPTIMUM
