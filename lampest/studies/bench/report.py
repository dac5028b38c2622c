"""A benchmark as tables for the screen and for pages, and what stands beside them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields

import numpy as np

from lampest.report.compare import Table
from lampest.studies.bench.rows import ALL, GROWTH_FROM, BenchRow, bench_rows, growth
from lampest.studies.bench.run import Bench
from lampest.studies.bench.settings import BenchFile, BenchLimits

SHORT = {
    "reduced": "reduced",
    "nodal": "nodal",
    "scipy_exact": "trf exact",
    "scipy_difference": "trf 2-point",
    "scipy_lbfgsb": "L-BFGS-B",
}
NO_GAP = 1e-12  # less is rounding
RATIO: tuple[str, Callable[[BenchRow], str]] = (
    "ratio",
    lambda row: "" if row.ratio is None or row.solver == "reduced" else short(row.ratio),
)
QUARTILES: tuple[str, Callable[[BenchRow], str]] = (
    "quartiles",
    lambda row: f"{short(row.ms_quartile_1)}–{short(row.ms_quartile_3)}" if row.count > 1 else "",
)


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
    return _table([("solver", lambda row: SHORT[row.solver])], rows, RATIO)


def methods_table(bench: Bench) -> Table:
    """The reduced solver: panel by panel, method by method."""
    rows = [row for row in bench_rows(bench) if row.method != ALL and row.solver == "reduced"]
    return _table([("method", lambda row: row.method)], rows, QUARTILES)


def _table(
    named: list[tuple[str, Callable[[BenchRow], str]]],
    rows: Sequence[BenchRow],
    special: tuple[str, Callable[[BenchRow], str]],
) -> Table:
    columns: list[tuple[str, Callable[[BenchRow], str]]] = [
        ("panel", _panel),
        *named,
        ("frames", lambda row: row.frames),
        ("ms", lambda row: short(row.ms)),
        special,
        ("inverses", lambda row: short(row.inverses)),
        ("steps", lambda row: short(row.iterations)),
        ("gap", lambda row: "" if row.gap is None else f"{row.gap:.0e}" if row.gap > NO_GAP else f"< {NO_GAP:.0e}"),
        ("verified", lambda row: f"{row.verified}/{row.count}"),
        ("MB", lambda row: "" if row.memory_mb is None else f"{row.memory_mb:.0f}"),
    ]
    filled = [(title, [text(row) for row in rows]) for title, text in columns]
    filled = [(title, texts) for title, texts in filled if any(texts)]
    return Table(tuple(title for title, _ in filled), tuple(zip(*(texts for _, texts in filled), strict=True)))


def _panel(row: BenchRow) -> str:
    return f"{row.rows} × {row.columns}"


def _times(ratio: float | None) -> str:
    return "" if ratio is None else f"{short(ratio)} ×"


def growth_table(bench: Bench) -> Table:
    """Exponents with their standard errors."""
    cells = tuple(
        (
            one.solver,
            one.method,
            one.frames,
            f"{one.exponent:.2f}" + ("" if one.standard_error is None else f" ± {one.standard_error:.2f}"),
            f"{one.panels}, {GROWTH_FROM} to {one.largest:.0f}",
        )
        for one in growth(bench)
    )
    return Table(("solver", "method", "frames", "exponent of the side", "panels"), cells)


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
