"""Whether a point is a strict local minimum, cell by cell: what one more Newton step would do there, and what bends.

With g and H the first and second derivatives of the cost φ in u = log r over the cells that no bound holds, a Newton
step is s = −H⁻¹ g and its decrement δ = √(gᵀ H⁻¹ g). Where cost/s₀² stands for −2·log probability, √2·s₀·√(H⁻¹)_cc is
the posterior deviation of u_c, so that δ/(√2·s₀) bounds |s_c| over it for all cells at once (Cauchy and Schwarz). No
scale of the cost enters, and no large reading hides a small one.
Source: Nocedal & Wright, Numerical Optimization, 2006, theorem 2.4; Boyd & Vandenberghe, Convex Optimization, 2004,
section 9.5 (the decrement).
"""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lampest.cost.problem import Evaluation
from lampest.panel.conjugate import DENSE_UNKNOWNS, Linear, conjugate_gradients
from lampest.panel.panel import Array
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.directions import Factor, preconditioner
from lampest.solvers.newton.downhill import downhill
from lampest.solvers.newton.kinks import Kinks, Straight, standing
from lampest.solvers.newton.pair import FramePair
from lampest.solvers.newton.squares import ORTHOGONAL_UNKNOWNS, Squares

MILLIONTH = 1e-6  # of a cell: what a verified estimate may still move by where the noise is not known
SHARE = 1e-3  # of a cell's posterior deviation: the same where it is
NEARBY = 0.01  # of log r: second derivatives change by about as much, and a predicted step with them
NOTHING = 1e-10  # of the cost's scale: four digits below what a verified cost may be off by
LEVEL = 1e-6  # of the cost's scale: the gradient of a verified cost
REPRODUCED = 1e-5  # of a reading: what second derivatives of readings add to JᵀΩJ is no larger part of it
SOLVED = 0.3  # of log r: so near within the bounds, cells that reproduce all readings are what the cost asks for
REPRODUCED_UNKNOWNS = 1024  # cells, up to which a solve with J is asked for where no noise says what may be off
ACCURACY = 0.1  # of a predicted step on large panels
SURE = 1e-3  # of what squares of residuals bend
UNSEEN = 1e-14  # of the cost's scale, over a change of one in log r: what no digit of the cost itself would show
ROUNDING = 1e-11  # of the matrix with a unit diagonal: what differences of impedances leave of 16 digits


class Bend(Enum):
    """What second derivatives say."""

    UP = "a strict minimum"
    FLAT = "no digit of double precision tells whether the cost rises"
    DOWN = "the cost falls"


@dataclass(frozen=True, eq=False)
class Certificate:
    """bend : of the cost over the free cells. step : (cells) of log r by which a Newton step would move each, within
    its bounds. decrement : δ = √(gᵀ H⁻¹ g). deviations : δ/(√2·s₀), s₀² = ½ mean ∂²φ/∂y² σ² over the readings that
    count: what |s_c| is at most of its cell's posterior deviation; infinite where the noise is not known, or where the
    step is a millionth without that. curvature : where second derivatives were asked for. left : of the gradient in
    directions that no digit tells from flat ones, its largest entry; infinite where nobody asked.
    """

    bend: Bend
    step: Array
    decrement: float
    deviations: float
    curvature: Curvature | None = None
    left: float = float("inf")

    @classmethod
    def at(cls, curvature: Curvature, bend: Bend, step: Array, decrement: float) -> "Certificate":
        """Of a step from where second derivatives are known."""
        short = float(np.abs(step).max(initial=0.0)) <= MILLIONTH
        deviations = float("inf") if short or bend is not Bend.UP else _deviations(curvature, decrement)
        return cls(bend, step, decrement, deviations, curvature)

    @property
    def settled(self) -> bool:
        """Whether a strict minimum is so near that no cell would notice."""
        if self.bend is not Bend.UP:
            return False
        return float(np.abs(self.step).max(initial=0.0)) <= MILLIONTH or self.deviations <= SHARE

    def converged(self, cost_scale: float) -> bool:
        """Whether one more step moves no cell by a millionth and lowers the cost by no more than its own rounding.

        A gradient may be far from small there: of a penalty that outweighs the data by 10⁸ it is rounding, and the
        curvature that multiplies the rounding divides it again in the step. On a plateau it must be small across it.
        """
        small = float(np.abs(self.step).max(initial=0.0)) <= MILLIONTH
        known = self.bend is Bend.UP or (self.bend is Bend.FLAT and self.left <= LEVEL * cost_scale)
        return small and known and self.decrement**2 <= NOTHING * cost_scale


def _deviations(curvature: Curvature, decrement: float) -> float:
    data = curvature.at.data
    bend = curvature.terms.diagonal()[data.measured.size :]
    counting = bend > 0
    if not (data.noise_known and counting.any()):
        return float("inf")
    return decrement / float(np.sqrt(np.mean(bend[counting] * data.sigma.ravel()[counting] ** 2)))


def free_cells(at: Evaluation, gradient: Array) -> NDArray[np.bool_]:
    """(cells) those that have room and are not pressed against a bound by the gradient, flat."""
    lower, upper = (bound.ravel() for bound in at.data.log_bounds)
    position = at.position.ravel()
    free: NDArray[np.bool_] = (lower < upper) & ~(
        ((position <= lower) & (gradient > 0)) | ((position >= upper) & (gradient < 0))
    )
    return free


def certificate(curvature: Curvature, gradient: Array, factor: Factor | None = None) -> Certificate:
    """Of a point with the gradient g (cells): from its second derivatives, or from a factor taken near enough."""
    if (exact := _of_reproduced(curvature)) is not None:
        return exact
    free = np.flatnonzero(free_cells(curvature.at, gradient))
    if not len(free):
        return Certificate(Bend.UP, np.zeros(len(gradient)), 0.0, 0.0)
    if isinstance(curvature.smoothing, Straight) and len(curvature.smoothing.dual):
        kinks = Kinks.of(curvature, standing(curvature.at, curvature.smoothing.dual), free)
        return at_kinks(curvature, gradient, free, kinks)
    if factor is not None and factor.solid and factor.serves(free, curvature.at.cell_resistance, NEARBY):
        bend, step = Bend.UP, factor.solve(-gradient[free])
    elif curvature.factored:
        bend, step, _ = _by_factorisation(curvature, gradient[free], free)
        if bend is not Bend.UP and (finer := _by_squares(curvature, free)) is not None:
            return finer
    else:
        bend, step = _by_conjugate_gradients(curvature, gradient[free], free, factor)
    decrement = float(np.sqrt(max(-float(gradient[free] @ step), 0.0)))
    return Certificate.at(curvature, bend, _within_bounds(curvature.at, free, step), decrement)


def _of_reproduced(curvature: Curvature) -> Certificate | None:
    """Where nothing but the readings enters and every one is reproduced, φ is nearly zero, its least: s = −J⁻¹ e.

    e : how far each reading is off, relative. J alone has the digits that H = JᵀΩJ loses. Where no noise is known, nor
    is it what a reading may be off by: then also where cells nearby reproduce them all. None elsewhere.
    """
    if not all(term.reads_measurement for term in curvature.at.cost.terms) or not curvature.only_misfit:
        return None
    bend, reading = curvature.terms.diagonal()[curvature.at.reading.size :], curvature.at.reading.ravel()
    if not np.all(bend > 0):
        return None
    missed = curvature.by_reading.ravel() / bend / reading
    known, close = curvature.at.data.noise_known, float(np.abs(missed).max()) <= REPRODUCED
    if len(reading) > (DENSE_UNKNOWNS if known else REPRODUCED_UNKNOWNS) or (known and not close):
        return None
    sensitivity = curvature.at.networks[0].sensitivity() / reading[:, None]
    _, _, step, singular = lapack.dgesv(sensitivity, -missed)
    if singular or not np.all(np.isfinite(step)):
        return Certificate.at(curvature, Bend.FLAT, np.zeros(len(reading)), np.inf) if close else None
    inside = _within_bounds(curvature.at, np.arange(len(step)), step)
    if not close and (float(np.abs(step).max()) > SOLVED or not np.array_equal(inside, step)):
        return None
    decrement = float(np.sqrt(np.sum(bend * (missed * reading) ** 2)))
    return Certificate.at(curvature, Bend.UP, inside, decrement)


def at_kinks(curvature: Curvature, gradient: Array, free: NDArray[np.intp], kinks: Kinks) -> Certificate:
    """Where rows of absolute losses stay at their kink: over moves that keep them there, after one that brings them.

    Along all others the cost has a corner. What seems to bend down may be the last bits of heavy rows.
    """
    along = kinks.along
    matrix, slope = kinks.reduced(curvature.matrix[np.ix_(free, free)], gradient[free])
    usual = np.einsum("ij,i,ij->j", along, _usual_bend(curvature)[free], along)
    bend, part, left = _bent(matrix, slope, ROUNDING * usual)
    if bend is Bend.DOWN:
        towards = np.zeros(len(gradient))
        towards[free] = along @ np.linalg.eigh(matrix)[1][:, 0]
        bend = bend if downhill(curvature.at, towards) is not None else Bend.FLAT
    decrement = float(np.sqrt(max(-float(slope @ part), 0.0)))
    step = _within_bounds(curvature.at, free, kinks.back + along @ part)
    return replace(Certificate.at(curvature, bend, step, decrement), left=left)


def _by_factorisation(curvature: Curvature, slope: Array, free: NDArray[np.intp]) -> tuple[Bend, Array, float]:
    matrix = curvature.matrix[np.ix_(free, free)]
    return _bent(matrix, slope, ROUNDING * _usual_bend(curvature)[free])


def _bent(matrix: Array, slope: Array, least: Array) -> tuple[Bend, Array, float]:
    """(how the cost bends, Newton's step, what it leaves of the gradient); where the matrix cannot be factored, the
    step leaves out what is flat.
    """
    if not len(slope):
        return Bend.UP, slope, 0.0
    size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), least))
    unit = matrix / size[:, None] / size
    if not np.all(np.isfinite(unit)):
        return Bend.FLAT, np.full(len(slope), np.inf), np.inf
    if np.all(np.diag(matrix) > least):
        triangle, step, failed = lapack.dposv(unit, -slope / size)
        if not failed and clear_of_rounding(triangle, unit):
            return Bend.UP, step / size, 0.0
    values, vectors = np.linalg.eigh(unit)
    solid = values > ROUNDING
    part = vectors.T @ (slope / size)
    step = -vectors[:, solid] @ (part[solid] / values[solid]) / size
    left = float(np.abs(size * (vectors[:, ~solid] @ part[~solid])).max(initial=0.0))
    return Bend.DOWN if values[0] < -ROUNDING else Bend.FLAT, step, left


def _by_squares(curvature: Curvature, free: NDArray[np.intp]) -> Certificate | None:
    """From residuals' first derivatives, which have twice the digits; None where those do not suffice or φ falls."""
    if len(free) > ORTHOGONAL_UNKNOWNS:
        return None
    found = Squares.of(curvature, free).newton(curvature.matrix[np.ix_(free, free)])
    if found is None or not found[0] > max(found[1], SURE):
        return None
    _, _, step, decrement = found
    return Certificate.at(curvature, Bend.UP, _within_bounds(curvature.at, free, step), decrement)


def clear_of_rounding(triangle: Array, unit: Array) -> bool:
    """Whether 1/‖H⁻¹‖₁ of H = UᵀU with a unit diagonal is more than rounding.

    It is at most the smallest eigenvalue and at least 1/√n of that, while rounding may leave every pivot positive.
    Estimated in five solves (Higham, Accuracy and Stability of Numerical Algorithms, 2002, section 15.3).
    """
    norm = float(np.abs(unit).sum(axis=0).max())
    reciprocal, _ = lapack.dpocon(triangle, norm)
    return bool(reciprocal * norm > ROUNDING)


def _usual_bend(curvature: Curvature) -> Array:
    """(cells) what a cell's reading alone would make the cost bend, were it read as the others are."""
    response = np.concatenate([network.own_response().ravel() for network in curvature.at.networks])
    bend = curvature.terms.diagonal()[response.size :]
    return np.asarray(np.median(bend[bend > 0]) * response**2 if np.any(bend > 0) else np.ones_like(response))


def _by_conjugate_gradients(
    curvature: Curvature, slope: Array, free: NDArray[np.intp], kept: Factor | None
) -> tuple[Bend, Array]:
    whole = np.zeros(curvature.at.cell_resistance.size)
    image, precondition = _images(curvature, free, kept)

    def product(search: Array) -> Array:
        whole[free] = search
        return image(whole)[free]

    step, downhill = conjugate_gradients(product, precondition, -slope, ACCURACY)
    if downhill is None:
        return Bend.UP, step
    size, bend = np.abs(curvature.local.diagonal()[free]), float(downhill @ product(downhill))
    unseen = UNSEEN * curvature.at.cost_scale * float(np.abs(downhill).max()) ** 2
    flat = bend > -max(ROUNDING * float(downhill @ (size * downhill)), unseen)
    return Bend.FLAT if flat else Bend.DOWN, step


def _images(curvature: Curvature, free: NDArray[np.intp], kept: Factor | None) -> tuple[Linear, Linear]:
    """Second derivatives, and what conjugate gradients are preconditioned with; of two frames in their ratios, which at
    an optimum bend as log r does.
    """
    if not curvature.paired:
        return curvature.product, preconditioner(curvature, free, kept).over(free)
    moving = np.isin(np.arange(curvature.at.cell_resistance.size), free)
    pair = FramePair(curvature, moving)
    return pair.product, pair.inverse(np.zeros(len(moving)))


def _within_bounds(at: Evaluation, free: NDArray[np.intp], step: Array) -> Array:
    """(cells) the step as far as bounds let it."""
    position = at.position.ravel()
    target = position.copy()
    target[free] += step
    lower, upper = (bound.ravel() for bound in at.data.log_bounds)
    return np.asarray(np.minimum(np.maximum(target, lower), upper) - position)
