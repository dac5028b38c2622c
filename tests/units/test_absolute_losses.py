"""Absolute losses: their smoothing, the number of steps, the accuracy of optima; sparse rows."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.cost.given import Background
from lampest.cost.problem import Evaluation
from lampest.panel.trust_region import SubproblemStep
from lampest.posterior import sampled
from lampest.posterior.linear import LinearModel
from lampest.solvers.direction import (
    MAX_TRIES,
    QuadraticModel,
    hold_beyond_bounds,
    newton_direction,
)
from lampest.solvers.hessian import Smoothing
from lampest.solvers.iterate import Iterate
from lampest.solvers.multistart import best_solution, evaluated
from lampest.solvers.projected_newton import NewtonParts, ProjectedNewton, trust_region_step
from lampest.solvers.solution import Settings

SIDE = 10
# Steps of a first frame under each of TERMS; with μ a tenth of the gap alone 10, 6 and 24.
MOST_STEPS = (8, 8, 25)
MOST_LARGE_STEPS = 60
# Side, weight, and steps that they take at most: 17 with Levenberg's steps within rounding, 36 with
# products that end early because the smoothed gradient is large.
HEAVY = ((10, 10.0, 15), (26, 3.0, 25))
MOST_PRODUCTS = 9  # of a draw; measured 5, and 14 with the curvature of a smoothed loss
SAME_COST = 1e-9  # relative: optima of absolute losses
PENALTIES = (lampest.TotalVariation(weight=1e-3), lampest.CellResistance(weight=1e-6))
ABSOLUTE = tuple(replace(term, loss=lampest.Absolute()) for term in PENALTIES)
TERMS = [(lampest.Misfit(weighting="noise"), term) for term in ABSOLUTE]
TERMS.append((lampest.Misfit(weighting="noise", loss=lampest.Absolute()), *ABSOLUTE[:1]))


def start(terms: tuple[lampest.Term, ...], side: int = SIDE) -> Evaluation:
    """A frame with a soft block, at equal cells."""
    scene = lampest.Scene(lampest.Panel(side, side), lampest.TwoPointReadout(noise_lsb=1.0))
    random = np.random.default_rng(7)
    cells = 3000 * np.exp(0.2 * random.standard_normal((side, side)))
    cells[side // 3 : side // 2 + 1, side // 3 :] *= 0.3
    exact = scene.circuit.exact_reading(cells)
    readings = lampest.Readings.of(scene, exact * (1 + 1e-3 * random.standard_normal(exact.shape)))
    estimator = lampest.Estimator(terms, "reduced")
    data = estimator.data(readings.alone(), Background(scene))
    return evaluated(estimator.cost(scene, 1, partial=data.partial), data, data.uniform_start)


@pytest.mark.parametrize("width", [1e-3, 1.0, 30.0])
def test_the_smoothed_loss_is_one_function_with_its_slope_and_its_second_derivative(
    width: float,
) -> None:
    """ψ lies between |x| − 2β − β log(1 + |x|/β) and |x|; at z = ψ' its Newton system is exact."""
    x = np.linspace(-5, 5, 41)
    centred = Smoothing(width, Smoothing(width, np.zeros(41)).slope(x))
    step = 1e-6
    by_differences = (centred.slope(x + step) - centred.slope(x - step)) / (2 * step)
    size = width + np.sqrt(width**2 + x**2)
    loss = size - width * np.log(size / (2 * width)) - 2 * width
    assert np.all(loss <= np.abs(x)) and np.all(np.abs(centred.dual) < 1)
    assert_allclose((1 - centred.dual**2) * x, 2 * width * centred.dual, atol=1e-9)
    assert_allclose(centred.stiffness(x), by_differences, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("terms", TERMS)
def test_one_factor_solves_the_step_of_a_small_panel_with_absolute_losses(
    terms: tuple[lampest.Term, ...],
) -> None:
    far = start(terms, 5)
    solution = best_solution(ProjectedNewton(far.cost, Settings()), far.data, None)
    at = far.elsewhere(1.001 * solution.cell_resistance)
    point = Iterate.of(at, Smoothing.start(at))
    model = QuadraticModel.of(point)
    direction = newton_direction(point, model, np.inf, hold_beyond_bounds)
    assert model.exact and direction.products == 1


@pytest.mark.parametrize("terms", TERMS[:2])
def test_an_optimum_is_proved_by_duals_within_their_range_and_the_tolerance(
    terms: tuple[lampest.Term, ...],
) -> None:
    at = start(terms)
    tolerance = Settings().tolerance
    outcome = ProjectedNewton(at.cost, Settings()).solve(at.data, at)
    end = at.elsewhere(outcome.cell_resistance)
    assert np.abs(outcome.dual).max() <= 1
    assert end.projected_gradients(end.log_gradient(outcome.dual)) <= tolerance
    assert end.dual_gap(outcome.dual) <= tolerance * end.cost_scale


def test_duals_do_not_follow_the_last_bits_of_residuals() -> None:
    at = start(TERMS[0])
    outcome = ProjectedNewton(at.cost, Settings()).solve(at.data, at)
    end = at.elsewhere(outcome.cell_resistance)
    random = np.random.default_rng(2)
    rounded = 1 + np.finfo(float).eps * random.choice([-1, 1], end.cell_resistance.shape)
    nearly = end.elsewhere(end.cell_resistance * rounded)
    change = np.zeros(len(outcome.dual))
    smoothing = Smoothing(change + 1e-13, 0.5 * outcome.dual)
    moved = [smoothing.moved(end, after, change).dual for after in (nearly, end)]
    assert np.abs(nearly.nonsmooth - end.nonsmooth).max() > 0
    assert_allclose(*moved, rtol=1e-15)


@pytest.mark.parametrize(("terms", "most_steps"), list(zip(TERMS, MOST_STEPS, strict=True)))
def test_absolute_losses_take_few_steps_and_end_within_a_billionth_of_the_cost(
    terms: tuple[lampest.Term, ...], most_steps: int
) -> None:
    at = start(terms)
    usual, finer = (
        best_solution(ProjectedNewton(at.cost, Settings(tolerance=tolerance)), at.data, None)
        for tolerance in (1e-8, 1e-10)
    )
    assert usual.strict and usual.iterations <= most_steps
    assert abs(usual.objective / finer.objective - 1) < SAME_COST


def test_a_rejected_step_within_the_rounding_of_the_cost_is_not_shortened() -> None:
    """A quarter of the step leaves three quarters of the gradient, which has to halve."""
    far = start((lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=1.0)))
    optimum = far.elsewhere(
        ProjectedNewton(far.cost, Settings()).solve(far.data, far).cell_resistance
    )
    tried = list[int]()
    for at in (far, optimum):
        radii = list[float]()

        def counted(*arguments: Any, radii: list[float] = radii) -> SubproblemStep:
            radii.append(arguments[2])
            return newton_direction(*arguments)

        parts = NewtonParts(direction=counted, acceptance=lambda *step: False)
        point = replace(Iterate.of(at, Smoothing.start(at), None), gauss_newton=0)
        assert trust_region_step(point, parts) is None
        tried.append(len(radii))
    assert tried == [MAX_TRIES, 1]


@pytest.mark.slow
@pytest.mark.parametrize(("side", "weight", "most_steps"), HEAVY)
def test_heavy_absolute_losses_take_few_steps(side: int, weight: float, most_steps: int) -> None:
    at = start((lampest.Misfit(weighting="noise"), lampest.TotalVariation(weight=weight)), side)
    assert ProjectedNewton(at.cost, Settings()).solve(at.data, at).iterations <= most_steps


def test_errors_under_an_absolute_loss_are_drawn_with_few_products(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The preconditioner has the curvature of the errors, which is not that of a smoothed loss."""
    at = start((lampest.Misfit(weighting="noise"), lampest.TotalVariation(weight=1.0)), 21)
    solution = best_solution(ProjectedNewton(at.cost, Settings()), at.data, None)
    assert solution.at is not None and solution.dual is not None
    products = list[int]()
    solve = sampled.steihaug

    def counted(*arguments: Any) -> SubproblemStep:
        step = solve(*arguments)
        products.append(step.products)
        return step

    monkeypatch.setattr(sampled, "steihaug", counted)
    model = LinearModel(solution.at, solution.dual, deviation=at.data.deviation)
    assert sampled.SampledErrors(model).draws.shape[1] == len(products)
    assert np.median(products) <= MOST_PRODUCTS


@pytest.mark.slow
def test_steps_of_a_large_panel_do_not_shrink_between_corners() -> None:
    """Once 179 steps, as corners outran the gradient: each step then moved cells by a millionth."""
    readout = lampest.TwoPointReadout(adc_bits=10, readings=1, noise_lsb=1.0)
    scene = lampest.Scene(lampest.Panel(32, 32), readout, 140.0)
    mouth = lampest.OralDisc(
        centre_mm=(154, 156), diameter_mm=112, rim_width_mm=19, pressure_kpa=-12
    )
    simulation = lampest.Simulation(1, 1, scene, baseline_frames=3, frames=3, loads=(mouth,))
    terms = (lampest.Misfit(weighting="noise"), lampest.LogRatio(weight=0.17))
    found = lampest.reconstruct(lampest.simulate(simulation), terms, error_bars=False)
    steps = [step.solution.iterations for step in found.steps]
    assert max(steps) <= MOST_LARGE_STEPS, steps
