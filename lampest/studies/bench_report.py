"""A benchmark's figures by panel, method, solver and kind of frame, how they grow; tables, remarks and files."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import linregress

from lampest.files import hdf5
from lampest.panel.panel import Array
from lampest.report.compare import Table
from lampest.studies import study
from lampest.studies.bench import Bench, BenchFile, run_bench
from lampest.studies.timing import NO_GAP, Timing

ALL = "all"  # methods together
GROWTH_FROM = 32  # rows and columns of the smallest panel of which growth is measured
SHORT = {
    "reduced": "reduced",
    "nodal": "nodal",
    "scipy_exact": "trf exact",
    "scipy_difference": "trf 2-point",
    "scipy_lbfgsb": "L-BFGS-B",
}


@dataclass(frozen=True)
class Growth:
    """Time ∝ side^exponent, side = (rows + columns)/2, on panels of which no side is below 32.

    A least-squares line through the logarithms of `ms`; `all` is that of the methods' geometric mean.
    standard_error : of the slope, from the scatter about the line; None with two panels. panels : how many. largest :
    the largest side.
    """

    method: str
    solver: str
    frames: str
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

    def over(self, name: str) -> Array:
        """Values of frames, one for each, of all recordings and methods."""
        return self._chosen(self.own, name)

    def _chosen(self, timings: Sequence[Timing], name: str) -> Array:
        values = [getattr(timing, name) for timing in timings]
        chosen = slice(0, 1) if self.first else slice(1, None)
        return np.concatenate([(value() if callable(value) else value)[chosen] for value in values])

    @property
    def frames(self) -> str:
        """first, pair or later."""
        return "later" if not self.first else "pair" if all(timing.pair for timing in self.own) else "first"

    def ms(self, share: float = 0.5) -> float:
        """A quantile of the frames' times."""
        return 1e3 * float(np.quantile(self.over("times"), share))

    def ratio(self) -> float | None:
        """The median over the reduced solver's."""
        return self.ms() / 1e3 / float(np.median(self._chosen(self.reduced, "times"))) if self.reduced else None

    def gap(self) -> float | None:
        """The largest, failed frames included; None where the solver was alone."""
        gap = self.over("gap")
        return None if np.all(np.isnan(gap)) else float(np.nanmax(gap))

    def memory_mb(self) -> float | None:
        """Peak of a fresh process, 10⁶ bytes; None where it was not measured."""
        peaks = [self.bench.memory_mb.get((one.shape, one.method, one.solver)) for one in self.own]
        return max((peak for peak in peaks if peak is not None), default=None)


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
    by_solver = study.grouped(timings, lambda timing: timing.solver)
    for several in by_solver.values():
        for first in (True, False):
            own, reduced = (
                [timing for timing in some if first or len(timing.status) > 1]
                for some in (several, by_solver.get("reduced", []))
            )
            if {timing.method for timing in own} == set(methods):
                yield FramesOf(bench, name, own, reduced, first)


def growth(bench: Bench) -> list[Growth]:
    """By solver, method and kind of frames; nothing where there are fewer than two such panels.

    `all` methods have later frames alone: which first frames are pairs differs from method to method.
    """
    rows = [row for row in bench_rows(bench) if min(row.rows, row.columns) >= GROWTH_FROM and row.method != ALL]
    found: list[Growth] = []
    for solver, own in study.grouped(rows, lambda row: row.solver).items():
        times: dict[tuple[str, str], dict[int, float]] = {}
        for row in own:
            times.setdefault((row.method, row.frames), {})[row.rows + row.columns] = float(np.log(row.ms))
        later = [of for (_, frames), of in times.items() if frames == "later"]
        common = sorted(set.intersection(*map(set, later))) if later else []
        together = {(ALL, "later"): {lines: float(np.mean([of[lines] for of in later])) for lines in common}}
        for (method, frames), of in (*together.items(), *times.items()):
            if len(of) > 1:
                line = linregress(np.log(list(of)), list(of.values()))
                error = float(line.stderr) if len(of) > 2 else None
                found.append(Growth(method, solver, frames, float(line.slope), error, len(of), max(of) / 2))
    return found


def short(value: float) -> str:
    """Two digits or more, thousands with their commas."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}" if value >= 10 else f"{value:.2g}"


def _gap(row: study.Row) -> str:
    return "" if row.gap is None else f"{row.gap:.0e}" if row.gap > NO_GAP else f"< {NO_GAP:.0e}"


SCREEN: dict[str, Callable[[study.Row], str]] = {
    "panel": lambda row: f"{row.rows} × {row.columns}",
    "solver": lambda row: SHORT[row.solver],
    "method": lambda row: row.method,
    "frames": lambda row: row.frames,
    "ms": lambda row: short(row.ms),
    "ratio": lambda row: "" if row.ratio is None or row.solver == "reduced" else short(row.ratio),
    "quartiles": lambda row: f"{short(row.ms_quartile_1)}–{short(row.ms_quartile_3)}" if row.count > 1 else "",
    "inverses": lambda row: short(row.inverses),
    "steps": lambda row: short(row.iterations),
    "gap": _gap,
    "verified": lambda row: f"{row.verified}/{row.count}",
    "MB": lambda row: study.text_of(row.memory_mb, ".0f"),
}
GROWTH_SCREEN: dict[str, Callable[[Growth], str]] = {
    "solver": lambda one: one.solver,
    "method": lambda one: one.method,
    "frames": lambda one: one.frames,
    "exponent of the side": lambda one: (
        f"{one.exponent:.2f}" + ("" if one.standard_error is None else f" ± {one.standard_error:.2f}")
    ),
    "panels": lambda one: f"{one.panels}, {GROWTH_FROM} to {one.largest:.0f}",
}


def tables(bench: Bench) -> list[tuple[str, Table]]:
    """Titled tables for the screen, those without any row left out."""
    rows = bench_rows(bench)
    titled = (
        ("solvers: all methods together", _table([row for row in rows if row.method == ALL], "method", "quartiles")),
        (
            "methods: the reduced solver",
            _table([row for row in rows if row.method != ALL and row.solver == "reduced"], "solver", "ratio"),
        ),
        ("growth: time ∝ side^exponent", study.screen_table(growth(bench), GROWTH_SCREEN)),
    )
    return [(title, table) for title, table in titled if table.cells]


def _table(rows: Sequence[study.Row], *without: str) -> Table:
    """Columns in which some row has anything."""
    columns = {title: text for title, text in SCREEN.items() if title not in without and any(map(text, rows))}
    return study.screen_table(rows, columns)


def bench_remarks(bench: Bench) -> list[str]:
    """Sentences beside the tables: disturbances, limits, and what there was no time for."""
    settings = bench.settings
    lines = [f"{100 * np.mean([timing.clean() for timing in bench.timings]):.0f} % of the solves were not held up"]
    largest = max(max(shape) for shape in settings.shapes)
    limited = [f"{name} {limit}" for name, limit in vars(settings.limits).items() if limit < largest]
    if limited:
        lines.append(f"not run beyond these sides (limits): {', '.join(limited)}")
    panels: dict[tuple[str, str], list[str]] = {}  # of which the same was left out
    for (shape, what), own in study.grouped(bench.left_out, lambda one: (one.shape, one.what)).items():
        methods = [one.method for one in own]
        named = "all methods" if methods == list(settings.estimators) else ", ".join(methods)
        panels.setdefault((what, named), []).append(f"{shape[0]} × {shape[1]}")
    return lines + [
        f"left out, would not end within {settings.budget_s:g} s: {what}: {named} at {', '.join(several)}"
        for (what, named), several in panels.items()
    ]


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
