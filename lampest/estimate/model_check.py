"""Whether the circuit that a scene specifies can have made the readings, in a sentence."""

from dataclasses import dataclass, replace
from functools import lru_cache
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray

from lampest.estimate.cells_fit import LEVEL
from lampest.estimate.comparison import Better, Explanation, better_rival, broken_law
from lampest.estimate.outliers import without_outliers
from lampest.estimate.rivals import Question, nearly_gaussian, rivals_of, standing_frames
from lampest.estimate.scatter import LEAST_FACTOR
from lampest.panel.panel import Array, Modules
from lampest.panel.scene import Scene
from lampest.posterior.interval import chi_square_tail, largest_of
from lampest.recording.readings import Readings, strongest_frame
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.solvers.multistart import BROKEN

EXPLAINED = "the circuit explains its readings"
MOST_MODULES = 3  # of which the circuit is checked
MOST_MISSING = 0.1  # of the readings: with a fifth missing, nothing shows which cells must have moved


@dataclass(frozen=True)
class ModelCheck:
    """What was found, for people in `sentence` (ASCII, as results files keep it).

    explains : whether nothing speaks against the specified circuit; None: not checked, because the noise is unknown or
    no fit was found. better : the circuit that explains the readings better, as a scene would name it; ''.
    noise : by how much the unloaded frames scatter beyond the specified noise; 1 where not noticeably.

    >>> lampest.ModelCheck(True, "the circuit explains its readings").mark
    'yes'
    """

    explains: bool | None
    sentence: str
    better: str = ""
    noise: float = 1.0

    @property
    def mark(self) -> str:
        """'yes', 'no', 'noise' where σ is in doubt and the circuit is not, or 'not checked'."""
        if self.explains is None:
            return "not checked"
        return "no" if not self.explains else "yes" if self.noise == 1 else "noise"


@lru_cache(maxsize=1)  # several estimators of one recording come one after the other
def recording_check(recording: Recording) -> ModelCheck:
    """The check of a recording's circuit, which all its estimates share. Raises InputError as `Readings.of`."""
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    measured = np.flatnonzero(recording.role == MEASURED)
    return model_check(recording.scene, recording.recorded, recording.sigma, unloaded, measured, recording.number)


def _of_modules(
    scene: Scene,
    layout: Modules,
    recorded: Array,
    sigma: Array | None,
    unloaded: NDArray[np.intp],
    measured: NDArray[np.intp],
    number: NDArray[np.intp] | None,
) -> ModelCheck:
    """Of the modules whose readings move most, MOST_MODULES of them: one circuit after the other takes its time."""
    values = layout.split(Readings.of(scene, recorded, sigma).plain_values)
    with catch_warnings(), np.errstate(all="ignore"):
        simplefilter("ignore")  # of a module that says nothing
        resting = np.nanmean(values[unloaded if len(unloaded) else [0]], axis=0)
        moved = np.nan_to_num(np.nanmean(np.abs(np.log(values[measured] / resting)), axis=(2, 3))).max(0, initial=0.0)
    living = [one for one in np.argsort(moved)[::-1].tolist() if one not in scene.dead_modules]
    chosen, found = sorted(living[:MOST_MODULES]), []
    for one in chosen:
        inside = (..., *layout.cells(one))
        known = None if sigma is None else sigma[inside]
        found.append((one, model_check(scene.of_modules[one], recorded[inside], known, unloaded, measured, number)))
    explains = [check.explains for _, check in found]
    verdict = False if False in explains else True if True in explains else None
    said = [(one, check) for one, check in found if check.explains is verdict]
    sentence = "; ".join(f"module {list(layout.place(one))}: {check.sentence}" for one, check in said)
    if len(chosen) < layout.count:
        sentence += f"; {len(chosen)} of {layout.count} modules were checked, those that move most"
    noise = max(check.noise for _, check in found)
    return ModelCheck(verdict, sentence, next((check.better for _, check in said if check.better), ""), noise)


def model_check(
    scene: Scene,
    recorded: Array,
    sigma: Array | None,
    unloaded: NDArray[np.intp],
    measured: NDArray[np.intp],
    number: NDArray[np.intp] | None = None,
) -> ModelCheck:
    """The check of frames (frames, rows, columns) as the scene's readout recorded them.

    unloaded, measured : which of the frames; without an unloaded one the first frame stands in. number : (frames) by
    which sentences name them; None: as they come. The unloaded panel's
    mean and the frame that differs most from it are explained by cells alone, every frame is held against the circuit's
    inequalities, and other circuits are tried on the same two. Raises InputError as `Readings.of`.
    """
    if scene.panel.modules is not None:
        return _of_modules(scene, scene.panel.modules, recorded, sigma, unloaded, measured, number)
    readings = Readings.of(scene, recorded, sigma)
    if readings.sigma is None:
        return ModelCheck(None, "the circuit was not checked: the noise of the readings is unknown")
    try:
        with np.errstate(all="ignore"):
            outliers, _ = without_outliers(readings, np.isin(np.arange(len(recorded)), unloaded))
            named = np.arange(len(recorded)) if number is None else number
            check = _checked(scene, np.where(outliers, np.nan, recorded), sigma, unloaded, measured, named)
            return replace(check, sentence=check.sentence + _said_of_outliers(int(outliers.sum())))
    except BROKEN:
        return ModelCheck(None, "the circuit was not checked: arithmetic broke down over its readings")


def _checked(
    scene: Scene,
    recorded: Array,
    sigma: Array | None,
    unloaded: NDArray[np.intp],
    measured: NDArray[np.intp],
    named: NDArray[np.intp],
) -> ModelCheck:
    """The check of readings whose noise is known, outliers left out."""
    readings = Readings.of(scene, recorded, sigma)
    resting = unloaded if len(unloaded) else np.array([0])
    others = np.setdiff1d(measured, resting)
    specified, *rivals = rivals_of(scene, recorded, sigma)
    used = replace(readings, seen=readings.seen * nearly_gaussian(specified, 1))
    noise = noise_factor(used[resting])
    standing = others
    if len(others):
        frame = strongest_frame(readings.plain_values, readings[resting].mean().value, others)
        standing = standing_frames(used, frame, others, noise)
    question = Question(specified, resting, standing, noise, named)
    found = Explanation.of(specified, question, patient=True)
    fault = ("" if found is None else _unexplained(found, question)) or broken_law(scene, used, noise, named)
    fault = fault or _below_series(scene, recorded, readings, named)
    if found is None and not fault:
        return ModelCheck(None, "the circuit was not checked: no fit of its cells was found", noise=noise)
    compared = readings[np.concatenate([question.resting, question.standing])]
    whole = float(compared.missing(scene).mean()) <= MOST_MISSING
    better = better_rival([specified, *rivals], question, None if fault else found) if whole else None
    sentence = _sentence(fault, better)
    if not whole:
        sentence = f"{fault or EXPLAINED}; other circuits were not tried, too many readings are missing"
    if noise > 1:
        sentence += f"; the unloaded frames scatter by {noise:.2g} times the noise that is told, which is allowed for"
    return ModelCheck(not fault and better is None, sentence, "" if better is None else better.name, noise)


def noise_factor(resting: Readings) -> float:
    """√(χ²/degrees) of unloaded frames (frames, rows, columns) about their mean; 1 where that is no noted excess."""
    plain = np.all((resting.side == 0) & (resting.seen > 0), axis=0)
    degrees = (len(resting.value) - 1) * int(plain.sum())
    if degrees == 0 or resting.sigma is None:
        return 1.0
    about = ((resting.value - resting.value.mean(axis=0)) / resting.sigma)[:, plain]
    chi_square = float(np.sum(about**2))
    factor = float(np.sqrt(chi_square / degrees))
    return factor if factor >= LEAST_FACTOR and chi_square_tail(chi_square, degrees) < LEVEL else 1.0


def _unexplained(found: Explanation, question: Question) -> str:
    """What the cells leave unexplained, in words; '' where nothing."""
    if found.holds:
        return ""
    worst = int(np.argmin([fit.tail for fit in found.fits]))
    fit, what = found.fits[worst], question.loaded if worst else "the unloaded panel"
    return (
        f"no cells give the readings of {what}: chi square is {fit.chi_square:.3g} where some {fit.degrees:.3g} would "
        f"be noise, {fit.worst_line()}"
    )


def _below_series(scene: Scene, recorded: Array, readings: Readings, named: NDArray[np.intp]) -> str:
    """The reading that lies below the series resistance by more than its noise, in words; '' where none does."""
    if scene.circuit.unit != "ohm" or readings.sigma is None:
        return ""
    left = scene.circuit.from_recorded(recorded, scene)
    known = (readings.seen > 0) & np.isfinite(left)
    excess = np.where(known, -left / readings.sigma, -np.inf)
    if largest_of(excess.max(), excess.size) >= LEVEL:
        return ""
    frame, row, column = (int(part) for part in np.unravel_index(np.argmax(excess), excess.shape))
    short = f"{-left[frame, row, column]:.3g} ohm below its series resistance, {excess[frame, row, column]:.3g} times"
    return f"the reading of row {row}, column {column} in frame {named[frame]} lies {short} its noise"


def _sentence(fault: str, better: Better | None) -> str:
    if fault:
        return f"{fault}; " + (
            "no other circuit that was tried gives them" if better is None else f"{better.name} does"
        )
    if better is None:
        return EXPLAINED
    return f"{better.name} explains the readings better: {better.reason}"


def _said_of_outliers(count: int) -> str:
    """What a sentence on the circuit says of them; nothing where there are none."""
    return f"; {count} outlier{'s' if count > 1 else ''} of one frame left out" if count else ""
