"""Two frames explained together, all cells but a few the same in both: the constrained fit behind a comparison.

A circuit with as many cells as readings explains nearly every single frame. Two frames say more: a load touches some
cells, and under the right circuit all others stand still, within the noise. Under a wrong one, cells that nobody
touched seem to move with the load. So the cells that must have moved for the rest to stand still are counted, each at
the same cost. Linear theory proposes them; the network itself is then fitted with these cells free and all others tied.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import CellsFit, fitted, residual_of
from lampest.estimate.rivals import Question, Rival
from lampest.panel.least_squares import LevenbergMarquardt
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

# −2 log probability, per cell that is said to move: what a cell gains at random is χ² of one degree, and the largest of
# 400 such exceeds 12 in one case of five.
PRICE = 12.0
CREEP = 3e-3  # of log r, by which films creep on their own in seconds
LONGEST = 1.5  # of log r, that of one step
SETTLED = 0.1  # of χ²: a smaller gain changes no verdict
FIT = LevenbergMarquardt(evaluations=60, settled=SETTLED / 2, damping=1e-4, most_damping=1e4, longest=LONGEST)
FIRMNESS = 1e-4  # 1/variance of a step: what no reading sees stays where it is
MOST_ROUNDS = 10  # of choosing anew which cells have moved; two or three settle it
MOST_SERIES, LARGEST_PART, LEAST_PART = 12, 0.15, 0.005  # steps, and of the largest resistance in series at once
SECANT = 1e-4  # of the largest resistance in series: readings bend little over it


@dataclass(frozen=True, eq=False)
class JointFit:
    """argmin χ² of an unloaded panel and a frame while only some cells have moved, beside a factor common to all.

    rival : the circuit. pair : its readings of each. position : log r of each (2, cells). moved : (cells).
    residual : (y − y_measured)/σ of both (2·cells). slopes : its derivatives with respect to log r of the unloaded
    panel, and of the frame; each (2·cells, cells).
    """

    rival: Rival
    pair: tuple[Readings, ...]
    position: Array
    moved: NDArray[np.bool_]
    residual: Array
    slopes: tuple[Array, Array]

    @classmethod
    def at(cls, rival: Rival, pair: tuple[Readings, ...], position: Array, moved: NDArray[np.bool_]) -> "JointFit":
        """What a circuit leaves of a pair of readings there."""
        parts = [_of_frame(rival.scene, *one) for one in zip(pair, position, strict=True)]
        none = np.zeros_like(parts[0][1])
        slopes = np.concatenate([parts[0][1], none]), np.concatenate([none, parts[1][1]])
        return cls(rival, pair, position, moved, np.concatenate([part[0] for part in parts]), slopes)

    @classmethod
    def tied(cls, rival: Rival, pair: tuple[Readings, ...], position: Array, moved: NDArray[np.bool_]) -> "JointFit":
        """The settled fit that begins where all but the moved cells keep what they were, beside a common factor.

        To tie them costs least where the linear theory of both frames says so: the gap is closed by a step of both.
        """
        apart = cls.at(rival, pair, position, moved)
        change = position[1] - position[0]
        factor = float(np.median(change if moved.all() else change[~moved]))
        gap = np.where(moved, 0.0, change - factor)
        step = _solved(apart.jacobian, apart.slopes[1] @ gap - apart.residual)
        step *= LONGEST / max(float(np.abs(step).max()), LONGEST)
        closed = replace(apart, position=np.stack([position[0], position[1] - gap]))
        return closed.stepped(step).settled()

    @property
    def chi_square(self) -> float:
        """Σ residual²."""
        return float(self.residual @ self.residual)

    @property
    def cost(self) -> float:
        """½ Σ residual²."""
        return self.chi_square / 2

    @property
    def gradient(self) -> Array:
        """Of the cost by all unknowns, see `jacobian`."""
        return np.asarray(self.jacobian.T @ self.residual)

    @cached_property
    def normal(self) -> Array:
        """JᵀJ of all unknowns, with the FIRMNESS of a step."""
        return _normal(self.jacobian)

    @property
    def count(self) -> int:
        """How many cells have moved."""
        return int(self.moved.sum())

    @property
    def sparse(self) -> bool:
        """Whether more than half of the cells are where they were."""
        return 2 * self.count < self.moved.size

    @property
    def score(self) -> float:
        """χ², and what moved cells, readings taken for bounds and another resistance in series cost."""
        bounds = sum(int(readings.bounds.sum()) for readings in self.pair)
        return self.chi_square + PRICE * (self.count + bounds + (self.rival.in_series is not None))

    @cached_property
    def followed(self) -> float:
        """Σ s²/(1 + s²) over the singular values s of the Jacobian: how many numbers of the noise the fit follows.

        Cells at the edge of r > 0 follow none: the fit of a circuit that has many there leaves more of the noise.
        """
        seen = np.linalg.eigvalsh(self.normal) - FIRMNESS
        return float(np.sum(seen / (1 + seen)))

    @property
    def expected(self) -> float:
        """χ² of mere noise; at least 1."""
        return max(float(sum(readings.plain.sum() for readings in self.pair)) - self.followed, 1.0)

    @property
    def beyond_noise(self) -> float:
        """The score without what noise alone would leave."""
        return self.score - self.expected

    @property
    def excess(self) -> float:
        """χ² over that of mere noise, at least 1: by how much films that creep exceed the noise, for one."""
        return max(self.chi_square / self.expected, 1.0)

    def settled(self) -> "JointFit":
        """The least χ² that is reached while the same cells have moved."""
        return FIT.minimum(self.stepped, np.zeros(self.jacobian.shape[1])).at

    def chosen_anew(self) -> NDArray[np.bool_]:
        """Which cells must have moved (cells), by linear theory about this fit: all changes free, and priced."""
        common = self._common
        wanted = np.column_stack([self.slopes[1], self.residual])
        left = wanted - common @ _solved(common, wanted)
        precision = _normal(left[:, :-1])
        change = self.position[1] - self.position[0]
        change = change - (np.median(change) if self.moved.all() else np.median(change[~self.moved]))
        return selected(precision @ change - left[:, :-1].T @ left[:, -1], precision)

    def series_step(self, series: Array) -> float:
        """By how many ohm in series χ² falls most, by linear theory while the same cells have moved."""
        return float(_solved(np.column_stack([self.jacobian, series]), -self.residual)[-1])

    @property
    def _common(self) -> Array:
        """d residual/d(log r of both frames, the factor)."""
        resting, frame = self.slopes
        return np.column_stack([resting + frame, frame.sum(axis=1)])

    @cached_property
    def jacobian(self) -> Array:
        """d residual/d(log r of both frames, the factor, what the moved cells changed beside it)."""
        return np.column_stack([self._common, self.slopes[1][:, self.moved]])

    def stepped(self, step: Array) -> "JointFit":
        """The fit a step further."""
        size = len(self.moved)
        position = self.position + step[:size]
        position[1] += step[size]
        position[1, self.moved] += step[size + 1 :]
        return JointFit.at(self.rival, self.pair, position, self.moved)


def joint_fit(rival: Rival, question: Question, cells: tuple[Array, Array], moving: NDArray[np.bool_]) -> JointFit:
    """The circuit's best explanation of both frames; moved cells are chosen anew until the score no longer falls.

    cells : where to begin, (rows, columns) ohm of both frames. moving : the cells that moved, to begin with.
    """
    position = np.log([one.ravel() for one in cells])
    best = JointFit.tied(rival, question.readings(rival), position, moving.ravel())
    for _ in range(MOST_ROUNDS):
        moved = best.chosen_anew()
        if np.array_equal(moved, best.moved):
            break
        found = JointFit.tied(rival, best.pair, best.position, moved)
        if found.score >= best.score:
            break
        best = found
    return best


def in_series(fit: JointFit, question: Question, most: float) -> JointFit:
    """The same with the resistance in series that explains best, up to `most` ohm, by steps from what it has."""
    specified = fit.rival.scene.told_in_series
    best = replace(fit, rival=fit.rival.with_series(specified))
    largest = LARGEST_PART * most
    for _ in range(MOST_SERIES):
        assert best.rival.in_series is not None
        step = float(np.clip(best.series_step(_slope_in_series(best, question, most)), -largest, largest))
        if not np.isfinite(step):
            break
        found = _placed(best, question, float(np.clip(best.rival.in_series + step, 0, most)))
        if found is None or found.score >= best.score - SETTLED:
            largest = min(abs(step), largest) / 4
            if largest < LEAST_PART * most:
                break
        else:
            best = found
    return best


def _placed(fit: JointFit, question: Question, ohm: float) -> JointFit | None:
    """With so much in series: each frame alone follows that easily, then they are tied; None where one does not."""
    rival = fit.rival.with_series(ohm)
    pair, shape = question.readings(rival), fit.pair[0].value.shape
    alone = [
        fitted(rival.scene, readings, np.exp(position).reshape(shape))
        for readings, position in zip(pair, fit.position, strict=True)
    ]
    done = tuple(one.cells for one in alone if one is not None)
    return joint_fit(rival, question, (done[0], done[1]), fit.moved.reshape(shape)) if len(done) == 2 else None


def _slope_in_series(fit: JointFit, question: Question, most: float) -> Array:
    """d residual/d(ohm in series) (2·cells, 1) by a secant."""
    assert fit.rival.in_series is not None
    step = SECANT * most * (1 if fit.rival.in_series < most / 2 else -1)
    further = fit.rival.with_series(fit.rival.in_series + step)
    there = JointFit.at(further, question.readings(further), fit.position, fit.moved)
    return (there.residual - fit.residual)[:, None] / step


def _normal(matrix: Array) -> Array:
    return np.asarray(matrix.T @ matrix + FIRMNESS * np.eye(matrix.shape[1]))


def _solved(matrix: Array, wanted: Array) -> Array:
    """argmin |matrix·x − wanted|² + FIRMNESS·|x|²."""
    return np.asarray(np.linalg.solve(_normal(matrix), matrix.T @ wanted))


def _of_frame(scene: Scene, readings: Readings, position: Array) -> tuple[Array, Array]:
    """(residuals/σ of one frame at log r (cells), their derivatives)."""
    cells = np.exp(position).reshape(readings.value.shape)
    network = scene.circuit.network(cells, scene.circuit.ties(readings.value), scene.wiring)
    residual, weight = residual_of(network, readings)
    return residual.ravel(), network.sensitivity() * weight.reshape(-1, 1)


def moved_score(resting: CellsFit, frame: CellsFit) -> tuple[float, NDArray[np.bool_]]:
    """(min over sets S of χ²(the cells outside S stand still) + PRICE·|S| + log det, S) of two fits of one circuit.

    The change of all cells together (temperature, supply) is taken off. log det is that of the covariance of the change
    against the frame's own: −2 log density of the frame's readings, so that a circuit gains nothing by being blind.
    """
    change = np.log(frame.cells / resting.cells).ravel()
    change = change - np.median(change)
    own = np.linalg.inv(frame.normal)
    together = own + np.linalg.inv(resting.normal)
    least = float(np.linalg.slogdet(frame.normal)[1])
    best = (np.inf, np.ones(resting.cells.shape, dtype=bool))
    for creep in (0.0, CREEP):
        covariance = together + creep**2 * np.eye(len(change))
        precision = np.linalg.inv(covariance)
        gained, moved = _forward(precision @ change, precision)
        chi_square = float(change @ precision @ change) - gained
        score = chi_square + PRICE * int(moved.sum()) + float(np.linalg.slogdet(covariance)[1]) + least
        best = (score, moved.reshape(resting.cells.shape)) if score < best[0] else best
    return best


def selected(slope: Array, precision: Array) -> NDArray[np.bool_]:
    """Cells that must have moved, of changes d with −2 log density dᵀ·precision·d − 2 slope·d: the better of two ways.

    Forward, one after the other is released while it gains more than its PRICE, and what then gains less beside the
    others is tied again: among changes that readings hardly tell apart the first to go is often one between those that
    moved. Backward, one after the other is tied while that loses less than its PRICE.
    """
    forward = _backward(slope, precision, _forward(slope, precision)[1])
    backward = _backward(slope, precision, np.ones(len(slope), dtype=bool))
    return min((forward, backward), key=lambda one: one[0])[1]


def _backward(slope: Array, precision: Array, moved: NDArray[np.bool_]) -> tuple[float, NDArray[np.bool_]]:
    """(−2 log density and prices, moved cells): cells are tied while one of them loses less than its PRICE.

    To tie cell c loses d_c²/C_cc, with the covariance C of those that are free; d and C are then those of the others.
    """
    free = np.flatnonzero(moved)
    covariance = np.linalg.inv(precision[np.ix_(free, free)])
    change = covariance @ slope[free]
    gained, held = float(slope[free] @ change), np.zeros(len(free), dtype=bool)
    while not held.all():
        loss = np.where(held, np.inf, change**2 / np.maximum(np.diag(covariance), 1e-300))
        cell = int(np.argmin(loss))
        if loss[cell] >= PRICE:
            break
        gained, held[cell] = gained - loss[cell], True
        column = covariance[:, cell] / covariance[cell, cell]
        change = change - column * change[cell]
        covariance = covariance - np.outer(column, covariance[cell])
    left = np.zeros(len(slope), dtype=bool)
    left[free[~held]] = True
    return PRICE * int(left.sum()) - gained, left


def _forward(slope: Array, precision: Array) -> tuple[float, NDArray[np.bool_]]:
    """(χ² that is gained, released cells): cells are released while one of them gains more than its PRICE.

    To release cell c gains slope_c²/P_cc; slope and P are then those of the others alone (sweep operator).
    """
    precision, slope = precision.copy(), slope.copy()
    gained, held = 0.0, np.ones(len(slope), dtype=bool)
    while held.any():
        gain = np.where(held, slope**2 / np.maximum(np.diag(precision), 1e-300), 0.0)
        cell = int(np.argmax(gain))
        if gain[cell] < PRICE:
            break
        gained, held[cell] = gained + gain[cell], False
        column = precision[:, cell] / precision[cell, cell]
        slope = slope - column * slope[cell]
        precision -= np.outer(column, precision[cell])
    return gained, ~held
