"""The five methods as the paper writes and solves them: equations (11) to (24) by `lsqnonlin`.

Cost = Σ (f(r) − R_m)² + λ Σ penalty², r ≥ R_m and no upper bound. Baseline: for absolute methods by
itself; for relative ones together with the first frame, from where on every solution is the next
one's reference.

`lsqnonlin` is MATLAB's in kind: trust-region-reflective within bounds, and it stops where MATLAB's
defaults do. What it leaves is not always a minimum: where plain least squares has none, its answer
is where it stopped. Written from the published algorithm (Coleman and Li, SIAM J. Optim. 6, 1996;
Branch, Coleman and Li, SIAM J. Sci. Comput. 21, 1999) and the documented defaults: subspace of two
dimensions, tolerances 10⁻⁶, 100 evaluations for each unknown, derivatives by forward differences,
which cost as many evaluations as there are unknowns. Derivatives are exact here; they are charged.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from lampest.panel.network import SolvedNetwork
from lampest.panel.panel import Array, Panel, difference_matrix
from lampest.panel.readouts.floating import grounding

# MATLAB's defaults; evaluations for each unknown
TOLERANCE = 1e-6
EVALUATIONS = 100
ITERATIONS = 400
# Of the first trust region, in the unknowns' unit; it grows to REACH times the start's length.
RADIUS = 10.0
REACH = 100.0
Function = Callable[[Array], Array]


@dataclass(frozen=True)
class Weights:
    """λ of absolute penalties, of relative ones, and the start over R_m.

    Absolute penalties are of resistances in ohm, relative ones of changes in percent.
    """

    absolute: float = 1e-3
    relative: float = 10.0
    start: float = 1.0


@dataclass(frozen=True, eq=False)
class LeftBySolver:
    """Results of one method on a recording, where its solver stopped.

    baseline : (rows, columns) ohm. cells, model, measured : (frames, rows, columns) ohm.
    evaluations : (frames) solves of the forward problem that MATLAB would have needed, derivatives
    included. why : (frames) reason of the stop. joint : whether the first frame was solved together
    with the baseline.
    """

    baseline: Array
    cells: Array
    model: Array
    measured: Array
    evaluations: NDArray[np.int64]
    why: tuple[str, ...]
    joint: bool

    @property
    def change(self) -> Array:
        """100·(r/r₀ − 1), (frames, rows, columns) percent."""
        return np.asarray(100 * (self.cells / self.baseline - 1))

    @property
    def data_error(self) -> Array:
        """100·|f(r) − R_m|/R_m, (frames, rows, columns) percent."""
        return np.asarray(100 * np.abs(self.model - self.measured) / self.measured)


WEIGHTS = Weights(relative=1e-3, start=1.66)  # of the scene that was fitted to the paper's numbers


@dataclass(frozen=True, eq=False)
class Stopped:
    """Where the solver ended, after how many evaluations, and why.

    The reason is 'cost', 'step', 'gradient' or 'limit'.
    """

    point: Array
    evaluations: int
    why: str


@dataclass(frozen=True, eq=False)
class Quadratic:
    """q(s) = ½‖Js‖² + ½ sᵀdiag(c)s + gᵀs in scaled unknowns."""

    jacobian: Array
    curvature: Array
    gradient: Array

    def along(
        self, direction: Array, origin: Array, low: float, high: float
    ) -> tuple[float, Array]:
        """(least value, its step) of origin + t·direction with t between low and high."""
        image = self.jacobian @ direction
        shift = self.jacobian @ origin
        curvature = image @ image + direction @ (self.curvature * direction)
        slope = self.gradient @ direction + image @ shift + direction @ (self.curvature * origin)
        ends = [low, high] + (
            [float(np.clip(-slope / curvature, low, high))] if curvature > 0 else []
        )
        steps = [origin + t * direction for t in ends]
        values = [self.at(step) for step in steps]
        best = int(np.argmin(values))
        return values[best], steps[best]

    def at(self, step: Array) -> float:
        """q(s)."""
        image = self.jacobian @ step
        return float(0.5 * (image @ image + step @ (self.curvature * step)) + self.gradient @ step)


def lsqnonlin(residual: Function, jacobian: Function, start: Array, lower: Array) -> Stopped:
    """Minimise Σ residual² within point ≥ lower, until one of MATLAB's limits is met.

    The start is moved above `lower`.
    """
    point = np.maximum(start, lower + 1e-10 * np.maximum(1.0, np.abs(lower)))
    values = residual(point)
    slopes = jacobian(point)
    cost = float(values @ values)
    evaluations = 1 + len(point)
    radius = RADIUS
    largest = max(REACH * float(np.linalg.norm(point)), 1.0)
    length = np.inf
    change = np.inf
    ratio = 0.0
    for number in range(ITERATIONS):
        gradient = slopes.T @ values
        room = np.where(gradient >= 0, point - lower, 1.0)
        optimality = float(np.abs(room * gradient).max())
        why = _why(number, optimality, length, radius, ratio, change, cost)
        if why or evaluations >= EVALUATIONS * len(point):
            return Stopped(point, evaluations, why or "limit")
        scale = np.sqrt(room)
        model = Quadratic(slopes * scale, np.maximum(gradient, 0.0), scale * gradient)
        theta = max(0.95, 1 - optimality)
        expected, step = _step(model, point, scale, lower, radius, theta)
        trial = np.maximum(point + scale * step, np.nextafter(lower, np.inf))
        fresh = residual(trial)
        new = float(fresh @ fresh)
        evaluations = evaluations + 1
        length = float(np.linalg.norm(step))
        gained = 0.5 * (cost - new) - 0.5 * float(step @ (model.curvature * step))
        ratio = gained / -expected if expected < 0 else 0.0
        change = abs(cost - new)
        if ratio >= 0.75 and length >= 0.9 * radius:
            radius = min(largest, 2 * radius)
        elif ratio <= 0.25:
            radius = min(length / 4, radius / 4)
        if new < cost:
            point = trial
            values = fresh
            cost = new
            slopes = jacobian(trial)
            evaluations += len(point)
    return Stopped(point, evaluations, "limit")


def _why(
    number: int,
    optimality: float,
    length: float,
    radius: float,
    ratio: float,
    change: float,
    cost: float,
) -> str:
    """Which tolerance is met; empty where none is."""
    if optimality < TOLERANCE:
        return "gradient"
    if number and length < 0.9 * radius and ratio > 0.25 and change < TOLERANCE * (1 + cost):
        return "cost"
    return "step" if number and length < TOLERANCE else ""


def _step(
    model: Quadratic, point: Array, scale: Array, lower: Array, radius: float, theta: float
) -> tuple[float, Array]:
    """(value, step) in scaled unknowns.

    The step is the trust region's, cut at the bound, reflected there, or down the gradient.
    """
    step = _subspace_step(model, radius)
    if np.all(point + scale * step > lower):
        return model.at(step), step
    reach = _to_bound(point, scale * step, lower)
    hit = point + reach * scale * step <= lower + 1e-12 * np.abs(lower)
    cut = reach * step
    reflected = np.where(hit, -step, step)
    options = [(model.at(theta * cut), theta * cut)]
    on_bound = np.maximum(point + scale * cut, lower)
    far = min(
        theta * _to_bound(on_bound, scale * reflected, lower), _to_sphere(cut, reflected, radius)
    )
    near = (1 - theta) * reach
    if far > near:
        options.append(model.along(reflected, cut, near, far))
    downhill = -model.gradient
    far = min(
        theta * _to_bound(point, scale * downhill, lower), radius / float(np.linalg.norm(downhill))
    )
    options.append(model.along(downhill, np.zeros_like(step), 0.0, far))
    return min(options, key=lambda option: option[0])


def _subspace_step(model: Quadratic, radius: float) -> Array:
    """The least q within the radius in the plane of gradient and Gauss-Newton step."""
    matrix = model.jacobian.T @ model.jacobian + np.diag(model.curvature)
    floor = 1e-14 * np.trace(matrix) / len(matrix)
    newton = -np.linalg.solve(matrix + floor * np.eye(len(matrix)), model.gradient)
    basis = np.linalg.qr(np.stack([model.gradient, newton], axis=1))[0]
    curvatures, turn = np.linalg.eigh(basis.T @ matrix @ basis)
    slope = turn.T @ (basis.T @ model.gradient)
    curvatures = np.maximum(curvatures, 1e-300)
    if np.linalg.norm(slope / curvatures) <= radius:
        return np.asarray(-basis @ (turn @ (slope / curvatures)))
    most = float(np.linalg.norm(slope)) / radius
    shift = brentq(lambda mu: float(np.linalg.norm(slope / (curvatures + mu))) - radius, 0.0, most)
    return np.asarray(-basis @ (turn @ (slope / (curvatures + shift))))


def _to_bound(point: Array, direction: Array, lower: Array) -> float:
    """The largest t for which point + t·direction stays at or above the bound."""
    falling = direction < 0
    return float(np.min((lower - point)[falling] / direction[falling], initial=np.inf))


def _to_sphere(origin: Array, direction: Array, radius: float) -> float:
    """The t ≥ 0 at which origin + t·direction leaves a sphere about zero."""
    square = float(direction @ direction)
    mixed = float(origin @ direction)
    inside = max(mixed**2 - square * (float(origin @ origin) - radius**2), 0.0)
    return (inside**0.5 - mixed) / square if square > 0 else 0.0


# Name → what is penalised, and whether relatively to the frame before.
METHODS: dict[str, tuple[str, bool]] = {
    "LSM": ("", False),
    "LSR-CR": ("value", False),
    "LSR-dCR": ("value", True),
    "LSR-gCR": ("gradient", False),
    "LSR-gdCR": ("gradient", True),
}


def left_by_solver(
    method: str, panel: Panel, resting: Array, measured: Array, weights: Weights = WEIGHTS
) -> LeftBySolver:
    """Every frame in order.

    resting : (rows, columns), measured : (frames, rows, columns) ohm as recorded.
    """
    penalised, relative = METHODS[method]
    problem = _Problem(panel, _operator(penalised, panel), weights)
    frames = list(measured)
    if relative:
        baseline, first = problem.joint(resting, frames[0])
        ended = [first]
        for frame in frames[1:]:
            ended.append(problem.following(frame, ended[-1].point))
    else:
        baseline = problem.alone(resting).point
        ended = [problem.alone(frame) for frame in frames]
    cells = np.stack([record.point.reshape(panel.shape) for record in ended])
    model = np.stack(
        [
            _network(record.point, frame).reading()
            for record, frame in zip(ended, frames, strict=True)
        ]
    )
    counts = np.array([record.evaluations for record in ended])
    why = tuple(record.why for record in ended)
    return LeftBySolver(
        baseline.reshape(panel.shape), cells, model, measured, counts, why, relative
    )


def _operator(penalised: str, panel: Panel) -> Array | None:
    """Return the matrix of the penalty, which acts on a vector of cells."""
    if penalised == "gradient":
        down = np.kron(difference_matrix(panel.rows), np.eye(panel.columns))
        return np.vstack([down, np.kron(np.eye(panel.rows), difference_matrix(panel.columns))])
    return np.eye(panel.crossings) if penalised else None


@dataclass(frozen=True, eq=False)
class _Problem:
    """Costs and where their minimisation stopped.

    operator : (penalties, cells), None without a penalty.
    """

    panel: Panel
    operator: Array | None
    weights: Weights

    def alone(self, measured: Array) -> Stopped:
        """(11), (13), (19)."""
        factor = np.sqrt(self.weights.absolute)
        rows = (
            np.zeros((0, self.panel.crossings)) if self.operator is None else factor * self.operator
        )

        def residual(cells: Array) -> Array:
            return np.concatenate([_misfit(cells, measured), rows @ cells])

        def jacobian(cells: Array) -> Array:
            return np.vstack([_slopes(cells, measured), rows])

        return self._minimised(residual, jacobian, measured.ravel())

    def following(self, measured: Array, before: Array) -> Stopped:
        """(17), (23): relative to the solution before, which is also where it starts."""
        rows = self._relative_rows()

        def residual(cells: Array) -> Array:
            return np.concatenate([_misfit(cells, measured), rows @ (cells / before - 1)])

        def jacobian(cells: Array) -> Array:
            return np.vstack([_slopes(cells, measured), rows / before])

        return lsqnonlin(residual, jacobian, np.maximum(before, measured.ravel()), measured.ravel())

    def joint(self, resting: Array, measured: Array) -> tuple[Array, Stopped]:
        """Solve (15), (21): the baseline, and the first frame with the effort of both."""
        rows = self._relative_rows()
        count = self.panel.crossings
        none = np.zeros((count, count))

        def residual(both: Array) -> Array:
            baseline = both[:count]
            cells = both[count:]
            return np.concatenate(
                [
                    _misfit(baseline, resting),
                    _misfit(cells, measured),
                    rows @ (cells / baseline - 1),
                ]
            )

        def jacobian(both: Array) -> Array:
            baseline = both[:count]
            cells = both[count:]
            return np.block(
                [
                    [_slopes(baseline, resting), none],
                    [none, _slopes(cells, measured)],
                    [-rows * (cells / baseline**2), rows / baseline],
                ]
            )

        ended = self._minimised(
            residual, jacobian, np.concatenate([resting.ravel(), measured.ravel()])
        )
        return ended.point[:count], Stopped(ended.point[count:], 2 * ended.evaluations, ended.why)

    def _minimised(self, residual: Function, jacobian: Function, lower: Array) -> Stopped:
        return lsqnonlin(residual, jacobian, self.weights.start * lower, lower)

    def _relative_rows(self) -> Array:
        assert self.operator is not None
        return np.asarray(100 * np.sqrt(self.weights.relative) * self.operator)


def _network(cells: Array, measured: Array) -> SolvedNetwork:
    return SolvedNetwork.floating(1 / cells.reshape(measured.shape), grounding(measured))


def _misfit(cells: Array, measured: Array) -> Array:
    return np.asarray((_network(cells, measured).reading() - measured).ravel())


def _slopes(cells: Array, measured: Array) -> Array:
    """∂f/∂r, (readings, cells)."""
    return np.asarray(_network(cells, measured).sensitivity() / cells)
