"""Recognition of attachments in the results of a run, which hold the readings with their noise."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lampest.apps.recognition.detect.answer import MIN_PROBABILITY, Detected
from lampest.apps.recognition.detect.detection import (
    HEAD_FRAMES,
    Frames,
    Known,
    noise_by_scatter,
    with_bounds_counted,
    with_slow_waves,
)
from lampest.panel.panel import Array
from lampest.recording.readings import stand_in
from lampest.runs.case import CaseResult
from lampest.runs.executors import each_of
from lampest.runs.filling import frame_noise_of
from lampest.runs.results import Results


def detect_results(
    results: Results,
    patch_mm: float | None = None,
    threshold: float = MIN_PROBABILITY,
    on_case: Callable[[int, int], None] = lambda done, total: None,
) -> list[Detected]:
    """Return the answer to every recording of a results file."""
    return list(
        each_of(
            _of_case,
            [(results.of(name)[0], patch_mm, threshold) for name in results.recordings()],
            on_case,
        )
    )


def _of_case(task: tuple[CaseResult, float | None, float]) -> Detected:
    case, patch_mm, threshold = task
    known, frames = known_of_case(case, patch_mm)
    messages = tuple(filter(None, case.warnings.split("\n")))
    answer = replace(known, threshold=threshold).answer(frames)
    return replace(answer, warnings=(*answer.warnings, *messages))


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
        patch_mm,
        explained=lambda: case.model_mark != "no",
        start_time=case.start_time,
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
