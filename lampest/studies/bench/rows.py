"""A benchmark's figures: by panel, method, solver and kind of frame, and how they grow with the panel."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import linregress

from lampest.panel.panel import Array
from lampest.studies.bench.run import Bench, Timing
from lampest.studies.study import Figures, Row, grouped, rows_of

ALL = "all"  # methods together
GROWTH_FROM = 32  # rows and columns of the smallest panel of which growth is measured
Kind = Literal["first", "pair", "later"]  # of frames


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


FIGURES: Figures = {
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


def bench_rows(bench: Bench) -> list[Row]:
    """By panel, then all methods together and each of them, then by solver, then first and later frames.

    Where a method was left out on a panel, there is no row of all: it would be one of other methods than elsewhere.
    """
    methods = list(dict.fromkeys(timing.method for timing in bench.timings))
    found: list[Row] = []
    for here in grouped(bench.timings, lambda timing: timing.shape).values():
        for name, several in ((ALL, methods), *((method, [method]) for method in methods)):
            chosen = [timing for timing in here if timing.method in several]
            found += rows_of(_samples(bench, name, several, chosen), FIGURES)
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
