"""Two frames explained together, all cells but a few the same in both: the constrained fit behind a comparison.

What linear theory says of cells that readings hardly see is not to be trusted; here the network itself is asked, and
asked again which cells must have moved while all others stand still.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.model_check.cells_fit import fitted
from lampest.estimate.model_check.question import Question
from lampest.estimate.model_check.rivals import Rival
from lampest.estimate.model_check.stillness import PRICE, released
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

MOST_STEPS, LONGEST_STEP = 60, 1.5  # of log r; 4 to 8 steps suffice, some 40 with open lines
DAMPING, MOST_DAMPING = 1e-4, 1e4  # of the diagonal, as Levenberg and Marquardt begin and end
SETTLED = 0.1  # of χ²: a smaller gain changes no verdict
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
        step = _solved(apart._jacobian, apart.slopes[1] @ gap - apart.residual)
        step *= LONGEST_STEP / max(float(np.abs(step).max()), LONGEST_STEP)
        closed = replace(apart, position=np.stack([position[0], position[1] - gap]))
        return closed._stepped(step).settled()

    @property
    def chi_square(self) -> float:
        """Σ residual²."""
        return float(self.residual @ self.residual)

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
        system, _ = self._normal
        seen = np.linalg.eigvalsh(system) - FIRMNESS
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
        """The least χ² that steps of Levenberg and Marquardt reach while the same cells have moved."""
        here, damping = self, DAMPING
        system, slope = here._normal
        for _ in range(MOST_STEPS):
            step = np.linalg.solve(system + damping * np.diag(np.diag(system)), -slope)
            step *= LONGEST_STEP / max(float(np.abs(step).max()), LONGEST_STEP)
            there = here._stepped(step)
            gained = here.chi_square - there.chi_square
            if not gained > 0:
                damping *= 10
                if damping > MOST_DAMPING:
                    break
                continue
            here, damping = there, damping / 10
            system, slope = here._normal
            if gained < SETTLED:
                break
        return here

    @property
    def _normal(self) -> tuple[Array, Array]:
        """(JᵀJ, Jᵀ residual) of all unknowns."""
        jacobian = self._jacobian
        system = jacobian.T @ jacobian
        system[np.diag_indices(len(system))] += FIRMNESS
        return system, jacobian.T @ self.residual

    def chosen_anew(self) -> NDArray[np.bool_]:
        """Which cells must have moved (cells), by linear theory about this fit: all changes free, and priced."""
        common = self._common
        wanted = np.column_stack([self.slopes[1], self.residual])
        left = wanted - common @ _solved(common, wanted)
        precision = left[:, :-1].T @ left[:, :-1]
        precision[np.diag_indices(len(precision))] += FIRMNESS
        change = self.position[1] - self.position[0]
        change = change - (np.median(change) if self.moved.all() else np.median(change[~self.moved]))
        return released(precision @ change - left[:, :-1].T @ left[:, -1], precision)

    def series_step(self, series: Array) -> float:
        """By how many ohm in series χ² falls most, by linear theory while the same cells have moved."""
        return float(_solved(np.column_stack([self._jacobian, series]), -self.residual)[-1])

    @property
    def _common(self) -> Array:
        """d residual/d(log r of both frames, the factor)."""
        resting, frame = self.slopes
        return np.column_stack([resting + frame, frame.sum(axis=1)])

    @property
    def _jacobian(self) -> Array:
        """d residual/d(log r of both frames, the factor, what the moved cells changed beside it)."""
        return np.column_stack([self._common, self.slopes[1][:, self.moved]])

    def _stepped(self, step: Array) -> "JointFit":
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
    told = fit.rival.scene.circuit.told_in_series(fit.rival.scene)
    best = replace(fit, rival=fit.rival.with_series(told))
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


def _solved(matrix: Array, wanted: Array) -> Array:
    """argmin |matrix·x − wanted|² + FIRMNESS·|x|²."""
    system = matrix.T @ matrix
    system[np.diag_indices(len(system))] += FIRMNESS
    return np.asarray(np.linalg.solve(system, matrix.T @ wanted))


def _of_frame(scene: Scene, readings: Readings, position: Array) -> tuple[Array, Array]:
    """(residuals/σ of one frame at log r (cells), their derivatives)."""
    assert readings.sigma is not None
    circuit = scene.circuit
    cells = np.exp(position).reshape(readings.value.shape)
    network = circuit.network(cells, circuit.ties(readings.value), scene.wiring)
    missed = (network.reading() - readings.value) / readings.sigma
    counted = (readings.seen > 0) & ((readings.side == 0) | (readings.side * missed < 0))
    weight = np.where(counted, 1 / readings.sigma, 0.0).ravel()
    return np.where(counted, missed, 0.0).ravel(), network.sensitivity() * weight[:, None]
