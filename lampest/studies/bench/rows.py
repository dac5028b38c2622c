"""A benchmark's figures: by panel, method, solver and kind of frame, and how they grow with the panel."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lampest.panel.panel import Array
from lampest.studies.bench.run import Bench, Timing

ALL = "all"
GROWTH_FROM = 32
Kind = Literal["first", "pair", "later"]  # of frames


@dataclass(frozen=True)
class BenchRow:
    """One solver on one panel with one method, or with `all` of them, over all recordings.

    Parameters
    ----------
    rows, columns, method, solver : what was measured.
    frames : 'first', cold starts; 'pair', cold starts solved jointly with the baseline; 'later', in sequence. `all`
        methods have pairs among their first frames.
    ms, ms_quartile_1, ms_quartile_3 : median and quartiles over the frames; see `Timing.times`.
    ratio : ms over the reduced solver's on the same panel with the same method; None where that did not run.
    inverses : ms in dense inverses of size rows + columns − 1.
    iterations : median.
    gap : the largest `Timing.gap`, failed frames included; None where the solver was alone.
    count, verified, solved : number of frames; with a verified optimum; with an estimate.
    memory_mb : peak of a fresh process, 10⁶ bytes; None where it was not measured.
    """

    rows: int
    columns: int
    method: str
    solver: str
    frames: Kind
    ms: float
    ms_quartile_1: float
    ms_quartile_3: float
    ratio: float | None
    inverses: float
    iterations: float
    gap: float | None
    count: int
    verified: int
    solved: int
    memory_mb: float | None


@dataclass(frozen=True)
class Growth:
    """Time ∝ side^exponent, side = (rows + columns)/2, on panels of which no side is below 32.

    A least-squares line through the logarithms of `BenchRow.ms`; `all` is that of the methods' geometric mean.
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


def bench_rows(bench: Bench) -> list[BenchRow]:
    """By panel, then all methods together and each of them, then by solver, then first and later frames.

    Where a method was left out on a panel, there is no row of all: it would be one of other methods than elsewhere.
    """
    methods = list(dict.fromkeys(timing.method for timing in bench.timings))
    found: list[BenchRow] = []
    for shape in dict.fromkeys(timing.shape for timing in bench.timings):
        here = [timing for timing in bench.timings if timing.shape == shape]
        found += _rows(bench, ALL, methods, here)
        for method in methods:
            found += _rows(bench, method, [method], [timing for timing in here if timing.method == method])
    return found


def _rows(bench: Bench, name: str, methods: Sequence[str], timings: Sequence[Timing]) -> Iterator[BenchRow]:
    for solver in dict.fromkeys(timing.solver for timing in timings):
        for first in (True, False):
            own, reduced = (
                [timing for timing in timings if timing.solver == one and (first or len(timing.status) > 1)]
                for one in (solver, "reduced")
            )
            if {timing.method for timing in own} == set(methods):
                yield _row(bench, name, own, reduced, first)


def _row(bench: Bench, method: str, own: Sequence[Timing], reduced: Sequence[Timing], first: bool) -> BenchRow:
    chosen = slice(0, 1) if first else slice(1, None)
    ms, gap = (1e3 * over(own, "times", chosen), over(own, "gap", chosen))
    peaks = [
        bench.memory_mb[key]
        for timing in own
        if (key := (timing.shape, timing.method, timing.solver)) in bench.memory_mb
    ]
    shape = own[0].shape
    low, median, high = (float(part) for part in np.quantile(ms, (0.25, 0.5, 0.75)))
    return BenchRow(
        *shape,
        method,
        own[0].solver,
        "later" if not first else "pair" if all(timing.pair for timing in own) else "first",
        median,
        low,
        high,
        ratio=median / (1e3 * float(np.median(over(reduced, "times", chosen)))) if reduced else None,
        inverses=median / 1e3 / bench.inverse_s(shape),
        iterations=float(np.median(over(own, "iterations", chosen))),
        gap=None if np.all(np.isnan(gap)) else float(np.nanmax(gap)),
        count=ms.size,
        verified=int(np.sum(over(own, "verified", chosen))),
        solved=int(np.sum(over(own, "solved", chosen))),
        memory_mb=max(peaks) if peaks else None,
    )


def over(timings: Sequence[Timing], name: str, chosen: slice) -> Array:
    """Values of frames, one for each, of all recordings and methods."""
    values = [getattr(timing, name) for timing in timings]
    return np.concatenate([(value() if callable(value) else value)[chosen] for value in values])


def growth(bench: Bench) -> list[Growth]:
    """By solver, method and kind of frames; nothing where there are fewer than two such panels.

    `all` methods are told of later frames alone: which first frames are pairs differs from method to method.
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
    lines, logarithms = np.log(list(times)), np.array(list(times.values()))
    from_mean = lines - lines.mean()
    exponent = float(from_mean @ logarithms / (from_mean @ from_mean))
    scatter = logarithms - logarithms.mean() - exponent * from_mean
    free = len(times) - 2
    error = float(np.sqrt(scatter @ scatter / free / (from_mean @ from_mean))) if free else None
    yield Growth(method, solver, frames, exponent, error, len(times), max(times) / 2)
