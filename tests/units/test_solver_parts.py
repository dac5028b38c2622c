"""NewtonParts of the projected Newton method: each is exchanged in a solve, and tested alone."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.cost.given import Background
from lampest.cost.problem import Data, Evaluation
from lampest.panel.trust_region import SUFFICIENT_DECREASE, SubproblemStep
from lampest.solvers.bounds import MIN_DECREASE_SHARE
from lampest.solvers.direction import (
    MAX_CHANGE,
    MIN_REDUCTION,
    WINDOW,
    ActiveSet,
    History,
    Mask,
    QuadraticModel,
    conductance_change,
    decreases_enough,
    hold_beyond_bounds,
    late_or_stalled,
    log_resistance_change,
    newton_direction,
    stalled,
)
from lampest.solvers.hessian import Smoothing
from lampest.solvers.iterate import Iterate
from lampest.solvers.multistart import evaluated, most_starts
from lampest.solvers.projected_newton import NewtonParts, ProjectedNewton
from lampest.solvers.solution import Outcome, Settings, Status

STUDENT = lampest.Student(corner=3.0)
SAME_MINIMUM = 1e-6  # relative; solves end at gradients below 1e-8 of the cost
OHM = 1000.0
LOADED_OHM = 40.0
SCENE = lampest.Scene(lampest.Panel(5, 6), lampest.TwoPointReadout())
TERMS = (lampest.Misfit(), lampest.Gradient(weight=1e-4))


@pytest.fixture(scope="module")
def start() -> Evaluation:
    """A cost at equal cells, of which bounds and a strong load make the minimum far."""
    cells = np.full(SCENE.panel.shape, OHM)
    cells[1:3, 2:4] = LOADED_OHM
    cells[4, 5] = 100 * OHM
    readings = lampest.Readings.of(SCENE, lampest.two_point_resistance(cells))
    estimator = lampest.Estimator(TERMS, "reduced")
    data = estimator.data(readings.alone(), Background(SCENE))
    return evaluated(estimator.cost(SCENE, 1), data, data.uniform_start)


def solved(start: Evaluation, parts: NewtonParts) -> Outcome:
    """The outcome of a solve with some parts."""
    return ProjectedNewton(start.cost, Settings(), parts=parts).solve(start.data, start)


@pytest.fixture(scope="module")
def minimum(start: Evaluation) -> lampest.Array:
    """The cells at which the usual parts end."""
    outcome = solved(start, NewtonParts())
    assert outcome.status is Status.OPTIMUM
    return outcome.cell_resistance


def gradient_direction(
    point: Iterate, model: QuadraticModel, radius: float, active_set: ActiveSet
) -> SubproblemStep:
    """Steepest descent in the metric of the preconditioner, with the best length of the model."""
    del active_set
    free = point.hessian.free
    gradient = np.where(free, point.hessian.gradient, 0.0)
    along = np.zeros(free.size)
    along[free] = -model.preconditioner.over(free, point.at.cell_resistance)(gradient[free])
    slope = float(gradient @ along)
    curvature = float(along @ model.product(along))
    norm = np.sqrt(-slope)
    length = min(-slope / curvature if curvature > 0 else np.inf, radius / norm)
    size = min(length * float(np.abs(along).max()), MAX_CHANGE) / float(np.abs(along).max())
    decrease = -(size * slope + 0.5 * size**2 * curvature)
    return SubproblemStep(size * along, size * norm, decrease, curvature <= 0, 1)


def project_alone(moving: Mask, step: lampest.Array, low: object, high: object) -> Mask:
    """No cell stops: the step is projected on the bounds as a whole."""
    return moving


def any_decrease(point: Iterate, trial: Iterate, predicted: float) -> bool:
    """Accept every step that lowers the cost, or the gradient within its rounding."""
    return trial.objective < point.objective or trial.residual < point.residual / 2


@pytest.mark.parametrize(
    "parts",
    [
        NewtonParts(direction=gradient_direction),
        NewtonParts(active_set=project_alone),
        NewtonParts(acceptance=any_decrease),
        NewtonParts(termination=lambda data, history: None),
    ],
    ids=["direction", "active set", "acceptance", "termination"],
)
def test_a_solve_with_another_part_ends_at_the_same_minimum(
    start: Evaluation, minimum: lampest.Array, parts: NewtonParts
) -> None:
    outcome = solved(start, parts)
    assert outcome.status is Status.OPTIMUM
    assert_allclose(outcome.cell_resistance, minimum, rtol=SAME_MINIMUM)


def counted(usual: Callable[..., object], calls: list[str], name: str) -> Callable[..., object]:
    """A part that notes its calls."""

    def part(*arguments: object) -> object:
        calls.append(name)
        return usual(*arguments)

    return part


def test_a_solve_asks_every_part(start: Evaluation) -> None:
    calls: list[str] = []
    usual = vars(NewtonParts())
    parts = NewtonParts(**{name: counted(part, calls, name) for name, part in usual.items()})
    solved(start, parts)
    # newton_direction itself asks the active set
    assert set(calls) == set(usual)


def test_a_solve_ends_as_its_termination_says(start: Evaluation) -> None:

    def after_two(data: Data, history: History) -> Status | None:
        return Status.STALLED if len(history) > 2 else None

    outcome = solved(start, NewtonParts(termination=after_two))
    assert outcome.status is Status.STALLED
    assert outcome.iterations == 2


@pytest.mark.slow
def test_a_solve_whose_steps_are_all_refused_does_not_claim_an_optimum(start: Evaluation) -> None:
    outcome = solved(start, NewtonParts(acceptance=lambda point, trial, predicted: False))
    assert outcome.status is not Status.OPTIMUM


def test_the_direction_without_bounds_is_that_of_newton(
    start: Evaluation, minimum: lampest.Array
) -> None:
    """Near the minimum it solves (∇²φ + diag(∇φ)) s = −∇φ over the free cells."""
    near = start.elsewhere(minimum * 1.001)
    point = Iterate.of(near, Smoothing.start(near))
    step = newton_direction(point, QuadraticModel.of(point), np.inf, hold_beyond_bounds)
    free = np.flatnonzero(point.hessian.free)
    matrix = point.hessian.matrix + np.diag(point.hessian.gradient)
    exact = np.linalg.solve(matrix[np.ix_(free, free)], -point.hessian.gradient[free])
    # conjugate gradients end at the forcing term, the root of the residual
    accuracy = np.sqrt(point.residual) * np.linalg.norm(exact)
    assert np.linalg.norm(conductance_change(step.step)[free] - exact) <= accuracy


def test_cells_beyond_a_bound_stop_and_all_others_keep_moving() -> None:
    """A cell on its bound still moves; one that does not move never starts again."""
    moving = np.array([True, True, True, False])
    step = np.array([-2.0, 1.0, 3.0, 0.0])
    staying = hold_beyond_bounds(moving, step, np.full(4, -1.0), np.full(4, 1.0))
    assert staying.tolist() == [False, True, False, False]


def test_changes_of_log_r_and_of_conductance_are_inverse() -> None:
    """−log(1 − s) and 1 − exp(−δu)."""
    share = np.array([-3.0, -0.5, 0.0, 1e-12, 0.74])
    assert_allclose(conductance_change(log_resistance_change(share)), share, rtol=1e-12, atol=0)
    assert_allclose(np.exp(-log_resistance_change(share)), 1 - share, rtol=1e-12)


def test_a_step_is_accepted_from_the_smallest_sufficient_decrease_on() -> None:
    predicted = 2.0
    least = SUFFICIENT_DECREASE * predicted
    decrease = np.array([least, 0.999 * least, -1.0, np.nan, np.inf])
    accepted = decreases_enough(decrease, predicted, 10.0, 1.0, 1.0)
    assert accepted.tolist() == [True, False, False, False, False]


def test_a_step_within_rounding_is_accepted_where_the_gradient_halves() -> None:
    rounding = MIN_DECREASE_SHARE
    decrease = np.array([0.0, 0.0, -10 * rounding])
    trial_residual = np.array([0.5, 0.51, 0.1])
    accepted = decreases_enough(decrease, rounding / 2, 1.0, 1.0, trial_residual)
    assert accepted.tolist() == [True, False, False]


def test_a_solve_stalls_where_neither_cost_nor_gradient_falls_over_a_window() -> None:
    flat = [(1.0, 1.0)] * (WINDOW + 1)
    assert stalled(flat)
    assert not stalled(flat[1:])
    assert not stalled([(2.0, 1.0), *flat[1:]])
    assert not stalled([*flat[:-1], (1.0, MIN_REDUCTION / 2)])


def test_the_time_limit_comes_before_a_stall() -> None:
    flat = [(1.0, 1.0)] * (WINDOW + 1)
    late = SimpleNamespace(overdue=True)
    punctual = SimpleNamespace(overdue=False)
    assert late_or_stalled(late, flat) is Status.TIME  # type: ignore[arg-type]
    assert late_or_stalled(punctual, flat) is Status.STALLED  # type: ignore[arg-type]
    assert late_or_stalled(punctual, flat[1:]) is None  # type: ignore[arg-type]


def test_a_frame_that_no_cells_give_is_not_solved_again_from_its_own_optimum() -> None:
    """The lower of a given start and the convex one is taken: the optimum itself."""
    readings = lampest.two_point_resistance(np.full(SCENE.panel.shape, OHM))
    readings[2, 3] *= 3.0
    estimator = lampest.Estimator((lampest.Misfit(),), "reduced")
    measured = lampest.Readings.of(SCENE, readings)
    data = estimator.data(measured.alone(), Background(SCENE))
    first = evaluated(estimator.cost(SCENE, 1), data, data.uniform_start)
    solver = ProjectedNewton(first.cost, Settings())
    outcome = solver.solve(data, first)
    again = solver.solve(data, first.elsewhere(outcome.cell_resistance))
    assert outcome.status is again.status is Status.OPTIMUM
    assert outcome.iterations > 1
    assert again.iterations == 0


def test_solvers_with_different_parts_are_different(start: Evaluation) -> None:
    solver = ProjectedNewton(start.cost, Settings())
    assert replace(solver, parts=NewtonParts(active_set=project_alone)) != solver
    assert replace(solver, parts=NewtonParts()) == solver


@pytest.mark.parametrize(
    ("terms", "most"),
    [
        ((lampest.Misfit(),), 1),
        (TERMS, 3),
        ((lampest.Misfit(), lampest.Gradient(weight=1e-4, loss=STUDENT)), 40),
    ],
)
def test_settings_state_the_largest_number_of_starts(
    start: Evaluation, terms: tuple[lampest.Term, ...], most: int
) -> None:
    """The numbers in the description of `Settings.starts` are those that a frame may spend."""
    cost = lampest.Estimator(terms, "reduced").cost(SCENE, 1)
    assert most_starts(ProjectedNewton(cost, Settings()), start.data) == most
    described = str(Settings.__doc__).split("starts : int or None")[1]
    assert (f"up to {most}" if most > 1 else "None: one where") in " ".join(described.split())
