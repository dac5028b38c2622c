"""Results → detections: every estimate of every recording, and the readings themselves."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.files.log import told_reason
from lampest.loads.pressure import water_pressure
from lampest.loads.recognition.baseline import Baseline
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.frame import Direct, Observation, TwoStep, counting
from lampest.loads.recognition.settings import ModelErrors, RecognitionSettings
from lampest.loads.recognition.verdict import Verdict
from lampest.loads.recognition.zero import Zero
from lampest.panel.panel import Array
from lampest.panel.scene import Scene, Water
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.readings import AT_LEAST, VALUE, Readings, StandIn
from lampest.report.detect.detection import Detection
from lampest.runs.case import SHARED
from lampest.runs.executors import each_of
from lampest.runs.frame_noise import frame_noise_of
from lampest.runs.results import CaseResult, Results, read_results

AS_PUBLISHED = RecognitionSettings()
MOST_SOURCES = 80  # readings and estimates of recordings


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
    A recording of another readout, or of unknown noise, is left out, and `on_refused` is told why. Raises InputError
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
    measured, sigma : (frames, rows, columns) ohm; what stands in for a missing reading has so large a σ that it does
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
            errors = _model_errors(settings, scene, case.reading_error)
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
    told = frame.measured, frame.sigma, frame.baseline, frame.water, frame.seconds
    return TwoStep(*told, estimate, common=frame.common)


def _model_errors(settings: RecognitionSettings, scene: Scene, reading_error: float) -> ModelErrors:
    """What the settings assume; where they leave it as published, what scene and frames say of errors and of the film.

    reading_error : of the logarithm of each reading, the same in all frames, as the frames told.
    """
    errors = settings.model_errors
    return errors if errors != AS_PUBLISHED.model_errors else errors.told_by(scene, reading_error)


def _complete(measured: Array) -> Array:
    """A frame (rows, columns) with what stands in for its missing readings."""
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
