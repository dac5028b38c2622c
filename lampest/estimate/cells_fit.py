"""Least-squares fit of the cells to one frame, or to two frames with few moved cells, under a given circuit.

A frame has as many cells as readings, so a misfit remains only where cells would have to be negative. Over the cone
g ≥ 0 the misfit is χ² with one degree of freedom for each cell at the boundary of the cone, and smaller where the truth
lies inside (chi-bar-squared; Shapiro, Biometrika 72, 1985). Two frames determine more: under the right circuit the
cells that no load touches stand still. The fit of two frames selects the cells that moved, each at the same cost in the
evidence.
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

EXACT_CHI_SQUARE = 1e-2  # χ² so small that it changes no verdict
FIT = LevenbergMarquardt(evaluations=16, settled=EXACT_CHI_SQUARE / 2, share=0.1, damping=0.0, longest=1.5)
# Fits with cells at the boundary r = 0 take some 20 iterations, circuits that cannot explain the readings hundreds.
BRIEF = Settings(max_iterations=25)
# Factor on the lower bound that estimates have: a short behind a drive resistor of a kilo-ohm is smaller than that.
MIN_CELL_FACTOR = 1e-3
# χ² for each reading that noise never reaches: a circuit is given up above it. Without it checks take four times as
# long.
MAX_CHI_SQUARE = 10.0
CELL_PRECISION = UNKNOWN_SD**-2  # prior precision of log r of a cell that no reading determines
SERIES_UNIT = 0.1  # of the largest resistance in series: the unit of that unknown, comparable to a step of log r by 1


@cache
def cells_alone() -> Estimator:
    """Return the estimator of plain least squares over r > 0, created at the first call.

    Its creation looks for installed methods, which must not happen at import.
    """
    return Estimator((Misfit(weighting="noise"),), "reduced", bounds=Bounds("none", "none"), error_bars=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class CellsFit(SumOfSquares):
    """Fit of the cells to one frame, as a sum of squares over log r; no Jacobian on panels of more than MAX_CELLS.

    Attributes
    ----------
    readings : Readings
        (rows, columns).
    cells : array, shape (rows, columns)
        Cell resistances, ohm.
    ridge : float
        Prior precision of each log r.
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
        """Whether the panel has no more than MAX_CELLS cells, and the fit a Jacobian."""
        return bool(self.jacobian.size)

    @property
    def chi_square(self) -> float:
        """χ² = Σ ((f(r) − y)/σ)²."""
        return 2 * self.cost

    @cached_property
    def degrees(self) -> float:
        """Degrees of freedom of χ²: the readings less those that the cells follow; at least 1."""
        return max(float(np.sum(self.readings.seen)) - _followed(self.normal), 1.0)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the log cells, (cells, cells)."""
        return np.asarray(np.linalg.inv(self.normal))

    @cached_property
    def gain(self) -> Array:
        """K (cells, readings): derivative of the fitted log cells with respect to the readings."""
        assert self.readings.sigma is not None
        # K = (J̃ᵀ J̃ + ridge)⁻¹ J̃ᵀ/σ, with J̃ = ∂y/∂log r / σ
        return np.asarray(np.linalg.solve(self.normal, self.jacobian.T / self.readings.sigma.ravel()))

    def response(self, errors: Array) -> Array:
        """Return K U, the change of the log cells (cells, n) by errors U of the readings (n, rows, columns)."""
        return np.asarray(self.gain @ errors.reshape(len(errors), self.cells.size).T)

    @property
    def tail(self) -> float:
        """P(χ²_degrees ≥ chi_square), the tail probability of the misfit under noise alone."""
        return float(chi_square_tail(self.chi_square, self.degrees))


def fitted(
    scene: Scene,
    readings: Readings,
    near: Array | None = None,
    *,
    patient: bool = False,
    effects: Sequence[Effect] = (),
) -> CellsFit | None:
    """Return argmin Σ ((f(r) − y)/σ)² of one frame over r > 0; None where the solver or arithmetic fails.

    Parameters
    ----------
    scene : Scene
    readings : Readings
        y and σ, (rows, columns).
    near : array, shape (rows, columns), optional
        Cells in ohm to begin at; by default the readout's start.
    patient : bool
        Whether every start is tried, and any misfit accepted. Otherwise few iterations are allowed, and a fit far from
        noise is given up.
    effects : sequence of Effect
        Effects in the network beside its circuit. With effects the fit that the first loop reaches is returned.
    """
    try:
        with np.errstate(all="ignore"):
            data = cells_alone().data(readings.alone(), Background(scene))
            data = replace(data, lower=MIN_CELL_FACTOR * data.lower)
            # The Levenberg-Marquardt method suffices where cells explain the readings exactly, which is usual.
            fit = _fitted_near(data, readings, convex(data, None)[0] if near is None else near, scene, effects)
            if fit.chi_square <= EXACT_CHI_SQUARE or effects:
                return fit
            if not patient and fit.chi_square > MAX_CHI_SQUARE * readings.value.size:
                return None
            # Elsewhere cells stand at the boundary r = 0, and the solver of the estimates finds the minimum.
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
    """Return the fit that Levenberg-Marquardt reaches from `start`; on panels of more than MAX_CELLS, the start."""
    bounds = (data.log_bounds[0].ravel(), data.log_bounds[1].ravel())

    def model(position: Array) -> CellsFit:
        network, added = with_effects(effects, scene, data.network(0, np.exp(position).reshape(start.shape)))
        return CellsFit.at(data, replace(readings, value=readings.value - added), network)

    loop = FIT if start.size <= MAX_CELLS else replace(FIT, evaluations=1)
    return loop.minimum(model, np.log(start).ravel(), bounds, lambda fit, _: fit.chi_square <= EXACT_CHI_SQUARE).at


def _residual(network: Network, readings: Readings) -> tuple[Array, Array]:
    """Return (y − y_measured)/σ and 1/σ, both (rows, columns); 0 where nothing was read, or a bound is satisfied."""
    assert readings.sigma is not None
    missed = (network.reading() - readings.value) / readings.sigma
    counted = (readings.seen > 0) & ((readings.side == 0) | (readings.side * missed < 0))
    return np.where(counted, missed, 0.0), np.where(counted, 1 / readings.sigma, 0.0)


def _followed(normal: Array) -> float:
    """Return Σ s²/(1 + s²) over the singular values s of J/σ, the degrees of freedom of the unknowns."""
    seen = np.linalg.eigvalsh(normal) - CELL_PRECISION
    return float(np.sum(seen / (1 + seen)))


@dataclass(frozen=True, eq=False)
class JointFit:
    """Joint least-squares fit of an unloaded panel and a frame in which only some cells have moved.

    The unknowns, in this order, are log r of the unloaded cells (cells,), the logarithm of a factor common to all
    cells (1,), the resistance in series in units of SERIES_UNIT · `most` (1,), and the changes of the moved cells
    beside the common factor (moved,).

    Attributes
    ----------
    rival : Rival
        The circuit.
    question : Question
        The frames to explain.
    most : float
        Largest resistance in series, ohm; 0 keeps it at its value.
    pair : tuple of Readings
        The readings of both frames.
    position : array, shape (2, cells)
        log r of both frames.
    moved : boolean array, shape (cells,)
    series : array, shape (2·cells,)
        Derivative of the residual with respect to the resistance in series, where the fit began.
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

        The selection of moved cells and the fit alternate until the score no longer falls.

        Parameters
        ----------
        rival : Rival
        question : Question
        cells : sequence of array, shape (rows, columns)
            Initial cells of both frames, ohm.
        moved : boolean array
            Initial moved cells.
        most : float
            Largest resistance in series, ohm; 0 keeps it at its value.
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
        """Return the fit with the least χ² in which all cells but the moved ones change by a common factor only.

        The search begins at the least χ² of linear theory: the changes of the still cells are set to the common one,
        and a step of all unknowns compensates for that.
        """
        fit, place = replace(self, series=self._secant()), len(self.moved) + 1
        # argmin |e − J_f gap + J step|², with e the residual, J of all unknowns and J_f of the frame's log cells
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
        """Return the fit after a step of its unknowns."""
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
        """Derivatives of the residual by log r of the unloaded panel and of the frame, each (2·cells, cells)."""
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
        """Derivative of the residual by all unknowns but the changes of moved cells, (2·cells, cells + 2)."""
        resting, frame = self.slopes
        return np.column_stack([resting + frame, frame.sum(axis=1), self.series])

    @property
    def _change(self) -> Array:
        """Change of log r less the median change of the still cells, (cells,)."""
        change = self.position[1] - self.position[0]
        return np.asarray(change - np.median(change if self.moved.all() else change[~self.moved]))

    @cached_property
    def _freed(self) -> SumOfSquares:
        """The sum of squares over the changes of all cells, with the other unknowns projected out."""
        requested = np.column_stack([self.slopes[1], self.residual])
        # variable projection: (1 − C C⁺) [J_f | e], with C of the other unknowns
        left = requested - self._common @ _solved(self._common, requested)
        return SumOfSquares(left[:, -1], left[:, :-1], CELL_PRECISION)

    def chosen_anew(self) -> NDArray[np.bool_]:
        """Return the moved cells (cells,) that `select_changed` finds by linear theory about this fit."""
        precision = self._freed.normal
        # s = P d, where P d̂ = P d − gradient at the unrestricted minimum d̂ of linear theory
        slope = precision @ self._change - self._freed.gradient
        starts = [self.moved, *usual_starts(np.linalg.solve(precision, slope))]
        return select_changed(slope, precision, starts)[1]

    @property
    def score(self) -> float:
        """−2 ln evidence up to a constant: χ², and the costs of moved cells, bounds and a resistance in series."""
        # MOVED_COST |M| + ln |P_MM + 1| + Σ d_M², the prior d_M ~ N(0, 1) of moved cells at the fitted changes
        slab = self._freed.normal[np.ix_(self.moved, self.moved)] + np.eye(int(self.moved.sum()))
        moved = MOVED_COST * len(slab) + np.linalg.slogdet(slab)[1] + np.sum(self._change[self.moved] ** 2)
        bounds = sum(int(readings.bounds.sum()) for readings in self.pair)
        return float(2 * self.squares.cost + moved + PARAMETER_COST * (bounds + (self.rival.in_series is not None)))

    @cached_property
    def _expected(self) -> float:
        """Expected χ² of noise alone, at least 1: the readings less the degrees of freedom of the unknowns."""
        return max(float(sum(readings.plain.sum() for readings in self.pair)) - _followed(self.squares.normal), 1.0)

    @property
    def beyond_noise(self) -> float:
        """The score less the expected χ² of noise alone."""
        return self.score - self._expected

    @property
    def excess(self) -> float:
        """χ² over that of noise alone, at least 1; creeping films, for example, exceed 1."""
        return max(2 * self.squares.cost / self._expected, 1.0)


def _solved(matrix: Array, wanted: Array) -> Array:
    """Return argmin |matrix·x − wanted|² + CELL_PRECISION·|x|²."""
    normal = matrix.T @ matrix + CELL_PRECISION * np.eye(matrix.shape[1])
    return np.asarray(np.linalg.solve(normal, matrix.T @ wanted))
