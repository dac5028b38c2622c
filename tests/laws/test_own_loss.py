"""Losses of a user's own, in no union, which say what they cost and nothing else."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import casadi
import numpy as np
import pytest
from golden.numerics import LOSSES
from numpy.testing import assert_allclose

from lampest import Array, Gradient, InputError, Misfit, Panel, Reconstruction, Recording, Scene, Term, reconstruct
from lampest.cost.losses import Absolute, Huber, Loss, PenaltyEvidence, Squared
from lampest.panel.readouts.floating import two_point_resistance
from tests.estimates import recording_of

SHAPE = (4, 5)
CORNER = 40.0
GRID = np.linspace(-3, 3, 61) * CORNER + 0.1
LOOSE, SHARP = 1e6, 1.0  # ohm: far above all steps between cells, and far below them


@dataclass(frozen=True)
class PseudoHuber(Loss):
    """Σ 2c²(√(1 + (x/c)²) − 1): x² near 0, 2c|x| far out, and smooth in between."""

    corner: float
    kind: Literal["pseudo_huber"] = "pseudo_huber"

    def cost(self, residual: Any) -> Any:
        return 2 * self.corner**2 * casadi.sum1(casadi.sqrt(1 + (residual / self.corner) ** 2) - 1)


@dataclass(frozen=True)
class Cauchy(Loss):
    """Σ c² ln(1 + (x/c)²): not convex, what is far out hardly pulls."""

    corner: float
    kind: Literal["cauchy"] = "cauchy"

    def cost(self, residual: Any) -> Any:
        return self.corner**2 * casadi.sum1(casadi.log(1 + (residual / self.corner) ** 2))


@dataclass(frozen=True)
class OnlyCost(Loss):
    """Another loss, of which nothing but its formula is known."""

    of: Loss
    kind: Literal["only_cost"] = "only_cost"

    def cost(self, residual: Any) -> Any:
        return self.of.cost(residual)


SMOOTH = [loss for loss in LOSSES if loss.enters != "dual"]


def recording(pressed: float = 0.4, outlier: float = 1.0) -> Recording:
    """One frame with 0.3 % of noise; pressed : a factor for the cells of two columns. outlier : for one reading."""
    cells = 3000 * np.exp(0.05 * np.random.default_rng(0).standard_normal(SHAPE))
    cells[:, 3:] *= pressed
    exact = two_point_resistance(cells)
    measured = exact * (1 + 0.003 * np.random.default_rng(1).standard_normal(SHAPE))
    measured[1, 1] *= outlier
    return recording_of(Scene(Panel(*SHAPE)), measured[None], sigma=0.003 * exact[None])


def estimated(terms: tuple[Term, ...], formulation: str = "reduced", **scene: float) -> Reconstruction:
    found: Reconstruction = reconstruct(recording(**scene), terms, formulation=formulation, error_bars=True)
    assert all(step.solution.solved for step in found.steps)
    return found


def deviation(estimate: Reconstruction) -> Array:
    bars = estimate.steps[0].bars
    return bars.frame.deviation


def with_gradient(loss: Loss, weight: float | Literal["auto"]) -> tuple[Term, ...]:
    return Misfit(weighting="noise"), Gradient(weight=weight, loss=loss)


@pytest.mark.parametrize("loss", SMOOTH, ids=lambda loss: loss.kind)
def test_what_follows_from_the_formula_is_what_the_losses_say(loss: Loss) -> None:
    """ω, the pull beyond it and η, from derivatives of the cost and from the closed forms."""
    plain = OnlyCost(loss)
    assert_allclose(plain.curvature(GRID), loss.curvature(GRID), atol=1e-12)
    assert_allclose(plain.steady_pull(GRID), loss.steady_pull(GRID), atol=1e-6 * CORNER)
    inside = GRID[np.abs(GRID) < CORNER]
    evidence = PenaltyEvidence(inside, 0.0, 5.0, lambda: 2.0)
    assert plain.size(evidence) == pytest.approx(loss.size(evidence))
    assert plain.determined(evidence) == loss.determined(evidence) == 3.0


@pytest.mark.parametrize("loss", [PseudoHuber(CORNER), Cauchy(CORNER)], ids=lambda loss: loss.kind)
def test_slope_is_explained_by_curvature_and_pull(loss: Loss) -> None:
    """(ω x)² + H² = (½ρ')² wherever the loss is convex, ω = ½ρ'' against differences."""
    step = 1e-3 * CORNER
    low, here, high = (np.array([float(loss.cost(x + move)) for x in GRID]) for move in (-step, 0.0, step))
    slope, curvature = (high - low) / (4 * step), (high - 2 * here + low) / (2 * step**2)
    assert_allclose(loss.curvature(GRID), np.maximum(curvature, 0), atol=1e-5)
    assert_allclose((loss.curvature(GRID) * GRID) ** 2 + loss.steady_pull(GRID) ** 2, slope**2, rtol=1e-4)


@pytest.mark.parametrize("loss", [PseudoHuber(100.0), Cauchy(300.0)], ids=lambda loss: loss.kind)
def test_formulations_agree_on_an_own_loss(loss: Loss) -> None:
    found = [estimated(with_gradient(loss, 1e-5), formulation) for formulation in ("reduced", "nodal")]
    assert_allclose(found[0].cell_resistance, found[1].cell_resistance, rtol=1e-5)
    assert_allclose(deviation(found[0]), deviation(found[1]), rtol=1e-4)


def test_a_corner_far_away_leaves_the_squared_loss() -> None:
    """Cells, error bars, and the weight where it is open: Huber's loss with that corner is squared, too."""
    ours, squared = (estimated(with_gradient(loss, 1e-6)) for loss in (PseudoHuber(LOOSE), Squared()))
    assert_allclose(ours.cell_resistance, squared.cell_resistance, rtol=1e-5)
    assert_allclose(deviation(ours), deviation(squared), rtol=1e-4)
    ours, huber = (estimated(with_gradient(loss, "auto")) for loss in (PseudoHuber(LOOSE), Huber(corner=LOOSE)))
    assert ours.steps[0].weights[1] == pytest.approx(huber.steps[0].weights[1], rel=1e-3)


def test_a_corner_close_by_leaves_the_absolute_loss() -> None:
    """2c|x| far out: with the weight of |x| over 2c the cells are the same."""
    absolute = estimated(with_gradient(Absolute(), "auto"))
    ours = estimated(with_gradient(PseudoHuber(SHARP), absolute.steps[0].weights[1] / (2 * SHARP)))
    assert_allclose(ours.cell_resistance, absolute.cell_resistance, rtol=0.05)


def test_a_reading_far_off_is_forgotten() -> None:
    """How far one reading that is 15 % too low moves the cells of an even panel, kept and let go of."""
    moved = {}
    for loss in (Squared(), Cauchy(3.0)):
        terms = (replace(Misfit(weighting="noise"), loss=loss), Gradient(weight=1e-4))
        pair = [np.log(estimated(terms, pressed=1.0, outlier=factor).cell_resistance) for factor in (1.0, 0.85)]
        moved[loss.kind] = np.max(np.abs(pair[1] - pair[0]))
    assert moved["cauchy"] < 0.2 * moved["squared"]


def test_a_loss_that_does_not_sum_is_told_so() -> None:
    @dataclass(frozen=True)
    class Forgetful(Loss):
        kind: Literal["forgetful"] = "forgetful"

        def cost(self, residual: Any) -> Any:
            return residual**2

    with pytest.raises(InputError, match=r"loss Forgetful: cost gives 40×1 numbers; it must give one, the sum"):
        estimated(with_gradient(Forgetful(), 1.0))
