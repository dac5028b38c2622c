"""Cells that explain the readings of one frame, or of two with few moved cells, under a circuit; no estimator is asked.

A frame has as many cells as readings, so that a misfit remains only where cells would have to be negative. Over the
cone g ≥ 0 it is χ² with as many degrees of freedom as cells stand at the cone, and smaller where the truth lies inside
(Shapiro, Biometrika 72, 1985: chi-bar-squared). Two frames say more: under the right circuit the cells that no load
touches stand still. The cells that must have moved for the rest to stand still are counted, each at the same price.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import Misfit
from lampest.estimate.estimator import Bounds, Estimator
from lampest.estimate.rivals import Question, Rival
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.interval import chi_square_tail
from lampest.recording.readings import Readings
from lampest.solvers.multistart import BROKEN, best_solution, convex, evaluated, solved_from
from lampest.solvers.solution import Settings

LEVEL = 1e-4  # P(χ²) below which cells do not explain a frame: of each of a handful of tests
EXACT = 1e-2  # χ² that changes no verdict
FIT = LevenbergMarquardt(evaluations=16, settled=EXACT / 2, share=0.1, damping=0.0, longest=1.5)
# Cells at the edge of r > 0 take some 20 iterations, a circuit that cannot explain its readings hundreds.
BRIEF = Settings(max_iterations=25)
EDGE = 1e-3  # of the least cell of estimates: a short behind a drive resistor of a kilo-ohm is smaller
HOPELESS = 10.0  # χ² for each reading that noise at the edge of r > 0 never leaves
MOST_CELLS = 400  # where matrices over the cells take tens of milliseconds; beyond, every reading counts as a degree
SPREAD = 0.01  # 1/variance of log r: a cell that no reading sees may be anything within e^±10

# −2 log probability, per cell that is said to move: what a cell gains at random is χ² of one degree, and the largest of
# 400 such exceeds 12 in one case of five.
PRICE = 12.0
TOGETHER = 0.05  # of log r: by so much all cells may change with temperature
# −2 log probability by which another circuit, or an effect beside it, must beat the scene's: e^18 to one. The best of
# eight kinds, with any resistance in series, beat a right one by 32, 25 and 19 in three of some 430 recordings, else by
# 15 or less.
MARGIN = 36.0
MOST_ASKED = 3  # rivals or effects: those that linear theory finds best
CREEP = 3e-3  # of log r, by which films creep on their own in seconds
JOINT = replace(FIT, evaluations=60, settled=0.05, share=0.0)
UNIT, SECANT = 0.1, 1e-4  # of the largest resistance in series: what a step of log r by 1 is to it, and differences


@cache
def cells_alone() -> Estimator:
    """Plain least squares over r > 0; made when it is asked for, because installed methods are looked for then."""
    return Estimator((Misfit(weighting="noise"),), "reduced", bounds=Bounds("none", "none"), error_bars=False)


def mostly_still(moved: NDArray[np.bool_]) -> bool:
    """Whether more than half of the cells are where they were."""
    return 2 * int(moved.sum()) < moved.size


@dataclass(frozen=True, eq=False, kw_only=True)
class CellsFit(SumOfSquares):
    """Of one frame over log r; its Jacobian has no columns on panels of more than MOST_CELLS.

    readings : (rows, columns). cells : the same shape, ohm.
    """

    readings: Readings
    cells: Array
    ridge: float = SPREAD

    @classmethod
    def of(cls, scene: Scene, readings: Readings, near: Array | None, patient: bool) -> "CellsFit | None":
        """argmin Σ ((f(r) − y)/σ)² over r > 0; see `fitted`."""
        alone = cells_alone()
        data = alone.data(readings.alone(), Background(scene))
        data = replace(data, lower=EDGE * data.lower)
        found = cls.near(data, readings, convex(data, None)[0] if near is None else near)
        if found.chi_square <= EXACT:
            return found
        if not patient and found.chi_square > HOPELESS * readings.value.size:
            return None
        solver = (alone if patient else replace(alone, solver=BRIEF)).problem(scene, 1, float("inf"), data.partial)
        solution = (
            best_solution(solver, data, None)
            if patient
            else solved_from(solver, evaluated(solver.cost, data, found.cells[None]))
        )
        return cls.at(data, readings, solution.at.networks[0]) if solution.solved and solution.at is not None else None

    @classmethod
    def near(cls, data: Data, readings: Readings, start: Array) -> "CellsFit":
        """The least squares that the loop reaches from cells; on panels too large for it, the start itself."""
        bounds = (data.log_bounds[0].ravel(), data.log_bounds[1].ravel())
        position = np.clip(np.log(start).ravel(), *bounds)

        def model(position: Array) -> CellsFit:
            return cls.at(data, readings, data.network(0, np.exp(position).reshape(start.shape)))

        if start.size > MOST_CELLS:
            return model(position)
        return FIT.minimum(model, position, bounds, ended=lambda fit, _: fit.chi_square <= EXACT).at

    @classmethod
    def at(cls, data: Data, readings: Readings, network: Network) -> "CellsFit":
        """What a solved network leaves of the readings."""
        residual, weight = _residual(network, readings)
        jacobian = np.zeros((residual.size, 0))
        if readings.value.size <= MOST_CELLS:
            jacobian = network.sensitivity() * weight.reshape(-1, 1) * (data.lower < data.upper).ravel()
        return cls(residual=residual.ravel(), jacobian=jacobian, readings=readings, cells=network.cell_resistance)

    @property
    def small(self) -> bool:
        """Whether the panel has no more than MOST_CELLS."""
        return bool(self.jacobian.size)

    @property
    def chi_square(self) -> float:
        """Σ residual²."""
        return 2 * self.cost

    @cached_property
    def degrees(self) -> float:
        """Readings less what the cells can follow; at least 1."""
        return max(float(np.sum(self.readings.seen)) - _followed(self.normal), 1.0)

    @property
    def tail(self) -> float:
        """P(χ² of so many degrees is as large)."""
        return float(chi_square_tail(self.chi_square, self.degrees))

    def worst_line(self) -> str:
        """'row 3 holds 62 % of it': the line with most of the misfit."""
        squares = self.residual.reshape(self.cells.shape) ** 2
        rows, columns = squares.sum(axis=1), squares.sum(axis=0)
        name, lines = ("row", rows) if rows.max() >= columns.max() else ("column", columns)
        return f"{name} {int(np.argmax(lines))} holds {100 * lines.max() / squares.sum():.0f} % of it"


def fitted(scene: Scene, readings: Readings, near: Array | None = None, patient: bool = False) -> CellsFit | None:
    """The fit of one frame; None where it is not reached, or arithmetic breaks down.

    near : cells (rows, columns) ohm to begin at; None: the readout's start. patient : every start is tried, else a few
    iterations must do.
    """
    try:
        with np.errstate(all="ignore"):
            return CellsFit.of(scene, readings, near, patient)
    except BROKEN:
        return None


def _residual(network: Network, readings: Readings) -> tuple[Array, Array]:
    """((y − y_measured)/σ, 1/σ), both (rows, columns): 0 where nothing was read, or a bound is kept."""
    assert readings.sigma is not None
    missed = (network.reading() - readings.value) / readings.sigma
    counted = (readings.seen > 0) & ((readings.side == 0) | (readings.side * missed < 0))
    return np.where(counted, missed, 0.0), np.where(counted, 1 / readings.sigma, 0.0)


def _followed(normal: Array) -> float:
    """Σ s²/(1 + s²) over the singular values s of J/σ: how many numbers of the noise the unknowns follow."""
    seen = np.linalg.eigvalsh(normal) - SPREAD
    return float(np.sum(seen / (1 + seen)))


@dataclass(frozen=True, eq=False)
class JointFit:
    """argmin χ² of an unloaded panel and a frame while only some cells have moved, beside a factor common to all.

    rival : the circuit. question : what it is to explain. most : the largest resistance in series, ohm, where that is
    free; else 0. pair : the readings of both frames. position : log r of each (2, cells). moved : (cells). series :
    d residual/d(resistance in series over UNIT of the largest one), where the fit began.
    """

    rival: Rival
    question: Question
    most: float
    pair: tuple[Readings, ...]
    position: Array
    moved: NDArray[np.bool_]
    series: Array | None = None

    @classmethod
    def of(
        cls, rival: Rival, question: Question, cells: tuple[Array, ...], moved: NDArray[np.bool_], most: float = 0.0
    ) -> "JointFit":
        """The circuit's best explanation of both frames; moved cells are chosen anew until the score no longer falls.

        cells : where to begin, (rows, columns) ohm of both frames. moved : the cells that moved, to begin with.
        """
        position, pair = np.log([one.ravel() for one in cells]), question.readings(rival)
        best = cls(rival, question, most, pair, position, moved.ravel()).tied()
        while not np.array_equal(moved := best.chosen_anew(), best.moved):
            found = replace(best, moved=moved).tied()
            if not found.score < best.score:
                break
            best = found
        return best

    def with_series(self, most: float) -> "JointFit":
        """The same with the resistance in series that explains best, up to `most` ohm, begun at what the scene says."""
        rival = self.rival.with_series(self.rival.scene.specified_in_series)
        cells = tuple(np.exp(one).reshape(self.pair[0].value.shape) for one in self.position)
        return JointFit.of(rival, self.question, cells, self.moved, most)

    def tied(self) -> "JointFit":
        """The least χ² while all but the moved cells keep what they were, beside a common factor.

        It begins where linear theory says that to tie them costs least: the gap is closed by a step of both frames.
        """
        here, place = replace(self, series=self._secant()), len(self.moved) + 1
        change = self.position[1] - self.position[0]
        gap = np.where(self.moved, 0.0, change - self._factor)
        step = _solved(here.squares.jacobian, here.slopes[1] @ gap - here.residual)
        step *= min(1.0, FIT.longest / max(float(np.abs(step).max()), 1e-300))
        begun = replace(here, position=np.stack([self.position[0], self.position[1] - gap])).stepped(step)
        low, high = np.full((2, len(step)), [[-np.inf], [np.inf]])
        if self.most:
            at = begun.rival.ohm / (UNIT * self.most)
            low[place], high[place] = -at, 1 / UNIT - at
        found = JOINT.minimum(lambda step: begun.stepped(step).squares, np.zeros(len(step)), (low, high))
        return begun.stepped(found.position)

    def stepped(self, step: Array) -> "JointFit":
        """The fit a step of its unknowns further; see `squares`."""
        size = len(self.moved)
        position = self.position + step[:size]
        position[1] += step[size]
        position[1, self.moved] += step[size + 1 + bool(self.most) :]
        if not self.most:
            return replace(self, position=position)
        ohm = self.rival.ohm + UNIT * self.most * float(step[size + 1])
        return replace(self._with_ohm(float(np.clip(ohm, 0.0, self.most))), position=position)

    def _with_ohm(self, ohm: float) -> "JointFit":
        rival = self.rival.with_series(ohm)
        return replace(self, rival=rival, pair=self.question.readings(rival))

    def _secant(self) -> Array | None:
        if not self.most:
            return None
        step = SECANT * self.most * (1 if self.rival.ohm < self.most / 2 else -1)
        return (self._with_ohm(self.rival.ohm + step).residual - self.residual) * (UNIT * self.most / step)

    @cached_property
    def _networks(self) -> list[Network]:
        scene, shape = self.rival.scene, self.pair[0].value.shape
        pairs = zip(self.pair, np.exp(self.position), strict=True)
        return [
            scene.circuit.network(cells.reshape(shape), scene.circuit.ties(readings.value), scene.wiring)
            for readings, cells in pairs
        ]

    @cached_property
    def residual(self) -> Array:
        """(y − y_measured)/σ of both frames, (2·cells)."""
        pairs = zip(self._networks, self.pair, strict=True)
        return np.concatenate([_residual(*one)[0].ravel() for one in pairs])

    @cached_property
    def slopes(self) -> tuple[Array, Array]:
        """Derivatives of the residual by log r of the unloaded panel, and of the frame; each (2·cells, cells)."""
        pairs = zip(self._networks, self.pair, strict=True)
        resting, frame = (one[0].sensitivity() * _residual(*one)[1].reshape(-1, 1) for one in pairs)
        none = np.zeros_like(resting)
        return np.concatenate([resting, none]), np.concatenate([none, frame])

    @cached_property
    def squares(self) -> SumOfSquares:
        """Over what is common, and what the moved cells changed beside it."""
        jacobian = np.column_stack([self._common, self.slopes[1][:, self.moved]])
        return SumOfSquares(self.residual, jacobian, SPREAD)

    @property
    def chi_square(self) -> float:
        """Σ residual²."""
        return 2 * self.squares.cost

    @property
    def count(self) -> int:
        """How many cells have moved."""
        return int(self.moved.sum())

    @property
    def score(self) -> float:
        """χ², and what moved cells, readings taken for bounds and another resistance in series cost."""
        bounds = sum(int(readings.bounds.sum()) for readings in self.pair)
        return self.chi_square + PRICE * (self.count + bounds + (self.rival.in_series is not None))

    @cached_property
    def expected(self) -> float:
        """χ² of mere noise; at least 1. Cells at the edge of r > 0 follow none of it."""
        followed = _followed(self.squares.normal)
        return max(float(sum(readings.plain.sum() for readings in self.pair)) - followed, 1.0)

    @property
    def beyond_noise(self) -> float:
        """The score without what noise alone would leave."""
        return self.score - self.expected

    @property
    def excess(self) -> float:
        """χ² over that of mere noise, at least 1: by how much films that creep exceed the noise, for one."""
        return max(self.chi_square / self.expected, 1.0)

    def chosen_anew(self) -> NDArray[np.bool_]:
        """Which cells must have moved (cells), by linear theory about this fit: all changes free, and priced."""
        wanted = np.column_stack([self.slopes[1], self.residual])
        left = wanted - self._common @ _solved(self._common, wanted)
        precision = SumOfSquares(left[:, -1], left[:, :-1], SPREAD).normal
        change = self.position[1] - self.position[0] - self._factor
        return selected(precision @ change - left[:, :-1].T @ left[:, -1], precision)[1]

    @property
    def _factor(self) -> float:
        """log of what all cells that did not move changed by."""
        change = self.position[1] - self.position[0]
        return float(np.median(change if self.moved.all() else change[~self.moved]))

    @cached_property
    def _common(self) -> Array:
        """d residual/d(log r of both frames, the factor, the resistance in series where that is free)."""
        resting, frame = self.slopes
        return np.column_stack([resting + frame, frame.sum(axis=1), *([] if self.series is None else [self.series])])


def _solved(matrix: Array, wanted: Array) -> Array:
    """argmin |matrix·x − wanted|² + SPREAD·|x|²."""
    normal = matrix.T @ matrix + SPREAD * np.eye(matrix.shape[1])
    return np.asarray(np.linalg.solve(normal, matrix.T @ wanted))


def moved_score(resting: CellsFit, frame: CellsFit) -> tuple[float, NDArray[np.bool_]]:
    """(min over sets S of χ²(the cells outside S stand still) + PRICE·|S| + log det, S) of two fits of one circuit.

    The change of all cells together (temperature, supply) is taken off. log det is that of the covariance of the change
    against the frame's own: −2 log density of the frame's readings, so that a circuit gains nothing by being blind.
    """
    change = np.log(frame.cells / resting.cells).ravel()
    change = change - np.median(change)
    together = np.linalg.inv(frame.normal) + np.linalg.inv(resting.normal)
    least, found = float(np.linalg.slogdet(frame.normal)[1]), []
    for creep in (0.0, CREEP):
        covariance = together + creep**2 * np.eye(len(change))
        precision = np.linalg.inv(covariance)
        gained, moved = _swept(precision @ change, precision, 1)
        chi_square = float(change @ precision @ change) - gained
        score = chi_square + PRICE * int(moved.sum()) + float(np.linalg.slogdet(covariance)[1]) + least
        found.append((score, moved.reshape(resting.cells.shape)))
    return min(found, key=lambda one: one[0])


def selected(slope: Array, precision: Array, briefly: bool = False) -> tuple[float, NDArray[np.bool_]]:
    """(what is lost, cells that must have moved) of changes d with −2 log density dᵀ·precision·d − 2 slope·d.

    briefly : cells are added one after the other; else none stays that is not needed, from both ends.
    """
    gained, added = _swept(slope, precision, 1)
    if briefly:
        return PRICE * int(added.sum()) - gained, added
    found = []
    for begun in (added, np.ones(len(slope), dtype=bool)):
        free, moved = np.flatnonzero(begun), np.zeros(len(slope), dtype=bool)
        covariance = np.linalg.inv(precision[np.ix_(free, free)])
        change = covariance @ slope[free]
        lost, tied = _swept(change, covariance, -1)
        moved[free[~tied]] = True
        found.append((PRICE * int(moved.sum()) + lost - float(slope[free] @ change), moved))
    return min(found, key=lambda one: one[0])


def _swept(vector: Array, matrix: Array, sign: int) -> tuple[float, NDArray[np.bool_]]:
    """(Σ v²/M, which) of cells taken one after the other: the largest down to PRICE (sign 1), or the least up to it."""
    total, taken = 0.0, np.zeros(len(vector), dtype=bool)
    while not taken.all():
        size = vector**2 / np.maximum(np.diag(matrix), 1e-300)
        cell = int(np.argmax(np.where(taken, -np.inf, sign * size)))
        if sign * (size[cell] - PRICE) < 0:
            break
        total, taken[cell] = total + float(size[cell]), True
        column = matrix[:, cell] / matrix[cell, cell]
        vector, matrix = vector - column * vector[cell], matrix - np.outer(column, matrix[cell])
    return total, taken
