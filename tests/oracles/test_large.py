"""Conjugate gradients on larger panels find what a factorisation finds; their preconditioner is what it says."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import linalg, sparse

from lampest import Absolute, Estimator, Huber, Panel, Recording, Scene, Settings, Status, two_point_resistance
from lampest.cost.given import Background
from lampest.cost.problem import Evaluation
from lampest.cost.terms import CellResistance, Gradient, GradientOfRelativeChange, Misfit, RelativeChange, Term
from lampest.estimate.sequence import reconstruct
from lampest.panel.readouts import TwoPointReadout, floating
from lampest.panel.readouts.floating import FloatingNetwork, Stencil, grounding, square_by_lines
from lampest.solvers import certificate, hessian, projected_newton
from lampest.solvers.interior_point import by_interior_point
from lampest.solvers.preconditioners import TwoLevel, sparse_inverse
from lampest.solvers.smoothing import Smoothing
from tests.estimates import recording_of

SHAPE = (9, 11)
ESTIMATORS: dict[str, tuple[Term, ...]] = {
    "LSM": (Misfit(),),
    "weighted": (Misfit(weighting="noise"),),
    "LSR-CR": (Misfit(), CellResistance(weight=1e-3)),
    "LSR-dCR": (Misfit(), RelativeChange(weight=10)),
    "LSR-gCR": (Misfit(), Gradient(weight=1e-3)),
    "LSR-gdCR": (Misfit(), GradientOfRelativeChange(weight=10)),
    "Huber": (Misfit(loss=Huber(corner=2.0)), Gradient(weight=1e-3)),
    "absolute": (Misfit(), Gradient(weight=1.0, loss=Absolute())),
}


def recording(noise: float) -> Recording:
    """One unloaded frame and two with a pressed ring, noise in units of the readout's σ."""
    generator = np.random.default_rng(5)
    truth = np.repeat(3000 * np.exp(0.2 * generator.standard_normal((1, *SHAPE))), 3, axis=0)
    truth[1:, 2:6, 3:7] *= 0.3
    truth[1:, 3:5, 4:6] *= 12
    readout = TwoPointReadout()
    exact = two_point_resistance(truth)
    resistance = exact + noise * readout.sigma(exact) * generator.standard_normal(exact.shape)
    assert_allclose(readout.recorded_from_volt(readout.volt_from_recorded(exact)), exact)
    return recording_of(Scene(Panel(*SHAPE), readout), resistance, 1)


# Absolute penalties have several minima where the noise is strong, and either way may end in another.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "noise"),
    [(name, noise) for name in ESTIMATORS for noise in (1.0, 5.0) if (name, noise) != ("absolute", 5.0)],
)
def test_products_and_factors_agree(name: str, noise: float, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded, estimator = recording(noise), Estimator(ESTIMATORS[name], formulation="reduced")
    factored = reconstruct(recorded, estimator)
    for module in (hessian, floating):
        monkeypatch.setattr(module, "DENSE_CELLS", 0)
    monkeypatch.setattr(hessian, "MATRIX_CELLS", 0)
    products = reconstruct(recorded, estimator)
    for one, other in zip(factored.steps, products.steps, strict=True):
        assert one.solution.solved
        assert other.solution.solved
        assert other.solution.objective == pytest.approx(one.solution.objective, rel=1e-6, abs=1e-6)


def test_stencil_is_close_to_the_response_of_an_even_panel() -> None:
    """On equal cells D∘D and its stencil differ by little more than 1/(rows + columns)."""
    cells = np.full((30, 40), 1000.0)
    resistance = two_point_resistance(cells)
    network = FloatingNetwork.solve(1 / cells, grounding(resistance))
    stencil = Stencil.of(1 / cells, resistance, np.ones(cells.shape, dtype=bool))
    generator = np.random.default_rng(1)
    values = generator.standard_normal(cells.shape)
    back = stencil.solve(network.forward(values * cells))
    assert np.linalg.norm(back - values) < 0.1 * np.linalg.norm(values)


def test_stencil_inverts_what_it_stands_for() -> None:
    generator = np.random.default_rng(2)
    conductance = np.exp(generator.standard_normal((4, 5)))
    resistance = two_point_resistance(1 / conductance)
    free = generator.random((4, 5)) < 0.7
    stencil = Stencil.of(conductance, resistance, free)
    row, column = np.divmod(np.arange(20), 5)
    matrix = np.diag(1 / np.where(free, stencil.diagonal, 1.0).ravel())
    matrix += (row[:, None] == row) / conductance.sum(axis=1)[row] ** 2
    matrix += (column[:, None] == column) / conductance.sum(axis=0)[column] ** 2
    chosen = np.flatnonzero(free)
    values = generator.standard_normal(20)
    expected = np.linalg.solve(matrix[np.ix_(chosen, chosen)], values[chosen])
    assert_allclose(stencil.solve(values.reshape(4, 5)).ravel()[chosen], expected, rtol=1e-10)


def test_lines_stand_for_the_square_of_the_stencil() -> None:
    """G S W S G, S put together cell by cell, is the diagonal and the lines that a preconditioner takes."""
    generator = np.random.default_rng(3)
    conductance, weight = np.exp(generator.standard_normal((2, 4, 5)))
    resistance = two_point_resistance(1 / conductance)
    row, column = np.divmod(np.arange(20), 5)
    lines = (row[:, None] == row) / conductance.sum(axis=1)[row] ** 2
    lines += (column[:, None] == column) / conductance.sum(axis=0)[column] ** 2
    own = np.maximum(resistance.ravel() ** 2 - np.diag(lines), 0.05 * resistance.ravel() ** 2)
    response = (lines + np.diag(own)) * conductance.ravel()
    matrix = response.T @ (weight.reshape(-1, 1) * response)
    parts = square_by_lines(conductance, resistance, weight)
    lines = np.concatenate([row[:, None] == np.arange(4), column[:, None] == np.arange(5)], axis=1)
    across = np.concatenate([one.reshape(-1, 1) * lines for one in parts.along], axis=1)
    assert_allclose(matrix, np.diag(parts.own.ravel()) + across @ parts.mixed @ across.T, rtol=1e-10)


def crowded(deviations: float) -> Recording:
    """A large panel with so much noise that a third of its cells, or nearly all, end at their bound."""
    generator = np.random.default_rng(8)
    truth = 3000 * np.exp(0.2 * generator.standard_normal((18, 20)))
    truth[4:9, 5:9] *= 0.1
    readout = TwoPointReadout()
    exact = two_point_resistance(truth)
    resistance = exact + deviations * readout.sigma(exact) * generator.standard_normal(exact.shape)
    resistance = np.maximum(resistance, 10.0)
    return recording_of(Scene(Panel(18, 20), readout), resistance[None])


@pytest.fixture
def begun_inside(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Evaluation, int]]:
    """What every interior-point solve ended at, and its steps."""
    taken = []

    def watched(start: Evaluation) -> tuple[Evaluation, int]:
        taken.append(by_interior_point(start))
        return taken[-1]

    monkeypatch.setattr(projected_newton, "by_interior_point", watched)
    return taken


@pytest.mark.slow
def test_the_interior_point_method_ends_where_stops_at_bounds_end(
    begun_inside: list[tuple[Evaluation, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a large panel with noise, a third of the cells at their bound; begun inside, and stopped one by one."""
    recorded, estimator = crowded(100), Estimator((Misfit(),), formulation="reduced")
    inside = reconstruct(recorded, estimator).steps[0].solution
    assert max(steps for _, steps in begun_inside) > 5
    monkeypatch.setattr(projected_newton, "by_interior_point", lambda start: (start, 0))
    stopped = reconstruct(recorded, estimator).steps[0].solution
    assert np.sum(inside.open_cell) > 38
    assert inside.status is stopped.status is Status.HELD
    assert inside.objective == pytest.approx(stopped.objective, rel=1e-8)


@pytest.mark.slow
def test_the_interior_point_method_leaves_no_search_for_the_bounds(
    begun_inside: list[tuple[Evaluation, int]],
) -> None:
    """Where nine of ten cells end at a bound, it puts those there that belong there."""
    solution = reconstruct(crowded(1000), Estimator((Misfit(),), formulation="reduced")).steps[0].solution
    assert np.mean(solution.open_cell) > 0.9
    for found, steps in begun_inside:
        assert steps > 5
        assert np.array_equal(found.cell_resistance >= found.data.upper, solution.open_cell)


def pressed_patch() -> Evaluation:
    """LSR-∇CR at equal cells, of a panel with a patch of a hundredth: in log r the cost is concave there."""
    generator = np.random.default_rng(4)
    truth = 3000 * np.exp(0.2 * generator.standard_normal((18, 20)))
    truth[4:12, 5:13] *= 0.01
    readings = two_point_resistance(truth)[None]
    recorded = recording_of(Scene(Panel(18, 20), TwoPointReadout()), readings)
    estimator = Estimator((Misfit(), Gradient(weight=1e-3)), formulation="reduced")
    data = estimator.data(recorded.readings()[0].alone(), Background(recorded.scene))
    return Evaluation.at(estimator.cost(recorded.scene, 1, partial=False), data, data.uniform_start)


def test_gauss_newtons_matrix_is_positive_where_second_derivatives_are_not() -> None:
    """JᵀWJ + PᵀKP as products and as a matrix, where ∇²φ is indefinite."""
    found = hessian.Hessian(at := pressed_patch(), Smoothing.start(at))
    matrix = np.stack([found.gauss_newton_product(unit) for unit in np.eye(at.cell_resistance.size)])
    assert_allclose(
        matrix, found.gauss_newton_between(np.arange(found.gradient.size)), atol=1e-9 * np.abs(matrix).max()
    )
    assert np.linalg.eigvalsh(found.matrix)[0] < 0
    assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * np.abs(matrix).max()


def test_negative_curvature_under_a_large_mouth_is_left_behind() -> None:
    """From equal cells to a verified minimum, in fewer iterations than one for every ten cells of the patch."""
    start = pressed_patch()
    solution = projected_newton.ProjectedNewton(start.cost, Settings()).solve(start.data, start)
    assert solution.status is Status.OPTIMUM and solution.iterations < 40
    assert start.elsewhere(solution.cell_resistance).objective < 0.1 * start.objective


def test_lines_precondition_the_crosstalk() -> None:
    """Beside the convex start, by changes of log r: symmetric, positive, and near the inverse along most directions."""
    at = pressed_patch()
    at = at.elsewhere(
        np.clip(at.data.readout.start(at.data.measured[0], at.data.upper[0]), at.data.lower, at.data.upper)
    )
    found = hessian.Hessian(at, Smoothing.start(at))
    count, spread = at.cell_resistance.size, {}
    cells, free = at.cell_resistance.ravel(), np.ones(at.cell_resistance.size, dtype=bool)
    scale = sparse.diags_array(1 / cells)
    local = sparse.csr_array(scale @ (found.penalty_matrix + sparse.diags_array(found.own)) @ scale)
    for lined in (False, True):
        kept = TwoLevel.of(found) if lined else TwoLevel(at.cell_resistance, sparse_inverse(local))
        assert (kept.lines is not None) == lined
        solve = kept.over(free, at.cell_resistance)
        inverse = np.stack([solve(unit) for unit in np.eye(count)])
        assert_allclose(inverse, inverse.T, atol=1e-6 * np.abs(inverse).max())
        values = linalg.eigvals(found.gauss_newton_between(np.arange(found.gradient.size)) @ inverse).real
        assert values.min() > 0
        spread[lined] = np.quantile(values, 0.98) / np.quantile(values, 0.02)
    assert spread[True] < 0.3 * spread[False], spread


@pytest.mark.parametrize(("curvature", "named"), [(-1e-16, "UNDETERMINED"), (-1e-3, "INDEFINITE"), (1e-3, "POSITIVE")])
def test_what_the_last_digits_of_the_cost_hide_is_no_way_down(
    curvature: float, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One cell of a large panel curves the cost by ± a share of its scale, over a change of one in log r."""
    at = pressed_patch()
    found = hessian.Hessian(at, Smoothing.start(at))
    diagonal = np.full(at.cell_resistance.size, at.cost_scale)
    diagonal[7] *= curvature
    monkeypatch.setattr(hessian.Hessian, "product", lambda self, step: diagonal * step)
    monkeypatch.setattr(hessian.Hessian, "gradient", np.where(np.arange(len(diagonal)) == 7, 1e-9, 0.0))
    kept = TwoLevel(at.cell_resistance, lambda values: values)
    assert certificate.certificate(found, kept).definiteness is certificate.Definiteness[named]
