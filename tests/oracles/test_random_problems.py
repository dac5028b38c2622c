"""No other solver finds less, by a second statement of the costs: `tests/least_cost.py`."""

from dataclasses import replace

import numpy as np
import pytest
from promises import promise

from lampest import (
    Array,
    Estimator,
    GroundedReadout,
    LoadedColumnsReadout,
    Panel,
    Readings,
    Scene,
    Solution,
    Stream,
    VirtualGroundReadout,
)
from lampest.cost.given import Background
from lampest.cost.losses import Absolute, Loss, Squared, Student
from lampest.cost.problem import Data
from lampest.cost.terms import Gradient, Misfit, Term, term_types
from lampest.files.errors import InputError
from lampest.panel.readouts import TwoPointReadout
from lampest.solvers.multistart import best_solution, evaluated, solved_from
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Status
from tests.least_cost import LeastCost, Penalty
from tests.random_problem import RandomProblem, shape_of

MAX_SMALL_CELLS = 40  # cells: problems that are solved in every way within a second
SMALL_PROBLEMS = [
    number for number in range(110) if np.prod(shape_of(11, number)) <= MAX_SMALL_CELLS
][:40]
# Ended without an estimate once, as (seed, number): gradients that a heavy penalty multiplies are
# rounding; kinks of readings and of penalties at once; cells tied loosely by a heavy penalty that
# met their bounds one by one; a plateau across which nothing but rounding is left of the gradient.
ONCE_UNSOLVED = [
    (1, 17),
    (1, 21),
    (2, 19),
    (2, 28),
    (2, 35),
    (2, 45),
    (31, 28),
    (31, 36),
    (31, 183),
    (31, 576),
]
ONCE_UNSOLVED += [(31, 714), (31, 173), (31, 218), (53, 61), (77, 146)]
PROBLEMS = [pytest.param(11, n, marks=pytest.mark.slow) for n in SMALL_PROBLEMS if n != 6]
PROBLEMS += [pytest.param(*numbers, marks=pytest.mark.slow) for numbers in ONCE_UNSOLVED]
PROBLEMS += [pytest.param(1, number, marks=pytest.mark.soak) for number in range(1000)]
NO_ESTIMATE = (Status.UNREAD, Status.UNRESTED, Status.ROUNDED)
SHAPE = (6, 5)
CONVERTER = {"adc_bits": 12, "readings": 1, "noise_lsb": 0.5, "supply_volt": 5.0}
CIRCUITS = {
    "two_point": TwoPointReadout(reference_ohm=3000.0, **CONVERTER),
    "loaded": LoadedColumnsReadout(drive_ohm=1000.0, load_ohm=1e4, **CONVERTER),
    "grounded": GroundedReadout(drive_ohm=70.0, sense_ohm=70.0, load_ohm=1000.0, **CONVERTER),
    "virtual": VirtualGroundReadout(
        drive_ohm=70.0, sense_ohm=70.0, feedback_ohm=3000.0, **CONVERTER
    ),
}
MAX_EXCESS = 1e-6  # share of the cost of an estimate that another solver may save
MAX_KKT = 1e-6  # of a verified optimum
EQUAL = 1e-8  # of log r, between cells that a heavy penalty holds together; measured 4e-12
MAX_ITERATIONS = 200  # limit: a third above the largest number measured


@promise("README: Only plain least squares of two-point readings is known to have a single one.")
@pytest.mark.parametrize(("seed", "number"), PROBLEMS)
def test_no_other_solver_reaches_a_lower_cost(seed: int, number: int) -> None:
    """There is no estimate where too little is read, or where arithmetic is at its end."""
    problem = RandomProblem.drawn(seed, number)
    try:
        solution = problem.solved().solution
    except InputError:
        return
    if solution.solved:
        assert problem.excess(solution) <= MAX_EXCESS, problem.about
    else:
        assert solution.status in NO_ESTIMATE, (solution.status, problem.about)


@pytest.mark.slow
def test_a_large_joint_pair_of_noisy_readings_ends() -> None:
    """Two frames of 19 × 18 cells, readings off by 5 % of unknown noise, took all iterations."""
    problem = replace(RandomProblem.drawn(97, 130), joint=True)
    cost = problem.estimator.cost(problem.scene, 2, partial=problem.data.partial)
    start = evaluated(cost, problem.data, problem.data.uniform_start)
    solution = solved_from(ProjectedNewton(cost, problem.estimator.solver), start)
    max_iterations = 150  # all 300 were taken once
    assert solution.optimum and solution.iterations < max_iterations


def pressed(noise: float) -> tuple[Array, Array]:
    """(values, σ) of a baseline and a frame with a pressed patch, (2, rows, columns) ohm."""
    random = np.random.default_rng(5)
    resting = 3000 * np.exp(0.3 * random.standard_normal(SHAPE))
    change = np.zeros(SHAPE)
    change[1:4, 2:4] = -1.2
    circuit = Scene(Panel(*SHAPE)).circuit
    exact = np.stack(
        [circuit.exact_reading(cells) for cells in (resting, resting * np.exp(change))]
    )
    return exact * (1 + noise * random.standard_normal(exact.shape)), noise * exact


def posed(estimator: Estimator, scene: Scene, measured: Array, sigma: Array) -> Data:
    """Return the data of a solve of these readings."""
    zeros = np.zeros(measured.shape)
    return estimator.data(Readings(measured, sigma, zeros, zeros + 1), Background(scene))


def solved(
    terms: tuple[Term, ...], scene: Scene, measured: Array, sigma: Array
) -> tuple[Solution, Data]:
    estimator = Estimator(terms, formulation="reduced")
    data = posed(estimator, scene, measured, sigma)
    return best_solution(
        estimator.problem(scene, len(measured), 1.0, partial=data.partial), data, None
    ), data


def solved_with(
    kind: str, weight: float, *, scaled: bool, loss: Loss, noise: float
) -> tuple[Solution, LeastCost]:
    """Return the solution of a pair, or of a frame where nothing is compared, and its cost anew."""
    measured, sigma = pressed(noise)
    term = term_types()[kind](weight=weight, loss=loss)
    frames = slice(0 if term.needs_previous else 1, 2)
    misfit = Misfit(weighting="noise" if scaled else "plain")
    solution, data = solved((misfit, term), Scene(Panel(*SHAPE)), measured[frames], sigma[frames])
    return solution, LeastCost.of(
        data, Penalty("misfit", 1.0, scaled=scaled), Penalty(kind, weight, loss.kind)
    )


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("weight", [1e9, 1e12])
@pytest.mark.parametrize(
    "kind",
    [
        "gradient",
        "relative_change",
        "gradient_of_relative_change",
        "log_ratio",
        "total_variation_of_change",
    ],
)
def test_heavy_squares_are_verified(kind: str, weight: float, scaled: bool) -> None:
    """At 10¹² the status may say that second derivatives are mere rounding."""
    solution, least = solved_with(kind, weight, scaled=scaled, loss=Squared(), noise=0.01)
    if weight > 1e9 and solution.status in (Status.ROUNDED, Status.STALLED):
        return
    assert solution.status in (Status.OPTIMUM, Status.FLAT)
    place = np.log(solution.cell_resistance).ravel()
    assert least.value(place) == pytest.approx(solution.objective, rel=MAX_EXCESS)
    for start in (place, np.full_like(place, place.mean())):
        assert least.value(least.minimised(start)) >= solution.objective * (1 - MAX_EXCESS)


@pytest.mark.parametrize(
    ("kind", "weight", "scaled"),
    [
        *(("total_variation", weight, False) for weight in (1e-9, 1e-3, 1.0, 1e3, 1e6, 1e9, 1e12)),
        *((kind, 0.1, True) for kind in ("gradient", "cell_resistance")),
    ],
)
def test_absolute_losses_end_within_a_hundred_millionth_of_the_least_cost(
    kind: str, weight: float, scaled: bool
) -> None:
    """From 10⁶ on all cells are one number, and rounding hides that it is strict."""
    solution, least = solved_with(kind, weight, scaled=scaled, loss=Absolute(), noise=0.003)
    place = np.log(solution.cell_resistance).ravel()
    if weight < 1e6:
        assert solution.status is Status.OPTIMUM and solution.kkt_residual < MAX_KKT
        assert (
            least.value(least.minimised(place, 200))
            >= least.value(place) * (1 - 1e-8) - 1e-12 * least.blank()
        )
        return
    assert solution.status is Status.FLAT and np.ptp(place) < EQUAL
    misfit = [
        least.value(np.full_like(place, place.mean() + aside)) for aside in (-1e-4, 0.0, 1e-4)
    ]
    assert misfit[1] < min(misfit[0], misfit[2])


@pytest.mark.long
@pytest.mark.parametrize("weight", [3e3, 1e4, 3e4, 1e5, 1e6])
@pytest.mark.parametrize("shape", [(24, 1), (1, 9), (4, 1)])
def test_cells_that_heavy_losses_hold_at_one_bound_are_verified(
    shape: tuple[int, int], weight: float
) -> None:
    """Where Newton's method ends by the rounding of equal cells, IPOPT solves the frame."""
    random = np.random.default_rng(3)
    measured = 7000 * np.exp(0.3 * random.standard_normal((1, *shape)))
    estimator = Estimator((Misfit(weighting="noise"), Gradient(weight=weight, loss=Absolute())))
    scene = Scene(Panel(*shape))
    data = posed(estimator, scene, measured, 4e-3 * measured)
    solver = estimator.problem(scene, 1, 1.0, partial=data.partial)
    solution = estimator.method.solution(solver, data, None, None)
    assert solution.optimum and solution.kkt_residual < MAX_KKT
    np.testing.assert_allclose(solution.cell_resistance, measured.max(), rtol=EQUAL)


def solution_of_a_skin(kind: str, *terms: Term) -> Solution:
    """Solve a foam skin with contacts, memory and joined rows that its scene omits."""
    random = np.random.default_rng(3)
    side = 16
    readout = CIRCUITS[kind]
    row, column = np.indices((side, side))
    load = np.exp(-((row - 6) ** 2 + (column - 9) ** 2) / 8)
    cells = 3e6 * np.exp(0.8 * random.standard_normal((side, side))) / (1 + 1500 * load)
    reading = readout.exact_reading(cells + random.uniform(0, 200, side))
    reading = reading + 0.03 * np.roll(reading, 1, axis=1)
    reading[3] = reading[4] = (reading[3] + reading[4]) / 2
    reading *= 1 + 0.05 * random.standard_normal(reading.shape)
    scene = Scene(Panel(side, side), readout)
    readings = Readings.of(scene, reading, 2e-3 * np.abs(reading) + 1e-4 * np.abs(reading).max())
    return Stream.begin(Estimator(terms, error_bars=False), scene, 1.0, readings).baseline.solution


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.0, 1e-3])
@pytest.mark.parametrize("kind", CIRCUITS)
def test_a_frame_with_a_wrong_model_is_solved_quickly_at_any_weight(
    kind: str, weight: float
) -> None:
    solution = solution_of_a_skin(
        kind, Misfit(weighting="noise"), term_types()["log_gradient"](weight=weight)
    )
    assert solution.solved or solution.status is Status.STALLED
    assert solution.iterations < MAX_ITERATIONS


@pytest.mark.slow
def test_readings_beyond_the_corner_of_a_loss_still_lead_to_the_minimum() -> None:
    misfit = Misfit(weighting="noise", loss=Student(corner=4.0))
    solution = solution_of_a_skin("loaded", misfit, term_types()["log_gradient"](weight=1e-3))
    assert solution.solved and solution.iterations < 0.75 * MAX_ITERATIONS
