"""Penalties of 10⁹ and 10¹²: verified, and no other solver on a second statement of the equations finds less.

There second derivatives hold nothing but rounding along what the penalty leaves free, which is all that data tell. At
10¹² a frame may end with the sentence that says so.
"""

import numpy as np
import pytest

from lampest import Array, Estimator, Loss, Misfit, Panel, Readings, Scene, Solution, Squared, Status, term_types
from lampest.cost.given import Background
from lampest.solvers.multistart import best_solution
from tests.least_cost import Circuit, LeastCost, Penalty

SHAPE = (6, 5)
NOISE = 0.01


def readings() -> tuple[Array, Array]:
    """(values, σ) of a baseline and a frame with a pressed patch, (2, rows, columns) ohm."""
    random = np.random.default_rng(5)
    resting = 3000 * np.exp(0.3 * random.standard_normal(SHAPE))
    change = np.zeros(SHAPE)
    change[1:4, 2:4] = -1.2
    exact = np.stack(
        [Scene(Panel(*SHAPE)).circuit.exact_reading(cells) for cells in (resting, resting * np.exp(change))]
    )
    return exact * (1 + NOISE * random.standard_normal(exact.shape)), NOISE * exact


def solved(kind: str, weight: float, scaled: bool, loss: Loss | None) -> tuple[Solution, LeastCost]:
    """A pair jointly, or the frame alone for a penalty that compares nothing; and the same stated anew."""
    measured, sigma = readings()
    own = {} if loss is None else {"loss": loss}
    term = term_types()[kind](weight=weight, **own)
    if not term.needs_previous:
        measured, sigma = measured[1:], sigma[1:]
    terms = (Misfit(weighting="noise" if scaled else "plain"), term)
    scene, nothing = Scene(Panel(*SHAPE)), np.zeros(measured.shape)
    estimator = Estimator(terms, formulation="reduced")
    data = estimator.data(Readings(measured, sigma, nothing, nothing + 1), Background(scene))
    found = best_solution(estimator.problem(scene, len(measured), 1.0, partial=data.partial), data, None)
    stated = (
        Penalty("misfit", 1.0, scaled=scaled),
        Penalty(kind, weight, "squared" if term.loss.squared else "absolute"),
    )
    faulty = np.zeros(SHAPE, dtype=bool)
    bounds = (data.lower, data.upper)
    return found, LeastCost(Circuit("two_point"), stated, measured, sigma, nothing, nothing + 1, *bounds, faulty)


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("weight", [1e9, 1e12])
@pytest.mark.parametrize(
    "kind",
    ["gradient", "relative_change", "gradient_of_relative_change", "log_ratio", "total_variation_of_change"],
)
def test_squares_are_verified(kind: str, weight: float, scaled: bool) -> None:
    found, least = solved(kind, weight, scaled, Squared())
    if weight > 1e9 and found.status in (Status.ROUNDED, Status.STALLED):
        return
    assert found.status is Status.OPTIMUM or (weight >= 1e9 and found.status is Status.FLAT)
    place = np.log(found.cell_resistance).ravel()
    assert least.value(place) == pytest.approx(found.objective, rel=1e-6)
    for start in (place, np.full_like(place, place.mean())):
        assert least.value(least.minimised(start)) >= found.objective * (1 - 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("kind", ["log_ratio", "total_variation_of_change"])
def test_absolute_losses_are_verified(kind: str, scaled: bool) -> None:
    """Their residuals are zero but for rounding, which the weight makes as large as the cost; it counts for nothing."""
    found, _ = solved(kind, 1e12, scaled, None)
    assert found.status in (Status.OPTIMUM, Status.ROUNDED, Status.STALLED, Status.FLAT)
