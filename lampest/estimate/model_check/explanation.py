"""How well one circuit explains an unloaded panel and one frame together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.model_check.cells_fit import CellsFit, fitted
from lampest.estimate.model_check.joint_fit import JointFit, joint_fit
from lampest.estimate.model_check.question import Question
from lampest.estimate.model_check.rivals import Rival
from lampest.estimate.model_check.stillness import PRICE, moved_score
from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.readings import Readings
from lampest.solvers.starts import BROKEN

LEVEL = 1e-4  # of each of a handful of tests; where few cells are held by r > 0, χ² is rougher than its tail says
NEARLY_ALL = 0.98  # of the largest resistance in series: with all of it nothing is left for the panel
GRID = 5  # resistances in series that are tried; what lies between is found by steps


@dataclass(frozen=True, eq=False)
class Explanation:
    """rival : the circuit. fits : of the unloaded panel and of the frame. score, moving : of `moved_score`.

    A reading that the circuit takes for a bound costs as much as a cell that moved: none gains by reading less.

    Without a frame, or on a panel too large for it, the score is 0 and no cell has moved.
    """

    rival: Rival
    fits: tuple[CellsFit, ...]
    score: float
    moving: NDArray[np.bool_]

    @classmethod
    def of(cls, told: Rival, question: Question) -> "Explanation | None":
        """Of the told circuit; None where no fit is found."""
        fits = [fitted(told.scene, readings, patient=True) for readings in question.readings(told)]
        done = tuple(fit for fit in fits if fit is not None)
        return cls.scored(told, done) if len(done) == len(fits) else None

    @classmethod
    def tried(cls, rival: Rival, question: Question, near: "Explanation | None" = None) -> "Explanation | None":
        """Of another circuit, given up as soon as it fails; near : of one much like it, or None."""
        done: list[CellsFit] = []
        try:
            for number, readings in enumerate(question.readings(rival)):
                fit = fitted(rival.scene, readings, None if near is None else near.fits[number].cells)
                if fit is None or fit.tail < LEVEL:
                    return None
                done.append(fit)
            return cls.scored(rival, tuple(done))
        except (InputError, *BROKEN):
            return None

    @classmethod
    def scored(cls, rival: Rival, fits: tuple[CellsFit, ...]) -> "Explanation":
        """With its score."""
        alone = cls(rival, fits, 0.0, np.zeros(fits[0].cells.shape, dtype=bool))
        if not alone.comparable:
            return alone
        score, moving = moved_score(*fits)
        bounds = sum(int(np.sum((fit.readings.side != 0) & (fit.readings.seen > 0))) for fit in fits)
        return cls(rival, fits, score + PRICE * bounds, moving)

    @property
    def moved(self) -> int:
        """How many cells must have moved."""
        return int(self.moving.sum())

    def joint(self, question: Question, moving: NDArray[np.bool_]) -> JointFit:
        """Both frames explained by the network itself, as if these cells had moved to begin with."""
        resting, frame = self.fits
        return joint_fit(self.rival, question, (resting.cells, frame.cells), moving)

    @property
    def comparable(self) -> bool:
        """Whether there are two frames, of a panel small enough, to tell circuits apart by."""
        return len(self.fits) == 2 and self.fits[0].sensitivity is not None

    @property
    def tail(self) -> float:
        """The smaller of the fits' tails."""
        return min(fit.tail for fit in self.fits)

    @property
    def holds(self) -> bool:
        """Whether the circuit explains both."""
        return self.tail >= LEVEL

    @property
    def sparse(self) -> bool:
        """Whether it leaves more than half of the cells where they were."""
        return 2 * self.moved < self.fits[0].cells.size


def explanation_of(rival: Rival, question: Question) -> Explanation | None:
    """Of a rival as it is; where it explains nothing, with the resistance in series that explains best of a few."""
    plain = Explanation.tried(rival, question)
    return plain if plain is not None else with_some_in_series(rival, question)


def with_some_in_series(rival: Rival, question: Question) -> Explanation | None:
    """Of a rival with the resistance in series that explains best of a few; None where it has none."""
    if rival.in_series is not None:
        return None
    most = most_in_series(rival, question)
    found = _over_grid(rival, question, most) if most else []
    return min(found, key=lambda one: one.score, default=None)


def most_in_series(rival: Rival, question: Question) -> float:
    """The largest resistance in series that the readings allow, ohm; 0 where there is none, or no telling."""
    if not rival.scene.circuit.series_name or len(question.standing) == 0:
        return 0.0
    try:
        read = question.readings(rival.with_series(0.0))
    except (InputError, *BROKEN):
        return 0.0
    circuit = rival.with_series(0.0).scene.circuit
    most = min(circuit.most_in_series(one.value[None], sigma[None]) for one in read for sigma in _sigma(one))
    return NEARLY_ALL * most if np.isfinite(most) and most > 0 else 0.0


def _sigma(readings: Readings) -> tuple[Array, ...]:
    """σ of one frame's values, if it is known."""
    sigma = readings.sigma_of_values
    return () if sigma is None else (sigma,)


def _over_grid(rival: Rival, question: Question, most: float) -> list[Explanation]:
    """Explanations over a grid of resistances, each begun at the one before."""
    found: list[Explanation] = []
    near, scene = None, rival.scene
    for ohm in np.linspace(0, most, GRID)[int(scene.circuit.told_in_series(scene) == 0) :]:
        one = Explanation.tried(rival.with_series(float(ohm)), question, near)
        found, near = ([*found, one], one) if one is not None else (found, near)
    return found
