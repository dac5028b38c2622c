"""A trade-off's table and files."""

from pathlib import Path

from lampest.files import hdf5
from lampest.report.compare import Table
from lampest.studies.study import Reported, Study, samples_file, write_columns, write_rows
from lampest.studies.tradeoff.figure import plot_tradeoff
from lampest.studies.tradeoff.rows import (
    TradeoffRow,
    detailed_rows,
    first_method,
    method_rows,
    on_front,
    summary_rows,
)
from lampest.studies.tradeoff.run import Tradeoff, run_tradeoff
from lampest.studies.tradeoff.settings import Plan, read_plan


def tradeoff_table(found: Tradeoff) -> Table:
    """The first method's rows as short texts."""
    about = ("panel", "method", "formulation", "first [ms]", "frame [ms]", "cell error [%]", "of changed cells [%]")
    headers = (*about, "gap median / worst", "reached [%]", "failed", "memory [MB]", "front")
    rows = first_method(found)
    cells = []
    for row in rows:
        here = [other for other in rows if (other.rows, other.columns) == (row.rows, row.columns)]
        cells.append(
            (
                f"{row.rows} × {row.columns}",
                row.method,
                row.formulation,
                f"{row.first_ms:.3g}",
                f"{row.frame_ms:.3g}",
                _text(row.cell_error),
                _text(row.changed_error),
                f"{row.gap:.0e} / {row.worst_gap:.0e}",
                f"{100 * row.reached:.0f}",
                f"{row.failed}/{row.frames}",
                "" if row.memory_mb is None else f"{row.memory_mb:.0f}",
                "*" if row.formulation in on_front(here) else "",
            )
        )
    return Table(headers, tuple(cells))


def _text(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


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


def _write_samples(path: Path, found: Tradeoff) -> Path:
    """/entry/<recording>/<method>/<formulation>: times, errors, objectives and gaps of every frame; and memory."""
    with samples_file(path, "tradeoff/1") as entry:
        for one in found.measured:
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
            memory = found.memory_mb.get((one.shape, one.formulation))
            if memory is not None:
                hdf5.set_attributes(group, peak_memory_mb=memory)
    return path


def report_tradeoff(found: Tradeoff, plan: Plan, folder: Path) -> Reported:
    """Write tradeoff.csv, summary first and then every row, tradeoff.h5 with every sample, and the figure."""
    rows = (*summary_rows(found), *method_rows(found), *detailed_rows(found))
    files = (
        write_rows(folder / "tradeoff.csv", TradeoffRow, rows),
        _write_samples(folder / "tradeoff.h5", found),
        plot_tradeoff(first_method(found), method_rows(found), folder / "tradeoff.png"),
    )
    return Reported([("", tradeoff_table(found))], files)


STUDY: Study[Plan, Tradeoff] = Study("measurements", "tradeoff.yaml", read_plan, run_tradeoff, report_tradeoff)
