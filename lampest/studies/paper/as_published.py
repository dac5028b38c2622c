"""The five methods as the paper writes and solves them: equations (11) to (24), left where `lsqnonlin` stops.

Cost = Σ (f(r) − R_m)² + λ Σ penalty², r ≥ R_m and no upper bound. Baseline: for absolute methods by itself; for
relative ones together with the first frame, from where on every solution is the next one's reference.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.panel.panel import Array, Panel
from lampest.panel.readouts.two_point.floating import FloatingNetwork, grounding
from lampest.studies.paper.lsqnonlin import Function, Stopped, lsqnonlin

METHODS: Mapping[str, tuple[str, bool]] = {  # name → what is penalised, and whether relatively to the frame before
    "LSM": ("", False),
    "LSR-CR": ("value", False),
    "LSR-dCR": ("value", True),
    "LSR-gCR": ("gradient", False),
    "LSR-gdCR": ("gradient", True),
}


@dataclass(frozen=True)
class Weights:
    """λ of absolute penalties (resistances in ohm), of relative ones (changes in percent), and the start over R_m."""

    absolute: float = 1e-3
    relative: float = 10.0
    start: float = 1.0


@dataclass(frozen=True, eq=False)
class LeftBySolver:
    """What one method leaves of a recording.

    baseline : (rows, columns) ohm. cells, model, measured : (frames, rows, columns) ohm. evaluations : (frames) solves
    of the forward problem that MATLAB would have needed, derivatives included. why : (frames) what ended it.
    joint : whether the first frame was solved together with the baseline.
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


def left_by_solver(method: str, panel: Panel, resting: Array, measured: Array, weights: Weights) -> LeftBySolver:
    """Every frame in order; resting : (rows, columns), measured : (frames, rows, columns) ohm as recorded."""
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
    cells = np.stack([one.point.reshape(panel.shape) for one in ended])
    model = np.stack([_network(one.point, frame).reading() for one, frame in zip(ended, frames, strict=True)])
    counts = np.array([one.evaluations for one in ended])
    why = tuple(one.why for one in ended)
    return LeftBySolver(baseline.reshape(panel.shape), cells, model, measured, counts, why, relative)


def _operator(penalised: str, panel: Panel) -> Array | None:
    """What the penalty takes of a vector of cells."""
    if penalised == "gradient":
        down = np.kron(panel.row_gradient(), np.eye(panel.columns))
        return np.vstack([down, np.kron(np.eye(panel.rows), panel.column_gradient())])
    return np.eye(panel.cells) if penalised else None


@dataclass(frozen=True, eq=False)
class _Problem:
    """Costs and where their minimisation stopped; operator : (penalties, cells), None without a penalty."""

    panel: Panel
    operator: Array | None
    weights: Weights

    def alone(self, measured: Array) -> Stopped:
        """(11), (13), (19)."""
        factor = np.sqrt(self.weights.absolute)
        rows = np.zeros((0, self.panel.cells)) if self.operator is None else factor * self.operator

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
        """(15), (21): the baseline, and the first frame with what both needed."""
        rows, count = self._relative_rows(), self.panel.cells
        none = np.zeros((count, count))

        def residual(both: Array) -> Array:
            rest, cells = both[:count], both[count:]
            return np.concatenate([_misfit(rest, resting), _misfit(cells, measured), rows @ (cells / rest - 1)])

        def jacobian(both: Array) -> Array:
            rest, cells = both[:count], both[count:]
            return np.block(
                [
                    [_slopes(rest, resting), none],
                    [none, _slopes(cells, measured)],
                    [-rows * (cells / rest**2), rows / rest],
                ]
            )

        ended = self._minimised(residual, jacobian, np.concatenate([resting.ravel(), measured.ravel()]))
        return ended.point[:count], Stopped(ended.point[count:], 2 * ended.evaluations, ended.why)

    def _minimised(self, residual: Function, jacobian: Function, lower: Array) -> Stopped:
        return lsqnonlin(residual, jacobian, self.weights.start * lower, lower)

    def _relative_rows(self) -> Array:
        assert self.operator is not None
        return np.asarray(100 * np.sqrt(self.weights.relative) * self.operator)


def _network(cells: Array, measured: Array) -> FloatingNetwork:
    return FloatingNetwork.solve(1 / cells.reshape(measured.shape), grounding(measured))


def _misfit(cells: Array, measured: Array) -> Array:
    return np.asarray((_network(cells, measured).reading() - measured).ravel())


def _slopes(cells: Array, measured: Array) -> Array:
    """∂f/∂r, (readings, cells)."""
    return np.asarray(_network(cells, measured).sensitivity() / cells)
