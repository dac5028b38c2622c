"""Newton directions: (∇²φ + μ·diag) s = −∇φ on the free cells, by Cholesky or by conjugate gradients."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from lampest.panel.conjugate import Linear, conjugate_gradients
from lampest.panel.panel import Array
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.local import local_inverse
from lampest.solvers.newton.pair import FramePair
from lampest.solvers.newton.reach import within_reach
from lampest.solvers.newton.rough import Rough
from lampest.solvers.newton.softest import softest

LEAST_SIZE, LEAST_DAMPING = 1e-3, 1e-3
REACH, TINY = 2.5, 0.1  # changes of log r
FLAT = 1e-9  # of a diagonal: differences of impedances leave 11 digits of a matrix, factorising it some fewer
FOLLOWED = 0.5  # of log r: frames in sequence differ by less in most cells, and what they bend by alike


@dataclass(frozen=True, eq=False)
class Factor:
    """(∇²φ)⁻¹ over some cells, and where it was taken: cell_resistance (frames, rows, columns) ohm.

    solve : of a vector over these cells. triangle : U with ∇²φ = UᵀU, where it is exact; else it is what conjugate
    gradients are preconditioned with.
    """

    cells: NDArray[np.intp]
    cell_resistance: Array
    solve: Linear
    triangle: Array | None = None

    @property
    def exact(self) -> bool:
        """Whether it is by Cholesky."""
        return self.triangle is not None

    @cached_property
    def solid(self) -> bool:
        """Whether no pivot U_ii² is so small a part of ∂²φ/∂u_i² = Σ_k U_ki² that rounding may have made it."""
        if self.triangle is None:
            return False
        upper = self.triangle
        whole = np.einsum("ki,ki,ki->i", upper, upper, _above(len(upper)))
        return bool(np.all(np.diag(upper) ** 2 > FLAT * whole))

    @cached_property
    def softest(self) -> Array | None:
        """(cells) the direction in which the cost bends far less than in any other, length one; None without such."""
        return softest(self.solve, len(self.cells)) if self.exact and len(self.cells) > 1 else None

    def serves(self, free: NDArray[np.intp], cell_resistance: Array, reach: float) -> bool:
        """Whether it is of the same cells, none of which has moved by more than `reach` in log r since."""
        return np.array_equal(free, self.cells) and self.near(cell_resistance, reach)

    def near(self, cell_resistance: Array, reach: float) -> bool:
        """Whether no cell has moved by more than `reach` in log r since."""
        same = cell_resistance.shape == self.cell_resistance.shape
        return same and bool(np.abs(np.log(cell_resistance / self.cell_resistance)).max() <= reach)

    def over(self, free: NDArray[np.intp]) -> Linear:
        """The part between free cells of an inverse over more cells, which conjugate gradients take as well."""
        if len(free) == len(self.cells):
            return self.solve
        whole = np.zeros(self.cell_resistance.size)

        def solve(values: Array) -> Array:
            whole[free] = values
            part: Array = self.solve(whole)[free]
            return part

        return solve


@lru_cache(maxsize=8)
def _above(size: int) -> Array:
    """Ones on the diagonal and above; what a factor leaves below is anything."""
    return np.triu(np.ones((size, size)))


@dataclass(frozen=True, eq=False)
class Direction:
    """step : (cells) of log r. damping : with which it was made. factor : where nothing was added to ∇²φ."""

    step: Array
    damping: float
    factor: Factor | None = None


def direction(
    curvature: Curvature,
    free: NDArray[np.bool_],
    known: Array,
    damping: float,
    accuracy: float,
    kept: Factor | None = None,
) -> Direction:
    """`known` at cells that are not free, a Newton step at the others given that.

    The damping is raised where the matrix is not positive definite, unless that leaves no step worth the name.
    accuracy : relative residual at which conjugate gradients stop. kept : an earlier factor; as their preconditioner it
    need not be exact.
    """
    slope = curvature.gradient + (curvature.product(known) if known.any() else 0.0)
    chosen = np.flatnonzero(free)
    if len(chosen) == 0:
        return Direction(known, damping)
    if curvature.factored:
        found = _by_factorisation(curvature, chosen, slope[chosen], damping)
    elif curvature.paired:
        found = _of_pair(FramePair(curvature, free), chosen, slope[chosen], damping, accuracy)
    else:
        found = _by_conjugate_gradients(curvature, chosen, slope[chosen], damping, accuracy, kept)
    step = known.copy()
    step[chosen] = found.step
    return replace(found, step=step)


def _by_factorisation(curvature: Curvature, free: NDArray[np.intp], slope: Array, damping: float) -> Direction:
    matrix = curvature.matrix if len(free) == len(curvature.gradient) else curvature.matrix[np.ix_(free, free)]
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(slope))):
        return Direction(np.zeros_like(slope), damping)
    size = _at_least(np.abs(np.diag(matrix)), LEAST_SIZE)
    failed, used = 1, damping
    while failed:
        shifted = matrix.copy()
        shifted.flat[:: len(size) + 1] += used * size
        triangle, step, failed = lapack.dposv(shifted.T, -slope, overwrite_a=True)
        used = raised(used) if failed else used
    # A shift in proportion to the diagonal may forbid every step along a faint negative curvature.
    if used and np.abs(step).max() < TINY and (used > damping or bends_down(matrix, size)):
        return Direction(within_reach(matrix, slope, REACH / (1 + damping / LEAST_DAMPING)), damping)
    solve: Linear = lambda right: lapack.dpotrs(triangle, right)[0]  # noqa: E731
    return Direction(step, used, None if used else Factor(free, curvature.at.cell_resistance, solve, triangle))


def bends_down(matrix: Array, size: Array) -> bool:
    """Whether the cost falls along some direction, by more than rounding makes a flat one seem to."""
    return bool(lapack.dpotrf((matrix + np.diag(FLAT * size)).T)[1])


def _by_conjugate_gradients(
    curvature: Curvature, free: NDArray[np.intp], slope: Array, damping: float, accuracy: float, kept: Factor | None
) -> Direction:
    """Where the curvature turns negative the step is extended along that direction to a change of one in log r."""
    shift: Array = np.zeros(len(curvature.gradient))
    if damping:
        shift = damping * _at_least(np.abs(curvature.local.diagonal()), 1e-6)
    whole = np.zeros(len(shift))

    def product(search: Array) -> Array:
        whole[free] = search
        image = curvature.product(whole)[free]
        return image + shift[free] * search if damping else image

    factor = None if damping else preconditioner(curvature, free, kept)
    precondition = _damped_inverse(curvature, shift, free) if factor is None else factor.over(free)
    step, downhill = conjugate_gradients(product, precondition, -slope, accuracy)
    if downhill is None:
        return Direction(step, damping, None if damping else factor)
    reach = max(1 / (1 + damping) - np.abs(step).max(), 0)
    return Direction(step + downhill * reach / np.abs(downhill).max(initial=1e-300), raised(damping), factor)


def _of_pair(pair: FramePair, free: NDArray[np.intp], slope: Array, damping: float, accuracy: float) -> Direction:
    """Of two large frames; where second derivatives bend down, by squares, with as much damping as makes these firm."""
    whole = np.zeros(pair.free.size)

    def solved(image: Linear) -> tuple[Array, Array | None]:
        shift = damping * _at_least(np.abs(pair.size), 1e-6)

        def product(search: Array) -> Array:
            whole[free] = search
            return np.asarray((image(whole) + shift * whole)[free])

        return conjugate_gradients(product, pair.inverse(shift), -slope, accuracy)

    step, downhill = solved(pair.product)
    damping = damping if downhill is None else max(damping, LEAST_DAMPING)
    while downhill is not None:
        step, downhill = solved(pair.squares)
        damping = damping if downhill is None else raised(damping)
    whole[:] = 0
    whole[free] = step
    return Direction(np.clip(pair.change(whole)[free], -REACH, REACH), damping)


def preconditioner(curvature: Curvature, free: NDArray[np.intp], kept: Factor | None = None) -> Factor:
    """For ∇²φ over the free cells or over all: one that was kept while it serves, else a new one.

    Absolute losses stiffen where cells hardly move; theirs is always new.
    """
    cells = curvature.at.cell_resistance
    if curvature.only_misfit:
        return Factor(free, cells, misfit_inverse(curvature, free, np.zeros(cells.size)))
    if kept is not None and not kept.exact and kept.near(cells, FOLLOWED) and not len(curvature.at.cost.slope):
        return kept
    everything = np.arange(cells.size)
    rough = Rough.of(curvature, curvature.bent_up, lined=True)
    return Factor(everything, cells, rough.over(everything, cells.ravel()))


def raised(damping: float) -> float:
    """The next larger damping."""
    return max(4 * damping, LEAST_DAMPING)


def _damped_inverse(curvature: Curvature, shift: Array, free: NDArray[np.intp]) -> Linear:
    if curvature.only_misfit:
        return misfit_inverse(curvature, free, shift)
    return local_inverse(curvature.local, shift, free)


def misfit_inverse(curvature: Curvature, free: NDArray[np.intp], diagonal: Array) -> Linear:
    """(Jᵀ W J + diag(c))⁻¹ as the network approximates it, on the free cells of one frame; diagonal : c (cells)."""
    shape = curvature.at.cell_resistance.shape[1:]
    weight = _at_least(curvature.terms.diagonal()[diagonal.size :], 1e-6)
    moving = np.zeros(diagonal.size, dtype=bool)
    moving[free] = True
    inverse = curvature.at.networks[0].normal_inverse(
        weight.reshape(shape), diagonal.reshape(shape), moving.reshape(shape)
    )

    def solve(values: Array) -> Array:
        whole = np.zeros(diagonal.size)
        whole[free] = values
        return inverse(whole.reshape(shape)).ravel()[free]

    return solve


def _at_least(values: Array, share: float) -> Array:
    """The values, none below that share of the largest."""
    floor: Array = np.maximum(values, share * values.max(initial=1e-300))
    return floor
