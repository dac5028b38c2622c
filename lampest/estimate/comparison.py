"""How well circuits explain an unloaded panel and one frame together, and which does so better than the scene's."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import LEVEL, CellsFit, fitted
from lampest.estimate.joint_fit import PRICE, JointFit, in_series, joint_fit, moved_score
from lampest.estimate.rivals import Question, Rival, nearly_gaussian
from lampest.files.errors import InputError
from lampest.panel.scene import Scene
from lampest.posterior.interval import largest_of
from lampest.recording.readings import Readings
from lampest.solvers.multistart import BROKEN

NEARLY_ALL = 0.98  # of the largest resistance in series: with all of it nothing is left for the panel
GRID = 5  # resistances in series that are tried; what lies between is found by steps
# −2 log probability by which another circuit must beat the scene's: e^18 to one. The best of eight kinds, with any
# resistance in series, beat a right one by 32, 25 and 19 in three of some 430 recordings, else by 15 or less.
MARGIN = 36.0
MOST_ASKED = 3  # rivals: those that linear theory finds best


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
    def of(
        cls, rival: Rival, question: Question, near: "Explanation | None" = None, patient: bool = False
    ) -> "Explanation | None":
        """Of a circuit; None where no fit is found. near : of a circuit much like it, or None.

        patient : the fit is searched for from every start, and taken whatever it leaves; else a circuit is given up as
        soon as it fails.
        """
        fits: list[CellsFit] = []
        try:
            for number, readings in enumerate(question.readings(rival)):
                fit = fitted(rival.scene, readings, None if near is None else near.fits[number].cells, patient)
                if fit is None or (not patient and fit.tail < LEVEL):
                    return None
                fits.append(fit)
            alone = cls(rival, tuple(fits), 0.0, np.zeros(fits[0].cells.shape, dtype=bool))
            if not alone.comparable:
                return alone
            score, moving = moved_score(*fits)
        except (InputError, *BROKEN):
            return None
        bounds = sum(int(np.sum((fit.readings.side != 0) & (fit.readings.seen > 0))) for fit in fits)
        return replace(alone, score=score + PRICE * bounds, moving=moving)

    def joint(self, question: Question, moving: NDArray[np.bool_]) -> JointFit:
        """Both frames explained by the network itself, as if these cells had moved to begin with."""
        resting, frame = self.fits
        return joint_fit(self.rival, question, (resting.cells, frame.cells), moving)

    @property
    def comparable(self) -> bool:
        """Whether there are two frames, of a panel small enough, to tell circuits apart by."""
        return len(self.fits) == 2 and self.fits[0].sensitivity is not None

    @property
    def holds(self) -> bool:
        """Whether the circuit explains both."""
        return min(fit.tail for fit in self.fits) >= LEVEL

    @property
    def sparse(self) -> bool:
        """Whether it leaves more than half of the cells where they were."""
        return 2 * int(self.moving.sum()) < self.moving.size


def explanation_of(rival: Rival, question: Question) -> Explanation | None:
    """Of a rival as it is; where it explains nothing, with the resistance in series that explains best of a few."""
    plain = Explanation.of(rival, question)
    return plain if plain is not None else with_some_in_series(rival, question)


def with_some_in_series(rival: Rival, question: Question) -> Explanation | None:
    """Of a rival with the resistance in series that explains best of a few; None where it has none."""
    if rival.in_series is not None:
        return None
    most = most_in_series(rival, question)
    if not most:
        return None
    found: list[Explanation] = []
    for ohm in np.linspace(0, most, GRID)[int(rival.scene.told_in_series == 0) :]:
        one = Explanation.of(rival.with_series(float(ohm)), question, found[-1] if found else None)
        found += [] if one is None else [one]
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
    known = [(one.value, sigma) for one in read if (sigma := one.sigma_of_values) is not None]
    most = min(circuit.most_in_series(value[None], sigma[None]) for value, sigma in known)
    return NEARLY_ALL * most if np.isfinite(most) and most > 0 else 0.0


@dataclass(frozen=True)
class Better:
    """Another circuit that explains the readings better: its name, and how that shows."""

    name: str
    reason: str


def better_rival(rivals: list[Rival], question: Question, specified: Explanation | None) -> Better | None:
    """The rival that explains the readings where the scene's circuit does not, or by MARGIN better; None without one.

    rivals : the scene's circuit first. specified : what that explains; None where it does not. No rival is one under
    which most cells have moved, for nothing then shows which have not, or as many as under the scene's circuit.
    """
    if specified is None:
        tried = (with_some_in_series(rivals[0], question), *(explanation_of(rival, question) for rival in rivals[1:]))
        found = [one for one in tried if one is not None and one.sparse and lawful(one.rival, question)]
        first = min(found, key=lambda one: one.score, default=None)
        return None if first is None else Better(first.rival.name, "")
    if not specified.comparable:
        return None
    as_told = specified.joint(question, specified.moving)
    if as_told.beyond_noise < MARGIN:
        return None
    best = min(_others(as_told, specified, rivals[1:], question), key=lambda fit: fit.beyond_noise, default=None)
    if best is None or not _beaten(as_told, best):
        return None
    # What moved under the rival may have moved under the specified circuit.
    again = specified.joint(question, best.moved.reshape(specified.moving.shape))
    if not _beaten(again, best):
        return None
    moved = min(as_told.count, again.count)
    if best.count >= moved:
        return None
    counts = f"{best.count} cells have moved then, and {moved} as told"
    return Better(best.rival.name, f"between the unloaded panel and {question.loaded} {counts}")


def _beaten(specified: JointFit, best: JointFit) -> bool:
    """Whether a rival explains better by MARGIN, wider where even the rival leaves more than noise."""
    return bool(specified.beyond_noise > best.beyond_noise + MARGIN * best.excess)


def _others(as_told: JointFit, specified: Explanation, rivals: list[Rival], question: Question) -> Iterator[JointFit]:
    """The specified circuit and its likeliest rivals, as linear theory has it, explained by the networks themselves.

    Each as it is and with more in series, rivals begun with nothing and with some in series.
    """
    plain = (explanation_of(rival, question) for rival in rivals)
    better = (one for one in plain if one is not None and one.score < specified.score)
    likely = sorted(better, key=lambda one: one.score)[:MOST_ASKED]
    begun = (with_some_in_series(one.rival, question) for one in likely)
    for one in (specified, *likely, *(one for one in begun if one is not None)):
        try:
            fit = as_told if one is specified else one.joint(question, one.moving)
            most = most_in_series(fit.rival, question)
            fits = [fit] * (one is not specified) + ([in_series(fit, question, most)] if most else [])
        except (InputError, *BROKEN):
            continue
        yield from (fit for fit in fits if fit.sparse and np.isfinite(fit.score))


def broken_law(scene: Scene, readings: Readings, noise: float, named: NDArray[np.intp] | None = None) -> str:
    """The inequality of the circuit that readings break by more than their noise, in words; '' where none.

    named : (frames) the numbers by which the words name them; None: as they come.
    """
    sigma = readings.sigma_of_values
    assert sigma is not None
    for test in scene.circuit.free_tests(readings.value, noise * sigma):
        frame = int(np.argmax(test.excess))
        if largest_of(test.excess[frame], test.count * len(test.excess)) < LEVEL:
            beyond = f"{test.excess[frame]:.3g} times its noise"
            number = frame if named is None else named[frame]
            return f"readings of frame {number} break a law of the circuit by {beyond}: {test.law}"
    return ""


def lawful(rival: Rival, question: Question) -> bool:
    """Whether every frame keeps the inequalities of a circuit that is to take the specified one's place."""
    readings = Readings.of(rival.scene, rival.recorded, rival.sigma)
    used = replace(readings, seen=readings.seen * nearly_gaussian(question.specified, 1))
    return not broken_law(rival.scene, used, question.widening)
