"""Results → detections: every estimate of every recording, and the readings themselves, frame by frame."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import hypot
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.files.log import told_reason
from lampest.loads.pressure import water_pressure
from lampest.loads.recognition.baseline import Baseline
from lampest.loads.recognition.candidates import KINDS, LOADS, Several
from lampest.loads.recognition.detector import MOST_AT_ONCE, Detector, Zero
from lampest.loads.recognition.fit import Fit
from lampest.loads.recognition.frame import Direct, Observation, TwoStep, counting
from lampest.loads.recognition.settings import RecognitionSettings
from lampest.loads.recognition.verdict import Verdict, further
from lampest.loads.shapes.round import QUANTITIES as DISC_QUANTITIES
from lampest.panel.panel import Array
from lampest.panel.scene import Water
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.readings import AT_LEAST, VALUE, Readings, StandIn
from lampest.runs.case import SHARED
from lampest.runs.executors import each_of
from lampest.runs.results import CaseResult, Results, read_results
from lampest.runs.results.scene import frame_noise_of

NOT_SOLVED = "not solved"
AS_PUBLISHED = RecognitionSettings()
MOST_SOURCES = 80  # readings and estimates of recordings: some 40 ms a frame of each
PLACE = 0.25  # of a diameter: two fits with centres this close are of the same load
# Those of a disc first, in their order; then what other shapes report beside them.
QUANTITIES = tuple(dict.fromkeys((*DISC_QUANTITIES, *(quantity for load in LOADS for quantity in load.quantities))))


@dataclass(frozen=True, eq=False)
class Detection:
    """One recording as one estimate of it, or the readings themselves, show it.

    Parameters
    ----------
    recording, source : the recording's name, and the estimator's, or `runs.case.SHARED` for the readings themselves.
    frame, time : (frames) index into the recording, and s.
    labels : (frames) what the frame may be called. probabilities : (frames, kinds) in the order of KINDS.
    values, errors : (frames, quantities) and their standard deviations; NaN where there is no such load or number.
    further : the same for the second load and the third, where several are there at once. count : (frames) of loads.
    goodness : (frames) χ² per reading of the most probable candidate; NaN where the frame was not solved.
    tared : (frames) why the unloaded panel was taken anew after a frame; '' where it was not.
    """

    recording: str
    source: str
    frame: NDArray[np.int64]
    time: Array
    labels: tuple[str, ...]
    probabilities: Array
    values: Array
    errors: Array
    further: tuple[tuple[Array, Array], ...]
    count: NDArray[np.int64]
    goodness: Array
    tared: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        recording: str,
        source: str,
        frame: NDArray[np.int64],
        time: Array,
        verdicts: tuple[Verdict | None, ...],
        tared: tuple[str, ...] = (),
    ) -> "Detection":
        """From the verdicts on all frames; None where a frame was not solved."""
        unknown = np.full(len(KINDS), np.nan)
        return cls(
            recording,
            source,
            frame,
            time,
            tuple(NOT_SOLVED if verdict is None else verdict.label for verdict in verdicts),
            np.array([unknown if verdict is None else verdict.probabilities for verdict in verdicts]),
            *_numbers(verdicts, 0),
            tuple(_numbers(verdicts, number) for number in range(1, MOST_AT_ONCE)),
            np.array([0 if verdict is None else _count(verdict) for verdict in verdicts]),
            np.array([np.nan if verdict is None else verdict.goodness for verdict in verdicts]),
            tared or ("",) * len(verdicts),
        )


def _numbers(verdicts: tuple[Verdict | None, ...], number: int) -> tuple[Array, Array]:
    """(values, errors) of the load with that number, (frames, quantities)."""
    both = [numbers_of(verdict, number) for verdict in verdicts]
    return np.array([values for values, _ in both]), np.array([errors for _, errors in both])


def _count(verdict: Verdict) -> int:
    """How many loads the most probable candidate has; 0 where there is none or nobody knows which."""
    return 1 + further(verdict.best.candidate) if verdict.best in verdict.loads else 0


def numbers_of(verdict: Verdict | None, number: int = 0) -> tuple[Array, Array]:
    """(values, errors) of one load of the most probable candidate, (quantities); NaN for what it has none of.

    Of a single load Σ P v, and √(Σ P (σ² + v²) − (Σ P v)²), over all single loads in its place that have the quantity:
    what is a cup or a mouth is as large as either may be.
    """
    values, errors = np.full((2, len(QUANTITIES)), np.nan)
    if verdict is None or number > further(verdict.best.candidate):
        return values, errors
    best = _reported(verdict.best, number)
    if isinstance(verdict.best.candidate, Several):
        return best
    weights = np.array([_in_place(fit, verdict.best) for fit in verdict.fits]) * verdict.shares
    each = np.array([_reported(fit) for fit in verdict.fits])
    known = np.isfinite(each[:, 0]) * np.isfinite(best[0]) * weights[:, None]
    total = known.sum(axis=0)
    with np.errstate(invalid="ignore"):
        mean = np.nansum(known * each[:, 0], axis=0) / total
        square = np.nansum(known * (each[:, 1] ** 2 + (each[:, 0] - mean) ** 2), axis=0) / total
    return np.where(total > 0, mean, values), np.where(total > 0, np.sqrt(square), errors)


def _in_place(fit: Fit, best: Fit) -> bool:
    """Whether a fit is one load where the best one is, within PLACE of its diameter."""
    if fit is best or isinstance(fit.candidate, Several):
        return fit is best
    one, other = fit.candidate.disc(fit.parameters), best.candidate.disc(best.parameters)
    if one is None or other is None:
        return False
    return hypot(one.x_mm - other.x_mm, one.y_mm - other.y_mm) < PLACE * other.diameter_mm


def _reported(fit: Fit, number: int = 0) -> tuple[Array, Array]:
    """(values, errors) of one load of a fit, (quantities); NaN for what it has none of."""
    values, errors = np.full((2, len(QUANTITIES)), np.nan)
    one, (found, slopes) = fit.candidate, fit.candidate.report(fit.parameters)
    if isinstance(fit.candidate, Several):
        one, (found, slopes) = fit.candidate.parts[number], fit.candidate.of_part(number, fit.parameters)
    columns = [QUANTITIES.index(quantity) for quantity in one.quantities]
    values[columns], errors[columns] = found, np.sqrt(np.einsum("qi,ij,qj->q", slopes, fit.covariance, slopes))
    return values, errors


def detect_file(
    path: str | Path,
    settings: RecognitionSettings = AS_PUBLISHED,
    on_case: Callable[[int, int], None] = lambda done, total: None,
    on_refused: Callable[[str], None] = lambda sentence: None,
    frames: range | None = None,
    estimators: Sequence[str] = (),
) -> tuple[Results, tuple[Detection, ...]]:
    """A results file and its detections; frames : as `read_results` takes them. estimators : as `detect` does.

    Raises InputError where it cannot be read, no recording can be looked at, or an estimator is unknown.
    """
    results = read_results(path, frames=frames)
    if not results.cases:
        raise InputError(f"{path}: holds no results to look at")
    try:
        return results, detect(results, settings, on_case, on_refused, estimators)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def detect(
    results: Results,
    settings: RecognitionSettings = AS_PUBLISHED,
    on_case: Callable[[int, int], None] = lambda done, total: None,
    on_refused: Callable[[str], None] = lambda sentence: None,
    estimators: Sequence[str] = (),
) -> tuple[Detection, ...]:
    """For every recording what its readings show (source SHARED), then what each estimate of it shows.

    estimators : those that are looked at; where none is named, those of `looked_at`.
    A recording of another readout, or of unknown noise, is left out, and `on_refused` gets why. Raises InputError
    where none is left, or an estimator is unknown.
    """
    chosen = results.named("estimator", estimators or looked_at(results))
    given: dict[str, GivenRecording] = {}
    refused: list[InputError] = []
    for name in results.recordings():
        try:
            given[name] = GivenRecording.of(results.of(name)[0], settings)
        except InputError as error:
            refused.append(error)
    if not given:
        raise refused[0]
    for sentence in refused:
        on_refused(str(sentence))
    tasks = [
        (recording, source)
        for name, recording in given.items()
        for source in (None, *(case for case in chosen.cases if case.recording == name))
    ]
    return tuple(each_of(_detected, tasks, on_case))


def looked_at(results: Results) -> tuple[str, ...]:
    """The estimators that `detect` looks at unasked: with the readings at most MOST_SOURCES series, at least one.

    A shape is fitted to every frame of a series, some 40 ms each, so that hundreds of them would take many minutes.
    """
    return results.estimators()[: max(1, MOST_SOURCES // max(1, len(results.recordings())) - 1)]


def _detected(task: "tuple[GivenRecording, CaseResult | None]") -> Detection:
    given, source = task
    name = f"{given.case.recording}, {SHARED if source is None else source.estimator}"
    try:
        return detected(given, source)
    except (ArithmeticError, ValueError) as error:
        raise InputError(f"{name}: {told_reason(error, name)}") from error


@dataclass(frozen=True, eq=False)
class GivenRecording:
    """A recording as the recognition is given it.

    case : any of its estimates. patch_mm : edge of a film. water : (rows, columns) kPa. noise : what the readings of a
    frame share by chance, or None.
    measured, sigma : (frames, rows, columns) ohm; the substitute of a missing reading has so large a σ that it does
    not count. enough : (frames) whether there is something to look at. baseline : the unloaded panel.
    zero_after : frames without a load from which that is taken anew.
    """

    case: CaseResult
    patch_mm: float
    water: Array
    measured: Array
    sigma: Array
    enough: NDArray[np.bool_]
    baseline: Baseline
    zero_after: int
    noise: FrameNoise | None

    @classmethod
    def of(cls, case: CaseResult, settings: RecognitionSettings) -> "GivenRecording":
        """From one case of the recording. Raises InputError where the noise is unknown."""
        scene, depth = case.scene, settings.top_row_depth_mm
        water = water_pressure(scene.panel, scene.water if depth is None else Water(depth))
        measured, unloaded = np.stack([_complete(frame) for frame in case.measured]), _complete(case.measured_baseline)
        sigma = np.where(case.valued, _noise(case, case.sigma, measured, settings), counting(np.zeros(1), measured))
        resting = _noise(case, case.sigma_baseline, unloaded, settings)
        try:
            errors = settings.model_errors
            if errors == AS_PUBLISHED.model_errors:  # what the scene and the frames say of errors and of the film
                errors = errors.told_by(scene, case.reading_error)
            noise = frame_noise_of(case.frame_noise, scene)
            common = None if noise is None else noise.columns(unloaded[None], True)
            baseline = Baseline.of(unloaded, resting, scene, errors, common)
        except ValueError as error:
            raise InputError(f"{case.recording}: {told_reason(error, case.recording)}") from error
        side = np.where(case.valued, VALUE, AT_LEAST)  # what is no value is not asked on which side it bounds
        enough = Readings(measured, None, side, np.ones(side.shape)).enough(scene)
        patch_mm, after = settings.patch_of(scene.panel), settings.zero_after
        return cls(case, patch_mm, water, measured, sigma, enough, baseline, after, noise)

    def frames(self) -> Iterator[Direct]:
        """All frames; the baseline ended one period before the first."""
        time = self.case.time
        period = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        for place, measured in enumerate(self.measured):
            seconds = float(time[place] - time[0]) + period
            common = None if self.noise is None else self.noise.columns(measured[None], False)
            yield Direct(measured, self.sigma[place], self.baseline, self.water, seconds, common=common)


def detected(given: GivenRecording, source: CaseResult | None) -> Detection:
    """What an estimate shows, or the readings themselves for None; frames that failed are left out."""
    zero, detector = Zero(given.case.scene, given.zero_after, given.baseline), None
    verdicts: list[Verdict | None] = []
    tared: list[str] = []
    for place, taken in enumerate(given.frames()):
        frame = zero.seen(taken)
        detector = detector or Detector.of(given.case.scene.panel, given.patch_mm, frame)
        if not (given.enough[place] and (source is None or source.solved[place])):
            verdict, zero = None, zero.broken()
        else:
            shown = frame if source is None else _compared(frame, source.cell_resistance[place])
            detector, verdict = detector.push(shown)
            zero, detector = zero.after(frame, verdict, detector)
        verdicts.append(verdict)
        tared.append(zero.said)
    name = SHARED if source is None else source.estimator
    return Detection.of(given.case.recording, name, given.case.frame, given.case.time, tuple(verdicts), tuple(tared))


def _compared(frame: Direct, estimate: Array) -> Observation:
    """The frame with an estimate of its cells."""
    known = frame.measured, frame.sigma, frame.baseline, frame.water, frame.seconds
    return TwoStep(*known, estimate, common=frame.common)


def _complete(measured: Array) -> Array:
    """A frame (rows, columns) with substitutes for its missing readings."""
    known = np.isfinite(measured)
    return measured if known.all() else np.where(known, measured, StandIn.of(measured, known).value)


def _noise(case: CaseResult, sigma: Array | None, measured: Array, settings: RecognitionSettings) -> Array:
    if sigma is None and settings.noise_percent is None:
        raise InputError(
            f"{case.recording}: the noise of the readings is unknown, and without it nothing can be told from noise; "
            "add a readout to the scene or sigma to the recording and run again, or give the noise in percent"
        )
    if sigma is None:
        return np.asarray(measured * (settings.noise_percent or 0.0) / 100)
    return counting(sigma, measured)
