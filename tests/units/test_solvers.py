"""Solvers: the least-squares loop against scipy's, second derivatives, IPOPT's starts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

import lampest
from lampest import Array, Readings, Readout, Term
from lampest.apps.studies.bench import BenchFile
from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.sequence import first_stream
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.trust_region import backtracked
from lampest.solvers.by_ipopt import Ipopt
from lampest.solvers.check import check
from lampest.solvers.hessian import Hessian
from lampest.solvers.multistart import best_solution, evaluated
from lampest.solvers.preconditioners import Cholesky
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Outcome, Settings, Status

TIMES = np.linspace(0.0, 2.0, 9)
LOOP = LevenbergMarquardt(evaluations=200, settled=1e-20)
MAX_POSITION_ERROR = 1e-6  # relative: Gauss–Newton steps end linearly; measured 1e-9
CONVERGED = 1e-9  # relative, of cells; measured 1e-11
ROUNDING = 1e-13  # relative, of a cost that is computed twice
MAX_WARM_STEPS = 8  # from the optimum's neighbourhood; measured 3
CONVERTER = {"adc_bits": 12, "readings": 4, "noise_lsb": 1.0}
CASES: list[tuple[str, Readout]] = [
    ("nodal", lampest.TwoPointReadout(**CONVERTER)),
    ("per_pixel", lampest.TwoPointReadout(**CONVERTER)),
    ("nodal", lampest.LoadedColumnsReadout(load_ohm=1000, drive_ohm=100, **CONVERTER)),
    ("nodal", lampest.GroundedReadout(load_ohm=1000, drive_ohm=70, **CONVERTER)),
    (
        "nodal",
        lampest.VirtualGroundReadout(drive_ohm=70, sense_ohm=70, feedback_ohm=150, **CONVERTER),
    ),
]
METHODS: dict[str, tuple[Term, ...]] = {
    "LSM": (),
    "LSR-CR": (lampest.CellResistance(weight=1e-7),),
    "LSR-gdCR": (lampest.GradientOfRelativeChange(weight=1e-2),),
}


def decayed(unknowns: Array) -> SumOfSquares:
    """Residuals of a decay of which the amplitude is 2, the rate 1.5 and the offset 0.3."""
    amplitude, rate, offset = unknowns
    falling = np.exp(-rate * TIMES)
    measured = 2 * np.exp(-1.5 * TIMES) + 0.3 + 0.01 * np.sin(TIMES)
    slopes = np.column_stack([falling, -amplitude * TIMES * falling, np.ones(len(TIMES))])
    return SumOfSquares(amplitude * falling + offset - measured, slopes)


def test_the_minimum_equals_that_of_scipy_with_and_without_bounds() -> None:
    free = (-np.inf, np.inf)
    box = (np.array([0.0, 0.0, 0.5]), np.array([5.0, 1.2, 5.0]))
    for damping, bounds in ((0.0, free), (10.0, free), (LOOP.damping, free), (LOOP.damping, box)):
        start = np.array([1.0, 0.5, 1.0])
        position, squares = replace(LOOP, damping=damping).minimum(decayed, start, bounds)
        exactly = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15}
        reference = least_squares(lambda at: decayed(at).residual, start, bounds=bounds, **exactly)
        assert_allclose(position, reference.x, rtol=MAX_POSITION_ERROR)
        assert np.isclose(squares.cost, reference.cost, rtol=MAX_POSITION_ERROR)
        assert np.all(position >= bounds[0]) and np.all(position <= bounds[1])


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1])
def test_second_derivatives_are_factored_once_and_reused(
    monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """The third frame needs one factorisation, few products with ∇²φ and few evaluations."""
    bench = BenchFile(schema=1, sizes=(8,))
    counts = dict[str, int]()
    recording = bench.recording((8, 8), number)
    readings = recording.readings()
    estimator = bench.estimator("LSR-gdCR", "reduced", (8, 8))
    stream = first_stream(recording, readings, estimator)
    *frames, third = recording.measured_frames()[:3]
    for frame in frames:
        stream, step = stream.push(readings[frame])
        assert step.solution.strict
    data, previous = stream.data_and_start(readings[third])
    solver = estimator.problem(stream.scene, len(data.measured), 1.0, partial=data.partial)
    solver.prepare()
    for owner, name in ((Evaluation, "elsewhere"), (Hessian, "product"), (Cholesky, "of")):
        counts[name] = 0
        usual = getattr(owner, name)

        def called(*arguments: object, name: str = name, usual: Any = usual) -> object:
            counts[name] += 1
            return usual(*arguments)

        monkeypatch.setattr(owner, name, called)
    solution = best_solution(solver, data, previous, stream.prepared)
    assert solution.strict and counts["of"] == 1
    assert counts["product"] < 8  # 8 where ∇²φ is factored at the end alone
    assert counts["elsewhere"] < 5  # 5 where the last point is evaluated again
    repeated = solution.at.elsewhere(solution.at.cell_resistance)
    assert np.isclose(repeated.objective, solution.objective, rtol=ROUNDING, atol=0)


def problem(readout: Readout, method: str) -> tuple[Cost, Data, Array]:
    """Return a frame's cost, its data and Newton's optimum, (1, rows, columns) ohm."""
    rod = lampest.Rod(centre_mm=(20.0, 25.0), diameter_mm=25.0, mass_g=400.0)
    scene = lampest.Scene(lampest.Panel(5, 6), readout)
    recording = lampest.simulate(
        lampest.Simulation(1, 5, scene, frames=3, loads=(rod,), baseline_frames=2)
    )
    terms = (lampest.Misfit(weighting="noise"), *METHODS[method])
    estimator = lampest.Estimator(terms, "reduced", error_bars=False)
    resting = Readings.of(scene, recording.recorded[recording.role == 0]).mean()
    stream = lampest.Stream.begin(estimator, scene, 0.2, resting)
    for frame in recording.recorded[recording.role == 1]:
        previous = stream
        stream, step = stream.push(Readings.of(scene, frame))
    data, _ = previous.data_and_start(Readings.of(scene, recording.recorded[-1]))
    assert step.solution.status is Status.OPTIMUM
    return estimator.problem(scene, 1, 0.2).cost, data, step.cell_resistance[None]


@pytest.mark.parametrize(("continues", "starts"), [(True, 1), (False, 3)])
def test_a_later_frame_keeps_a_strict_minimum_in_spite_of_negative_curvature(
    *, continues: bool, starts: int
) -> None:

    class Curved(ProjectedNewton):
        def solve(self, data: Data, start: Evaluation) -> Outcome:
            return replace(super().solve(data, start), convex=False)

    cost, data, cells = problem(lampest.TwoPointReadout(**CONVERTER), "LSR-CR")
    solver = Curved(cost, Settings())
    solution = best_solution(solver, replace(data, first=not continues), 1.1 * cells)
    assert solution.strict and solution.starts == starts


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("kind", "readout"), CASES)
def test_ipopt_reaches_the_optimum_from_near_and_far(
    kind: str, readout: Readout, method: str
) -> None:
    """IPOPT never takes the start for the answer, and continues with its own multipliers."""
    cost, data, cells = problem(readout, method)
    solver = Ipopt(cost, Settings(), readout, None, kind)
    optimum = (
        ProjectedNewton(cost, Settings(1e-12))
        .solve(data, evaluated(cost, data, cells))
        .cell_resistance
    )
    near = cells * np.exp(0.01 * np.random.default_rng(2).standard_normal(cells.shape))
    iterations = []
    carried = None
    for place in (data.uniform_start, near, near):
        start = evaluated(cost, data, place)
        solution = check(start, solver.continued(carried).solve(data, start))
        assert solution.solved
        assert_allclose(solution.cell_resistance, optimum, rtol=CONVERGED)
        iterations.append(solution.iterations)
        carried = solution.carried if len(iterations) > 1 else None
    cold, near_cold, warm = iterations
    assert 0 < warm <= near_cold and near_cold > 0 and cold > 0 and warm <= MAX_WARM_STEPS


def test_a_later_frame_begins_with_an_error_of_the_second_order() -> None:
    """Ten times as large a change of the readings leaves a hundred times as large an error."""
    readout = lampest.TwoPointReadout()
    cost, data, cells = problem(readout, "LSR-CR")
    solver = Ipopt(cost, Settings(), readout, None, "nodal")
    start = evaluated(cost, data, cells)
    first = check(start, solver.solve(data, start))
    change = np.random.default_rng(3).uniform(-1.0, 1.0, cells.shape)
    errors = []
    for size in (1e-3, 1e-2):
        measured = data.measured * np.exp(size * change)
        later = replace(data, given=replace(data.given, measured=measured))
        start = evaluated(cost, later, first.cell_resistance)
        predicted = first.carried.predicted(start)
        optimum = check(start, solver.solve(later, start)).cell_resistance
        distances = [
            float(np.abs(np.log(point.cell_resistance / optimum)).max())
            for point in (predicted, start)
        ]
        assert distances[0] < 0.1 * distances[1]
        errors.append(distances[0])
    assert 50 < errors[1] / errors[0] < 200


@pytest.mark.parametrize("factor", [1 / 8, 8.0])
def test_a_later_frame_begins_lower_after_any_change_of_a_reading(factor: float) -> None:
    readout = lampest.TwoPointReadout()
    cost, data, cells = problem(readout, "LSR-CR")
    solver = Ipopt(cost, Settings(), readout, None, "nodal")
    start = evaluated(cost, data, cells)
    first = check(start, solver.solve(data, start))
    measured = data.measured.copy()
    measured[0, 1, 1] *= factor
    later = replace(data, given=replace(data.given, measured=measured))
    start = evaluated(cost, later, first.cell_resistance)
    assert first.carried.predicted(start).objective < start.objective


def test_a_step_is_halved_until_a_trial_is_accepted() -> None:
    tried = list[float]()

    def accepted(length: float) -> float | None:
        tried.append(length)
        return length if length < 0.3 else None

    assert backtracked(accepted, 8) == 0.25 and tried == [1.0, 0.5, 0.25]
    assert backtracked(accepted, 2) is None
