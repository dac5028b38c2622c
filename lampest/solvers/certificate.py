"""Second-order certificate of a local minimum: a Newton step, and the definiteness of the Hessian.

With g and H of the cost in u = log r over the free cells, a Newton step is s = −H⁻¹ g, its
decrement δ = √(gᵀ H⁻¹ g). Where cost/s₀² is −2·log probability, δ/(√2·s₀) bounds |s_c| over the
posterior deviation of u_c (Cauchy and Schwarz).
Source: Nocedal & Wright, Numerical Optimization, 2006, theorem 2.4; Boyd & Vandenberghe, Convex
Optimization, 2004, section 9.5 (the decrement).
"""

from dataclasses import dataclass, replace
from enum import Enum
from math import inf
from typing import Any

import numpy as np
from scipy.linalg import lapack

from lampest.cost.problem import Evaluation
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.trust_region import DENSE_CELLS, MAX_DENSE, restricted, steihaug
from lampest.solvers.bounds import MILLIONTH, free_cells, lower_along, within_bounds
from lampest.solvers.hessian import Hessian
from lampest.solvers.preconditioners import Cholesky, Preconditioner, TwoLevel

# Of a cell's posterior standard deviation: allowed length of the remaining Newton step where the
# noise is known.
DEVIATION_SHARE = 1e-3
# Fraction of the cost's scale, four digits below the error that a verified cost may have.
MIN_COST_SHARE = 1e-10
# Relative misfit; second derivatives of readings add no larger part to JᵀWJ.
MAX_RELATIVE_MISFIT = 1e-5
# Distance in log r within which cells that reproduce all readings are the same minimum.
MAX_DISTANCE = 0.3
ACCURACY = 0.1  # of a predicted step on large panels
# Fraction of the cost's scale over a change of one in log r, below any digit of the cost.
MIN_CURVATURE = 1e-14
ROUNDING = 1e-11  # rounding error of a matrix with a unit diagonal, after differences of impedances


class Definiteness(Enum):
    """Definiteness of ∇²φ over the free cells."""

    POSITIVE = "a strict minimum"
    UNDETERMINED = "double precision does not show whether the cost rises"
    INDEFINITE = "the cost falls"


@dataclass(frozen=True, eq=False)
class Certificate:
    """Second-order certificate of a point.

    Attributes
    ----------
    definiteness : Definiteness
        Definiteness of ∇²φ over the free cells.
    step : array, shape (cells,)
        Newton step of log r, clipped to the bounds.
    decrement : float
        δ = √(gᵀ H⁻¹ g).
    deviations : float
        δ/(√2·s₀), s₀² = ½ mean ∂²φ/∂y² σ² over the readings with curvature: an upper bound of |s_c|
        over the posterior standard deviation of its cell. Infinite if the noise is not known, or if
        the step is at most a millionth.
    undetermined_slope : float
        Largest entry of the gradient in undetermined directions; infinite if it was not computed.
    factor : Cholesky or None
        Cholesky factor of ∇²φ, if the certificate was made by one.
    lower : Evaluation or None
        A point of lower cost next to a saddle.
    """

    definiteness: Definiteness
    step: Array
    decrement: float
    deviations: float = inf
    undetermined_slope: float = inf
    factor: Cholesky | None = None
    lower: Evaluation | None = None

    @classmethod
    def of(
        cls,
        hessian: Hessian,
        kind: Definiteness,
        free: Numbers,
        part: Array,
        decrement: float | None = None,
        **more: Any,
    ) -> "Certificate":
        """Return the certificate for a Newton step `part` of the `free` cells (numbers).

        If decrement is None, it is computed.
        """
        step = within_bounds(hessian.at, free, part)
        data = hessian.at.data
        if decrement is None:
            # δ² = gᵀ H⁻¹ g = −gᵀs
            decrement = float(np.sqrt(np.maximum(-hessian.gradient[free] @ part, 0.0)))
        point = cls(kind, step, decrement, **more)
        curved = hessian.curvature > 0
        if kind is Definiteness.POSITIVE and not point.short and data.noise_known and curved.any():
            # √2·s₀ = √(mean ∂²φ/∂y² σ²)
            spread = (hessian.curvature * data.sigma.ravel() ** 2)[curved]
            return replace(point, deviations=decrement / float(np.sqrt(np.mean(spread))))
        return point

    @property
    def settled(self) -> bool:
        """Whether the point is a strict minimum within a tolerance.

        The tolerance of the Newton step is a millionth of log r, or DEVIATION_SHARE of a posterior
        deviation.
        """
        if self.definiteness is not Definiteness.POSITIVE:
            return False
        return self.short or self.deviations <= DEVIATION_SHARE

    @property
    def short(self) -> bool:
        """Whether the Newton step moves no cell by more than a millionth."""
        return float(np.abs(self.step).max(initial=0.0)) <= MILLIONTH

    def after(self, hessian: Hessian) -> "Certificate":
        """Return the certificate of a nearby point, computed with the factor of this one.

        Second derivatives hardly differ between the two points.
        """
        assert self.factor is not None
        free = self.factor.cells
        part = self.factor.solve(-hessian.gradient[free])
        return Certificate.of(hessian, self.definiteness, free, part, factor=self.factor)

    def converged(self, cost_scale: float) -> bool:
        """Return whether one more Newton step hardly changes cells and cost.

        Such a step moves no cell by a millionth and lowers the cost by at most its rounding. The
        test replaces that of the gradient for penalties that outweigh the data by 10⁸: their
        gradient is rounding, but the Newton step, divided by their curvature, is small.
        """
        undetermined = self.definiteness is Definiteness.UNDETERMINED
        flat = undetermined and self.undetermined_slope <= MILLIONTH * cost_scale
        no_descent = self.definiteness is Definiteness.POSITIVE or flat
        return self.short and no_descent and self.decrement**2 <= MIN_COST_SHARE * cost_scale


def certificate(hessian: Hessian, preconditioner: Preconditioner | None = None) -> Certificate:
    """Return the certificate of a point.

    `preconditioner` serves the conjugate gradients of large problems.
    """
    # Plain least squares whose readings are all reproduced; if the noise is not known, cells nearby
    # that reproduce them suffice.
    missed = _relative_residuals(hessian)
    if missed is not None and (not hessian.at.data.noise_known or _close(missed)):
        of_reproduced = toward_readings(hessian)
        if of_reproduced is not None:
            return of_reproduced
    free = free_cells(hessian.at, hessian.gradient)
    chosen = np.flatnonzero(free)
    if not len(chosen):
        return Certificate(Definiteness.POSITIVE, np.zeros(len(free)), 0.0)
    if not hessian.dense:
        return _by_conjugate_gradients(hessian, free, preconditioner)
    return _by_factorisation(hessian, chosen)


def toward_readings(hessian: Hessian) -> Certificate | None:
    """Return the certificate of plain least squares by cells that reproduce all readings, or None.

    The cost there is nearly zero, its least value, and the Newton step is s = −J⁻¹ e with the
    relative residuals e of the readings. J alone keeps digits that H = JᵀWJ loses. Cells that do
    not reproduce the readings yet must lie within MAX_DISTANCE of those that do.
    """
    missed = _relative_residuals(hessian)
    most = DENSE_CELLS if hessian.at.data.noise_known else MAX_DENSE
    if missed is None or len(missed) > most:
        return None
    reading = hessian.at.reading.ravel()
    sensitivity = hessian.at.networks[0].sensitivity() / reading[:, None]
    cells = np.arange(len(reading))
    _, _, step, singular = lapack.dgesv(sensitivity, -missed)
    if singular or not np.all(np.isfinite(step)):
        if not _close(missed):
            return None
        return Certificate.of(hessian, Definiteness.UNDETERMINED, cells, 0 * missed, np.inf)
    beyond = np.abs(within_bounds(hessian.at, cells, step) - step).max()
    far = np.abs(step).max() > MAX_DISTANCE or beyond > MAX_RELATIVE_MISFIT
    if far and not _close(missed):
        return None
    # δ² = eᵀ (WY²) e with the weights W = ∂²φ/∂y² and the readings Y
    decrement = float(np.sqrt(np.sum(hessian.curvature * (missed * reading) ** 2)))
    return Certificate.of(hessian, Definiteness.POSITIVE, cells, step, decrement)


def _relative_residuals(hessian: Hessian) -> Array | None:
    """Return e = (∂φ/∂y)/(∂²φ/∂y²)/y of each reading; None unless all are of least squares."""
    if not all(term.reads_measurement for term in hessian.at.cost.terms) or not hessian.only_data:
        return None
    curvature = hessian.curvature
    if not np.all(curvature > 0):
        return None
    return hessian.by_reading.ravel() / curvature / hessian.at.reading.ravel()


def _close(missed: Array) -> bool:
    """Return whether relative residuals are those of readings that are reproduced."""
    return float(np.abs(missed).max()) <= MAX_RELATIVE_MISFIT


def _confirmed(
    hessian: Hessian, definiteness: Definiteness, free: Numbers, along: Array
) -> tuple[Definiteness, Evaluation | None]:
    """Return INDEFINITE only if the cost falls along the direction of the free cells.

    The point where it does is returned, too.
    """
    if definiteness is not Definiteness.INDEFINITE:
        return definiteness, None
    direction = np.zeros(len(hessian.gradient))
    direction[free] = along
    lower = lower_along(hessian.at, direction)
    return (definiteness if lower else Definiteness.UNDETERMINED), lower


def _by_factorisation(hessian: Hessian, free: Numbers) -> Certificate:
    """Return the certificate by a Cholesky factor; where that fails, by eigenvectors."""
    matrix = hessian.matrix[np.ix_(free, free)]
    slope = hessian.gradient[free]
    # Usual curvature from a cell's own reading: the median weight of the readings times J_cc²
    weight = hessian.curvature[hessian.curvature > 0]
    usual = np.ones(len(hessian.own_response))
    if len(weight):
        usual = np.median(weight) * hessian.own_response**2
    least = ROUNDING * usual[free]
    factor = None
    if np.all(matrix.diagonal() > least):
        factor = Cholesky.of(hessian.cells, free, matrix)
    if factor is not None and clear_of_rounding(factor.triangle, factor.norm):
        part = factor.solve(-slope)
        return Certificate.of(hessian, Definiteness.POSITIVE, free, part, factor=factor)
    modes = Modes.of(matrix, least)
    if modes is None:
        beyond = np.full(len(slope), np.inf)
        return Certificate.of(hessian, Definiteness.UNDETERMINED, free, beyond, factor=factor)
    lowest = modes.vectors[:, 0] / modes.size
    definiteness, lower = _confirmed(hessian, modes.definiteness, free, lowest)
    return Certificate.of(
        hessian,
        definiteness,
        free,
        modes.step(slope),
        undetermined_slope=float(np.abs(modes.undetermined(slope)).max(initial=0.0)),
        factor=factor,
        lower=lower,
    )


@dataclass(frozen=True, eq=False)
class Modes:
    """Eigenvectors of a Hessian H = D B D, scaled to a unit diagonal of B = V diag(λ) Vᵀ.

    Attributes
    ----------
    size : array, shape (n,)
        D, the square roots of the diagonal.
    values : array, shape (n,)
        λ, ascending.
    vectors : array, shape (n, n)
        V.
    """

    size: Array
    values: Array
    vectors: Array

    @classmethod
    def of(cls, matrix: Array, least: Array) -> "Modes | None":
        """Return the modes of a Hessian, (n, n), or None where it is beyond double precision.

        `least`, (n,), are the smallest diagonal entries that are above rounding.
        """
        size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), least))
        unit = matrix / size[:, None] / size
        if not np.all(np.isfinite(unit)):
            return None
        return cls(size, *np.linalg.eigh(unit))

    @property
    def solid(self) -> Mask:
        """Whether an eigenvalue is positive beyond rounding, (n,)."""
        return self.values > ROUNDING

    @property
    def definiteness(self) -> Definiteness:
        """Definiteness of the Hessian; positive where there is no direction."""
        if np.any(self.values < -ROUNDING):
            return Definiteness.INDEFINITE
        return Definiteness.POSITIVE if self.solid.all() else Definiteness.UNDETERMINED

    def step(self, slope: Array) -> Array:
        """Return −H⁺ g over the solid modes, s = −D⁻¹ V λ⁻¹ Vᵀ D⁻¹ g.

        `slope` is g, (n,), or several, (n, m).
        """
        vectors = self.vectors[:, self.solid] / self.size[:, None]
        return -vectors @ ((vectors.T @ slope).T / self.values[self.solid]).T

    def undetermined(self, slope: Array) -> Array:
        """Return the part of a gradient along the other modes, (n,)."""
        vectors = self.vectors[:, ~self.solid]
        return self.size * (vectors @ (vectors.T @ (slope / self.size)))


def clear_of_rounding(triangle: Array, norm: float) -> bool:
    """Return whether a matrix H = UᵀU with a unit diagonal is positive definite beyond rounding.

    The criterion is 1/‖H⁻¹‖₁ > ROUNDING, because rounding may leave every pivot positive.
    `triangle` is U, `norm` is ‖H‖₁. Source: Higham, Accuracy and Stability of Numerical Algorithms,
    2002, section 15.3.
    """
    # dpocon returns the reciprocal condition number 1/(‖H‖₁ ‖H⁻¹‖₁).
    return bool(lapack.dpocon(triangle, norm)[0] * norm > ROUNDING)


def _by_conjugate_gradients(
    hessian: Hessian, free: Mask, preconditioner: Preconditioner | None
) -> Certificate:
    """Return the certificate by conjugate gradients.

    UNDETERMINED if these cannot take a first step.
    """
    chosen = np.flatnonzero(free)
    slope = hessian.gradient[chosen]
    product = restricted(hessian.product, chosen, free.size)
    precondition = (preconditioner or TwoLevel.of(hessian)).over(free, hessian.cells)
    solved = steihaug(product, precondition, slope, ACCURACY)
    moved = bool(solved.products) or not slope.any()
    definiteness = Definiteness.POSITIVE if moved else Definiteness.UNDETERMINED
    if solved.negative:
        # Negative curvature counts only beyond its rounding error.
        along = solved.step / (np.abs(solved.step).max() or 1.0)
        curvature = float(along @ product(along))
        size = hessian.diagonal[chosen]
        of_products = ROUNDING * float(along @ (size * along))
        rounding = max(of_products, MIN_CURVATURE * hessian.at.cost_scale)
        beyond = curvature <= -rounding
        definiteness = Definiteness.INDEFINITE if beyond else Definiteness.UNDETERMINED
    definiteness, lower = _confirmed(hessian, definiteness, chosen, solved.step)
    return Certificate.of(hessian, definiteness, chosen, solved.step, lower=lower)
