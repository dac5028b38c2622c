"""Whether the circuit that a scene specifies can have made the readings, and which other explains them better."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import LEVEL, MOST_CELLS, PRICE, CellsFit, JointFit, fitted, mostly_still, moved_score
from lampest.estimate.nuisances import MARGIN, MOST_ASKED, Besides, Better, beside_channels, besides_the_circuit
from lampest.estimate.outliers import without_outliers
from lampest.estimate.rivals import Question, Rival, changes_beyond_noise, rivals_of, standing_frames
from lampest.estimate.saturation import as_passed
from lampest.estimate.scatter import LEAST_FACTOR
from lampest.files.errors import InputError
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.settings import patch_of
from lampest.panel.panel import Modules
from lampest.panel.scene import Scene
from lampest.panel.systematic import unshown_text
from lampest.posterior.interval import chi_square_tail, largest_of
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.solvers.multistart import BROKEN

EXPLAINED = "the circuit explains its readings"
MOST_MODULES = 3  # of which the circuit is checked: one after the other takes its time
MOST_MISSING = 0.1  # of the readings: with a fifth missing or bounds, nothing shows which cells must have moved
NEARLY_ALL = 0.98  # of the largest resistance in series: with all of it nothing is left for the panel
GRID = 5  # resistances in series that are tried; what lies between is found by steps


@dataclass(frozen=True)
class ModelCheck:
    """What was found, for people in `sentence` (ASCII, as results files keep it).

    explains : whether nothing speaks against the specified circuit; None: not checked, because the noise is unknown or
    no fit was found. better : the circuit that explains the readings better, as a scene would name it; ''.
    noise : by how much the unloaded frames scatter beyond the specified noise; 1 where not noticeably. together : how
    all cells changed alike, in words; ''. besides : whether effects beside the circuit are what explains best. lying :
    whether a load may lie on the unloaded panel.

    >>> lampest.ModelCheck(True, "the circuit explains its readings").mark
    'yes'
    """

    explains: bool | None
    sentence: str
    better: str = ""
    noise: float = 1.0
    together: str = ""
    besides: bool = False
    lying: bool = False

    @property
    def mark(self) -> str:
        """'yes', 'no', 'noise' where σ is in doubt and the circuit is not, or 'not checked'."""
        if self.explains is None:
            return "not checked"
        return "no" if not self.explains else "yes" if self.noise == 1 else "noise"


@lru_cache(maxsize=1)  # several estimators of one recording come one after the other
def recording_check(recording: Recording) -> ModelCheck:
    """The check of a recording's circuit, which all its estimates share. Raises InputError as `Readings.of`.

    The unloaded panel's mean and the frame that differs most from it are explained by cells alone, every frame is
    held against the circuit's inequalities, and other circuits are tried on the same two. Without an unloaded frame
    the first one stands in. Where the circuit explains the readings, the sentence says what no frame can show.
    """
    check, unshown = _check_of(recording), unshown_text(recording.scene)
    return replace(check, sentence=f"{check.sentence}; {unshown}") if check.explains and unshown else check


def _check_of(recording: Recording) -> ModelCheck:
    """The check without what no frame can show."""
    if recording.scene.panel.modules is not None:
        return _of_modules(recording, recording.scene.panel.modules)
    recording = as_passed(recording)
    scene, readings = recording.scene, recording.readings()
    if readings.sigma is None:
        return ModelCheck(None, "the circuit was not checked: the noise of the readings is unknown")
    try:
        with np.errstate(all="ignore"):
            outliers, _ = without_outliers(scene.circuit, readings, recording.role == UNLOADED)
            specified = Rival(scene, np.where(outliers, np.nan, recording.recorded), recording.sigma)
            check, count = _checked(specified, recording), int(outliers.sum())
    except BROKEN:
        return ModelCheck(None, "the circuit was not checked: arithmetic broke down over its readings")
    said = f"; {count} outlier{'s' if count > 1 else ''} of one frame left out" if count else ""
    return replace(check, sentence=check.sentence + said)


def _of_modules(recording: Recording, layout: Modules) -> ModelCheck:
    """Of those modules whose readings move most."""
    values, resting = layout.split(recording.readings().plain_values), recording.role == UNLOADED
    if not resting.any():
        resting[0] = True
    with catch_warnings(), np.errstate(all="ignore"):
        simplefilter("ignore")  # of a module without readings
        change = np.abs(np.log(values[recording.role == MEASURED] / np.nanmean(values[resting], axis=0)))
        moved = np.nan_to_num(np.nanmean(change, axis=(2, 3))).max(0, initial=0.0)
    living = [one for one in np.argsort(moved)[::-1].tolist() if one not in recording.scene.dead_modules]
    found = {one: _check_of(recording.modules[one]) for one in sorted(living[:MOST_MODULES])}
    explains = [check.explains for check in found.values()]
    verdict = False if False in explains else True if True in explains else None
    said = {one: check for one, check in found.items() if check.explains is verdict}
    sentence = "; ".join(f"module {list(layout.place(one))}: {check.sentence}" for one, check in said.items())
    if len(found) < layout.count:
        sentence += f"; {len(found)} of {layout.count} modules were checked, those that move most"
    better = next((check.better for check in said.values() if check.better), "")
    lying = any(check.lying for check in found.values())
    return ModelCheck(verdict, sentence, better, max(check.noise for check in found.values()), lying=lying)


def _checked(specified: Rival, recording: Recording) -> ModelCheck:
    """The check of readings whose noise is known, outliers left out."""
    scene, role, readings = specified.scene, recording.role, specified.readings()
    named = np.arange(len(role)) if recording.number is None else recording.number
    resting = np.flatnonzero(role == UNLOADED) if np.any(role == UNLOADED) else np.array([0])
    standing = np.setdiff1d(np.flatnonzero(role == MEASURED), resting)
    used = replace(readings, seen=readings.seen * specified.nearly_gaussian(1))
    noise = noise_factor(used[resting])
    if len(standing):
        frame = strongest_frame(readings.plain_values, readings[resting].mean().value, standing)
        standing = standing_frames(used, frame, standing, noise)
    question = Question(specified, resting, standing, noise, named)
    compared = readings[np.concatenate([resting, standing])]
    bounded = float((compared.bounds & scene.asked).sum() / max((compared.seen > 0)[:, scene.asked].sum(), 1))
    few_bounds = bounded <= MOST_MISSING
    found = Explanation.of(specified, question, patient=True) if few_bounds else None
    below = _below_series(scene, specified, readings, named)
    fault = ("" if found is None else _unexplained(found, question)) or broken_law(scene, used, noise, named) or below
    if found is None and not fault:
        if not few_bounds:
            lawful = f"no readings break a law of the circuit; {100 * bounded:.0f} % of them are bounds"
            return ModelCheck(True, f"{lawful}, and no cells were fitted")
        return ModelCheck(None, "the circuit was not checked: no fit of its cells was found", noise=noise)
    best, besides = Better(), effects_seen(recording)
    whole = float(compared.missing(scene).mean()) <= MOST_MISSING and (few_bounds or bool(below))
    if whole:
        change = changes_beyond_noise(scene, readings, role)
        rivals = list(rivals_of(specified, bool(change.max(initial=0.0) > -change.min(initial=0.0))))
        best, effect = better_rival(rivals, question, None if fault else found), besides.better
        if effect.name and (effect.fits_noise or not fault) and (not best.name or effect.count < best.count):
            best = effect
    if not whole:
        sentence = f"{fault or EXPLAINED}; other circuits were not tried, too many readings are missing or bounds"
    elif fault:
        sentence = f"{fault}; {best.name} does" if best.name else f"{fault}; no other circuit that was tried gives them"
    else:
        sentence = f"{best.name} explains the readings better: {best.reason}" if best.name else EXPLAINED
    if noise > 1:
        sentence += f"; the unloaded frames scatter by {noise:.2g} times the specified noise, which is allowed for"
    named_best = bool(best.name) and best is besides.better
    return ModelCheck(
        not fault and not best.name, sentence, best.name, noise, besides.together, named_best, besides.lying
    )


@lru_cache(maxsize=1)  # the check asks for it, and the noise
def effects_seen(recording: Recording) -> Besides:
    """What is there beside the circuit, in the frames that changed most and in the last one."""
    recording = as_passed(recording)
    scene, role = recording.scene, recording.role
    resting, standing = (np.flatnonzero(role == one) for one in (UNLOADED, MEASURED))
    if not len(resting) or not len(standing) or scene.panel.crossings > MOST_CELLS or scene.readout is None:
        return Besides()
    with suppress(*BROKEN), np.errstate(all="ignore"):
        _, readings = without_outliers(scene.circuit, recording.readings(), role == UNLOADED)
        specified = Rival(scene, recording.recorded, recording.sigma)
        readings = replace(readings, seen=readings.seen * specified.nearly_gaussian(1))
        noise, last = noise_factor(readings[resting]), standing[-1:]
        assert readings.sigma is not None
        widened = replace(readings, sigma=noise * readings.sigma)
        mean = widened[resting].mean()
        unloaded = fitted(scene, mean, patient=True)
        frame = strongest_frame(widened.plain_values, mean.value, standing)
        standing = standing_frames(widened, frame, standing, 1.0)
        question, frames = Question(specified, resting, standing, noise, recording.number), list[tuple[str, CellsFit]]()
        for chosen in (standing,) if last[0] in standing else (standing, last):
            near = None if unloaded is None else unloaded.cells
            fit = fitted(scene, widened[chosen].mean(), near, patient=True)
            frames += [] if fit is None else [(replace(question, standing=chosen).loaded, fit)]
        if unloaded is not None:
            search = Detector(scene.panel, patch_of(scene.panel)).search
            lying = unloaded.tail >= LEVEL and search.lies_on(np.log(unloaded.cells))
            return replace(besides_the_circuit(scene, unloaded, frames), lying=lying)
    return Besides()


def noise_factor(resting: Readings) -> float:
    """√(χ²/degrees) of unloaded frames (frames, rows, columns) about their mean; 1 where that is no noted excess."""
    plain = np.all(resting.plain, axis=0)
    degrees = (len(resting.value) - 1) * int(plain.sum())
    if degrees == 0 or resting.sigma is None:
        return 1.0
    chi_square = float(np.sum(((resting.value - resting.value.mean(axis=0)) / resting.sigma)[:, plain] ** 2))
    factor = float(np.sqrt(chi_square / degrees))
    return factor if factor >= LEAST_FACTOR and chi_square_tail(chi_square, degrees) < LEVEL else 1.0


def _unexplained(found: "Explanation", question: Question) -> str:
    """What the cells leave unexplained, in words; '' where nothing."""
    worst = int(np.argmin([fit.tail for fit in found.fits]))
    fit, what = found.fits[worst], question.loaded if worst else "the unloaded panel"
    if fit.tail >= LEVEL:
        return ""
    squares = fit.residual.reshape(fit.cells.shape) ** 2
    rows, columns = squares.sum(axis=1), squares.sum(axis=0)
    name, lines = ("row", rows) if rows.max() >= columns.max() else ("column", columns)
    return (
        f"no cells give the readings of {what}: chi square is {fit.chi_square:.3g} where some {fit.degrees:.3g} would "
        f"be noise, {name} {np.argmax(lines)} holds {100 * lines.max() / squares.sum():.0f} % of it"
    )


def _below_series(scene: Scene, specified: Rival, readings: Readings, named: NDArray[np.intp]) -> str:
    """The reading that lies below the series resistance by more than its noise, in words; '' where none does."""
    if scene.circuit.unit != "ohm" or readings.sigma is None:
        return ""
    left = scene.circuit.from_recorded(specified.recorded, scene)
    excess = np.where((readings.seen > 0) & np.isfinite(left), -left / readings.sigma, -np.inf)
    if largest_of(excess.max(), excess.size) >= LEVEL:
        return ""
    frame, row, column = (int(part) for part in np.unravel_index(np.argmax(excess), excess.shape))
    short = f"{-left[frame, row, column]:.3g} ohm below its series resistance, {excess[frame, row, column]:.3g} times"
    return f"the reading of row {row}, column {column} in frame {named[frame]} lies {short} its noise"


def broken_law(scene: Scene, readings: Readings, noise: float, named: NDArray[np.intp]) -> str:
    """The inequality of the circuit that readings break by more than their noise, in words; '' where none.

    noise : factor on every σ. named : (frames) the numbers by which the words name them.
    """
    sigma = readings.sigma_of_values
    assert sigma is not None
    for test in scene.circuit.free_tests(readings.value, noise * sigma):
        frame = int(np.argmax(test.excess))
        if largest_of(test.excess[frame], test.count * len(test.excess)) < LEVEL:
            beyond = f"{test.excess[frame]:.3g} times its noise"
            return f"readings of frame {named[frame]} break a law of the circuit by {beyond}: {test.law}"
    return ""


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
        bounds = sum(int(fit.readings.bounds.sum()) for fit in fits)
        return replace(alone, score=score + PRICE * bounds, moving=moving)

    def joint(self, question: Question, moving: NDArray[np.bool_]) -> JointFit:
        """Both frames explained by the network itself, as if these cells had moved to begin with."""
        return JointFit.of(self.rival, question, [fit.cells for fit in self.fits], moving)

    @property
    def comparable(self) -> bool:
        """Whether there are two frames, of a panel small enough, to tell circuits apart by."""
        return len(self.fits) == 2 and self.fits[0].small


def better_rival(rivals: list[Rival], question: Question, specified: Explanation | None) -> Better:
    """The rival that explains the readings where the scene's circuit does not, or by MARGIN better.

    rivals : the scene's circuit first. specified : what that explains; None where it does not. No rival is one under
    which most cells have moved, for nothing then shows which have not, or as many as under the scene's circuit.
    """
    if specified is None:
        tried = (with_some_in_series(rivals[0], question), *(_explanation(rival, question) for rival in rivals[1:]))
        found = [one for one in tried if one is not None and mostly_still(one.moving) and _lawful(one.rival, question)]
        return Better(min(((one.score, one.rival.name) for one in found), default=(0.0, ""))[1])
    if not specified.comparable:
        return Better()
    given = specified.joint(question, specified.moving)
    if given.beyond_noise < MARGIN:
        return Better()
    best = min(_others(given, specified, rivals[1:], question), key=lambda fit: fit.beyond_noise, default=None)
    if best is None or not _beaten(given, best):
        return Better()
    # What moved under the rival may have moved under the specified circuit.
    again = specified.joint(question, best.moved)
    count, plain = int(best.moved.sum()), int(min(given.moved.sum(), again.moved.sum()))
    if not _beaten(again, best) or count >= plain or not _beyond_channels(specified, best.rival, question):
        return Better()
    return Better(best.rival.name, question.loaded, count, plain)


def _beaten(specified: JointFit, best: JointFit) -> bool:
    """Whether a rival explains better by MARGIN, wider where even the rival leaves more than noise."""
    return bool(specified.beyond_noise > best.beyond_noise + MARGIN * best.excess)


def _beyond_channels(specified: Explanation, rival: Rival, question: Question) -> bool:
    """Whether a rival's resistance in series explains better by MARGIN where channels may differ, too."""
    found = None if rival.in_series is None else _explanation(rival, question)
    if found is None:
        return True
    given, other = (beside_channels(one.rival.scene, one.fits).score for one in (specified, found))
    return given > other + MARGIN


def _others(given: JointFit, specified: Explanation, rivals: list[Rival], question: Question) -> Iterator[JointFit]:
    """The specified circuit and its likeliest rivals, as linear theory has it, explained by the networks themselves."""
    plain = (_explanation(rival, question) for rival in rivals)
    better = (one for one in plain if one is not None and one.score < specified.score)
    likely = sorted(better, key=lambda one: one.score)[:MOST_ASKED]
    begun = (with_some_in_series(one.rival, question) for one in likely)
    for one in (specified, *likely, *(one for one in begun if one is not None)):
        try:
            fit = given if one is specified else one.joint(question, one.moving)
            most = most_in_series(fit.rival, question)
            fits = [fit] * (one is not specified) + ([fit.with_series(most)] if most else [])
        except (InputError, *BROKEN):
            continue
        yield from (fit for fit in fits if mostly_still(fit.moved) and np.isfinite(fit.score))


def _explanation(rival: Rival, question: Question) -> Explanation | None:
    """Of a rival as it is; where it explains nothing, with the resistance in series that explains best of a few."""
    return Explanation.of(rival, question) or with_some_in_series(rival, question)


def with_some_in_series(rival: Rival, question: Question) -> Explanation | None:
    """Of a rival with the resistance in series that explains best of a few; None where it has none."""
    most = 0.0 if rival.in_series is not None else most_in_series(rival, question)
    found: list[Explanation] = []
    for ohm in np.linspace(0, most, GRID)[int(rival.scene.specified_in_series == 0) :] if most else ():
        one = Explanation.of(rival.with_series(float(ohm)), question, found[-1] if found else None)
        found += [] if one is None else [one]
    return min(found, key=lambda one: one.score, default=None)


def most_in_series(rival: Rival, question: Question) -> float:
    """The largest resistance in series that the readings allow, ohm; 0 where there is none, or no telling."""
    if not rival.scene.circuit.series_name or len(question.standing) == 0:
        return 0.0
    without = rival.with_series(0.0)
    try:
        read = question.readings(without)
    except (InputError, *BROKEN):
        return 0.0
    known = [(one.value, sigma) for one in read if (sigma := one.sigma_of_values) is not None]
    most = min(without.scene.circuit.most_in_series(value[None], sigma[None]) for value, sigma in known)
    return NEARLY_ALL * most if np.isfinite(most) and most > 0 else 0.0


def _lawful(rival: Rival, question: Question) -> bool:
    """Whether every frame keeps the inequalities of a circuit that is to take the specified one's place."""
    readings = rival.readings()
    used = replace(readings, seen=readings.seen * question.specified.nearly_gaussian(1))
    return not broken_law(rival.scene, used, question.widening, np.arange(len(used.value)))
