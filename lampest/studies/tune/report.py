"""A study's figures: every rule's choice as a table and as CSV, the curves as HDF5."""

from pathlib import Path
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.files.whole import write_whole
from lampest.report.compare import Table
from lampest.studies.study import comma_separated, csv_value, samples_file
from lampest.studies.tune.choices import Choice, Tuned
from lampest.studies.tune.run import Study
from lampest.studies.tune.subject import squared

COLUMNS = (
    "recording",
    "estimator",
    "frame",
    "rule",
    "in_use",
    "weight",
    "weight_unit",
    "solves",
    "rms_log_error",
    "over_best",
)


def tune_table(study: Study) -> Table:
    """One row for every rule on every case."""
    headers = (
        "recording",
        "estimator",
        "rule",
        "in use",
        "λ",
        "unit of λ",
        "solves",
        "true error",
        "over the best",
    )
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
        for one in study.tuned
        for choice in one.choices
    ]
    return Table(headers, tuple(rows))


def write_study(folder: Path, study: Study) -> tuple[Path, Path]:
    """Write tune.csv, every choice, and tune.h5, the curves; returns their paths.

    Raises InputError where the folder cannot be written.
    """
    table, curves = folder / "tune.csv", folder / "tune.h5"
    choices = (_values(one, choice) for one in study.tuned for choice in one.choices)
    write_whole(table, comma_separated([COLUMNS, *choices]))
    _write_curves(curves, study)
    return table, curves


def _values(one: Tuned, choice: Choice) -> list[Any]:
    subject = one.subject
    start = (subject.recording, subject.name, subject.frame, choice.rule, int(choice.in_use))
    rest = (choice.weight, subject.weight_unit, choice.solves, choice.error, choice.excess)
    return [csv_value(value) for value in (*start, *rest)]


def _write_curves(path: Path, study: Study) -> None:
    """/entry/<recording>/<estimator>: everything over the weight; `choices` beside it."""
    with samples_file(path, "tune/1") as entry:
        for one in study.tuned:
            recording = entry.require_group(one.subject.recording)
            hdf5.set_attributes(recording, NX_class="NXsubentry")
            _write_one(recording.create_group(one.subject.name), one)


def _write_one(group: Any, one: Tuned) -> None:
    subject, curves = one.subject, one.curves
    signal = "evidence" if subject.noisy else "press"
    hdf5.set_attributes(group, NX_class="NXdata", signal=signal, axes=["weight"], frame=subject.frame)
    hdf5.set_attributes(group, readings=subject.count, noise_known=int(subject.noisy))
    hdf5.write_scale(group, "weight", curves.values("weight"), subject.weight_unit, "weight of the penalty")
    unit, square = "1" if subject.noisy else squared(subject.misfit_unit), squared(subject.misfit_unit)
    columns = (
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
    for name, units, long_name in columns:
        hdf5.write_dataset(group, name, curves.values(name), units, long_name, ("weight",))
    _write_choices(group.create_group("choices"), one)


def _write_choices(group: Any, one: Tuned) -> None:
    hdf5.set_attributes(group, NX_class="NXcollection")
    hdf5.write_dataset(group, "rule", hdf5.ascii_array([choice.rule for choice in one.choices]), "1", "rule")
    hdf5.write_dataset(
        group, "in_use", np.array([choice.in_use for choice in one.choices], dtype=np.uint8), "1", "1: the estimator's"
    )
    columns = (
        ("weight", one.subject.weight_unit, "the rule's weight, NaN where it has none"),
        ("solves", "1", "solves that it took, NaN where it needs the whole curve"),
        ("error", "1", "true root-mean-square error of log resistance"),
        ("excess", "1", "error over that of the best weight in hindsight"),
    )
    for name, units, long_name in columns:
        values = np.array([getattr(choice, name) for choice in one.choices], dtype=float)
        hdf5.write_dataset(group, name, values, units, long_name)
