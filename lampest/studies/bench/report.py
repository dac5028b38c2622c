"""A benchmark as tables for the screen and for pages, its remarks, and its files."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from lampest.files import hdf5
from lampest.files.whole import write_whole
from lampest.report.compare import Table
from lampest.studies import study
from lampest.studies.bench.mats import MAT_FIGURES, mat_rows
from lampest.studies.bench.rows import ALL, FIGURES, GROWTH_FROM, Growth, bench_rows, growth
from lampest.studies.bench.run import Bench, run_bench
from lampest.studies.bench.settings import BenchFile, BenchLimits

SHORT = {
    "reduced": "reduced",
    "nodal": "nodal",
    "scipy_exact": "trf exact",
    "scipy_difference": "trf 2-point",
    "scipy_lbfgsb": "L-BFGS-B",
}
NO_GAP = 1e-12  # less is rounding
Cells = Callable[[study.Row], str]


def overview_table(bench: Bench) -> Table:
    """Panel by panel, all methods together: the reduced solver's figures, and how many times as long others take."""
    rows = [row for row in bench_rows(bench) if row.method == ALL]
    others = [name for name in dict.fromkeys(row.solver for row in rows) if name != "reduced"]
    cells = []
    for panel in dict.fromkeys(_panel(row) for row in rows):
        first, later = (
            {row.solver: row for row in rows if _panel(row) == panel and (row.frames == "later") == sequence}
            for sequence in (False, True)
        )
        if "reduced" in first and "reduced" in later:
            own = later["reduced"]
            peak = "" if own.memory_mb is None else f"{own.memory_mb:.0f}"
            times = (short(first["reduced"].ms), short(own.ms), short(own.inverses), peak)
            cells.append((panel, *times, *(_times(later[name].ratio) if name in later else "" for name in others)))
    return Table(("panel", "first, ms", "later, ms", "inverses", "MB", *(SHORT[name] for name in others)), tuple(cells))


def times_table(bench: Bench) -> Table:
    """Panel by panel: ms of the reduced solver's first and later frames with each method."""
    rows = [row for row in bench_rows(bench) if row.method != ALL and row.solver == "reduced"]
    methods = list(dict.fromkeys(row.method for row in rows))
    cells = []
    for panel in dict.fromkeys(_panel(row) for row in rows):
        here = [row for row in rows if _panel(row) == panel]
        of = {name: [short(row.ms) for row in here if row.method == name] for name in methods}
        cells.append((panel, *(" / ".join(of[name]) for name in methods)))
    return Table(("panel", *methods), tuple(cells))


def solvers_table(bench: Bench) -> Table:
    """All methods together: panel by panel, solver by solver."""
    rows = [row for row in bench_rows(bench) if row.method == ALL]

    def ratio(row: study.Row) -> str:
        return "" if row.ratio is None or row.solver == "reduced" else short(row.ratio)

    return _table(rows, ("solver", lambda row: SHORT[row.solver]), ("ratio", ratio))


def methods_table(bench: Bench) -> Table:
    """The reduced solver: panel by panel, method by method."""
    rows = [row for row in bench_rows(bench) if row.method != ALL and row.solver == "reduced"]

    def quartiles(row: study.Row) -> str:
        return f"{short(row.ms_quartile_1)}–{short(row.ms_quartile_3)}" if row.count > 1 else ""

    return _table(rows, ("method", lambda row: row.method), ("quartiles", quartiles))


def _table(rows: Sequence[study.Row], named: tuple[str, Cells], special: tuple[str, Cells]) -> Table:
    """Columns in which some row has anything."""
    columns: dict[str, Cells] = {
        "panel": _panel,
        named[0]: named[1],
        "frames": lambda row: row.frames,
        "ms": lambda row: short(row.ms),
        special[0]: special[1],
        "inverses": lambda row: short(row.inverses),
        "steps": lambda row: short(row.iterations),
        "gap": lambda row: "" if row.gap is None else f"{row.gap:.0e}" if row.gap > NO_GAP else f"< {NO_GAP:.0e}",
        "verified": lambda row: f"{row.verified}/{row.count}",
        "MB": lambda row: study.text_of(row.memory_mb, ".0f"),
    }
    return study.screen_table(rows, {title: text for title, text in columns.items() if any(map(text, rows))})


def _panel(row: study.Row) -> str:
    return f"{row.rows} × {row.columns}"


def _times(ratio: float | None) -> str:
    return "" if ratio is None else f"{short(ratio)} ×"


def _exponent(one: Growth) -> str:
    return f"{one.exponent:.2f}" + ("" if one.standard_error is None else f" ± {one.standard_error:.2f}")


GROWTH_SCREEN: dict[str, Callable[[Growth], str]] = {
    "solver": lambda one: one.solver,
    "method": lambda one: one.method,
    "frames": lambda one: one.frames,
    "exponent of the side": _exponent,
    "panels": lambda one: f"{one.panels}, {GROWTH_FROM} to {one.largest:.0f}",
}
MAT_SCREEN: dict[str, Cells] = {
    "mat": lambda row: f"{row.side} × {row.side}",
    "noise": lambda row: f"{row.noise_percent:g} %",
    "solver": lambda row: row.solver,
    "ms": lambda row: short(row.ms),
    "networks": lambda row: "" if row.evaluations is None else short(row.evaluations),
    "misfit %": lambda row: _percent(row.reading_error),
    "cell %": lambda row: _percent(row.cell_error),
    "worst %": lambda row: _percent(row.worst_cell_error),
    "g < 0": lambda row: str(row.negative),
    "ended": lambda row: f"{row.converged}/{row.count}",
}


def _percent(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "none"


def short(value: float) -> str:
    """Two digits or more, thousands with their commas."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}" if value >= 10 else f"{value:.2g}"


def bench_remarks(bench: Bench, settings: BenchFile) -> list[str]:
    """Sentences beside the tables: disturbances, limits, and what there was no time for."""
    lines = [f"{100 * np.mean([timing.clean() for timing in bench.timings]):.0f} % of the solves were not held up"]
    largest = max(max(shape) for shape in settings.shapes)
    limited = [
        f"{field.name} {limit}"
        for field in fields(BenchLimits)
        if (limit := getattr(settings.limits, field.name)) < largest
    ]
    if limited:
        lines.append(f"not run beyond these sides (limits): {', '.join(limited)}")
    return lines + list(_left_out(bench, settings))


def _left_out(bench: Bench, settings: BenchFile) -> Iterator[str]:
    """One sentence for panels of which the same was left out."""
    found: dict[tuple[str, str], list[str]] = {}
    for shape, what in dict.fromkeys((one.shape, one.what) for one in bench.left_out):
        methods = [one.method for one in bench.left_out if (one.shape, one.what) == (shape, what)]
        named = "all methods" if methods == list(settings.estimators) else ", ".join(methods)
        found.setdefault((what, named), []).append(f"{shape[0]} × {shape[1]}")
    for (what, named), panels in found.items():
        yield f"left out, would not end within {settings.budget_s:g} s: {what}: {named} at {', '.join(panels)}"


def tables(bench: Bench) -> Iterator[tuple[str, Table]]:
    """Titled tables for the screen, those without any row left out."""
    titled = (
        ("solvers: all methods together", solvers_table(bench)),
        ("methods: the reduced solver", methods_table(bench)),
        ("growth: time ∝ side^exponent", study.screen_table(growth(bench), GROWTH_SCREEN)),
        ("mats: published solvers, no bounds, no penalties", study.screen_table(mat_rows(bench.mats), MAT_SCREEN)),
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


def markdown(table: Table) -> str:
    """A table as GitHub's Markdown."""
    lines = (table.headers, tuple("---" for _ in table.headers), *table.cells)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


SAMPLES = {
    "wall": "wall time of the solve",
    "cpu": "processor time of the solve",
    "objective": "value of the cost function",
    "gap": "objective against the best of all solvers, relative; NaN: it was alone",
}
MATS = (
    ("solver", "1", "name of the solver"),
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


def _write_samples(path: Path, bench: Bench) -> Path:
    """/entry/<rows>x<columns>/<method>/<solver>/recording_<k>: times, objectives, gaps; /entry/mats/<field>."""
    with study.samples_file(path, "bench/2") as entry:
        for (shape, *about), megabytes in bench.memory_mb.items():
            hdf5.set_attributes(_group(entry, shape, bench, *about), peak_memory_mb=megabytes)
        for one in growth(bench):
            error = np.nan if one.standard_error is None else one.standard_error
            name = f"growth_{one.method}_{one.solver}_{one.frames}"
            hdf5.set_attributes(entry, **{name: one.exponent, f"{name}_error": error})
        for timing in bench.timings:
            group = _group(entry, timing.shape, bench, timing.method, timing.solver)
            group = group.create_group(f"recording_{timing.recording}")
            timing.write(group, SAMPLES, "frame in sequence, 0: cold start", pair=int(timing.pair))
        if bench.mats:
            mats = entry.create_group("mats")
            hdf5.set_attributes(mats, NX_class="NXcollection")
            study.write_columns(mats, bench.mats, MATS)
    return path


def _group(entry: Any, shape: tuple[int, int], bench: Bench, method: str, solver: str) -> Any:
    group = entry.require_group(f"{shape[0]}x{shape[1]}")
    hdf5.set_attributes(group, NX_class="NXsubentry", inverse_s=bench.inverse_s(shape))
    for name in (method, solver):
        group = group.require_group(name)
        hdf5.set_attributes(group, NX_class="NXcollection")
    return group


def report_bench(bench: Bench, settings: BenchFile, folder: Path) -> study.Reported:
    """Write what was measured.

    bench.csv : a row for every panel, method, solver and kind of frame. growth.csv : exponents. mats.csv : published
    solvers, where they ran. bench.md : tables and remarks for a page. bench.h5 : every sample.
    """
    files = [
        study.write_rows(folder / "bench.csv", FIGURES, bench_rows(bench)),
        study.write_rows(folder / "growth.csv", Growth.__dataclass_fields__, growth(bench)),
    ]
    if bench.mats:
        files.append(study.write_rows(folder / "mats.csv", MAT_FIGURES, mat_rows(bench.mats)))
    write_whole(folder / "bench.md", page(bench, settings))
    files += [folder / "bench.md", _write_samples(folder / "bench.h5", bench)]
    return study.Reported(list(tables(bench)), files, bench_remarks(bench, settings))


STUDY: study.Study[BenchFile, Bench] = study.Study(
    "methods", "bench.yaml", study.read_settings(BenchFile), run_bench, report_bench
)
