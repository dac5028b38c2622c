"""A benchmark's files: rows as CSV, every sample as HDF5, tables for a page."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.files.whole import write_whole
from lampest.report.compare import Table
from lampest.studies.bench.mat_report import MatRow, mat_rows, mats_table
from lampest.studies.bench.mats import MatSolve
from lampest.studies.bench.report import (
    bench_remarks,
    growth_table,
    methods_table,
    overview_table,
    solvers_table,
    times_table,
)
from lampest.studies.bench.rows import BenchRow, Growth, bench_rows, growth
from lampest.studies.bench.run import Bench
from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.timing import Timing
from lampest.studies.study import samples_file, write_rows

FRAME = ("frame",)
SAMPLES = ("frame", "repeat")


def tables(bench: Bench) -> Iterator[tuple[str, Table]]:
    """Titled tables for the screen, those without any row left out."""
    titled = (
        ("solvers: all methods together", solvers_table(bench)),
        ("methods: the reduced solver", methods_table(bench)),
        ("growth: time ∝ side^exponent", growth_table(bench)),
        ("mats: published solvers, no bounds, no penalties", mats_table(bench)),
    )
    yield from ((title, table) for title, table in titled if table.cells)


def page(bench: Bench, settings: BenchFile) -> str:
    """The same as Markdown, after two tables that say less and before the remarks: sections, named before a colon."""
    titled = (
        ("overview: all methods together; other solvers as multiples of the reduced one", overview_table(bench)),
        ("times: the reduced solver, ms, first / later frames", times_table(bench)),
        *tables(bench),
    )
    sections = [f"## {title}\n\n{markdown(table)}" for title, table in titled]
    remarks = "".join(f"- {line}\n" for line in bench_remarks(bench, settings))
    return "\n".join((*sections, f"## remarks: what held it up, what was left out\n\n{remarks}"))


def write_bench(folder: Path, bench: Bench, settings: BenchFile) -> tuple[Path, ...]:
    """Write what was measured and return the paths.

    bench.csv : a row for every panel, method, solver and kind of frame. growth.csv : exponents. mats.csv : published
    solvers, where they ran. bench.md : tables and remarks for a page. bench.h5 : every sample.

    Raises InputError where the folder cannot be written.
    """
    rows: list[tuple[str, type[Any], Sequence[Any]]] = [
        ("bench.csv", BenchRow, bench_rows(bench)),
        ("growth.csv", Growth, growth(bench)),
    ]
    rows += [("mats.csv", MatRow, mat_rows(bench))] if bench.mats else []
    for name, kind, found in rows:
        write_rows(folder / name, kind, found)
    write_whole(folder / "bench.md", page(bench, settings))
    _write_samples(folder / "bench.h5", bench)
    return tuple(folder / name for name in (*(name for name, *_ in rows), "bench.md", "bench.h5"))


def markdown(table: Table) -> str:
    """A table as GitHub's Markdown."""
    lines = (table.headers, tuple("---" for _ in table.headers), *table.cells)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _write_samples(path: Path, bench: Bench) -> None:
    """/entry/<rows>x<columns>/<method>/<solver>/recording_<k>: times, objectives, gaps; /entry/mats/<field>."""
    with samples_file(path, "bench/2") as entry:
        for (shape, *about), megabytes in bench.memory_mb.items():
            hdf5.set_attributes(_group(entry, shape, bench, *about), peak_memory_mb=megabytes)
        for one in growth(bench):
            error = np.nan if one.standard_error is None else one.standard_error
            name = f"growth_{one.method}_{one.solver}_{one.frames}"
            hdf5.set_attributes(entry, **{name: one.exponent, f"{name}_error": error})
        for timing in bench.timings:
            group = _group(entry, timing.shape, bench, timing.method, timing.solver)
            _write_timing(group.create_group(f"recording_{timing.recording}"), timing)
        if bench.mats:
            _write_mats(entry.create_group("mats"), bench.mats)


def _group(entry: Any, shape: tuple[int, int], bench: Bench, method: str, solver: str) -> Any:
    panel = entry.require_group(f"{shape[0]}x{shape[1]}")
    hdf5.set_attributes(panel, NX_class="NXsubentry", inverse_s=bench.inverse_s(shape))
    group = panel
    for name in (method, solver):
        group = group.require_group(name)
        hdf5.set_attributes(group, NX_class="NXcollection")
    return group


def _write_timing(group: Any, timing: Timing) -> None:
    hdf5.set_attributes(group, NX_class="NXdata", signal="wall_time", axes=list(SAMPLES), pair=int(timing.pair))
    frames, repeats = timing.wall.shape
    hdf5.write_scale(group, "frame", np.arange(frames), "1", "frame in sequence, 0: cold start")
    hdf5.write_scale(group, "repeat", np.arange(repeats), "1", "turn of the alternation")
    columns: Sequence[tuple[str, Any, str, str, tuple[str, ...]]] = (
        ("wall_time", timing.wall, "s", "wall time of the solve", SAMPLES),
        ("cpu_time", timing.cpu, "s", "processor time of the solve", SAMPLES),
        ("objective", timing.objective, "1", "value of the cost function", FRAME),
        ("gap", timing.gap, "1", "objective against the best of all solvers, relative; NaN: it was alone", FRAME),
        ("iterations", timing.iterations, "1", "iterations of the solver", FRAME),
        ("solved", timing.solved.astype(np.uint8), "1", "1: solved, 0: failed", FRAME),
        ("status", hdf5.ascii_array(timing.status), "1", "how the solve ended", FRAME),
    )
    for name, values, units, long_name, scales in columns:
        hdf5.write_dataset(group, name, values, units, long_name, scales)


def _write_mats(group: Any, solves: Sequence[MatSolve]) -> None:
    """One number of every solve in each dataset."""
    hdf5.set_attributes(group, NX_class="NXcollection")
    columns = (
        ("side", "1", "rows and columns"),
        ("noise_percent", "percent", "standard deviation of a reading's noise"),
        ("draw", "1", "number of the mat"),
        ("seconds", "s", "time of the solve"),
        ("iterations", "1", "iterations of the solver"),
        ("converged", "1", "1: by its own word it is solved"),
        ("reading_error", "percent", "largest error of a reading"),
        ("cell_error", "percent", "median error of the conductances"),
        ("worst_cell_error", "percent", "largest error of a conductance"),
        ("negative", "1", "conductances below zero"),
    )
    hdf5.write_dataset(group, "solver", hdf5.ascii_array([solve.solver for solve in solves]), "1", "name of the solver")
    for name, units, long_name in columns:
        hdf5.write_dataset(group, name, np.array([getattr(solve, name) for solve in solves]), units, long_name)
