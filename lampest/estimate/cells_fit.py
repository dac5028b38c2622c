"""Cells that explain the readings of one frame, or of two with few moved cells, under a circuit; no estimator is asked.

A frame has as many cells as readings, so that a misfit remains only where cells would have to be negative. Over the
cone g ≥ 0 it is χ² with as many degrees of freedom as cells stand at the cone, and smaller where the truth lies inside
(Shapiro, Biometrika 72, 1985: chi-bar-squared). Two frames say more: under the right circuit the cells that no load
touches stand still. The cells that must have moved for the rest to stand still are counted, each at the same price.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.cost.given import Background
from lampest.cost.problem import Data
from lampest.cost.terms import Misfit
from lampest.estimate.changed_cells import MOVED_COST, PARAMETER_COST, select_changed, usual_starts
from lampest.estimate.estimator import Bounds, Estimator
from lampest.estimate.rivals import Question, Rival
from lampest.estimate.state import UNKNOWN_SD
from lampest.panel.effects import Effect, with_effects
from lampest.panel.least_squares import LevenbergMarquardt, SumOfSquares
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.interval import chi_square_tail
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings
from lampest.solvers.multistart import BROKEN, best_solution, convex, evaluated, solved_from
from lampest.solvers.solution import Settings

EXACT_CHI_SQUARE = 1e-2  # χ² that changes no verdict
FIT = LevenbergMarquardt(evaluations=16, settled=EXACT_CHI_SQUARE / 2, share=0.1, damping=0.0, longest=1.5)
# Cells at the edge of r > 0 take some 20 iterations, a circuit that cannot explain its readings hundreds.
BRIEF = Settings(max_iterations=25)
MIN_CELL_FACTOR = 1e-3  # of the least cell of estimates: a short behind a drive resistor of a kilo-ohm is smaller
# χ² for each reading that noise at the edge of r > 0 never leaves; without it checks take four times longer.
MAX_CHI_SQUARE = 10.0
CELL_PRECISION = UNKNOWN_SD**-2  # a cell that no reading sees may be anything within e^±10
SERIES_UNIT = 0.1  # of the largest resistance in series: what a step of log r by 1 is to it


@cache
def cells_alone() -> Estimator:
    """Plain least squares over r > 0; made when it is asked for, because installed methods are looked for then."""
    return Estimator((Misfit(weighting="noise"),), "reduced", bounds=Bounds("none", "none"), error_bars=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class CellsFit(SumOfSquares):
    """Fit of the cells to one frame over log r; no Jacobian on panels of more than MAX_CELLS.

    Attributes
    ----------
    readings : Readings
        (rows, columns).
    cells : array
        The same shape, ohm.
    """

    readings: Readings
    cells: Array
    ridge: float = CELL_PRECISION

    @classmethod
    def at(cls, data: Data, readings: Readings, network: Network) -> "CellsFit":
        """Return the fit of a solved network to the readings."""
        residual, weight = _residual(network, readings)
        jacobian = np.zeros((residual.size, 0))
        if readings.value.size <= MAX_CELLS:
            jacobian = network.sensitivity() * weight.reshape(-1, 1) * (data.lower < data.upper).ravel()
        return cls(residual=residual.ravel(), jacobian=jacobian, readings=readings, cells=network.cell_resistance)

    @property
    def small(self) -> bool:
        """Whether the panel has no more than MAX_CELLS."""
        return bool(self.jacobian.size)

    @property
    def chi_square(self) -> float:
        """Σ residual²."""
        return 2 * self.cost

    @cached_property
    def degrees(self) -> float:
        """Number of readings less the degrees of freedom of the cells; at least 1."""
        return max(float(np.sum(self.readings.seen)) - _followed(self.normal), 1.0)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the log cells, (cells, cells)."""
        return np.asarray(np.linalg.inv(self.normal))

    @cached_property
    def gain(self) -> Array:
        """K (cells, readings): derivative of the log cells by the readings."""
        assert self.readings.sigma is not None
        return np.asarray(np.linalg.solve(self.normal, self.jacobian.T / self.readings.sigma.ravel()))

    def response(self, errors: Array) -> Array:
        """Return K U: the effect on the log cells (cells, n) of errors U of the readings (n, rows, columns)."""
        return np.asarray(self.gain @ errors.reshape(len(errors), self.cells.size).T)

    @property
    def tail(self) -> float:
        """P(χ² of so many degrees is as large)."""
        return float(chi_square_tail(self.chi_square, self.degrees))


def fitted(
    scene: Scene,
    readings: Readings,
    near: Array | None = None,
    *,
    patient: bool = False,
    effects: Sequence[Effect] = (),
) -> CellsFit | None:
    """argmin Σ ((f(r) − y)/σ)² of one frame over r > 0; None where it is not reached, or arithmetic breaks down.

    Parameters
    ----------
    near : array or None
        Cells (rows, columns) ohm to begin at; None: the readout's start.
    patient : bool
        Every start is tried, else a few iterations must do.
    effects : sequence of Effect
        Of the network beside its circuit; the fit that is reached from `near` is taken then.
    """
    try:
        with np.errstate(all="ignore"):
            data = cells_alone().data(readings.alone(), Background(scene))
            data = replace(data, lower=MIN_CELL_FACTOR * data.lower)
            fit = _fitted_near(data, readings, convex(data, None)[0] if near is None else near, scene, effects)
            if fit.chi_square <= EXACT_CHI_SQUARE or effects:
                return fit
            if not patient and fit.chi_square > MAX_CHI_SQUARE * readings.value.size:
                return None
            alone = cells_alone() if patient else replace(cells_alone(), solver=BRIEF)
            solver = alone.problem(scene, 1, float("inf"), partial=data.partial)
            start = None if patient else evaluated(solver.cost, data, fit.cells[None])
            solution = best_solution(solver, data, None) if start is None else solved_from(solver, start)
            if solution.solved and solution.at is not None:
                return CellsFit.at(data, readings, solution.at.networks[0])
    except BROKEN:
        pass
    return None


def _fitted_near(data: Data, readings: Readings, start: Array, scene: Scene, effects: Sequence[Effect]) -> CellsFit:
    """Return the least squares that the loop reaches from cells; on panels too large for it, the start itself."""
    bounds = (data.log_bounds[0].ravel(), data.log_bounds[1].ravel())

    def model(position: Array) -> CellsFit:
        network, added = with_effects(effects, scene, data.network(0, np.exp(position).reshape(start.shape)))
        return CellsFit.at(data, replace(readings, value=readings.value - added), network)

    loop = FIT if start.size <= MAX_CELLS else replace(FIT, evaluations=1)
    return loop.minimum(model, np.log(start).ravel(), bounds, lambda fit, _: fit.chi_square <= EXACT_CHI_SQUARE).at


def _residual(network: Network, readings: Readings) -> tuple[Array, Array]:
    """((y − y_measured)/σ, 1/σ), both (rows, columns): 0 where nothing was read, or a bound is kept."""
    assert readings.sigma is not None
    missed = (network.reading() - readings.value) / readings.sigma
    counted = (readings.seen > 0) & ((readings.side == 0) | (readings.side * missed < 0))
    return np.where(counted, missed, 0.0), np.where(counted, 1 / readings.sigma, 0.0)


def _followed(normal: Array) -> float:
    """Σ s²/(1 + s²) over the singular values s of J/σ: how many numbers of the noise the unknowns follow."""
    seen = np.linalg.eigvalsh(normal) - CELL_PRECISION
    return float(np.sum(seen / (1 + seen)))


@dataclass(frozen=True, eq=False)
class JointFit:
    """argmin χ² of an unloaded panel and a frame while only some cells have moved, beside a factor common to all.

    Unknowns are log r of the unloaded cells, that of the factor, the resistance in series in SERIES_UNIT of `most` (the
    largest one, ohm; 0: as it is), and the changes of moved cells beside the factor.

    Attributes
    ----------
    pair : tuple of Readings
        The readings of both frames.
    position : array
        log r of each (2, cells).
    moved : boolean array, shape (cells)
    series : array
        d residual/d(the third), where the fit began.
    """

    rival: Rival
    question: Question
    most: float
    pair: tuple[Readings, ...]
    position: Array
    moved: NDArray[np.bool_]
    series: Array

    @classmethod
    def of(
        cls, rival: Rival, question: Question, cells: Sequence[Array], moved: NDArray[np.bool_], most: float = 0.0
    ) -> "JointFit":
        """Return the circuit's best explanation of both frames.

        Moved cells are chosen anew until the score no longer falls.

        cells, moved : where to begin, (rows, columns) ohm of both frames, and which of them moved.
        """
        position = np.log([frame.ravel() for frame in cells])
        start = cls(rival, question, most, question.readings(rival), position, moved.ravel(), np.zeros(0))
        best = start.tied()
        while not np.array_equal(moved := best.chosen_anew(), best.moved):
            anew = replace(best, moved=moved).tied()
            if not anew.score < best.score:
                break
            best = anew
        return best

    def with_series(self, most: float) -> "JointFit":
        """Return the fit with the resistance in series that explains best, up to `most` ohm.

        The search begins at the scene's value.
        """
        rival = self.rival.with_series(self.rival.scene.specified_in_series)
        cells = np.exp(self.position).reshape(2, *self.pair[0].value.shape)
        return JointFit.of(rival, self.question, list(cells), self.moved, most)

    def tied(self) -> "JointFit":
        """Return the least χ² while all but the moved cells keep what they were, beside a common factor.

        It begins where linear theory says that to tie them costs least: the gap is closed by a step of both frames.
        """
        fit, place = replace(self, series=self._secant()), len(self.moved) + 1
        gap = np.where(self.moved, 0.0, self._change)
        step = _solved(fit.squares.jacobian, fit.slopes[1] @ gap - fit.residual)
        step *= min(1.0, FIT.longest / max(float(np.abs(step).max()), 1e-300))
        start = replace(fit, position=np.stack([self.position[0], self.position[1] - gap])).stepped(step)
        low, high = np.full((2, len(step)), [[-np.inf], [np.inf]])
        if self.most:
            low[place] = -start.rival.ohm / (SERIES_UNIT * self.most)
            high[place] = 1 / SERIES_UNIT + low[place]
        loop = replace(FIT, evaluations=60, settled=0.05, share=0.0)
        least = loop.minimum(lambda step: start.stepped(step).squares, np.zeros(len(step)), (low, high))
        return start.stepped(least.position)

    def stepped(self, step: Array) -> "JointFit":
        """Return the fit a step of its unknowns further."""
        size = len(self.moved)
        position = self.position + step[:size]
        position[1] += step[size]
        position[1, self.moved] += step[size + 2 :]
        fit = self._with_ohm(self.rival.ohm + SERIES_UNIT * self.most * float(step[size + 1])) if self.most else self
        return replace(fit, position=position)

    def _with_ohm(self, ohm: float) -> "JointFit":
        rival = self.rival.with_series(min(max(ohm, 0.0), self.most))
        return replace(self, rival=rival, pair=self.question.readings(rival))

    def _secant(self) -> Array:
        if not self.most:
            return np.zeros_like(self.residual)
        step = 1e-4 * self.most * (1 if self.rival.ohm < self.most / 2 else -1)
        return (self._with_ohm(self.rival.ohm + step).residual - self.residual) * (SERIES_UNIT * self.most / step)

    @cached_property
    def _solved_networks(self) -> list[tuple[Network, Readings]]:
        scene, shape = self.rival.scene, self.pair[0].value.shape
        pairs = zip(self.pair, np.exp(self.position).reshape(2, *shape), strict=True)
        return [(scene.circuit.network(cells, scene.circuit.ties(y.value), scene.wiring), y) for y, cells in pairs]

    @cached_property
    def residual(self) -> Array:
        """(y − y_measured)/σ of both frames, (2·cells)."""
        return np.concatenate([_residual(*solved)[0].ravel() for solved in self._solved_networks])

    @cached_property
    def slopes(self) -> tuple[Array, Array]:
        """Derivatives of the residual by log r of the unloaded panel, and of the frame; each (2·cells, cells)."""
        resting, frame = (
            solved[0].sensitivity() * _residual(*solved)[1].reshape(-1, 1) for solved in self._solved_networks
        )
        none = np.zeros_like(resting)
        return np.concatenate([resting, none]), np.concatenate([none, frame])

    @cached_property
    def squares(self) -> SumOfSquares:
        """The sum of squares over all unknowns."""
        return SumOfSquares(
            self.residual, np.column_stack([self._common, self.slopes[1][:, self.moved]]), CELL_PRECISION
        )

    @cached_property
    def _common(self) -> Array:
        """d residual/d(all unknowns but the last)."""
        resting, frame = self.slopes
        return np.column_stack([resting + frame, frame.sum(axis=1), self.series])

    @property
    def _change(self) -> Array:
        """Change of log r less that of the cells that did not move."""
        change = self.position[1] - self.position[0]
        return np.asarray(change - np.median(change if self.moved.all() else change[~self.moved]))

    @cached_property
    def _freed(self) -> SumOfSquares:
        """The sum of squares over the changes of all cells, with the other unknowns at their best."""
        requested = np.column_stack([self.slopes[1], self.residual])
        left = requested - self._common @ _solved(self._common, requested)
        return SumOfSquares(left[:, -1], left[:, :-1], CELL_PRECISION)

    def chosen_anew(self) -> NDArray[np.bool_]:
        """Return which cells must have moved (cells), by linear theory about this fit."""
        precision = self._freed.normal
        slope = precision @ self._change - self._freed.gradient
        starts = [self.moved, *usual_starts(np.linalg.solve(precision, slope))]
        return select_changed(slope, precision, starts)[1]

    @property
    def score(self) -> float:
        """−2 ln evidence up to a constant: χ², moved cells, readings taken for bounds, a resistance in series."""
        slab = self._freed.normal[np.ix_(self.moved, self.moved)] + np.eye(int(self.moved.sum()))
        moved = MOVED_COST * len(slab) + np.linalg.slogdet(slab)[1] + np.sum(self._change[self.moved] ** 2)
        bounds = sum(int(readings.bounds.sum()) for readings in self.pair)
        return float(2 * self.squares.cost + moved + PARAMETER_COST * (bounds + (self.rival.in_series is not None)))

    @cached_property
    def _expected(self) -> float:
        """χ² of mere noise; at least 1. Cells at the edge of r > 0 follow none of it."""
        return max(float(sum(readings.plain.sum() for readings in self.pair)) - _followed(self.squares.normal), 1.0)

    @property
    def beyond_noise(self) -> float:
        """The score without the χ² of noise alone."""
        return self.score - self._expected

    @property
    def excess(self) -> float:
        """χ² over that of mere noise, at least 1: by how much films that creep exceed the noise, for one."""
        return max(2 * self.squares.cost / self._expected, 1.0)


def _solved(matrix: Array, wanted: Array) -> Array:
    """argmin |matrix·x − wanted|² + CELL_PRECISION·|x|²."""
    normal = matrix.T @ matrix + CELL_PRECISION * np.eye(matrix.shape[1])
    return np.asarray(np.linalg.solve(normal, matrix.T @ wanted))
