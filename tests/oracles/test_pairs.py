"""Baseline and first frame, solved jointly beyond small panels: none fails, and nothing else finds less."""

import numpy as np
import pytest
from scipy.optimize import minimize

from lampest import Array, Estimator, Panel, Readings, Scene, TwoPointReadout, two_point_resistance
from lampest.cost.given import Background
from lampest.cost.terms import GradientOfRelativeChange, Misfit, RelativeChange, Term
from lampest.solvers import hessian
from lampest.solvers.multistart import best_solution
from tests.least_cost import Circuit, LeastCost, Penalty

SHAPE = (12, 11)
ALIKE = 1e-6  # of a cost
METHODS: dict[str, Term] = {
    "relative_change": RelativeChange(weight=10),
    "gradient_of_relative_change": GradientOfRelativeChange(weight=10),
}


def mouth() -> Array:
    """(2, rows, columns) ohm: uneven cells without and with a mouth, its rim pressed, what lies within sucked."""
    generator = np.random.default_rng(3)
    resting = 3000 * np.exp(0.4 * generator.standard_normal(SHAPE))
    down, right = np.mgrid[: SHAPE[0], : SHAPE[1]]
    distance = np.hypot(down - 5.6, right - 5.3)
    return np.stack([resting, resting * np.where(distance < 2.6, 6.0, np.where(distance < 4, 0.06, 1.0))])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "most"),
    [("relative_change", 600), ("gradient_of_relative_change", 600), ("relative_change", 0)],
    ids=["relative_change-factors", "gradient_of_relative_change-factors", "relative_change-products"],
)
def test_a_joint_pair_ends_where_nothing_else_finds_less(
    method: str, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of several hundred unknowns, most of a disc's cells bending the cost downwards."""
    monkeypatch.setattr(hessian, "DENSE_STIFF_CELLS", most)
    cells, readout = mouth(), TwoPointReadout(reference_ohm=1000.0, adc_bits=10, readings=20, noise_lsb=0.7)
    exact = two_point_resistance(cells)
    sigma = readout.sigma(exact)
    measured = exact + sigma * np.random.default_rng(4).standard_normal(exact.shape)
    scene = Scene(Panel(*SHAPE), readout)
    estimator = Estimator((Misfit(), METHODS[method]), formulation="reduced")
    seen = np.ones(exact.shape)
    data = estimator.data(Readings(measured, sigma, 0 * seen, seen), Background(scene))
    found = best_solution(estimator.problem(scene, 2, 1.0, partial=data.partial), data, None)
    assert found.optimum, found.status

    terms = (Penalty("misfit", 1.0), Penalty(method, METHODS[method].weight))
    nothing = np.zeros(SHAPE, dtype=bool)
    least = LeastCost(
        Circuit("two_point"), terms, measured, sigma, 0 * seen, seen, data.lower, data.upper, faulty=nothing
    )
    assert least.value(np.log(found.cell_resistance).ravel()) == pytest.approx(found.objective, rel=1e-9)
    uniform = measured * cells[0].size / (sum(SHAPE) - 1)
    for start in (cells, uniform, found.cell_resistance * 1.05):
        assert lowest(least, start) >= found.objective * (1 - ALIKE)


def lowest(least: LeastCost, start: Array) -> float:
    """What L-BFGS-B reaches from cells (frames, rows, columns) ohm."""

    def value(position: Array) -> tuple[float, Array]:
        residuals, slopes = least.as_squares(position, 0.0)
        return float(residuals @ residuals), 2 * residuals @ slopes

    lower, upper = np.log(least.lower).ravel(), np.log(least.upper).ravel()
    bounds = np.column_stack((lower, upper))
    options = {"maxiter": 150, "maxfun": 200, "ftol": 1e-13}
    place = np.clip(np.log(start).ravel(), lower, upper)
    return float(minimize(value, place, jac=True, method="L-BFGS-B", bounds=bounds, options=options).fun)
