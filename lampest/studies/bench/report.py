"""A benchmark's figures by panel, method, solver and kind of frame, how they grow; tables, remarks and files."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from scipy.stats import linregress

from lampest.files import hdf5
from lampest.panel.panel import Array
from lampest.report.compare import Table
from lampest.studies import study
from lampest.studies.bench.run import Bench, Timing, run_bench
from lampest.studies.bench.settings import BenchFile, BenchLimits
from lampest.studies.timing import NO_GAP

ALL = "all"  # methods together
GROWTH_FROM = 32  # rows and columns of the smallest panel of which growth is measured
Kind = Literal["first", "pair", "later"]  # of frames
SHORT = {
    "reduced": "reduced",
    "nodal": "nodal",
    "scipy_exact": "trf exact",
    "scipy_difference": "trf 2-point",
    "scipy_lbfgsb": "L-BFGS-B",
}
Cells = Callable[[study.Row], str]


@dataclass(frozen=True)
class Growth:
    """Time ∝ side^exponent, side = (rows + columns)/2, on panels of which no side is below 32.

    A least-squares line through the logarithms of `ms`; `all` is that of the methods' geometric mean.
    standard_error : of the slope, from the scatter about the line; None with two panels. panels : how many. largest :
    the largest side.
    """

    method: str
    solver: str
    frames: Kind
    exponent: float
    standard_error: float | None
    panels: int
    largest: float


@dataclass(frozen=True, eq=False)
class FramesOf:
    """Frames of one kind by one solver, with a method or all of them; reduced : ours on the same, empty where it is."""

    bench: Bench
    method: str
    own: Sequence[Timing]
    reduced: Sequence[Timing]
    first: bool

    def over(self, name: str, timings: Sequence[Timing] | None = None) -> Array:
        """Values of frames, one for each, of all recordings and methods."""
        values = [getattr(timing, name) for timing in (self.own if timings is None else timings)]
        chosen = slice(0, 1) if self.first else slice(1, None)
        return np.concatenate([(value() if callable(value) else value)[chosen] for value in values])

    @property
    def frames(self) -> Kind:
        """Which."""
        return "later" if not self.first else "pair" if all(timing.pair for timing in self.own) else "first"

    def ms(self, share: float = 0.5) -> float:
        """A quantile of the frames' times."""
        return 1e3 * float(np.quantile(self.over("times"), share))

    def ratio(self) -> float | None:
        """The median over the reduced solver's."""
        return self.ms() / (1e3 * float(np.median(self.over("times", self.reduced)))) if self.reduced else None

    def gap(self) -> float | None:
        """The largest, failed frames included; None where the solver was alone."""
        gap = self.over("gap")
        return None if np.all(np.isnan(gap)) else float(np.nanmax(gap))

    def memory_mb(self) -> float | None:
        """Peak of a fresh process, 10⁶ bytes; None where it was not measured."""
        keys = [(timing.shape, timing.method, timing.solver) for timing in self.own]
        return max((self.bench.memory_mb[key] for key in keys if key in self.bench.memory_mb), default=None)


FIGURES: study.Figures = {
    "rows": lambda one: one.own[0].shape[0],
    "columns": lambda one: one.own[0].shape[1],
    "method": lambda one: one.method,
    "solver": lambda one: one.own[0].solver,
    "frames": lambda one: one.frames,
    "ms": FramesOf.ms,  # median over the frames; see `Timing.times`
    "ms_quartile_1": lambda one: one.ms(0.25),
    "ms_quartile_3": lambda one: one.ms(0.75),
    "ratio": FramesOf.ratio,
    "inverses": lambda one: one.ms() / 1e3 / one.bench.inverse_s(one.own[0].shape),  # of size rows + columns − 1
    "iterations": lambda one: float(np.median(one.over("iterations"))),
    "gap": FramesOf.gap,
    "count": lambda one: one.over("times").size,
    "verified": lambda one: int(np.sum(one.over("verified"))),
    "solved": lambda one: int(np.sum(one.over("solved"))),
    "memory_mb": FramesOf.memory_mb,
}


def bench_rows(bench: Bench) -> list[study.Row]:
    """By panel, then all methods together and each of them, then by solver, then first and later frames.

    Where a method was left out on a panel, there is no row of all: it would be one of other methods than elsewhere.
    """
    methods = list(dict.fromkeys(timing.method for timing in bench.timings))
    found: list[study.Row] = []
    for here in study.grouped(bench.timings, lambda timing: timing.shape).values():
        for name, several in ((ALL, methods), *((method, [method]) for method in methods)):
            chosen = [timing for timing in here if timing.method in several]
            found += study.rows_of(_samples(bench, name, several, chosen), FIGURES)
    return found


def _samples(bench: Bench, name: str, methods: Sequence[str], timings: Sequence[Timing]) -> Iterator[FramesOf]:
    for solver in dict.fromkeys(timing.solver for timing in timings):
        for first in (True, False):
            own, reduced = (
                [timing for timing in timings if timing.solver == one and (first or len(timing.status) > 1)]
                for one in (solver, "reduced")
            )
            if {timing.method for timing in own} == set(methods):
                yield FramesOf(bench, name, own, reduced, first)


def growth(bench: Bench) -> list[Growth]:
    """By solver, method and kind of frames; nothing where there are fewer than two such panels.

    `all` methods have later frames alone: which first frames are pairs differs from method to method.
    """
    rows = [row for row in bench_rows(bench) if min(row.rows, row.columns) >= GROWTH_FROM and row.method != ALL]
    found: list[Growth] = []
    for solver in dict.fromkeys(row.solver for row in rows):
        times: dict[tuple[str, Kind], dict[int, float]] = {}
        for row in rows:
            if row.solver == solver:
                times.setdefault((row.method, row.frames), {})[row.rows + row.columns] = float(np.log(row.ms))
        later = [of for (_, frames), of in times.items() if frames == "later"]
        common = sorted(set.intersection(*map(set, later))) if later else []
        found += _grown(ALL, solver, "later", {lines: float(np.mean([of[lines] for of in later])) for lines in common})
        for (method, frames), of in times.items():
            found += _grown(method, solver, frames, of)
    return found


def _grown(method: str, solver: str, frames: Kind, times: dict[int, float]) -> Iterator[Growth]:
    """times : logarithms by M + N."""
    if len(times) < 2:
        return
    line = linregress(np.log(list(times)), list(times.values()))
    error = float(line.stderr) if len(times) > 2 else None
    yield Growth(method, solver, frames, float(line.slope), error, len(times), max(times) / 2)


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


def _exponent(one: Growth) -> str:
    return f"{one.exponent:.2f}" + ("" if one.standard_error is None else f" ± {one.standard_error:.2f}")


GROWTH_SCREEN: dict[str, Callable[[Growth], str]] = {
    "solver": lambda one: one.solver,
    "method": lambda one: one.method,
    "frames": lambda one: one.frames,
    "exponent of the side": _exponent,
    "panels": lambda one: f"{one.panels}, {GROWTH_FROM} to {one.largest:.0f}",
}


def short(value: float) -> str:
    """Two digits or more, thousands with their commas."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}" if value >= 10 else f"{value:.2g}"


def bench_remarks(bench: Bench) -> list[str]:
    """Sentences beside the tables: disturbances, limits, and what there was no time for."""
    settings = bench.settings
    lines = [f"{100 * np.mean([timing.clean() for timing in bench.timings]):.0f} % of the solves were not held up"]
    largest = max(max(shape) for shape in settings.shapes)
    limited = [
        f"{field.name} {limit}"
        for field in fields(BenchLimits)
        if (limit := getattr(settings.limits, field.name)) < largest
    ]
    if limited:
        lines.append(f"not run beyond these sides (limits): {', '.join(limited)}")
    return lines + list(_left_out(bench))


def _left_out(bench: Bench) -> Iterator[str]:
    """One sentence for panels of which the same was left out."""
    found: dict[tuple[str, str], list[str]] = {}
    for shape, what in dict.fromkeys((one.shape, one.what) for one in bench.left_out):
        methods = [one.method for one in bench.left_out if (one.shape, one.what) == (shape, what)]
        named = "all methods" if methods == list(bench.settings.estimators) else ", ".join(methods)
        found.setdefault((what, named), []).append(f"{shape[0]} × {shape[1]}")
    for (what, named), panels in found.items():
        yield f"left out, would not end within {bench.settings.budget_s:g} s: {what}: {named} at {', '.join(panels)}"


def tables(bench: Bench) -> list[tuple[str, Table]]:
    """Titled tables for the screen, those without any row left out."""
    titled = (
        ("solvers: all methods together", solvers_table(bench)),
        ("methods: the reduced solver", methods_table(bench)),
        ("growth: time ∝ side^exponent", study.screen_table(growth(bench), GROWTH_SCREEN)),
    )
    return [(title, table) for title, table in titled if table.cells]


def page(bench: Bench) -> str:
    """The same as Markdown before the remarks: sections, named before a colon."""
    sections = [f"## {title}\n\n{markdown(table)}" for title, table in tables(bench)]
    remarks = "".join(f"- {line}\n" for line in bench_remarks(bench))
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


def _write_samples(entry: Any, bench: Bench) -> None:
    """/entry/<rows>x<columns>/<method>/<solver>/recording_<k>: times, objectives, gaps."""
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


def _group(entry: Any, shape: tuple[int, int], bench: Bench, method: str, solver: str) -> Any:
    group = entry.require_group(f"{shape[0]}x{shape[1]}")
    hdf5.set_attributes(group, NX_class="NXsubentry", inverse_s=bench.inverse_s(shape))
    for name in (method, solver):
        group = group.require_group(name)
        hdf5.set_attributes(group, NX_class="NXcollection")
    return group


STUDY: study.Study[BenchFile, Bench] = study.Study(
    "bench",
    "methods",
    "bench.yaml",
    study.read_settings(BenchFile),
    run_bench,
    FIGURES,
    bench_rows,
    tables,
    "bench/2",
    _write_samples,
    texts=lambda bench: {
        "growth.csv": study.csv_of(Growth.__dataclass_fields__, growth(bench)),
        "bench.md": page(bench),
    },
    remarks=bench_remarks,
)
