"""`lampest study weights`: every case of a run that has one penalty, its rules' choices, the curves, a figure."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.whole import write_whole
from lampest.recording.recording import Recording
from lampest.report.compare import Table
from lampest.runs.config import Case, Run, read_run
from lampest.studies.study import OnStep, Reported, Study, comma_separated, csv_value, samples_file, write_columns
from lampest.studies.weights.choices import Choice, Tuned, tune
from lampest.studies.weights.figure import plot_weights
from lampest.studies.weights.subject import WeightSubject, squared, why_not

HEADERS = ("recording", "estimator", "frame", "rule", "in_use", "weight", "weight_unit", "solves", "rms_log_error")


@dataclass(frozen=True, eq=False)
class TunedCases:
    """tuned : in the order of the run. left_out : 'recording/estimator left out: why'."""

    tuned: Sequence[Tuned]
    left_out: Sequence[str]


def run_weights(run: Run, on_step: OnStep) -> TunedCases:
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
    reason = why_not(case.estimator, frames * recording.scene.panel.cells)
    if reason is not None:
        return reason
    subject = WeightSubject.of(case, recording)
    if subject is None:
        return "too little was read of every measured frame"
    found = tune(subject)
    return found if any(point.solved for point in found.curves.points) else "it was solved for no weight"


def weights_table(found: TunedCases) -> Table:
    """One row for every rule on every case."""
    headers = ("recording", "estimator", "rule", "in use", "λ", "unit of λ", "solves", "true error", "over the best")
    rows = [
        (
            one.subject.recording,
            one.subject.name,
            choice.rule,
            "*" if choice.in_use else "",
            "none" if choice.weight is None else f"{choice.weight:.3g}",
            one.subject.weight_unit,
            "" if choice.solves is None else str(choice.solves),
            "" if choice.error is None else f"{choice.error:.4f}",
            "" if choice.excess is None else f"{choice.excess:.3f}",
        )
        for one in found.tuned
        for choice in one.choices
    ]
    return Table(headers, tuple(rows))


def _csv_row(one: Tuned, choice: Choice) -> list[Any]:
    subject = one.subject
    start = (subject.recording, subject.name, subject.frame, choice.rule, int(choice.in_use))
    rest = (choice.weight, subject.weight_unit, choice.solves, choice.error, choice.excess)
    return [csv_value(value) for value in (*start, *rest)]


def _write_curves(path: Path, found: TunedCases) -> Path:
    """/entry/<recording>/<estimator>: everything over the weight; `choices` beside it."""
    with samples_file(path, "tune/1") as entry:
        for one in found.tuned:
            recording = entry.require_group(one.subject.recording)
            hdf5.set_attributes(recording, NX_class="NXsubentry")
            _write_one(recording.create_group(one.subject.name), one)
    return path


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
    write_columns(group, points, curves, ("weight",), float)
    choices = group.create_group("choices")
    hdf5.set_attributes(choices, NX_class="NXcollection")
    write_columns(choices, one.choices, (("rule", "1", "rule"), ("in_use", "1", "1: the estimator's")))
    numbers = (
        ("weight", subject.weight_unit, "the rule's weight, NaN where it has none"),
        ("solves", "1", "solves that it took, NaN where it needs the whole curve"),
        ("error", "1", "true root-mean-square error of log resistance"),
        ("excess", "1", "error over that of the best weight in hindsight"),
    )
    write_columns(choices, one.choices, numbers, (), float)


def report_weights(found: TunedCases, run: Run, folder: Path) -> Reported:
    """Write tune.csv, every choice, tune.h5, the curves, and a figure of each case."""
    rows = [_csv_row(one, choice) for one in found.tuned for choice in one.choices]
    write_whole(folder / "tune.csv", comma_separated([(*HEADERS, "over_best"), *rows]))
    files = (folder / "tune.csv", _write_curves(folder / "tune.h5", found), *plot_weights(found.tuned, folder))
    return Reported([("", weights_table(found))], files, left_out=found.left_out)


STUDY: Study[Run, TunedCases] = Study("cases", "tune.yaml", read_run, run_weights, report_weights)
