"""Recognition of attachments in recordings and results, frame by frame of the readings.

Results hold the readings with their noise.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lampest.apps.film.tare import sigma_of_frames
from lampest.apps.recognition.at_rest import touched
from lampest.apps.recognition.breath import too_slow
from lampest.apps.recognition.detect.answer import MIN_PROBABILITY, Detected
from lampest.apps.recognition.image import ImageWatch
from lampest.apps.recognition.model_errors import ModelErrors
from lampest.apps.recognition.watch import MAX_CELLS, Watch
from lampest.apps.recognition.watch_parts import WatchSetup
from lampest.files.errors import InputError
from lampest.files.hdf5 import format_of
from lampest.files.levels import NOISE_REACH
from lampest.files.process import ONE_BLAS_THREAD, logged_reason
from lampest.inference.effects.converter_ends import with_saturated_stage
from lampest.inference.noise import NoiseEstimate, without_factors
from lampest.inference.nuisances import CircuitEffects, without_effects_of
from lampest.inference.prepared import Prepared
from lampest.inference.warnings import warnings_of
from lampest.panel.panel import Array, Mask
from lampest.panel.scene import Scene
from lampest.posterior.frame_noise import FrameNoise
from lampest.recording.readings import Readings, Sidedness, stand_in
from lampest.recording.recording import (
    MEASURED,
    TOUCHED,
    UNEVENLY,
    UNLOADED,
    Recording,
    baseline_readings,
)
from lampest.recording.stored import StoredRecording
from lampest.runs.case import CaseResult
from lampest.runs.checks import kept_check
from lampest.runs.executors import each_of
from lampest.runs.filling import frame_noise_of
from lampest.runs.provenance import digest
from lampest.runs.results import Results

BY = "from the readings; cells by Gauss-Newton steps with a Gaussian prior"
NO_RESPONSE = (
    "no pressures and forces, since the scene names no response; "
    "shapes are fitted with the published one"
)
NOT_CHECKED = "the circuit was not checked: --no-check leaves it out"
HEAD_FRAMES = 100  # measured frames from which, with the unloaded ones, the noise is estimated
# Of the change to a bound: the cell is pressed at least so much, how much more is unknown.
BOUND_SHARE = 0.1
# Assumed period of waves, s. Within T < P/2, a wave of the period P changes frames about their mean
# by √12 P/(2π T) times less than in all.
WAVE_S = 5.0
Frames = Iterator[tuple[Array, Array, float]]


@dataclass(frozen=True, eq=False)
class Known:
    """Knowledge of a recording before its first measured frame.

    Attributes
    ----------
    name : str
        Name of the recording.
    scene : Scene
    resting, sigma : array, shape (rows, columns)
        Mean of the unloaded readings, and the standard deviation of one frame.
    unloaded : array, shape (frames, rows, columns)
        The unloaded readings; NaN where one is no value.
    begin : float
        Time of the last unloaded frame, s.
    reading_error : float
        Each reading's own error, see `NoiseEstimate`.
    noise : FrameNoise or None
        Random errors that the readings of a frame share.
    notes : tuple of str
        Assumptions.
    explained : callable
        Returns whether the circuit explains the readings, as `WatchSetup` has it.
    patch_mm : float or None
        Edge of a cell's film; None where it is not specified.
    effects : CircuitEffects or None
        Effects that are taken off the readings.
    threshold : float
        Probability from which an attachment is called a lamprey, or a suction cup.
    resting_side : array, shape (rows, columns), or None
        Sides of the unloaded readings that are bounds, see `Readings`; None: all are values.
    log_factor : array, shape (rows, columns), or None
        Logarithm of the factor on each recorded value that is taken off the frames, as it is off
        `resting`; None: nothing is.
    """

    name: str
    scene: Scene
    resting: Array
    sigma: Array
    unloaded: Array
    begin: float
    reading_error: float
    noise: FrameNoise | None
    notes: tuple[str, ...]
    explained: Callable[[], bool]
    patch_mm: float | None = None
    effects: CircuitEffects | None = None
    threshold: float = MIN_PROBABILITY
    resting_side: Array | None = None
    log_factor: Array | None = None

    @ONE_BLAS_THREAD
    def watch(self) -> Watch | ImageWatch:
        """Return the watch before the first frame.

        Raises ValueError if the panel is too large.
        """
        panel = self.scene.panel
        if panel.network.crossings > MAX_CELLS:
            raise ValueError(
                f"loads are recognised on panels and modules of up to {MAX_CELLS} cells"
            )
        errors = ModelErrors().of_scene(self.scene, self.reading_error)
        noise = self.noise if panel.modules is None else None
        setup = replace(
            WatchSetup.of(self.scene, errors, self.patch_mm, noise), explained=self.explained
        )
        kind = Watch if panel.modules is None else ImageWatch
        return kind.begin(setup, self.resting, self.sigma, self.unloaded, self.begin)

    @ONE_BLAS_THREAD
    def answer(self, frames: Frames) -> Detected:
        """Return the answer after all frames."""
        course = list[tuple[float, float]]()
        failed = list[str]()
        try:
            watch = self.watch()
        except (ArithmeticError, ValueError) as error:
            return Detected.unknown(self.name, logged_reason(error, self.name))
        for value, sigma, time in frames:
            try:
                watch = watch.push(value, sigma, time)
                course.append((time, watch.stands_out))
            except (ArithmeticError, ValueError) as error:  # such a frame is left out
                failed.append(
                    f"the frame at {time:.1f} s is left out: {logged_reason(error, self.name)}"
                )
        if len(course) < 2:
            return Detected.unknown(
                self.name, failed[0] if failed else "one frame shows no change; three are needed"
            )
        answer = self.detected(watch.ended(), [time for time, _ in course], np.array(course).T)
        failed[1:] = [f"so are {len(failed) - 1} more frames"] if len(failed) > 1 else []
        return replace(answer, notes=(*answer.notes, *failed))

    def detected(
        self, watch: Watch | ImageWatch, times: Sequence[float], course: Array | None = None
    ) -> Detected:
        """Return the answer after the frames so far.

        Parameters
        ----------
        watch : Watch or ImageWatch
        times : sequence of float
            Times of the last frames, s.
        course : array, optional
            As in `Detected`.
        """
        attachments = watch.attachments
        response = self.scene.response
        # by the median step of time
        rate = float(1 / np.median(np.diff(times))) if len(times) > 1 else 0.0
        if watch.doubt and not attachments:
            return replace(
                Detected.unknown(self.name, watch.doubt), frames_per_second=rate, course=course
            )
        if response is None:
            attachments = tuple(replace(load, suctions=()) for load in attachments)
        faults = tuple(
            f"{line} is open in frames from {at:.1f} s on; these are left out"
            for line, at in watch.faults
        )
        brief = tuple(
            f"something touched the panel from {begin:.1f} s to {end:.1f} s, "
            "too shortly to be recognised"
            for begin, end in watch.brief
        )
        leaks = tuple(
            f"from {watch.leaks_since_s:.1f} s on the readings show "
            f"{leak.sentence(self.scene.panel.rows)}, which counts as a part of the circuit"
            for leak in watch.leaks
        )
        slow = too_slow(rate) if any(load.sucks > 0.5 for load in attachments) else ""
        assumed = (BY, "" if response else NO_RESPONSE, slow, watch.doubt)
        detected = Detected.of(
            self.name,
            attachments,
            rate,
            notes=(*self.notes, *faults, *brief, *filter(None, assumed)),
            course=course,
            change=watch.change,
            panel=self.scene.panel,
            mat=self.scene.purpose == "mat",
            warnings=leaks,
            threshold=self.threshold,
            end_s=times[-1] if times else None,
        )
        return replace(detected, why=brief[-1]) if brief and not attachments else detected

    def values(self, readings: Readings) -> tuple[Array, Array]:
        """Return the values of one frame with their noise.

        Returns
        -------
        values : array, shape (rows, columns)
        sigma : array, shape (rows, columns)
            Infinite where a reading is no value and does not bound a change; see
            `with_bounds_counted`.
        """
        readings = without_factors(readings, self.scene, self.log_factor)
        sigma = self.sigma if readings.sigma is None else readings.sigma
        side = np.where(readings.seen > 0, readings.side, np.nan)
        return with_bounds_counted(readings.value, sigma, side, self.resting, self.resting_side)


def with_bounds_counted(
    value: Array, sigma: Array, side: Array, resting: Array, resting_side: Array | None
) -> tuple[Array, Array]:
    """Return frames in which bounds count as far as they say anything.

    A bound beyond the resting reading is a change of that much at least: its value with a σ of
    BOUND_SHARE of the change. A bound that was one at rest, too, shows no change. All others have
    an infinite σ.

    Parameters
    ----------
    value, sigma, side : array, shape (…, rows, columns)
        Readings; the side is NaN where one is missing.
    resting : array, shape (rows, columns)
        Unloaded readings.
    resting_side : array, shape (rows, columns), or None
        Their sides; None: all are values.

    Returns
    -------
    value, sigma : arrays, shape (…, rows, columns)
    """
    was_bound = np.zeros(resting.shape) if resting_side is None else resting_side
    change = value - resting
    size = np.abs(change)
    still = (side != Sidedness.VALUE) & (side == was_bound)
    known = (side == Sidedness.VALUE) | still
    beyond = (side * change > 0) & (size > NOISE_REACH * sigma)
    counted = np.where(beyond, np.maximum(sigma, BOUND_SHARE * size), np.inf)
    return np.where(still, resting, value), np.where(known, sigma, counted)


def with_slow_waves(noise: FrameNoise | None, lasted_s: float) -> FrameNoise | None:
    """Return the noise with the motion of waves that are slower than the unloaded frames.

    `lasted_s` is the duration of the unloaded frames.
    """
    if noise is None:
        return None
    slower = 12**0.5 * WAVE_S / (2 * np.pi * max(lasted_s, 1e-9))
    return replace(noise, motion=noise.motion * max(1.0, slower))


class Unchecked(NamedTuple):
    """Answer to a recording whose circuit may not have been checked yet.

    Attributes
    ----------
    answer : Detected
    doubts : callable or None
        Checks the circuit and returns all warnings. None if no check is to be made: of results,
        without one, or with one that a run has kept. The answer has its warnings then.
    """

    answer: Detected
    doubts: Callable[[], Sequence[str]] | None = None

    def checked(self) -> Detected:
        """Return the answer with all warnings that do not repeat it."""
        warnings = self.answer.warnings if self.doubts is None else self.doubts()
        repeating = (TOUCHED, UNEVENLY)
        messages = (line for line in warnings if line and not line.startswith(repeating))
        return replace(self.answer, warnings=tuple(messages))


def detect_recording(path: Path, **options: Any) -> Detected:
    """Return the answer to a recording with the check of its circuit, see `answer_recording`."""
    return answer_recording(path, **options).checked()


def answer_recording(
    path: Path,
    patch_mm: float | None = None,
    frames: range | None = None,
    threshold: float = MIN_PROBABILITY,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
    *,
    check: bool = True,
) -> Unchecked:
    """Return the answer to a recording, which is read part by part.

    The answer does not wait for the check of the circuit, unless it depends on it. A check that a
    run has kept holds here, too. Raises InputError where the recording cannot be read.

    Parameters
    ----------
    path : Path
    patch_mm : float, optional
        Edge of a cell's film.
    frames : range, optional
        Frames that are watched; by default all.
    threshold : float
        Probability from which an attachment is called a lamprey, or a suction cup.
    on_frame : callable
        Receives the numbers of watched and of all frames.
    check : bool
        Whether the circuit is checked; otherwise it is taken to explain the readings, and a note
        says so.
    """
    stored = StoredRecording.of(path)
    part = stored.part(stored.blocks[0])
    measured = np.flatnonzero(part.role == MEASURED)[:HEAD_FRAMES]
    if not len(measured):
        raise InputError(f"{path}: no frame is measured (role 1)")
    head = Prepared(stored.part(range(measured[-1] + 1)))
    kept = kept_check(path, digest(path)) if check else None
    settled = None if check and kept is None else lambda: kept is None or kept.mark != "no"
    requested = range(stored.frames) if frames is None else frames

    def looked_at(known: Known) -> Frames:
        """Generate the requested measured frames, part by part."""
        for block in stored.blocks:
            measured = measured_frames(stored.part(block), known, np.isin(block, requested))
            for done, frame in enumerate(measured, block[0]):
                on_frame(done, stored.frames)
                yield frame
            on_frame(block[-1] + 1, stored.frames)

    answer = known_of(head, patch_mm, settled)
    if isinstance(answer, Known):
        answer = replace(answer, threshold=threshold).answer(looked_at(answer))
    answer = replace(answer, start_time=stored.start_time)
    seen = answer.warnings  # of leaks that began while the panel was watched
    doubts = partial(warnings_of, head.recording, recognition_noise(head))
    if kept is None and check:
        return Unchecked(answer, lambda: (*seen, *doubts(head.check)))
    known = (*doubts(None), NOT_CHECKED) if kept is None else kept.warnings.split("\n")
    return Unchecked(replace(answer, warnings=(*seen, *known)))


def known_of(
    prepared: Prepared,
    patch_mm: float | None = None,
    explained: Callable[[], bool] | None = None,
) -> "Known | Detected":
    """Return the knowledge from the first frames of a recording, or an answer.

    The answer has the reason why there is none. `explained` returns whether the circuit explains
    the readings; by default its check does, when a load needs to know.
    """
    head = prepared.recording
    readings = head.readings()
    notes = tuple[str, ...]()
    unloaded = np.flatnonzero(head.role == UNLOADED)
    seen = None if readings.sigma is None else recognition_noise(prepared)
    resting = baseline_readings(head, readings if seen is None else seen.readings)
    bounds = readings[unloaded].mean() if len(unloaded) else resting
    scene = head.scene
    # The unloaded panel may be one of bounds, as open cells give them.
    of_open = Sidedness.AT_LEAST if scene.circuit.unit == "ohm" else Sidedness.AT_MOST
    opened = bounds.bounds & (bounds.side == of_open) & scene.requested
    if not bounds.enough(scene) and 2 * opened.sum() >= scene.requested.sum():
        resting = bounds
    elif not resting.enough(scene):
        return Detected.unknown(head.name, "no frame has enough readings for a comparison")
    if touched(head):
        return Detected.unknown(head.name, TOUCHED)
    noise = None
    if seen is None or readings.sigma is None:
        if len(head.time) < 3:
            return Detected.unknown(head.name, "the noise is unknown, and too few frames show it")
        sigma, notes = noise_by_scatter(readings.plain_values)
    else:
        lasted_s = float(np.ptp(head.time[unloaded])) if len(unloaded) else 0.0
        noise = with_slow_waves(seen.frame, lasted_s)
        scene = with_saturated_stage(head).scene
        specified = np.min(np.where(readings.plain, readings.sigma, np.inf), axis=0)
        sigma = seen.sigma_factor / seen.model_factor * specified
        readings = seen.readings
    known = Known(
        head.name,
        scene,
        resting.value,
        sigma,
        readings.plain_values[unloaded],
        float(head.time[unloaded[-1] if len(unloaded) else 0]),
        0.0 if seen is None else seen.reading_error,
        noise,
        notes,
        explained or (lambda: prepared.check.explains is not False),
        patch_mm,
        None if seen is None else seen.corrected_effects,
        log_factor=None if seen is None else seen.log_factor,
    )
    side = np.where(resting.seen > 0, resting.side, 0.0)
    if not side.any():
        return known
    # Repeats of a bound are the bound
    values = np.where(side != Sidedness.VALUE, resting.value, known.unloaded)
    return replace(known, resting_side=side, unloaded=values)


def recognition_noise(prepared: Prepared) -> NoiseEstimate:
    """Return the noise for recognition; for modules that of their frames, which needs no fits."""
    return prepared.noise if prepared.layout is None else prepared.frame_noise


def measured_frames(part: Recording, watched: Known, asked: Mask) -> Frames:
    """Generate the values, σ and time in s of the requested measured frames, corrected for effects.

    Parameters
    ----------
    part : Recording
    watched : Known
    asked : boolean array, shape (frames,)
    """
    readings = Readings.of(watched.scene, part.recorded, part.sigma)
    besides = watched.effects
    if besides is not None and besides.pair is not None:
        readings = without_effects_of(besides.pair, readings, part.role == UNLOADED)
    for number in np.flatnonzero((part.role == MEASURED) & asked):
        yield *watched.values(readings[number]), float(part.time[number])


def noise_by_scatter(value: Array) -> tuple[Array, tuple[str, ...]]:
    """Return σ (rows, columns) from differences of successive frames, and a note on its origin."""
    # Of cells that have no value.
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        median = np.nanmedian(value, axis=0)
        relative = sigma_of_frames(np.log(value))
        size = float(np.nan_to_num(np.nanmedian(relative)))
    message = (
        f"the noise is unknown: {100 * size:.2g} % a reading, "
        "from differences of neighbouring frames"
    )
    return median * np.fmax(relative, max(size, 1e-6)), (message,)


def detect_results(
    results: Results,
    patch_mm: float | None = None,
    threshold: float = MIN_PROBABILITY,
    on_case: Callable[[int, int], None] = lambda done, total: None,
) -> list[Detected]:
    """Return the answer to every recording of a results file."""
    of_case = partial(_of_case, patch_mm=patch_mm, threshold=threshold)
    return each_of(of_case, [results.of(name)[0] for name in results.recordings()], on_case)


def _of_case(case: CaseResult, patch_mm: float | None, threshold: float) -> Detected:
    known, frames = known_of_case(case, patch_mm)
    messages = tuple(filter(None, case.warnings.split("\n")))
    answer = replace(known, threshold=threshold).answer(frames)
    return replace(answer, warnings=(*answer.warnings, *messages), start_time=case.start_time)


def known_of_case(case: CaseResult, patch_mm: float | None = None) -> tuple[Known, Frames]:
    """Return the knowledge of a recording from its results, as from the recording itself.

    Returns
    -------
    known : Known
    frames : iterable of (array, array, float)
        Values and σ, (rows, columns), and the time in s of each measured frame.
    """
    spread = case.sigma
    notes = tuple[str, ...]()
    period = float(np.median(np.diff(case.time))) if len(case.time) > 1 else 0.0
    noise = frame_noise_of(case.frame_noise, case.scene)
    # Results of earlier versions have the number of unloaded frames beside the noise that frames
    # share.
    count = case.unloaded_frames or (1 if noise is None else noise.unloaded)
    if spread is None or case.sigma_baseline is None:
        deviation, notes = noise_by_scatter(np.where(case.valued, case.measured, np.nan))
        spread = np.broadcast_to(deviation, case.measured.shape)
    else:
        spread = _frame_sigma(case, spread, 1)
        deviation = _frame_sigma(case, case.sigma_baseline, count)
        deviation = np.minimum(deviation, spread[:HEAD_FRAMES].min(axis=0))
    baseline = case.measured_baseline
    baseline = np.where(np.isfinite(baseline), baseline, stand_in(baseline, np.isfinite(baseline)))
    begin = float(case.time[0]) - period
    known = Known(
        case.recording,
        case.scene,
        baseline,
        deviation,
        # Results hold the mean of the unloaded frames alone.
        np.repeat(baseline[None], count, axis=0),
        begin,
        case.reading_error,
        with_slow_waves(noise, (count - 1) * period),
        notes,
        lambda: case.model_mark != "no",
        patch_mm,
    )
    sides = np.where(case.valued, 0.0, np.nan)
    if case.reading_side is not None:
        bounded = np.isfinite(case.measured) & (case.reading_side != 0)
        sides = np.where(bounded, case.reading_side, sides)
    values, spread = with_bounds_counted(case.measured, spread, sides, baseline, None)
    return known, zip(values, spread, map(float, case.time), strict=True)


def _frame_sigma(case: CaseResult, sigma: Array, count: int) -> Array:
    """Return σ of one frame's readings by the σ of the mean of `count` frames.

    The error of the model is left out; averaging does not reduce it, see `scaled` of
    `lampest.inference.model_error`.
    """
    return np.asarray(sigma * np.sqrt(count / (1 + count * (case.model_factor**2 - 1))))


def recordings_in(paths: Sequence[Path]) -> list[Path]:
    """Return the files, and of folders the recordings in them and in their folders.

    The recordings of a folder are in the order of their names.

    Raises InputError for a folder without a recording.
    """
    files = list[Path]()
    for path in paths:
        inside = [path]
        if path.is_dir():
            inside = sorted(path.rglob("*.h5"))
            inside = [file for file in inside if format_of(file).startswith("recording/")]
        if not inside:
            raise InputError(f"{path}: holds no recording (*.h5)")
        files += inside
    return list(dict.fromkeys(files))


def named_apart(answers: Sequence[Detected]) -> list[Detected]:
    """Return the answers with a number after the names of recordings that another one has, too."""
    named = dict[str, Detected]()
    for answer in answers:
        name = answer.recording
        number = 1
        while name in named:
            number += 1
            name = f"{answer.recording}_{number}"
        named[name] = replace(answer, recording=name)
    return list(named.values())
