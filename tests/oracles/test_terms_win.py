"""Why each term beyond the paper exists: a scene on which it wins; and how the baseline reaches terms and bars."""

from dataclasses import replace
from functools import cache

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import Array, Course, Data, Estimates, Estimator, Panel, Recording, Scene, Settings, two_point_resistance
from lampest.cost.cost import Cost
from lampest.cost.given import Given
from lampest.cost.losses import Absolute, Squared
from lampest.cost.terms import (
    AnyTerm,
    Gradient,
    GradientOfRelativeChange,
    LogRatio,
    Misfit,
    Reference,
    RelativeChange,
    State,
    Term,
    TotalVariation,
    TotalVariationOfChange,
)
from lampest.estimate.methods import MethodName
from lampest.estimate.sequence import reconstruct
from lampest.loads.shapes import Rod, Shape, SuctionCup
from lampest.panel.response import ratio_from_pressure
from lampest.posterior.dense import DenseErrors, DenseMemory
from lampest.posterior.linear import LinearModel
from lampest.posterior.sampled import SAMPLES, SampledErrors, SampledMemory
from lampest.solvers.ipopt.formulations import FORMULATIONS
from lampest.solvers.multistart import best_solution, evaluated
from lampest.solvers.multistart import solved_from as run
from lampest.solvers.projected_newton import ProjectedNewton

pytestmark = pytest.mark.slow

PANEL = Panel(8, 8)
ROD = Rod(kind="rod", centre_mm=(38, 33), diameter_mm=35, mass_g=500)
CUP = SuctionCup(kind="suction_cup", centre_mm=(38, 33), inner_diameter_mm=27, outer_diameter_mm=36, pressure_kpa=-9)
NOISE = 5e-3


@cache
def scene(load: Shape, frames: int, depth: float, seed: int) -> Recording:
    """Two unloaded frames, then `frames` of a load that swings by `depth` once in nine frames; noise of 0.5 %."""
    rng = np.random.default_rng(seed)
    course = Course(breathing_hz=1 / 9, breathing_depth=depth)
    time = np.arange(frames + 2.0) - 2
    contact, suction = load.mean_pressure(PANEL, 6.0)
    factors = (time >= 0) * np.stack(course.contact_and_suction(time))
    pressure = factors[0][:, None, None] * contact + factors[1][:, None, None] * suction
    cells = 3050 * np.exp(0.2 * rng.standard_normal(PANEL.shape)) * ratio_from_pressure(pressure)
    exact = two_point_resistance(cells)
    return Recording(
        Scene(PANEL),
        exact * np.exp(NOISE * rng.standard_normal(exact.shape)),
        time,
        (time >= 0).astype(np.uint8),
        sigma=NOISE * exact,
        truth_cell_resistance=cells,
    )


def estimated(recorded: Recording, *terms: Term, formulation: MethodName = "reduced") -> Estimates:
    return reconstruct(recorded, Estimator((Misfit(weighting="noise"), *terms), formulation, error_bars=False))


def error(recorded: Recording, *terms: Term) -> float:
    """Root mean square of log r − log truth over all cells and frames."""
    found = estimated(recorded, *terms)
    truth = recorded.truth_cell_resistance
    return float(np.sqrt(np.mean(np.log(found.cell_resistance / truth[found.frame]) ** 2)))


def best(recorded: Recording, term: Term, weights: Array) -> float:
    """The error with the best of some weights, in hindsight."""
    return min(error(recorded, replace(term, weight=float(weight))) for weight in weights)


def test_total_variation_keeps_edges_that_a_gradient_smears() -> None:
    """One frame, no baseline read: a cup, whose inside rises eightfold between neighbours."""
    recorded = scene(CUP, 1, 0.0, 1)
    ours = best(recorded, TotalVariation(), 10.0 ** np.arange(-2.5, -0.9, 0.5))
    others = [
        error(recorded),
        best(recorded, Gradient(), 10.0 ** np.arange(-9.0, -5.0)),
        best(recorded, Gradient(loss=Absolute()), 10.0 ** np.arange(-5.5, -2.0)),
    ]
    assert ours < 0.9 * min(others)


def test_baseline_is_a_better_mean_than_the_previous_frame_where_the_load_moves() -> None:
    """A rod: most cells never change."""
    recorded = scene(ROD, 5, 0.3, 2)
    ours = best(recorded, LogRatio(), 10.0 ** np.arange(-1.0, 0.6, 0.5))
    others = [error(recorded), best(recorded, RelativeChange(), 10.0 ** np.arange(-3.0, 0.1, 0.5))]
    assert ours < 0.9 * min(others)


def test_log_ratio_is_even_in_suction_and_pressure() -> None:
    recorded = scene(CUP, 9, 0.3, 3)
    ours = best(recorded, LogRatio(loss=Squared(), reference="previous"), 10.0 ** np.arange(-3.0, -0.4, 0.5))
    others = [error(recorded), best(recorded, RelativeChange(), 10.0 ** np.arange(-3.0, -0.4, 0.5))]
    assert ours < 0.95 * min(others)


def test_total_variation_of_change_does_not_pay_for_the_cells_own_pattern() -> None:
    recorded = scene(CUP, 1, 0.0, 4)
    ours = best(recorded, TotalVariationOfChange(), 10.0 ** np.arange(-2.5, -0.4, 0.5))
    others = [
        error(recorded),
        best(recorded, TotalVariation(), 10.0 ** np.arange(-2.5, -0.9, 0.5)),
        best(recorded, GradientOfRelativeChange(), 10.0 ** np.arange(-5.0, -0.4)),
        best(recorded, GradientOfRelativeChange(loss=Absolute()), 10.0 ** np.arange(-3.5, -0.4)),
    ]
    assert ours < 0.95 * min(others)


NEW = [
    TotalVariation(weight=0.05),
    LogRatio(weight=0.1, loss=Squared()),
    LogRatio(weight=1.0),
    TotalVariationOfChange(weight=0.05),
]


@pytest.mark.parametrize("term", NEW, ids=lambda term: f"{term.kind}-{term.loss.kind}")
def test_formulations_agree_on_every_term(term: AnyTerm) -> None:
    """The baseline reaches every solver, in the joint pair and after it."""
    recorded = scene(ROD, 3, 0.3, 5)
    small = replace(
        recorded,
        scene=Scene(Panel(4, 5)),
        recorded=two_point_resistance(recorded.truth_cell_resistance[:, 2:6, 1:6]),
        sigma=0.01 * recorded.resistance[:, 2:6, 1:6],
        truth_cell_resistance=None,
    )
    first, *others = (estimated(small, term, formulation=name) for name in ("reduced", *FORMULATIONS))
    for other in others:
        for ours, theirs in zip(first.steps, other.steps, strict=True):
            assert theirs.solution.objective == pytest.approx(ours.solution.objective, rel=2e-5)
        assert_allclose(other.cell_resistance, first.cell_resistance, rtol=1e-2)


@pytest.mark.parametrize("term", NEW, ids=lambda term: f"{term.kind}-{term.loss.kind}")
def test_known_references_leave_one_minimum(term: AnyTerm) -> None:
    """From starts some factor of four apart. The relative change has up to three minima there and must be searched."""
    rng = np.random.default_rng(9)
    recorded = scene(CUP, 1, 0.0, 10)
    resting, measured = recorded.truth_cell_resistance[0], recorded.resistance[-1:]
    solver = ProjectedNewton(Cost(PANEL, (Misfit(weighting="noise"), term)), Settings())
    given = Given(measured=measured, sigma=recorded.sigma[-1:], previous=resting, baseline=resting)
    data = Data(given, measured, 100 * measured)
    starts = measured * np.exp(1.4 * rng.standard_normal((5, *PANEL.shape)) + 1.4)
    ends = [run(solver, evaluated(solver.cost, data, start[None])) for start in starts]
    assert term.convex_in_log
    assert all(end.solved for end in ends)
    assert_allclose([end.objective for end in ends], ends[0].objective, rtol=1e-6)


@pytest.mark.parametrize("reference", ["baseline", "previous"])
def test_reference_is_what_the_term_says(reference: Reference) -> None:
    """What the term costs in the second and third frame, computed from the estimates."""
    recorded = scene(ROD, 3, 0.3, 6)
    found = estimated(recorded, LogRatio(weight=0.03, loss=Squared(), reference=reference))
    for frame in (1, 2):
        before = found.baseline_resistance if reference == "baseline" else found.cell_resistance[frame - 1]
        expected = 0.03 * np.sum((100 * np.log(found.cell_resistance[frame] / before)) ** 2)
        assert found.steps[frame].solution.costs[1] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("reads_both", [False, True])
def test_error_bars_know_the_baselines_error(reads_both: bool) -> None:
    """What errors of the baseline and of the previous frame add, against estimates from displaced ones."""
    rng = np.random.default_rng(8)
    shape, cells = (3, 4), 12
    known = 3000 * np.exp(0.2 * rng.standard_normal(shape) + 0.02 * rng.standard_normal((2, *shape)))
    measured = two_point_resistance(known[:1]) * np.exp(1e-3 * rng.standard_normal((1, *shape)))
    terms: tuple[Term, ...] = (Misfit(weighting="noise"), LogRatio(weight=0.05, loss=Squared()))
    terms += (LogRatio(weight=0.02, loss=Squared(), reference="previous"),) if reads_both else ()
    solver = ProjectedNewton(Cost(Panel(*shape), terms), Settings(tolerance=1e-12))
    given = Given(measured=measured, sigma=0.02 * measured, previous=known[0], baseline=known[1])
    data = Data(given, measured / 9, measured * 1e3)

    def moved(step: Array) -> Array:
        """log r from a previous frame and a baseline that are displaced by `step` in their logarithms."""
        previous, baseline = known * np.exp(step.reshape(2, *shape))
        where = replace(data, given=replace(data.given, previous=previous, baseline=baseline))
        return np.log(best_solution(solver, where, known[:1]).cell_resistance.ravel())

    carried = np.array([moved(step) - moved(-step) for step in 1e-3 * np.eye(2 * cells)]).T / 2e-3
    root = 0.1 * rng.standard_normal((2 * cells, 2 * cells))
    joint = root @ root.T
    memory = DenseMemory(joint[:cells, :cells], joint[cells:, cells:], joint[:cells, cells:])
    found = best_solution(solver, data, known[:1])
    model = LinearModel(found.at, np.zeros(0))
    dense = DenseErrors(model, memory)
    added = dense.covariance - DenseErrors(model).covariance
    expected = carried @ joint @ carried.T
    assert_allclose(added, expected, atol=0.03 * np.max(expected))
    assert_allclose(dense.variance, np.diag(dense.covariance), rtol=1e-10)
    shared = dense.memory().with_baseline
    expected = carried @ joint[:, cells:]
    assert_allclose(shared, expected, atol=0.03 * np.max(np.abs(expected)))
    samples = (root @ rng.standard_normal((2 * cells, SAMPLES))).T
    sampled = SampledErrors(model, SampledMemory(samples[:, :cells], samples[:, cells:]))
    assert_allclose(sampled.variance, dense.variance, rtol=0.6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (3, 1), (3, 4)])
def test_steps_are_those_between_neighbours(shape: tuple[int, int]) -> None:
    cells = np.exp(np.random.default_rng(7).standard_normal(shape))
    steps = State(panel=Panel(*shape), cell_resistance=None, reading=None).log_steps(casadi.DM(cells.ravel()))
    down, right = (np.diff(np.log(cells), axis=axis).ravel() for axis in (0, 1))
    assert_allclose(np.asarray(steps).ravel(), np.concatenate([down, right]), rtol=1e-12, atol=1e-12)
