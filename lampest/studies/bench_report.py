"""A benchmark's figures by panel, method, solver and kind of frame, how times grow; tables and remarks."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import linregress

from lampest.report.compare import Table
from lampest.studies import study
from lampest.studies.bench import Bench, BenchFile, BenchFrame, run_bench
from lampest.studies.timing import NO_GAP

ALL = "all"  # methods together
GROWTH_FROM = 32  # rows and columns of the smallest panel of which growth is measured


def bench_rows(frames: Sequence[BenchFrame]) -> list[study.Row]:
    """By panel, then all methods together and each of them, then by solver, then first and later frames.

    Where a method was left out on a panel, there is no row of all: it would be one of other methods than elsewhere.
    """
    methods = {one.method for one in frames}
    rows: list[study.Row] = []
    for here in study.grouped(frames, lambda one: one.shape).values():
        for name, chosen in ((ALL, here), *study.grouped(here, lambda one: one.method).items()):
            for several in study.grouped(chosen, lambda one: one.solver).values():
                kinds = study.grouped(several, lambda one: one.frame > 0).values()
                rows += [_row(name, own) for own in kinds if name != ALL or {one.method for one in own} == methods]
    reduced = {_problem(row): row.ms for row in rows if row.solver == "reduced"}
    for row in rows:
        row.ratio = row.ms / reduced[_problem(row)] if _problem(row) in reduced else None
    return rows


def _problem(row: study.Row) -> tuple[int, int, str, str]:
    return row.rows, row.columns, row.method, row.frames


def _row(method: str, own: Sequence[BenchFrame]) -> study.Row:
    """The figures of frames of one kind by one solver; ms : median, gap : the largest, infinite of a failed frame."""
    low, middle, high = (float(one) for one in np.quantile([1e3 * one.seconds for one in own], (0.25, 0.5, 0.75)))
    kinds = {one.kind for one in own}
    return study.Row(
        rows=own[0].rows,
        columns=own[0].columns,
        method=method,
        solver=own[0].solver,
        frames=kinds.pop() if len(kinds) == 1 else "first",
        ms=middle,
        ms_quartile_1=low,
        ms_quartile_3=high,
        ratio=None,
        inverses=middle / 1e3 / float(np.median([one.inverse_s for one in own])),
        iterations=float(np.median([one.iterations for one in own])),
        gap=max((one.gap for one in own if not np.isnan(one.gap)), default=None),
        count=len(own),
        verified=sum(one.verified for one in own),
        solved=sum(one.solved for one in own),
        memory_mb=max((one.memory_mb for one in own if one.memory_mb is not None), default=None),
    )


def growth(rows: Sequence[study.Row]) -> list[study.Row]:
    """Time ∝ side^exponent, side = (rows + columns)/2, by solver, method and kind of frames.

    A least-squares line through the logarithms of `ms`, on two or more panels of which no side is below 32.
    standard_error : of the slope, from the scatter about the line; None with two panels. largest : the largest side.
    """
    large = [row for row in rows if min(row.rows, row.columns) >= GROWTH_FROM and row.method != ALL]
    found = []
    for (solver, method, frames), own in study.grouped(large, lambda row: (row.solver, row.method, row.frames)).items():
        sides = [(row.rows + row.columns) / 2 for row in own]
        if len(own) > 1:
            line = linregress(np.log(sides), np.log([row.ms for row in own]))
            error = float(line.stderr) if len(own) > 2 else None
            figures = (solver, method, frames, float(line.slope), error, len(own), max(sides))
            found.append(study.Row(**dict(zip(GROWTH, figures, strict=True))))
    return found


GROWTH = ("solver", "method", "frames", "exponent", "standard_error", "panels", "largest")
GROWTH_SCREEN = {
    "solver": "{solver}",
    "method": "{method}",
    "frames": "{frames}",
    "exponent of the side": "{exponent:.2f} ± {standard_error:.2f}",
    "panels": f"{{panels}}, {GROWTH_FROM} to {{largest:.0f}}",
}
SCREEN: study.Screen = {
    "panel": "{rows} × {columns}",
    "solver": "{solver}",
    "method": "{method}",
    "frames": "{frames}",
    "ms": "{ms:digits}",
    "ratio": lambda row: "" if row.solver == "reduced" or row.ratio is None else study.text_of(row.ratio, "digits"),
    "quartiles": lambda row: (
        study.text_of(row.ms_quartile_1) + "–" + study.text_of(row.ms_quartile_3) if row.count > 1 else ""
    ),
    "inverses": "{inverses:digits}",
    "steps": "{iterations:g}",
    "gap": lambda row: study.text_of(row.gap, ".0e") if row.gap is None or row.gap > NO_GAP else f"< {NO_GAP:.0e}",
    "verified": "{verified}/{count}",
    "MB": "{memory_mb:.0f}",
}


def tables(bench: Bench) -> list[tuple[str, Table]]:
    """Titled tables for the screen, those without any row left out."""
    rows = bench_rows(bench.frames)
    together = [row for row in rows if row.method == ALL]
    ours = [row for row in rows if row.method != ALL and row.solver == "reduced"]
    titled = (
        ("solvers: all methods together", together, _without("method", "quartiles")),
        ("methods: the reduced solver", ours, _without("solver")),
        ("growth: time ∝ side^exponent", growth(rows), GROWTH_SCREEN),
    )
    return [(title, study.screen_table(own, screen)) for title, own, screen in titled if own]


def _without(*titles: str) -> study.Screen:
    return {title: of for title, of in SCREEN.items() if title not in titles}


def bench_remarks(bench: Bench) -> list[str]:
    """Limits, and what there was no time for."""
    settings = bench.settings
    largest = max(max(shape) for shape in settings.shapes)
    limited = [f"{name} {limit}" for name, limit in vars(settings.limits).items() if limit < largest]
    lines = [f"not run beyond these sides (limits): {', '.join(limited)}"] if limited else []
    panels: dict[tuple[str, str], list[str]] = {}  # of which the same was left out
    for (shape, what), own in study.grouped(bench.left_out, lambda one: (one[0], one[2])).items():
        methods = [method for _, method, _ in own]
        named = "all methods" if methods == list(settings.estimators) else ", ".join(methods)
        panels.setdefault((what, named), []).append(f"{shape[0]} × {shape[1]}")
    reason = f"left out, would not end within {settings.budget_s:g} s"
    return lines + [f"{reason}: {what}: {named} at {', '.join(several)}" for (what, named), several in panels.items()]


STUDY: study.Study[BenchFile, Bench] = study.Study(
    "bench",
    "methods",
    "bench.yaml",
    study.read_settings(BenchFile),
    run_bench,
    rows=lambda bench: bench_rows(bench.frames),
    tables=tables,
    form="bench/3",
    records=lambda bench: [study.RecordGroup("frames", bench.frames, "seconds")],
    texts=lambda bench: {"growth.csv": study.csv_of(growth(bench_rows(bench.frames)), GROWTH)},
    remarks=bench_remarks,
)
