"""The curves of a weight against the paper's equations in plain numpy, and the rules' choices against what runs use."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from lampest import Bounds, CellResistance, Estimator, Gradient, Misfit, Panel, Recording, RelativeChange, Scene, Term
from lampest.cost.problem import Evaluation
from lampest.estimate.sequence import reconstruct
from lampest.panel.readouts.star_mesh import two_point_resistance
from lampest.posterior.linear import LinearModel
from lampest.runs.config import Case
from lampest.studies.weights import CurvePoint, Tuned, WeightSubject, bound_evidence, l_curve, solve_at, tune
from tests.estimates import recording_of
from tests.oracles import paper

pytestmark = pytest.mark.slow

NOISE = 0.02


def recording(rows: int = 4, columns: int = 5, noise: float = NOISE) -> Recording:
    """Two unloaded frames and one with a bump, with relative noise."""
    rng = np.random.default_rng(5)
    cells = 3000 * np.exp(0.1 * rng.standard_normal((3, rows, columns)))
    cells[2, 1:3, 1:4] *= 0.3
    exact = two_point_resistance(cells)
    measured = exact * np.exp(noise * rng.standard_normal(exact.shape))
    return recording_of(Scene(Panel(rows, columns)), measured, 2, sigma=noise * exact, truth_cell_resistance=cells)


def subject(penalty: Term, held: Recording, bounds: Bounds | None = None) -> WeightSubject:
    """One penalty beside the paper's misfit."""
    estimator = Estimator((Misfit(), penalty), "reduced", bounds=bounds or Bounds())
    return WeightSubject.of(Case(Path("bump.h5"), "", "bump", "one", estimator, "", ""), held)


@pytest.fixture(scope="module")
def tuned() -> Tuned:
    return tune(subject(Gradient(weight="auto"), recording()))


def test_point_has_the_papers_misfit_and_penalty_and_the_true_error() -> None:
    made = recording()
    point = solve_at(subject(Gradient(weight="auto"), made), 2e-5, None)
    cells = point.cells[0]
    misfit = paper.forward(cells).resistance - made.resistance[2]
    penalty = np.concatenate([part.ravel() for part in paper.nabla(cells)])
    assert_allclose(point.misfit, np.sum(misfit**2) / np.mean(made.sigma[2] ** 2))
    assert_allclose(point.penalty, np.sum(penalty**2))
    error = np.log(cells / made.truth_cell_resistance[2])
    assert_allclose(point.error, np.sqrt(np.mean(error**2)))


def test_evidence_is_laplaces_at_each_estimate() -> None:
    """−2 log ∫ exp(−cost/2s²) du over a Gaussian prior of rank m − 1, up to what λ does not change."""
    made = recording()
    one = subject(Gradient(weight="auto"), made, Bounds("none", "none"))
    scale = float(np.mean(made.sigma[2] ** 2))

    def laplace(weight: float) -> tuple[float, float]:
        point = solve_at(one, weight, None)
        cells = point.cells[0]
        jacobian = paper.misfits_jacobian(cells, "gradient", weight, None) * cells.ravel()
        cost = np.sum(paper.misfits(cells, made.resistance[2], "gradient", weight, None) ** 2)
        curvature = jacobian.T @ jacobian / scale + 1e-4 * np.eye(cells.size)
        volume = np.linalg.slogdet(curvature)[1] - (cells.size - 1) * np.log(weight / scale)
        return point.evidence, cost / scale + volume

    first, second = laplace(1e-6), laplace(1e-4)
    assert abs(first[1] - second[1]) > 1
    assert_allclose(first[0] - second[0], first[1] - second[1], atol=1e-4)


def test_what_a_held_cell_leaves_is_the_integral_of_its_density() -> None:
    """The cost's slope and Gauss-Newton curvature by differences, the integral by quadrature."""
    made = recording()
    one = subject(CellResistance(weight="auto"), made)
    found = solve_at(one, 0.3, None)
    at = Evaluation.at(one.with_weight(0.3), one.data, found.cells)
    model = LinearModel(at, np.zeros(0))
    bound = np.flatnonzero(model.at_lower | model.at_upper)
    assert 0 < len(bound) < 20
    step = 1e-5

    def residuals(cell: int, change: float) -> np.ndarray:
        cells = found.cells.copy()
        cells.flat[cell] *= np.exp(change)
        data = two_point_resistance(cells) - one.data.measured
        return np.concatenate([data.ravel(), np.sqrt(0.3) * cells.ravel()])

    expected = 0.0
    for cell in bound:
        above, below = residuals(int(cell), step), residuals(int(cell), -step)
        curvature = float(np.sum(((above - below) / (2 * step)) ** 2)) / model.scale
        slope = abs(float(np.sum(above**2) - np.sum(below**2)) / (2 * step)) / model.scale
        reach = 60 / max(slope, np.sqrt(curvature))
        density, _ = quad(lambda t, g=slope, a=curvature: np.exp(-(g * t + a * t * t) / 2), 0, reach, epsabs=0)
        expected += np.log(2 * np.pi) - 2 * np.log(density)
    assert_allclose(bound_evidence(model), expected, rtol=1e-5)


def test_morozovs_weight_misses_the_readings_by_their_noise(tuned: Tuned) -> None:
    (weight,) = (choice.weight for choice in tuned.choices if choice.rule == "Morozov")
    assert_allclose(tuned.curves.at(weight).misfit, 20, rtol=0.05)


def test_l_curve_finds_the_corner_of_a_hyperbola() -> None:
    """x = √(1 + t²) + t, y = √(1 + t²) − t with t = log(λ/10) is curved most at t = 0."""
    weights = np.geomspace(1e-3, 1e5, 41)
    t = np.log(weights / 10)
    away = np.sqrt(1 + t**2)
    points = [CurvePoint(*both) for both in zip(weights, [1] * 41, np.exp(away + t), np.exp(away - t), strict=True)]
    assert_allclose(l_curve(tuple(points)), 10, rtol=1e-6)
    turned = tuple(replace(point, misfit=1 / point.penalty, penalty=1 / point.misfit) for point in points)
    assert l_curve(turned) is None


@pytest.mark.parametrize("penalty", [Gradient(weight="auto"), RelativeChange(weight="auto")])
def test_rule_in_use_is_what_a_run_goes_by(penalty: Term) -> None:
    made = recording()
    found = tune(subject(penalty, made))
    (used,) = (choice for choice in found.choices if choice.in_use)
    assert used.rule == "risk"
    run = reconstruct(made, found.subject.estimator)
    assert_allclose(run.steps[0].weights[1], used.weight)
    error = np.log(run.cell_resistance[0] / made.truth_cell_resistance[2])
    assert_allclose(used.error, np.sqrt(np.mean(error**2)), rtol=1e-4)


def test_no_choice_beats_hindsight_and_the_curves_are_in_order(tuned: Tuned) -> None:
    weights = tuned.curves.values("weight")
    assert np.all(np.diff(weights) > 0)
    assert np.all(tuned.curves.values("solved") == 1)
    assert np.all(np.diff(tuned.curves.values("misfit")) > -1e-6)
    assert np.all(np.diff(tuned.curves.values("penalty")) < 1e-6 * tuned.curves.values("penalty")[1:])
    assert {choice.rule for choice in tuned.choices} >= {"risk", "evidence", "Morozov", "L-curve", "best"}
    for choice in tuned.choices:
        if choice.excess is not None:
            assert choice.excess >= 1
