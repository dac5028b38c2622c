"""A trade-off's table and files."""

from collections.abc import Sequence
from pathlib import Path

from lampest.files import hdf5
from lampest.studies.study import Reported, Study, samples_file, write_columns, write_rows
from lampest.studies.tradeoff.figure import plot_tradeoff
from lampest.studies.tradeoff.rows import (
    FIGURES,
    detailed_rows,
    first_method,
    method_rows,
    summary_rows,
    tradeoff_table,
)
from lampest.studies.tradeoff.run import Measured, run_tradeoff
from lampest.studies.tradeoff.settings import Plan, read_plan

SAMPLES = {
    "wall": "wall time of the estimate",
    "cpu": "processor time from the frame before to this one",
    "objective": "cost with the reference's previous frame",
    "gap": "objective above the best of all rungs, against it and the noise",
}
ERRORS = (
    ("cell_error", "percent", "median error of the cells against the truth"),
    ("changed_error", "percent", "median error of the cells that have changed"),
)


def _write_samples(path: Path, found: Sequence[Measured]) -> Path:
    """/entry/<recording>/<method>/<formulation>: times, errors, objectives and gaps of every frame; and memory."""
    with samples_file(path, "tradeoff/1") as entry:
        for one in found:
            recording = entry.require_group(one.subject.recording.name)
            rows, columns = one.shape
            hdf5.set_attributes(recording, NX_class="NXsubentry", rows=rows, columns=columns)
            hdf5.set_attributes(recording, scene=one.subject.scene, noise=one.subject.noise)
            method = recording.require_group(one.method)
            hdf5.set_attributes(method, NX_class="NXcollection")
            group = method.create_group(one.formulation.replace(" ", "_"))
            about = {"formulation": one.formulation, "baseline_s": one.baseline_s}
            one.write(group, SAMPLES, "frame in sequence", **about)
            write_columns(group, one, ERRORS, ("frame",))
            if one.memory_mb is not None:
                hdf5.set_attributes(group, peak_memory_mb=one.memory_mb)
    return path


def report_tradeoff(found: Sequence[Measured], plan: Plan, folder: Path) -> Reported:
    """Write tradeoff.csv, summary first and then every row, tradeoff.h5 with every sample, and the figure."""
    rows = [*summary_rows(found), *method_rows(found), *detailed_rows(found)]
    files = (
        write_rows(folder / "tradeoff.csv", FIGURES, rows),
        _write_samples(folder / "tradeoff.h5", found),
        plot_tradeoff(first_method(found), method_rows(found), folder / "tradeoff.png"),
    )
    return Reported([("", tradeoff_table(found))], files)


STUDY: Study[Plan, Sequence[Measured]] = Study(
    "measurements", "tradeoff.yaml", read_plan, run_tradeoff, report_tradeoff
)
