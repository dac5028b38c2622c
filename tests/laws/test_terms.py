"""Laws of every cost term with every loss."""

import dataclasses
from typing import Any, Literal

import casadi
import numpy as np
import pytest
from golden.numerics import LOSSES as UNION_LOSSES
from golden.numerics import options
from numpy.testing import assert_allclose, assert_array_equal
from promises import promise
from scipy.stats import t

from lampest import Array, Panel, TwoPointReadout, two_point_resistance
from lampest.cost.cost import Cost
from lampest.cost.given import Given
from lampest.cost.losses import Absolute, Huber, Loss, PenaltyEvidence, Squared, Student
from lampest.cost.problem import Data, Evaluation
from lampest.cost.terms import Gradient, State, Term, term_types
from lampest.formulation.patterns import EXCITATIONS
from lampest.formulation.program import Program
from lampest.solvers.hessian import Hessian, Smoothing

PANEL = Panel(3, 4)
CORNER = 40.0  # of the losses of the union, too
# Of what a term is given.
IN_OHMS = ("cell_resistance", "reading", "measured", "sigma", "previous", "baseline")
GRID = np.linspace(-3, 3, 121) * CORNER
ROUNDING = 1e-12  # of float64, relative to the largest number of a sum
LAST_DIGITS = 1e-14  # of a single operation
CURVED = 1e-7  # of a slope by differences of fourth order, relative
CANCELLATION = 1e-9  # relative to a cost: its differences over steps of 1e-5
MAX_ERROR = 1e-6  # of differences of second order over such steps, and of IPOPT's minimum, relative
CORNER_DISTANCE = 1e-3  # of the residuals from 0, relative: a hundred times a step of differences
SHARE_OF_CORNER = 1e-3  # h of differences of second order; they are wrong by h²


@dataclasses.dataclass(frozen=True)
class GemanMcClure(Loss):
    """Σ x²/(1 + (x/c)²), a user's own bounded loss, flat for large x."""

    convex = False
    corner: float
    kind: Literal["geman_mcclure"] = "geman_mcclure"

    def cost(self, residual: Any) -> Any:
        return casadi.sum1(residual**2 / (1 + (residual / self.corner) ** 2))


@dataclasses.dataclass(frozen=True)
class OnlyCost(Loss):
    """Another loss, of which nothing but its formula is known."""

    of: Loss
    kind: Literal["only_cost"] = "only_cost"

    def cost(self, residual: Any) -> Any:
        return self.of.cost(residual)


LOSSES = [*UNION_LOSSES, GemanMcClure(CORNER)]
VARIANTS = [
    pytest.param(term, words, id="-".join([kind, *words.values()]))
    for kind, term in term_types().items()
    for words in options(term)
]
# Derivatives of a sum show an error of any part: every term once with each loss, and every loss by
# itself. Losses that enter through duals have sums of their own: without them a Hessian takes
# another way.
SUMS = {
    "smooth": [loss for loss in LOSSES if loss.enters != "dual"],
    "dual": [loss for loss in LOSSES if loss.enters == "dual"],
}
every_cost = pytest.mark.parametrize(
    "terms",
    [
        *(
            pytest.param(
                tuple(term(weight=0.7, loss=loss, **words) for loss in losses),
                id="-".join([kind, *words.values(), name]),
            )
            for kind, term in term_types().items()
            for words in options(term)
            for name, losses in SUMS.items()
        ),
        *(pytest.param((Gradient(weight=0.7, loss=loss),), id=loss.kind) for loss in LOSSES),
    ],
)


def example(frames: int, seed: int = 0) -> tuple[Data, Array]:
    """Data of the panel, and cells near those that made them."""
    rng = np.random.default_rng(seed)
    truth = 3000 * np.exp(0.4 * rng.standard_normal((frames, *PANEL.shape)))
    measured = two_point_resistance(truth) * np.exp(0.05 * rng.standard_normal(truth.shape))
    sigma = 10.0 * np.exp(0.3 * rng.standard_normal(truth.shape))
    previous = 3000 * np.exp(0.4 * rng.standard_normal(PANEL.shape))
    cells = truth * np.exp(0.2 * rng.standard_normal(truth.shape))
    baseline = 3000 * np.exp(0.4 * rng.standard_normal(PANEL.shape))
    deviation = 0.1 * np.exp(0.3 * rng.standard_normal(PANEL.shape))
    known = (
        {"previous": previous, "baseline": baseline, "previous_deviation": deviation}
        if frames == 1
        else {}
    )
    return Data(
        Given(measured=measured, sigma=sigma, **known), measured / 10, measured * 1e3
    ), cells


def state(data: Data, cells: Array, scale: float = 1.0) -> State:
    """One frame with every length of the axis of ohms times `scale`, as CasADi's matrices."""
    frame = {"cell_resistance": cells[0].ravel(), "reading": two_point_resistance(cells[0]).ravel()}
    columns = {
        name: casadi.DM(value * scale if name in IN_OHMS else value)
        for name, value in (frame | data.flat).items()
    }
    return State(panel=PANEL, **columns)


def residual(term: Term, point: State) -> Array:
    return np.asarray(casadi.DM(term.residual(point))).ravel()


def test_a_term_without_a_unit_or_with_the_kind_of_another_is_refused() -> None:
    @dataclasses.dataclass(frozen=True)
    class Unitless(Term):
        def residual(self, state: State) -> Any:
            return state.cell_resistance

    @dataclasses.dataclass(frozen=True)
    class Second(Unitless):
        unit = "ohm"
        kind: Literal["gradient"] = "gradient"

    with pytest.raises(
        ValueError, match=r"Unitless has no unit: declare it in the class, such as unit: ClassVar"
    ):
        Unitless()
    with pytest.raises(
        ValueError, match="Second has the kind 'gradient' of Gradient: choose another"
    ):
        Second()


@pytest.mark.parametrize(("term", "words"), VARIANTS)
def test_only_data_terms_read_the_measurement(term: type[Term], words: dict[str, Any]) -> None:
    data, cells = example(1)
    original = state(data, cells)
    moved = dataclasses.replace(original, measured=original.measured + 1.0)
    unchanged = np.array_equal(residual(term(**words), original), residual(term(**words), moved))
    assert term.reads_measurement == (not unchanged)


@promise("README: CasADi states this program with exact derivatives")
@pytest.mark.parametrize("frames", [1, 2])
@every_cost
def test_the_gradient_is_the_derivative_of_the_cost(terms: tuple[Term, ...], frames: int) -> None:
    """∂φ/∂log r along random directions against central differences of φ, of fourth order."""
    cost = Cost(PANEL, terms, frames)
    data, cells = example(frames)
    point = Evaluation.at(cost, data, cells)
    subgradient = np.sign(point.nonsmooth)
    gradient = point.log_gradient(subgradient)
    # No dual variable exceeds 1.
    assert point.kkt_residual(-subgradient) == point.kkt_residual(-3 * subgradient)
    rng = np.random.default_rng(1)
    step = 1e-5
    for _ in range(4):
        direction = rng.standard_normal(cells.shape)
        far, near = (
            np.subtract(
                *(
                    Evaluation.at(cost, data, cells * np.exp(sign * h * direction)).objective
                    for sign in (1, -1)
                )
            )
            for h in (2 * step, step)
        )
        # Fourth order: a loss may curve within a step of 0.03 ohm.
        slope = (8 * near - far) / (12 * step)
        size = np.sum(np.abs(gradient * direction))
        # An absolute loss is no parabola, but the step is far smaller than the distance to any
        # corner.
        assert slope == pytest.approx(
            np.sum(gradient * direction), abs=CURVED * size + CANCELLATION * point.objective
        )
    corners = np.abs(point.nonsmooth)
    assert not corners.size or np.min(corners) > CORNER_DISTANCE * np.max(corners)


@pytest.mark.parametrize(
    ("formulation", "frames"),
    [
        pytest.param(formulation, frames, marks=[pytest.mark.slow] * (frames != number % 2 + 1))
        for number, formulation in enumerate(EXCITATIONS)
        for frames in (1, 2)
    ],
)
@every_cost
def test_the_hessian_is_the_derivative_of_the_gradient(
    terms: tuple[Term, ...], formulation: str, frames: int
) -> None:
    program = Program.build(
        Cost(PANEL, terms, frames),
        TwoPointReadout(),
        None,
        formulation,
    )
    nlp = program.nlp
    multiplier = casadi.SX.sym("multiplier", program.nlp["g"].shape[0])
    lagrangian = 1.3 * nlp["f"] + casadi.dot(multiplier, nlp["g"])
    gradient = casadi.Function(
        "gradient", [nlp["x"], nlp["p"], multiplier], [casadi.gradient(lagrangian, nlp["x"])]
    )
    rng = np.random.default_rng(2)
    x, p, multipliers = (
        np.exp(0.3 * rng.standard_normal(symbol.shape[0]))
        for symbol in (nlp["x"], nlp["p"], multiplier)
    )
    # Resistances of the size of Huber's corner, so that residuals fall on either side of it.
    names = np.concatenate([np.full(size, name) for name, size in program.parameter.sizes.items()])
    p[np.isin(names, ("measured", "previous", "baseline"))] *= CORNER
    upper = np.asarray(program.hessian()(x, p, 1.3, multipliers))
    assert_array_equal(np.tril(upper, -1), 0)
    hessian = upper + np.triu(upper, 1).T
    step = 1e-6
    for _ in range(3):
        direction = rng.standard_normal(len(x))
        ends = [
            np.asarray(gradient(x + sign * step * direction, p, multipliers)).ravel()
            for sign in (1, -1)
        ]
        product_ = hessian @ direction
        assert_allclose(
            (ends[0] - ends[1]) / (2 * step), product_, atol=MAX_ERROR * np.max(np.abs(product_))
        )


@pytest.mark.parametrize("frames", [1, 2])
@every_cost
def test_the_reduced_hessian_is_the_derivative_of_the_reduced_gradient(
    terms: tuple[Term, ...], frames: int
) -> None:
    """∇²φ in log r, as a matrix and as a product, against central differences of ∇φ."""
    cost = Cost(PANEL, terms, frames)
    data, cells = example(frames)
    # 0.006 ohm: a loss curves within CORNER of them
    rng = np.random.default_rng(4)
    width = 50.0
    step = 2e-6

    def curvature(position: Array) -> Hessian:
        at = Evaluation.at(cost, data, position)
        return Hessian(
            at, Smoothing(width, Smoothing(width, np.zeros(len(at.nonsmooth))).slope(at.nonsmooth))
        )

    point = curvature(cells)
    matrix = point.matrix
    assert_allclose(matrix, matrix.T, atol=ROUNDING * np.max(np.abs(matrix)))
    for _ in range(3):
        direction = rng.standard_normal(cells.size)
        moved = [cells * np.exp(sign * step * direction.reshape(cells.shape)) for sign in (1, -1)]
        ends = [curvature(position).gradient for position in moved]
        expected = (ends[0] - ends[1]) / (2 * step)
        assert_allclose(matrix @ direction, expected, atol=MAX_ERROR * np.max(np.abs(expected)))
        assert_allclose(
            point.product(direction),
            matrix @ direction,
            atol=10 * ROUNDING * np.max(np.abs(expected)),
        )


@pytest.mark.parametrize(("term", "words"), VARIANTS)
def test_the_residual_scales_with_its_unit(term: type[Term], words: dict[str, Any]) -> None:
    """Doubled resistances double a residual in ohm; a percentage, a ratio, a deviation stays."""
    data, cells = example(1)
    chosen = term(**words)
    plain = (
        not chosen.unit.startswith(("percent", "standard deviations", "1 "))
        and words.get("weighting") != "noise"
    )
    factor = 2.0 if plain else 1.0
    expected = factor * residual(chosen, state(data, cells))
    assert_allclose(
        residual(chosen, state(data, cells, 2.0)),
        expected,
        rtol=1e-13,
        atol=1e-14 * np.abs(expected).max(),
    )


def values(loss: Loss, x: Array) -> Array:
    """The loss of each of many numbers."""
    return np.array([float(loss.cost(casadi.DM(value))) for value in x])


def slopes(loss: Loss, x: Array) -> Array:
    symbol = casadi.SX.sym("x")
    slope = casadi.Function("slope", [symbol], [casadi.gradient(loss.cost(symbol), symbol)])
    return np.array([float(slope(value)) for value in x])


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: loss.kind)
def test_losses_are_even_rising_zero_at_zero_and_convex_as_declared(loss: Loss) -> None:
    losses = values(loss, GRID)
    assert float(loss.cost(casadi.DM(0.0))) == 0
    assert np.all(losses[np.abs(GRID) > ROUNDING * CORNER] > 0)
    assert_allclose(losses, losses[::-1], rtol=ROUNDING)
    assert np.all(np.diff(losses[GRID >= 0]) > 0)
    assert np.all(np.diff(losses, 2) > -CANCELLATION * losses.max()) == loss.convex
    column = casadi.DM(GRID)
    assert float(loss.cost(column)) == pytest.approx(losses.sum(), rel=ROUNDING)


def test_losses_equal_their_published_formulas() -> None:
    outside = np.abs(GRID) > CORNER
    assert_allclose(values(Squared(), GRID), GRID**2, rtol=LAST_DIGITS)
    assert_allclose(values(Absolute(), GRID), np.abs(GRID), rtol=LAST_DIGITS)
    huber = values(Huber(corner=CORNER), GRID)
    assert_allclose(huber[~outside], GRID[~outside] ** 2, rtol=ROUNDING)
    assert_allclose(huber[outside], 2 * CORNER * np.abs(GRID[outside]) - CORNER**2, rtol=ROUNDING)
    density = t.logpdf(GRID, df=4, scale=CORNER / 2)
    assert_allclose(
        values(Student(corner=CORNER), GRID),
        2 * CORNER**2 / 5 * (density.max() - density),
        atol=1e-9,
    )


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: loss.kind)
def test_the_minimum_of_the_lowered_objective_is_the_loss(loss: Loss) -> None:
    """The least of the lowered objective over p, q ≥ 0 is weight·loss; duals are slopes."""
    weight = 0.7
    unit = 25.0
    x = np.array([-3.0, -1.0, -0.4, 0.2, 1.7]) * CORNER
    lowered = loss.lowered(
        casadi.SX(x), casadi.SX(np.full(5 if loss.enters == "dual" else 1, weight)), casadi.SX(unit)
    )
    cost = weight * float(loss.cost(casadi.DM(x)))
    if loss.enters == "whole":
        assert (
            not lowered.split
            and lowered.equation is None
            and float(casadi.DM(lowered.objective)) == cost
        )
        return
    start = np.concatenate([np.maximum(side, 0) + 0.01 for side in (x / unit, -x / unit)])
    assert np.all(start > 0)
    assert_allclose(np.subtract(*np.split(start, 2)), x / unit)
    assert (lowered.equation is None) == (loss.enters == "split")
    equation = casadi.SX(0, 1) if lowered.equation is None else lowered.equation
    program = {"x": casadi.vertcat(*lowered.split), "f": lowered.objective, "g": equation}
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}}
    solution = casadi.nlpsol("least", "ipopt", program, quiet)(x0=start, lbx=0, lbg=0, ubg=0)
    assert float(solution["f"]) == pytest.approx(cost, rel=MAX_ERROR)
    if loss.enters == "dual":
        assert_allclose(
            np.asarray(solution["lam_g"]).ravel() / (weight * unit), slopes(loss, x), atol=MAX_ERROR
        )


@pytest.mark.parametrize(
    "loss", [loss for loss in LOSSES if loss.enters != "dual"], ids=lambda loss: loss.kind
)
def test_derived_slopes_and_curvatures_equal_those_of_the_losses(loss: Loss) -> None:
    """ω, the pull beyond it and η, from derivatives of the cost and from the closed forms."""
    plain = OnlyCost(loss)
    grid = GRID + 0.1
    assert_allclose(plain.curvature(grid), loss.curvature(grid), atol=ROUNDING)
    assert_allclose(plain.steady_pull(grid), loss.steady_pull(grid), atol=ROUNDING * CORNER)
    inside = grid[np.abs(grid) < CORNER]
    evidence = PenaltyEvidence(inside, 0.0, 5.0, lambda: 2.0)
    assert plain.size(evidence) == pytest.approx(loss.size(evidence))
    assert plain.determined(evidence) == loss.determined(evidence) == 3.0


def test_curvature_and_pull_give_the_slope() -> None:
    """(ω x)² + H² = (½ρ')² wherever the loss is convex, ω = ½ρ'' against differences."""
    step = SHARE_OF_CORNER * CORNER
    loss = GemanMcClure(CORNER)
    grid = GRID + 0.1
    low, middle, high = (values(loss, grid + move) for move in (-step, 0.0, step))
    slope = (high - low) / (4 * step)
    curvature = (high - 2 * middle + low) / (2 * step**2)
    assert_allclose(loss.curvature(grid), np.maximum(curvature, 0), atol=10 * SHARE_OF_CORNER**2)
    assert_allclose(
        (loss.curvature(grid) * grid) ** 2 + loss.steady_pull(grid) ** 2,
        slope**2,
        rtol=10 * SHARE_OF_CORNER**2,
    )
