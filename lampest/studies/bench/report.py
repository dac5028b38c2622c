"""A benchmark's figures: ratios and growth, as a table, as CSV and as HDF5."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.panel.panel import Array
from lampest.report.compare import Table
from lampest.studies.bench.run import Bench, Timing
from lampest.studies.study import samples_file, write_rows

ALL = "all"
GROWTH_FROM = 32
FRAME = ("frame",)
SAMPLES = ("frame", "repeat")


@dataclass(frozen=True)
class BenchRow:
    """One solver on one panel with one method, or with `all` of them.

    Parameters
    ----------
    rows, columns, method, solver : what was measured.
    first_ms : median of cold starts; see `Timing`.
    frame_ms : median of the frames after it.
    ratio : frame_ms over the reduced solver's on the same panel with the same method; None where that did not run.
    inverses : frame_ms in dense inverses of size rows + columns − 1.
    iterations : median over the frames after the first.
    first_gap, gap : the largest `Timing.gap` of the cold starts, and of the frames after them, failed ones included.
    frames, failed : number of frames, the first included; those without a verified optimum.
    """

    rows: int
    columns: int
    method: str
    solver: str
    first_ms: float
    frame_ms: float
    ratio: float | None
    inverses: float
    iterations: float
    first_gap: float
    gap: float
    frames: int
    failed: int


def bench_rows(bench: Bench) -> list[BenchRow]:
    """By panel, then all methods together and each of them, then by solver."""
    found: list[BenchRow] = []
    for shape in dict.fromkeys(timing.shape for timing in bench.timings):
        here = [timing for timing in bench.timings if timing.shape == shape]
        for method in (ALL, *dict.fromkeys(timing.method for timing in here)):
            chosen = [timing for timing in here if method in (ALL, timing.method)]
            found += _rows(method, chosen, bench.inverse_s[shape])
    return found


def _rows(method: str, timings: list[Timing], inverse_s: float) -> Iterator[BenchRow]:
    times = {name: _following([t for t in timings if t.solver == name]) for name in {t.solver: 0 for t in timings}}
    for name, following in times.items():
        own = [timing for timing in timings if timing.solver == name]
        yield BenchRow(
            *own[0].shape,
            method,
            name,
            first_ms=1e3 * float(np.median([timing.times()[0] for timing in own])),
            frame_ms=1e3 * following,
            ratio=following / times["reduced"] if "reduced" in times else None,
            inverses=following / inverse_s,
            iterations=float(np.median(np.concatenate([timing.iterations[1:] for timing in own]))),
            first_gap=max(_worst(timing.gap[:1]) for timing in own),
            gap=max(_worst(timing.gap[1:]) for timing in own),
            frames=sum(timing.solved.size for timing in own),
            failed=sum(int(np.sum(~timing.solved)) for timing in own),
        )


def _worst(gap: Array) -> float:
    """The largest; infinite where a solve has left no objective."""
    return float(np.max(np.nan_to_num(gap, nan=np.inf)))


def _following(timings: list[Timing]) -> float:
    """Median time of the frames after the first, s."""
    return float(np.median(np.concatenate([timing.times()[1:] for timing in timings])))


def growth(bench: Bench) -> dict[str, float]:
    """Exponent p of time ∝ (M + N)^p of the reduced solver's frames on panels from 32 × 32 on, by method and for all.

    A least-squares line through the logarithms; `all` is that of the methods' geometric mean. Empty with fewer than two
    such panels.
    """
    chosen = [row for row in bench_rows(bench) if row.solver == "reduced" and min(row.rows, row.columns) >= GROWTH_FROM]
    found = {}
    for method in dict.fromkeys(row.method for row in chosen if row.method != ALL):
        own = [row for row in chosen if row.method == method]
        if len({row.rows + row.columns for row in own}) > 1:
            lines, times = [row.rows + row.columns for row in own], [row.frame_ms for row in own]
            found[method] = float(np.polyfit(np.log(lines), np.log(times), 1)[0])
    return {ALL: float(np.mean(list(found.values()))), **found} if found else {}


def bench_table(bench: Bench, method: str = ALL) -> Table:
    """The rows of one method, or of all together, as short texts."""
    headers = (
        "panel",
        "solver",
        "first [ms]",
        "frame [ms]",
        "over reduced",
        "inverses",
        "iterations",
        "first gap",
        "gap",
        "failed",
    )
    cells = [
        (
            f"{row.rows} × {row.columns}",
            row.solver,
            f"{row.first_ms:.3g}",
            f"{row.frame_ms:.3g}",
            "" if row.ratio is None else f"{row.ratio:.3g}",
            f"{row.inverses:.3g}",
            f"{row.iterations:.3g}",
            f"{row.first_gap:.0e}",
            f"{row.gap:.0e}",
            f"{row.failed}/{row.frames}",
        )
        for row in bench_rows(bench)
        if row.method == method
    ]
    return Table(headers, tuple(cells))


def bench_remarks(bench: Bench) -> list[str]:
    """Sentences beside the table: growth and memory."""
    exponents = growth(bench)
    lines = [f"{100 * np.mean([timing.clean() for timing in bench.timings]):.0f} % of the solves were not held up"]
    if exponents:
        each = ", ".join(f"{method} {exponent:.2f}" for method, exponent in exponents.items())
        lines.append(f"reduced, time of a frame ∝ (M + N)^p from {GROWTH_FROM} × {GROWTH_FROM} on, p: {each}")
    for (high, wide), megabytes in bench.memory_mb.items():
        lines.append(f"reduced, {high} × {wide}, all methods: peak memory of a fresh process {megabytes:.0f} MB")
    return lines


def write_bench(folder: Path, bench: Bench) -> tuple[Path, Path]:
    """Write bench.csv, a row for every panel, method and solver, and bench.h5 with every sample; returns their paths.

    Raises InputError where the folder cannot be written.
    """
    table, samples = folder / "bench.csv", folder / "bench.h5"
    write_rows(table, BenchRow, bench_rows(bench))
    _write_samples(samples, bench)
    return table, samples


def _write_samples(path: Path, bench: Bench) -> None:
    """/entry/<rows>x<columns>/<method>/<solver>: times, objectives, gaps; growth and memory as attributes of /entry."""
    with samples_file(path, "bench/1") as entry:
        hdf5.set_attributes(entry, **{f"growth_{method}": value for method, value in growth(bench).items()})
        for (high, wide), megabytes in bench.memory_mb.items():
            hdf5.set_attributes(entry, **{f"peak_memory_mb_{high}x{wide}": megabytes})
        for timing in bench.timings:
            high, wide = timing.shape
            panel = entry.require_group(f"{high}x{wide}")
            hdf5.set_attributes(panel, NX_class="NXsubentry", inverse_s=bench.inverse_s[timing.shape])
            method = panel.require_group(timing.method)
            hdf5.set_attributes(method, NX_class="NXcollection")
            _write_timing(method.create_group(timing.solver), timing)


def _write_timing(group: Any, timing: Timing) -> None:
    hdf5.set_attributes(group, NX_class="NXdata", signal="wall_time", axes=list(SAMPLES))
    frames, repeats = timing.wall.shape
    hdf5.write_scale(group, "frame", np.arange(frames), "1", "frame in sequence, 0: cold start")
    hdf5.write_scale(group, "repeat", np.arange(repeats), "1", "turn of the alternation")
    columns: Sequence[tuple[str, Any, str, str, tuple[str, ...]]] = (
        ("wall_time", timing.wall, "s", "wall time of the solve", SAMPLES),
        ("cpu_time", timing.cpu, "s", "processor time of the solve", SAMPLES),
        ("objective", timing.objective, "1", "value of the cost function", FRAME),
        ("gap", timing.gap, "1", "objective against the best of all solvers, relative", FRAME),
        ("iterations", timing.iterations, "1", "iterations of the solver", FRAME),
        ("solved", timing.solved.astype(np.uint8), "1", "1: solved, 0: failed", FRAME),
        ("status", hdf5.ascii_array(timing.status), "1", "how the solve ended", FRAME),
    )
    for name, values, units, long_name, scales in columns:
        hdf5.write_dataset(group, name, values, units, long_name, scales)
