"""`lampest study weights`: every case of a run that has one penalty, its rules' choices, the curves, a figure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.recording.recording import Recording
from lampest.runs.config import Case, Run, read_run
from lampest.studies import study
from lampest.studies.weights.choices import Tuned, tune
from lampest.studies.weights.curves import WeightSubject, squared, why_not
from lampest.studies.weights.figure import file_name, weights_figure


@dataclass(frozen=True, eq=False)
class TunedCases:
    """tuned : in the order of the run. left_out : 'recording/estimator left out: why'."""

    tuned: Sequence[Tuned]
    left_out: Sequence[str]


def run_weights(run: Run, on_step: study.OnStep) -> TunedCases:
    """Every case that has one penalty with a squared loss. on_step is called with how many of how many are done.

    Raises InputError where there is none, or where a rule needs the noise and it is unknown.
    """
    tuned: list[Tuned] = []
    left_out: dict[str, str] = {}
    for number, case in enumerate(run.cases, 1):
        found = _tuned(case)
        if isinstance(found, Tuned):
            tuned.append(found)
        else:
            left_out[f"{case.recording}/{case.name}"] = found
        on_step(number, len(run.cases))
    if not tuned:
        raise InputError(f"nothing to tune: {'; '.join(f'{name}: {reason}' for name, reason in left_out.items())}")
    return TunedCases(tuned, [f"{name} left out: {reason}" for name, reason in left_out.items()])


def _tuned(case: Case) -> Tuned | str:
    recording = Recording.load(case.path)
    frames = 2 if case.estimator.relative else 1
    reason = why_not(case.estimator, frames * recording.scene.panel.crossings)
    if reason is not None:
        return reason
    subject = WeightSubject.of(case, recording)
    if subject is None:
        return "too little was read of every measured frame"
    found = tune(subject)
    return found if any(point.solved for point in found.curves.points) else "it was solved for no weight"


FIGURES: study.Figures = {  # of a case and one rule's choice
    "recording": lambda both: both[0].recording,
    "estimator": lambda both: both[0].name,
    "frame": lambda both: both[0].frame,
    "rule": lambda both: both[1].rule,
    "in_use": lambda both: int(both[1].in_use),
    "weight": lambda both: both[1].weight,
    "weight_unit": lambda both: both[0].weight_unit,
    "solves": lambda both: both[1].solves,
    "rms_log_error": lambda both: both[1].error,
    "over_best": lambda both: both[1].excess,
}
SCREEN: dict[str, Callable[[study.Row], str]] = {
    "recording": lambda row: row.recording,
    "estimator": lambda row: row.estimator,
    "rule": lambda row: row.rule,
    "in use": lambda row: "*" * row.in_use,
    "λ": lambda row: study.text_of(row.weight) or "none",
    "unit of λ": lambda row: row.weight_unit,
    "solves": lambda row: study.text_of(row.solves, "d"),
    "true error": lambda row: study.text_of(row.rms_log_error, ".4f"),
    "over the best": lambda row: study.text_of(row.over_best, ".3f"),
}


def _write_curves(entry: Any, found: TunedCases) -> None:
    """/entry/<recording>/<estimator>: everything over the weight; `choices` beside it."""
    for one in found.tuned:
        recording = entry.require_group(one.subject.recording)
        hdf5.set_attributes(recording, NX_class="NXsubentry")
        _write_one(recording.create_group(one.subject.name), one)


def _write_one(group: Any, one: Tuned) -> None:
    subject, points = one.subject, one.curves.points
    signal = "evidence" if subject.noisy else "press"
    hdf5.set_attributes(group, NX_class="NXdata", signal=signal, axes=["weight"], frame=subject.frame)
    hdf5.set_attributes(group, readings=subject.count, noise_known=int(subject.noisy))
    hdf5.write_scale(group, "weight", one.curves.values("weight"), subject.weight_unit, "weight of the penalty")
    unit, square = "1" if subject.noisy else squared(subject.misfit_unit), squared(subject.misfit_unit)
    curves = (
        ("misfit", unit, "sum of squared misfits, over the noise's mean square where that is known"),
        ("penalty", squared(subject.penalty_unit), "sum of squared penalties"),
        ("evidence", "1", "-2 log of the Laplace evidence, up to a constant"),
        ("risk", "1", "estimate of the sum of squared errors of log resistance"),
        ("press", square, "sum of squared errors of readings predicted from all others"),
        ("error", "1", "true root-mean-square error of log resistance over the frame"),
        ("open_cells", "1", "cells of the frame at their upper bound"),
        ("bound_cells", "1", "cells at a bound, of all frames of the solve"),
        ("solved", "1", "1: solved, 0: failed"),
    )
    study.write_columns(group, points, curves, ("weight",), float)
    choices = group.create_group("choices")
    hdf5.set_attributes(choices, NX_class="NXcollection")
    study.write_columns(choices, one.choices, (("rule", "1", "rule"), ("in_use", "1", "1: the estimator's")))
    numbers = (
        ("weight", subject.weight_unit, "the rule's weight, NaN where it has none"),
        ("solves", "1", "solves that it took, NaN where it needs the whole curve"),
        ("error", "1", "true root-mean-square error of log resistance"),
        ("excess", "1", "error over that of the best weight in hindsight"),
    )
    study.write_columns(choices, one.choices, numbers, (), float)


def weight_rows(found: TunedCases) -> list[study.Row]:
    """A row for every case and rule."""
    return study.rows_of([(one.subject, choice) for one in found.tuned for choice in one.choices], FIGURES)


STUDY: study.Study[Run, TunedCases] = study.Study(
    "tune",
    "cases",
    "tune.yaml",
    read_run,
    run_weights,
    FIGURES,
    weight_rows,
    lambda found: [("", study.screen_table(weight_rows(found), SCREEN))],
    "tune/1",
    _write_curves,
    lambda found: {f"tune_{file_name(one)}": weights_figure(one) for one in found.tuned},
    left_out=lambda found: found.left_out,
)
