"""Deviation of an estimate whose products are in fixed point, as a processor without floats has.

python -m docs.studies.fixed_point [--frames 6] [--products 8]: frames of a load that moves over a
two-point panel, two steps of Gauss and Newton from the frame before.

Every vector and matrix has one exponent and mantissas of 16 (Q15) or 32 bits (Q31). Sums of
products have 64 bits. The optimum and the standard deviations are in double precision.
"""

import argparse
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array

CELL_OHM = 30_000.0
REFERENCE_OHM = 6000.0
SIGMA_SHARE = 0.38 / 4096  # of the supply: noise and rounding of 12 bits, four readings
PRIOR = 1.0  # 1/variance of ln of r over r at rest: log_ratio with the weight 1e-4
DEPTH = 1.5  # of the load, in ln r
RADIUS = 1.3  # of the load, in cells
MOTION = 0.5  # cells a frame
STEPS = 2
LARGEST_STEP = 2.0
SIDES = (10, 8)


@dataclass(frozen=True, eq=False)
class Block:
    """Numbers mantissa · 2^exponent with one exponent."""

    mantissa: NDArray[np.int64]
    exponent: int


@dataclass
class FixedPoint:
    """Arithmetic on arrays that are rounded to blocks of `bits` bits and a sign.

    bits : None stands for double precision.
    multiplications : number of those that were done.
    """

    bits: int | None
    multiplications: int = field(default=0)

    def rounded(self, values: Array) -> Array:
        """Return the values as the block holds them."""
        if self.bits is None:
            return values
        block = self._block(values)
        return np.ldexp(block.mantissa.astype(float), block.exponent)

    def times(self, first: Array, second: Array) -> Array:
        """Return first · second, element by element, rounded to a block."""
        self.multiplications += np.broadcast(first, second).size
        if self.bits is None:
            return np.asarray(first * second)
        a = self._block(np.asarray(first, float))
        b = self._block(np.asarray(second, float))
        return self._from_sum(a.mantissa * b.mantissa, a.exponent + b.exponent)

    def matrix_product(self, first: Array, second: Array) -> Array:
        """Return the matrix product of (m, k) and (k, n), rounded to a block."""
        self.multiplications += first.shape[0] * first.shape[1] * second.shape[1]
        if self.bits is None:
            return np.asarray(first @ second)
        a, b = self._block(first), self._block(second)
        guard = int(first.shape[1]).bit_length()  # Q31 products have 62 bits: room for their sum
        products = (a.mantissa[:, :, None] * b.mantissa[None, :, :]) >> guard
        return self._from_sum(products.sum(axis=1), a.exponent + b.exponent + guard)

    def dot(self, first: Array, second: Array) -> float:
        """Return the scalar product."""
        return float(self.matrix_product(first.reshape(1, -1), second.reshape(-1, 1))[0, 0])

    def plus(self, *values: Array) -> Array:
        """Return the sum, rounded to a block."""
        return self.rounded(np.asarray(sum(values)))

    def _block(self, values: Array) -> Block:
        assert self.bits is not None
        largest = float(np.max(np.abs(values), initial=0.0))
        if largest == 0:
            return Block(np.zeros(values.shape, np.int64), 0)
        exponent = int(np.frexp(largest)[1]) - self.bits
        mantissa = np.rint(np.ldexp(values, -exponent)).astype(np.int64)
        top = 2**self.bits - 1
        return Block(np.clip(mantissa, -top, top), exponent)

    def _from_sum(self, total: NDArray[np.int64], exponent: int) -> Array:
        assert self.bits is not None
        excess = max(0, int(np.max(np.abs(total))).bit_length() - self.bits)
        if excess:
            total = (total + (1 << (excess - 1))) >> excess
        return np.ldexp(total.astype(float), exponent + excess)


@dataclass(frozen=True, eq=False)
class Network:
    """Impedances of the lines for conductances (m, n), as the C library has them.

    Row sums `total` (m,), H = G/total `share` (m, n), S⁻¹ `inverse` (n, n), H·S⁻¹ `mutual` (m, n)
    and the rows' own impedances `own` (m,). The last column is at ground by a tie.
    """

    conductance: Array
    share: Array
    inverse: Array
    mutual: Array
    own: Array
    over_total: Array

    @classmethod
    def of(cls, conductance: Array, arithmetic: FixedPoint, solver: FixedPoint) -> "Network":
        """Solve with the arithmetic of the solver, and round the arrays to the other one."""
        total = conductance.sum(axis=1)
        share = solver.rounded(conductance / total[:, None])
        # The diagonal without subtraction, as in the library: what leads to ground, and the rest.
        schur = -solver.matrix_product(conductance.T, share)
        np.fill_diagonal(schur, 0.0)
        np.fill_diagonal(schur, -schur.sum(axis=1))
        schur[-1, -1] += conductance[:, -1].sum()
        schur = solver.rounded(schur)
        inverse = inverse_of(schur, solver)
        mutual = solver.matrix_product(share, inverse)
        own = solver.plus(1 / total, solver.times(share, mutual).sum(axis=1))
        arrays = (conductance, share, inverse, mutual, own, 1 / total)
        return cls(*(arithmetic.rounded(array) for array in arrays))

    def readings(self) -> Array:
        """Return the two-point resistances (m, n)."""
        return np.asarray(self.own[:, None] + np.diag(self.inverse) - 2 * self.mutual)

    def across(self, change: Array, fixed: FixedPoint) -> Array:
        """Return bᵀ·Z·L(change)·Z·b of all cells (m, n), L the Laplacian of (m, n) changes."""
        x_long, x_short = change.sum(axis=1), change.sum(axis=0)
        half = fixed.times(0.5 * x_long[:, None], self.share)
        y = fixed.plus(-change, half)
        c = fixed.matrix_product(self.share.T, y)
        c = fixed.plus(c, c.T, np.diag(x_short))
        short = np.diag(fixed.matrix_product(self.inverse, fixed.matrix_product(c, self.inverse)))
        q = fixed.times(self.over_total[:, None], fixed.plus(y, half))
        own = fixed.times(fixed.times(x_long, self.over_total), self.over_total)
        both = fixed.plus(q, fixed.matrix_product(self.mutual, c))
        parts = fixed.times(fixed.plus(q, both), self.mutual).sum(axis=1)
        long = fixed.plus(own, parts)
        between = fixed.matrix_product(both, self.inverse)
        return fixed.plus(long[:, None] + short - 2 * between)


@dataclass(frozen=True, eq=False)
class Frame:
    """Readings of a frame, their standard deviations, and ln of the cells at rest, (m, n) each."""

    reading: Array
    sigma: Array
    resting: Array


def inverse_of(matrix: Array, solver: FixedPoint) -> Array:
    """Return the inverse of a positive definite matrix by sweeps of Gauss and Jordan.

    The matrix is divided by its largest entry first, so that its inverse has the same block, and
    rounded after each sweep. A pivot that is lost gives NaN.
    """
    scale = np.max(matrix)
    inverse = matrix / scale
    for pivot in range(len(matrix)):
        if not inverse[pivot, pivot] > 0:
            return np.full_like(matrix, np.nan)
        over = 1 / inverse[pivot, pivot]
        row = over * inverse[pivot]
        column = inverse[:, pivot].copy()
        swept = inverse - solver.times(column[:, None], row[None, :])
        swept[pivot] = row
        swept[:, pivot] = -over * column
        swept[pivot, pivot] = over
        inverse = solver.rounded(swept)
    return np.asarray(inverse / scale)


def jacobian_of(u: Array) -> Array:
    """Return d reading/d u, (cells, cells), in double precision."""
    m, n = u.shape
    conductance = np.exp(-u)
    laplacian = np.zeros((m + n, m + n))
    laplacian[:m, m:] = -conductance
    laplacian += laplacian.T
    laplacian -= np.diag(laplacian.sum(axis=1))
    impedance = np.linalg.pinv(laplacian)
    row, column = np.divmod(np.arange(m * n), n)
    incidence = np.eye(m + n)[row] - np.eye(m + n)[m + column]
    return np.asarray((incidence @ impedance @ incidence.T) ** 2 * conductance.ravel())


def optimum(frame: Frame, start: Array) -> tuple[Array, Array]:
    """Return ln r at the optimum and its standard deviations, (m, n) each."""
    u = start
    double = FixedPoint(None)
    for _ in range(30):
        jacobian = jacobian_of(u) / frame.sigma.ravel()[:, None]
        off = (Network.of(np.exp(-u), double, double).readings() - frame.reading) / frame.sigma
        gradient = jacobian.T @ off.ravel() + PRIOR * (u - frame.resting).ravel()
        hessian = jacobian.T @ jacobian + PRIOR * np.eye(u.size)
        step = -np.linalg.solve(hessian, gradient)
        u = u + np.clip(step, -LARGEST_STEP, LARGEST_STEP).reshape(u.shape)
    return u, np.sqrt(np.diag(np.linalg.inv(hessian))).reshape(u.shape)


@dataclass(frozen=True, eq=False)
class Preconditioner:
    """M⁻¹ = D⁻¹ - D⁻¹·G·U·T·Uᵀ·G·D⁻¹ of the library: own responses, and those shared by lines."""

    inverse: Array
    drawn: Array
    lines: Array

    @classmethod
    def of(cls, u: Array, frame: Frame, arithmetic: FixedPoint) -> "Preconditioner":
        """Compute it in double precision, and round the arrays."""
        m, n = u.shape
        conductance = np.exp(-u)
        response = jacobian_of(u) / conductance.ravel()
        weight = 1 / frame.sigma.ravel() ** 2
        row, column = np.divmod(np.arange(u.size), n)
        shared = []
        for line in (row, column):
            neighbours = (line[:, None] == line) & ~np.eye(u.size, dtype=bool)
            along = neighbours * conductance.ravel()
            mean = np.sum(along * response, axis=1) / along.sum(axis=1)
            shared.append(np.bincount(line, weight * mean**2))
        own = (np.diag(response) * conductance.ravel()) ** 2 * weight + PRIOR
        drawn = conductance.ravel() / own
        incidence = np.hstack((np.eye(m)[row], np.eye(n)[column]))
        lines = np.diag(1 / np.concatenate(shared))
        lines += incidence.T @ ((conductance.ravel() * drawn)[:, None] * incidence)
        arrays = ((1 / own).reshape(u.shape), drawn.reshape(u.shape), np.linalg.inv(lines))
        return cls(*(arithmetic.rounded(array) for array in arrays))

    def times(self, r: Array, fixed: FixedPoint) -> Array:
        """Return M⁻¹·r, (m, n)."""
        drawn = fixed.times(self.drawn, r)
        sums = np.concatenate((drawn.sum(axis=1), drawn.sum(axis=0)))
        answer = fixed.matrix_product(self.lines, sums[:, None]).ravel()
        of_long, of_short = answer[: r.shape[0]], answer[r.shape[0] :]
        back = fixed.times(self.drawn, fixed.plus(of_long[:, None] + of_short))
        return fixed.plus(fixed.times(self.inverse, r), -back)


def estimate(frame: Frame, u: Array, products: int, fixed: FixedPoint, all_arrays: bool) -> Array:
    """Return ln r (m, n) after STEPS steps from u.

    all_arrays : the network's inverse, readings and gradients are in this arithmetic, too.
    """
    outside = fixed if all_arrays else FixedPoint(None)
    for _ in range(STEPS):
        exact = Network.of(np.exp(-u), outside, outside)
        off = (exact.readings() - frame.reading) / frame.sigma
        pull = exact.across(outside.rounded(off / frame.sigma), outside)
        gradient = outside.plus(outside.times(exact.conductance, pull), PRIOR * (u - frame.resting))
        step = conjugate_gradients(frame, u, -gradient, products, fixed, outside)
        u = u + np.clip(step, -LARGEST_STEP, LARGEST_STEP)
    return u


def conjugate_gradients(
    frame: Frame, u: Array, right: Array, products: int, fixed: FixedPoint, solver: FixedPoint
) -> Array:
    """Return x of (Jᵀ·W·J + prior)·x = right, (m, n), after some products.

    solver : arithmetic of the network's inverse.
    """
    network = Network.of(np.exp(-u), fixed, solver)
    preconditioner = Preconditioner.of(u, frame, fixed)
    weight = fixed.rounded(1 / frame.sigma**2)
    r = fixed.rounded(right)
    x = np.zeros_like(r)
    p = np.zeros_like(r)
    before = np.inf
    for _ in range(products):
        z = preconditioner.times(r, fixed)
        slope = fixed.dot(z, r)
        if not slope > 0:
            break
        p = fixed.plus(z, fixed.times(p, np.full_like(p, slope / before)))
        forward = network.across(fixed.times(network.conductance, p), fixed)
        back = network.across(fixed.times(weight, forward), fixed)
        q = fixed.plus(fixed.times(network.conductance, back), PRIOR * p)
        curvature = fixed.dot(p, q)
        if not curvature > 0:
            break
        length = slope / curvature
        x = fixed.plus(x, fixed.times(p, np.full_like(p, length)))
        r = fixed.plus(r, -fixed.times(q, np.full_like(q, length)))
        before = slope
    return x


def frames_of(side: int, count: int, rng: np.random.Generator) -> list[Frame]:
    """Return frames of a load that moves along a row."""
    resting = np.log(CELL_OHM) + 0.1 * rng.standard_normal((side, side))
    row, column = np.indices((side, side))
    frames = []
    for number in range(count):
        square = (row - 0.4 * side) ** 2 + (column - 0.4 * side - MOTION * number) ** 2
        u = resting - DEPTH * np.exp(-square / RADIUS**2)
        double = FixedPoint(None)
        ohm = Network.of(np.exp(-u), double, double).readings()
        share = ohm / (ohm + REFERENCE_OHM) + SIGMA_SHARE * rng.standard_normal(ohm.shape)
        reading = REFERENCE_OHM * share / (1 - share)
        frames.append(Frame(reading, SIGMA_SHARE * REFERENCE_OHM / (1 - share) ** 2, resting))
    return frames


def deviations(
    frames: list[Frame], products: int, fixed: FixedPoint, all_arrays: bool
) -> list[float]:
    """Return the rms deviation of each frame from its optimum, in standard deviations."""
    u = optimum(frames[0], frames[0].resting)[0]
    rms = []
    for frame in frames[1:]:
        u = estimate(frame, u, products, fixed, all_arrays)
        best, sigma = optimum(frame, u)
        rms.append(float(np.sqrt(np.mean(((u - best) / sigma) ** 2))))
    return rms


def main() -> None:
    """Print a row of the table for each panel and arithmetic."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--products", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("| panel | products | other work | median, σ | worst, σ | multiplications of a frame |")
    print("|---" * 6 + "|")
    for side in SIDES:
        frames = frames_of(side, options.frames + 1, np.random.default_rng(options.seed))
        for name, bits, all_arrays in (
            ("double precision", None, False),
            ("Q31", 31, False),
            ("Q31", 31, True),
            ("Q15", 15, False),
            ("Q15", 15, True),
        ):
            fixed = FixedPoint(bits)
            errors = deviations(frames, options.products, fixed, all_arrays)
            arithmetic = name if all_arrays else "double precision"
            count = fixed.multiplications / options.frames
            figures = f"{np.median(errors):.2g} | {max(errors):.2g} | {count:,.0f}"
            print(f"| {side} × {side} | {name} | {arithmetic} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
