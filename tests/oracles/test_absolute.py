"""Absolute losses are solved by smoothing: to 1e-8 of the cost at any weight, and in as few steps as others."""

import numpy as np
import pytest

from lampest import Absolute, Array, Estimator, Panel, Readings, Scene, Squared
from lampest.cost.given import Background
from lampest.cost.problem import Data, Evaluation
from lampest.cost.terms import Misfit, Term, TotalVariation, term_types
from lampest.solvers.multistart import best_solution
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings, Solution, Status, check
from tests.least_cost import Circuit, LeastCost, Penalty

SHAPE = (6, 5)
NOISE = 0.003


def readings(shape: tuple[int, int] = SHAPE) -> tuple[Array, Array]:
    """(values, σ) of scattered cells with a pressed patch, (1, rows, columns) ohm."""
    random = np.random.default_rng(5)
    cells = 3000 * np.exp(0.2 * random.standard_normal(shape))
    cells[shape[0] // 3 : shape[0] // 2 + 1, shape[1] // 3 :] *= 0.3
    exact = Scene(Panel(*shape)).circuit.exact_reading(cells)[None]
    return exact * (1 + NOISE * random.standard_normal(exact.shape)), NOISE * exact


def solved(terms: tuple[Term, ...], shape: tuple[int, int] = SHAPE) -> tuple[Solution, Data]:
    measured, sigma = readings(shape)
    scene, nothing = Scene(Panel(*shape)), np.zeros(measured.shape)
    estimator = Estimator(terms, formulation="reduced")
    data = estimator.data(Readings(measured, sigma, nothing, nothing + 1), Background(scene))
    return best_solution(estimator.problem(scene, 1, 1.0, partial=data.partial), data, None), data


def stated(data: Data, *penalties: Penalty) -> LeastCost:
    nothing = np.zeros(data.measured.shape)
    sound = np.zeros(nothing.shape[1:], dtype=bool)
    arrays = (data.measured, data.sigma, nothing, nothing + 1, data.lower, data.upper)
    measured, sigma, side, seen, lower, upper = (np.asarray(part, dtype=np.float64) for part in arrays)
    return LeastCost(Circuit("two_point"), penalties, measured, sigma, side, seen, lower, upper, sound)


@pytest.mark.parametrize("weight", [1e-9, 1e-3, 1.0, 1e3, 1e6, 1e9, 1e12])
def test_total_variation_at_any_weight(weight: float) -> None:
    """Within 1e-8 of the least cost; from 10⁶ on all cells are one number, and rounding hides that it is strict."""
    found, data = solved((Misfit(), TotalVariation(weight=weight)))
    assert found.status is (Status.OPTIMUM if weight < 1e6 else Status.FLAT)
    assert weight >= 1e6 or found.kkt_residual < 1e-6
    least = stated(data, Penalty("misfit", 1.0), Penalty("total_variation", weight, "absolute"))
    place = np.log(found.cell_resistance).ravel()
    if weight < 1e6:
        assert least.value(least.minimised(place, 200)) >= least.value(place) * (1 - 1e-8) - 1e-12 * least.blank()
        return
    assert np.ptp(place) < 1e-8
    misfit = [least.value(np.full_like(place, place.mean() + aside)) for aside in (-1e-4, 0.0, 1e-4)]
    assert misfit[1] < min(misfit[0], misfit[2])


@pytest.mark.parametrize("kind", ["gradient", "cell_resistance"])
def test_any_residual_may_be_zero(kind: str) -> None:
    term = term_types()[kind](weight=0.1, loss=Absolute())
    found, data = solved((Misfit(weighting="noise"), term))
    assert found.status is Status.OPTIMUM
    least = stated(data, Penalty("misfit", 1.0, scaled=True), Penalty(kind, 0.1, "absolute"))
    place = np.log(found.cell_resistance).ravel()
    assert least.value(least.minimised(place, 200)) >= least.value(place) * (1 - 1e-8) - 1e-12 * least.blank()


@pytest.mark.parametrize(("side", "loss"), [(20, Squared()), (11, Absolute())])
def test_a_large_panel_takes_no_more_steps(side: int, loss: Squared | Absolute) -> None:
    """Once 300 and more, by conjugate gradients along smoothed corners."""
    estimator = Estimator((Misfit(weighting="noise", loss=loss), TotalVariation(weight=1.0)), formulation="reduced")
    measured, sigma = readings((side, side))
    scene, nothing = Scene(Panel(side, side)), np.zeros(measured.shape)
    data = estimator.data(Readings(measured, sigma, nothing, nothing + 1), Background(scene))
    cost = estimator.cost(scene, 1, partial=data.partial)
    start = Evaluation.at(cost, data, data.uniform_start)
    found = check(start, ProjectedNewton(cost, Settings()).solve(data, start))
    assert found.status is Status.OPTIMUM and found.iterations < 60
