"""Laws of every preconditioner: M⁻¹ is linear, symmetric and positive definite."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from lampest import (
    CellResistance,
    Estimator,
    Gradient,
    Misfit,
    Panel,
    Readings,
    Scene,
    Term,
    TwoPointReadout,
)
from lampest.cost.given import Background
from lampest.panel.trust_region import steihaug
from lampest.solvers.hessian import Hessian, Smoothing
from lampest.solvers.multistart import evaluated
from lampest.solvers.preconditioners import (
    Cholesky,
    Preconditioner,
    TwoLevel,
    Woodbury,
    preconditioner,
)

SHAPE = (5, 6)
ALL_CELLS = np.ones(SHAPE[0] * SHAPE[1], dtype=bool)
COSTS: dict[str, tuple[Term, ...]] = {
    "plain": (Misfit(),),
    "size": (Misfit(), CellResistance(weight=1e-3)),
    "slope": (Misfit(), Gradient(weight=1e-3)),
}


def hessian_of(terms: tuple[Term, ...]) -> Hessian:
    """Return the Hessian of a cost at cells that differ by a factor of ten."""
    scene = Scene(Panel(*SHAPE), TwoPointReadout())
    rng = np.random.default_rng(4)
    cells = 3000.0 * 10 ** rng.uniform(-0.5, 0.5, SHAPE)
    exact = scene.circuit.to_recorded(scene.circuit.exact_reading(cells[None]), scene)[0]
    estimator = Estimator(terms, "reduced")
    data = estimator.data(Readings.of(scene, exact).alone(), Background(scene))
    point = evaluated(estimator.cost(scene, 1), data, cells[None])
    return Hessian(point, Smoothing.start(point))


def preconditioner_of(kind: type[Preconditioner], terms: tuple[Term, ...]) -> Preconditioner:
    """One of a kind at a point; a kind of one's own has `of(hessian)`."""
    hessian = hessian_of(terms)
    if kind is Cholesky:
        return preconditioner(hessian, ALL_CELLS)
    operator: Preconditioner = (TwoLevel if kind is Woodbury else kind).of(hessian)
    return operator


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("kind", Preconditioner.__subclasses__(), ids=lambda kind: kind.__name__)
def test_the_inverse_is_symmetric_and_positive_definite(
    kind: type[Preconditioner], cost: str
) -> None:
    operator = preconditioner_of(kind, COSTS[cost])
    rng = np.random.default_rng(5)
    for free in (ALL_CELLS, rng.random(ALL_CELLS.size) < 0.6):
        solve = operator.over(free, operator.cell_resistance)
        inverse = np.column_stack([solve(unit) for unit in np.eye(int(free.sum()))])
        # Sparse factors keep ten digits.
        assert_allclose(inverse, inverse.T, atol=1e-5 * np.abs(inverse).max())
        assert np.linalg.eigvalsh(inverse).min() > 0
        values = rng.standard_normal(int(free.sum()))
        assert_allclose(solve(values), inverse @ values, atol=1e-5 * np.abs(inverse).max())


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("kind", Preconditioner.__subclasses__(), ids=lambda kind: kind.__name__)
def test_conjugate_gradients_with_a_preconditioner_take_no_more_products(
    kind: type[Preconditioner], cost: str
) -> None:
    hessian = hessian_of(COSTS[cost])
    inverses = (
        preconditioner_of(kind, COSTS[cost]).over(ALL_CELLS, hessian.at.cell_resistance),
        lambda values: values,
    )
    preconditioned, plain = (
        steihaug(hessian.gauss_newton_product, inverse, hessian.gradient, 1e-6)
        for inverse in inverses
    )
    assert preconditioned.products <= plain.products


def test_the_distance_to_another_panel_is_infinite() -> None:
    operator = preconditioner(hessian_of(COSTS["plain"]), ALL_CELLS)
    assert operator.distance(operator.cell_resistance) == 0
    assert operator.distance(operator.cell_resistance * 2) == pytest.approx(np.log(2))
    assert operator.distance(np.ones((1, 3, 3))) == np.inf
    assert replace(operator).distance(operator.cell_resistance) == 0
