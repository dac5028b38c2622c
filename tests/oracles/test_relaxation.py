"""Losses that are not convex: minima from far, for every solver, and readings that are missed."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from docs.studies.minima import Problem
from lampest import (
    Array,
    Estimator,
    Huber,
    Loss,
    Misfit,
    Panel,
    Readings,
    Scene,
    Solution,
    Student,
    TotalVariation,
)
from lampest.cost.given import Background
from lampest.cost.problem import NO_DUAL, Data, Evaluation
from lampest.cost.terms import LogGradient
from lampest.estimate.methods import named_method
from lampest.solvers import multistart
from lampest.solvers.check import sharp_hessian
from lampest.solvers.multistart import (
    CORNER,
    FAR_OUT,
    LARGEST_STEP,
    best_solution,
    evaluated,
    exchanges,
    huber_of,
    solved_from,
)
from lampest.solvers.projected_lbfgs import serves
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings, Status

SHAPE = (4, 5)
SCENE = Scene(Panel(*SHAPE))
CORNER_SIGMA = 3.0
SAME = 1e-6  # relative, of costs at one minimum; measured 1e-12
NOISE = 1e-3  # of a reading
TERMS = (Misfit(weighting="noise", loss=Student(corner=CORNER_SIGMA)), LogGradient(weight=0.1))


@cache
def cells() -> tuple[Array, Array]:
    """Return the cells of the unloaded panel, and those under a palm that covers it."""
    random = np.random.default_rng(4)
    resting = 3000 * np.exp(0.1 * random.standard_normal(SHAPE))
    return resting, resting * np.exp(-1.0 - 0.2 * random.random(SHAPE))


def exact_reading(pressed: Array | None = None) -> Array:
    """Readings of the palm, or of other cells, without noise."""
    return SCENE.circuit.exact_reading(cells()[1] if pressed is None else pressed)


def frame(wrong: int, pressed: Array | None = None) -> Data:
    """Data of the palm, or of other cells, with so many readings that are half as large."""
    random = np.random.default_rng(7)
    exact = exact_reading(pressed)
    measured = exact * (1 + NOISE * random.standard_normal(SHAPE))
    measured.flat[random.permutation(exact.size)[:wrong]] *= 0.5
    zeros = np.zeros((1, *SHAPE))
    readings = Readings(measured[None], NOISE * exact[None], zeros, zeros + 1)
    return Estimator(TERMS).data(readings, Background(SCENE))


def solved(
    kind: str,
    data: Data,
    previous: Array | None,
    settings: Settings | None = None,
    weight: float = 0.1,
) -> Solution:
    terms = (TERMS[0], LogGradient(weight=weight))
    cost = Estimator(terms, kind).cost(SCENE, 1, partial=False)
    return best_solution(
        named_method(kind).solver(cost, SCENE, settings or Settings(), 1.0), data, previous
    )


@pytest.mark.parametrize("kind", ["reduced", "nodal"])
def test_a_palm_far_from_the_frame_before_is_no_outlier(kind: str) -> None:
    """From the unloaded cells every reading is beyond the corner."""
    data = frame(wrong=1)
    resting, pressed = cells()
    solution = solved(kind, data, resting[None])
    newton = ProjectedNewton(solution.at.cost, Settings())
    reference = solved_from(newton, evaluated(newton.cost, data, pressed[None]))
    assert solution.status is Status.OPTIMUM
    assert solution.objective <= reference.objective * (1 + SAME)
    assert_allclose(solution.objective, reference.objective, rtol=SAME)


def test_a_frame_without_outliers_takes_two_starts() -> None:
    data = frame(wrong=0)
    pressed = cells()[1][None]
    for previous in (pressed, None):
        assert solved("reduced", data, previous).starts == 2
    assert solved("reduced", data, pressed, Settings(starts=5)).starts == 5


def minimum(wrong: int, weight: float, start: Array | None = None) -> tuple[Solution, Evaluation]:
    """Minimum that a start, or that of the readout, leads to with so many wrong readings."""
    terms = (TERMS[0], LogGradient(weight=weight))
    newton = ProjectedNewton(Estimator(terms).cost(SCENE, 1, partial=False), Settings())
    data = frame(wrong)
    begin = evaluated(newton.cost, data, data.start() if start is None else start[None])
    solution = solved_from(newton, begin)
    assert solution.at is not None
    return solution, solution.at


def residuals_of(at: Evaluation) -> Array:
    """Residuals in standard deviations, flat."""
    return ((at.reading - at.data.measured) / at.data.sigma).ravel()


def test_an_outlier_enters_by_the_step_at_which_its_residual_vanishes() -> None:
    """Under a heavy penalty the wrong readings are outliers, and no reading has leverage."""
    solution, at = minimum(wrong=3, weight=1e5, start=cells()[1])
    residual = residuals_of(at)
    outliers = np.flatnonzero(np.abs(residual) > FAR_OUT * CORNER_SIGMA)
    steps = [step.ravel() for _, step in exchanges(solution)]
    jacobian = sharp_hessian(at, NO_DUAL).jacobian / at.data.sigma.reshape(-1, 1)
    entered = [
        [row for row in outliers if abs(residual[row] + jacobian[row] @ step) < 1e-6]
        for step in steps
        if np.abs(step).max() < LARGEST_STEP
    ]
    assert entered and all(len(rows) == 1 for rows in entered)


def test_a_reading_that_bends_the_cells_leaves() -> None:
    """From exact cells the solver meets a wrong reading; without that reading it misses it."""
    solution, at = minimum(wrong=1, weight=20.0)
    wrong = int(np.argmax(np.abs(np.log(at.data.measured / exact_reading()))))
    assert abs(residuals_of(at)[wrong]) < CORNER_SIGMA
    [(gain, step)] = exchanges(solution)
    assert gain > 0
    left = at.elsewhere(np.exp(at.position + step))
    assert abs(residuals_of(left)[wrong]) > 10 * CORNER_SIGMA


@pytest.mark.slow
def test_readings_are_exchanged_beside_absolute_losses() -> None:
    terms = (TERMS[0], TotalVariation(weight=0.5))
    cost = Estimator(terms, "reduced").cost(SCENE, 1, partial=False)
    solution = best_solution(ProjectedNewton(cost, Settings()), frame(wrong=1), cells()[1][None])
    assert solution.solved and solution.starts > 2


@pytest.mark.slow
def test_exchanges_lead_both_solvers_to_the_lowest_minimum(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of 4 × 4 cells, `reduced` ends higher without exchanges."""
    problem = Problem.drawn(2, 29)
    lowest = problem.least(problem.data, 3, 0)
    for kind in ("reduced", "nodal"):
        assert problem.solved(kind).objective <= lowest * (1 + SAME)
    monkeypatch.setattr(multistart, "exchanges", lambda minimum: [])
    assert problem.solved("reduced").objective > lowest * 1.01


def test_the_status_names_too_many_readings_for_outliers() -> None:
    """Cells that a heavy penalty holds together cannot follow wrong readings."""
    equal = np.full(SHAPE, 1000.0)
    for wrong, status in ((1, Status.OPTIMUM), (8, Status.MISSED)):
        solution = solved("reduced", frame(wrong, equal), equal[None], weight=1e4)
        assert solution.status is status


def test_a_batch_leaves_out_losses_that_are_not_convex() -> None:
    for loss, served in ((Student(corner=3.0), False), (Huber(corner=3.0), True)):
        terms = (Misfit(weighting="noise", loss=loss), TERMS[1])
        assert serves(Estimator(terms).cost(SCENE, 1, partial=False)) is served


def test_the_relaxed_loss_ends_its_square_at_a_tenth_of_the_corner() -> None:
    class Flat(Loss):
        """3·x²/(1 + x²), convex up to 1/√3, with six times the square at 0."""

        convex = False
        kind = "flat"

        def cost(self, residual):  # type: ignore[no-untyped-def]
            import casadi

            return casadi.sum1(3 * residual**2 / (1 + residual**2))

    assert_allclose(huber_of(Student(corner=4.0)), (CORNER * 4.0, 1.0), rtol=0.02)
    assert_allclose(huber_of(Flat()), (CORNER / np.sqrt(3), 3.0), rtol=0.02)
