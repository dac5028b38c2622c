"""Benchmark of solvers on simulated recordings; docs/studies/bench.py adds SciPy's solvers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from itertools import product
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import numpy as np

from lampest.apps.studies import common, study
from lampest.apps.studies.common import (
    MIN_GAP,
    Pushed,
    TimedFrame,
    inverse_time,
    outcome,
    pushed,
)
from lampest.apps.studies.study import OnStep, column
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.sequence import first_stream
from lampest.files.typed import Configuration, check_ranges
from lampest.panel.kirchhoff import laplacian
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.wiring import Lines
from lampest.recording.recording import Recording
from lampest.recording.shapes import AnyShape, Rod
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Course, Simulation, simulate
from lampest.report.compare import Columns, grouped
from lampest.report.words import text_of
from lampest.solvers.solution import Settings


def loads(number: int, shape: common.Shape) -> tuple[tuple[AnyShape, ...], Course]:
    """Return loads and time course of recording `number`, periodic in 3.

    0: a breathing mouth over a third of the shorter side, with increasing suction. 1: three
    standing rods. 2: a mouth of 35 mm that presses, then sucks, with a rod next to it.

    Returns
    -------
    shapes : tuple of shapes
    course : Course
    """
    pitch = Panel(*shape).pitch_mm
    height, width = (pitch * (side - 1) for side in shape)
    rods = tuple(
        Rod(centre_mm=(right * width, down * height), diameter_mm=40, mass_g=mass)
        for right, down, mass in ((0.3, 0.3, 680.0), (0.7, 0.35, 300.0), (0.4, 0.75, 1200.0))
    )
    breathing = common.shipped_lamprey().course
    wide = common.lamprey_mouth((0.49 * width, 0.51 * height), 0.35 * pitch * min(shape))
    mouth = common.lamprey_mouth((0.6 * width, 0.55 * height))
    return (
        ((wide,), breathing),
        (rods, Course()),
        ((mouth, rods[0]), replace(breathing, start_s=-0.4, approach_s=2)),
    )[number % 3]


@dataclass(frozen=True)
class BenchLimits(Configuration):
    """Largest side, max(rows, columns), of panels for each solver; 0: none.

    Attributes
    ----------
    reduced, nodal : int
        Limits of the formulations.
    joint : int
        Largest side on which relative methods solve the first frame jointly with the baseline.
    """

    reduced: int = common.MAX_SIDE
    nodal: int = 16
    joint: int = 10

    @property
    def solvers(self) -> tuple[str, ...]:
        """Names of the solvers in order."""
        return tuple(limit.name for limit in fields(self) if limit.name != "joint")


@dataclass(frozen=True)
class BenchFile(Configuration):
    """Settings of the benchmark.

    Attributes
    ----------
    sizes
        Sides of square panels, or [rows, columns].
    estimators
        Methods by name, their terms as in a run file; by default the five of the paper.
    recordings
        Number of simulated recordings of every panel, each with its own loads and noise.
    frames, repeats
        Number of frames after the first, and of solves of each by every solver.
    seed, readout, unmodelled
        Of the simulated recordings, as in a simulation file.
    lines
        Lines of their scenes; nodal is left out if they resist.
    solver
        Tolerance and iterations of all solvers.
    limits
        Largest side for each solver.
    """

    schema: Literal[1]
    sizes: common.Sizes
    estimators: dict[str, common.StudyMethod] = field(default_factory=common.paper_methods)
    recordings: int = 1
    frames: int = 4
    repeats: int = 3
    seed: int = 1
    readout: TwoPointReadout = TwoPointReadout(noise_lsb=0.7)
    unmodelled: Unmodelled = field(default_factory=Unmodelled)
    lines: Lines | None = None
    solver: Settings = Settings()
    limits: BenchLimits = BenchLimits()

    def __post_init__(self) -> None:
        if not self.sizes or not self.estimators:
            raise ValueError("sizes and estimators must hold at least one")
        common.check_sides(self.shapes, 2, common.MAX_SIDE)
        for rows, columns in self.shapes:
            if not self.solvers((rows, columns)):
                raise ValueError(f"limits leave no solver for {rows} × {columns}")
        check_ranges(self, 1, 1000, "recordings", "frames", "repeats")

    @property
    def shapes(self) -> tuple[common.Shape, ...]:
        """Shapes (rows, columns) of the panels."""
        return common.shapes_of(self.sizes)

    def solvers(self, shape: common.Shape) -> tuple[str, ...]:
        """Return the names of the solvers that run on a panel."""
        wired = self.lines is not None and self.lines.resist
        return tuple(
            name
            for name in self.limits.solvers
            if max(shape) <= getattr(self.limits, name) and not (wired and name == "nodal")
        )

    def estimator(self, method: str, solver: str, shape: common.Shape) -> Estimator:
        """Return a method with a solver for a panel.

        The baseline of a large one is solved separately.
        """
        formulation = self.formulation(solver, joint=max(shape) <= self.limits.joint)
        return self.estimators[method].estimator(formulation, self.solver, error_bars=False)

    def formulation(self, solver: Any, *, joint: bool) -> Method:
        """Return the formulation of a solver."""
        return OptimalMethod(kind=solver, joint=joint)

    def recording(self, shape: common.Shape, number: int = 0) -> Recording:
        """Simulate a recording of a panel with 3 unloaded frames and the loads of `loads`."""
        scene = common.simple_scene(shape, self.readout, self.lines)
        touching, course = loads(number, shape)
        simulation = Simulation(
            1,
            self.seed + number,
            scene,
            frames=self.frames + 1,
            loads=touching,
            course=course,
            unmodelled=self.unmodelled,
        )
        return simulate(simulation, str(number))


LONG_TURN_S = 1.0  # of all solvers, against which disturbances are small


@dataclass(frozen=True, kw_only=True)
class BenchFrame(TimedFrame):
    """A frame of the benchmark.

    The gap is (φ − φ_best)/(φ_best + 1e-9·Σ R²); the last part is the cost of missing every reading
    by 0.003 %.
    """

    kind: str = column(
        "1", "first: a cold start; pair: together with the baseline; later: from the frame before"
    )
    inverse_s: float = column("s", "a dense inverse of size rows + columns - 1 at that time")


class Bench(NamedTuple):
    """Measurements of the benchmark, and its settings."""

    settings: BenchFile
    frames: tuple[BenchFrame, ...]


def run_bench(bench: BenchFile, on_step: OnStep) -> Bench:
    """Measure solvers on all recordings; the first recordings of all panels come first.

    `on_step` receives the numbers of finished and of all parts, and the name of the next one.
    """
    frames = list[BenchFrame]()
    parts = list(product(range(bench.recordings), bench.shapes, bench.estimators))
    simulated = lru_cache(maxsize=1)(bench.recording)
    for done, (number, shape, method) in enumerate(parts):
        name = f"{shape[0]} × {shape[1]} {method}, recording {number + 1}"
        on_step(done, len(parts), name)
        frames += _frames(bench, simulated(shape, number), shape, method)
    return Bench(bench, tuple(frames))


def _frames(
    bench: BenchFile, recording: Recording, shape: common.Shape, method: str
) -> Iterator[BenchFrame]:
    """Solve every frame by all solvers."""
    readings = recording.readings()
    matrix = laplacian(np.ones(shape))[1:, 1:]
    stream = first_stream(recording, readings, bench.estimator(method, "reduced", shape))
    # Without it, the first frame is a cold start.
    start = stream.previous if stream.estimator.relative else None
    streams = {
        name: replace(stream, estimator=bench.estimator(method, name, shape), previous=start)
        for name in bench.solvers(shape)
    }
    kind = "pair" if stream.estimator.joint_start else "first"
    for number, frame in enumerate(recording.measured_frames()):
        turns = list[dict[str, Pushed]]()
        for _ in range(bench.repeats if number else 1):
            turns.append({name: pushed(each, readings[frame]) for name, each in streams.items()})
            if sum(turn.seconds for turn in turns[-1].values()) > LONG_TURN_S:
                break
        leader = min(turns[0].values(), key=attrgetter("objective"))
        # scale of the gap: φ_best + 1e-9 Σ R²
        size = leader.objective + 1e-9 * float(np.sum(readings[frame].value ** 2))
        for name, turn in turns[0].items():
            solution = turn.step.solution
            gap = (turn.objective - leader.objective) / size if solution.solved else np.inf
            yield BenchFrame(
                **outcome(recording, turn.step),
                method=method,
                solver=name,
                frame=number,
                seconds=min(turn[name].seconds for turn in turns),
                objective=solution.objective,
                gap=gap if len(streams) > 1 else np.nan,
                kind="later" if number else kind,
                inverse_s=inverse_time(matrix),
            )
        # All continue from the best estimate, each with its own caches.
        streams = {
            name: replace(
                leader.stream, estimator=stream.estimator, prepared=turns[0][name].stream.prepared
            )
            for name, stream in streams.items()
        }


ALL = "all"  # methods together
PROBLEM = attrgetter("rows", "columns", "method", "frames")  # of rows that differ in their solvers


def bench_rows(frames: Sequence[BenchFrame]) -> list[study.Row]:
    """Return rows by panel, method (all together first), solver, and first or later frames."""
    rows = []
    for panel in grouped(frames, lambda frame: frame.shape).values():
        for name, chosen in {ALL: panel, **grouped(panel, lambda frame: frame.method)}.items():
            for several in grouped(chosen, lambda frame: frame.solver).values():
                kinds = grouped(several, lambda frame: frame.frame > 0).values()
                rows += [_row(name, timed) for timed in kinds]
    reduced = {PROBLEM(row): row.ms for row in rows if row.solver == "reduced"}
    for row in rows:
        row.ratio = row.ms / reduced[PROBLEM(row)] if PROBLEM(row) in reduced else None
    return rows


def _row(method: str, measured: Sequence[BenchFrame]) -> study.Row:
    """Summarise frames of one kind by one solver.

    ms is the median, gap the largest, infinite of a failed frame.
    """
    low, middle, high = np.quantile(
        [1e3 * frame.seconds for frame in measured], (0.25, 0.5, 0.75)
    ).tolist()
    kinds = {frame.kind for frame in measured}
    return study.Row(
        **study.named_values(measured[0], "rows", "columns"),
        method=method,
        solver=measured[0].solver,
        frames=kinds.pop() if len(kinds) == 1 else "first",
        ms=middle,
        ms_quartile_1=low,
        ms_quartile_3=high,
        ratio=None,
        inverses=middle / 1e3 / float(np.median([frame.inverse_s for frame in measured])),
        iterations=float(np.median([frame.iterations for frame in measured])),
        gap=max((frame.gap for frame in measured if not np.isnan(frame.gap)), default=None),
        count=len(measured),
        verified=sum(frame.verified for frame in measured),
        solved=sum(frame.solved for frame in measured),
    )


SCREEN: Columns = {
    "panel": "{rows} × {columns}",
    "solver": "{solver}",
    "method": "{method}",
    "frames": "{frames}",
    "ms": "{ms:digits}",
    "ratio": lambda row: "" if row.solver == "reduced" else text_of(row.ratio),
    "quartiles": lambda row: (
        f"{text_of(row.ms_quartile_1)}–{text_of(row.ms_quartile_3)}"
        if row.ms_quartile_1 < row.ms_quartile_3
        else ""
    ),
    "inverses": "{inverses:digits}",
    "steps": "{iterations:g}",
    "gap": lambda row: (
        text_of(row.gap, ".0e") if row.gap is None or row.gap > MIN_GAP else f"< {MIN_GAP:.0e}"
    ),
    "verified": "{verified}/{count}",
}


def sheets(bench: Bench) -> list[study.Sheet]:
    """Return the tables that are not empty."""
    rows = bench_rows(bench.frames)
    totals = [row for row in rows if row.method == ALL]
    ours = [row for row in rows if row.method != ALL and row.solver == "reduced"]

    def without(*titles: str) -> Columns:
        return {title: of for title, of in SCREEN.items() if title not in titles}

    titled = [
        ("solvers: all methods together", totals, without("method", "quartiles")),
        ("methods: the reduced solver", ours, without("solver")),
    ]
    return [sheet for sheet in titled if sheet[1]]


def bench_remarks(bench: Bench) -> list[str]:
    """Return the limits of panels, if any panel exceeds one."""
    largest = max(max(shape) for shape in bench.settings.shapes)
    limits = vars(bench.settings.limits).items()
    limited = [f"{name} {limit}" for name, limit in limits if limit < largest]
    return [f"not run beyond these sides (limits): {', '.join(limited)}"] if limited else []


STUDY: study.Study[BenchFile, Bench] = study.Study(
    "bench",
    "methods",
    "bench.yaml",
    study.read_settings(BenchFile),
    run_bench,
    rows=lambda bench: bench_rows(bench.frames),
    sheets=sheets,
    form="bench/3",
    records=lambda bench: [study.RecordGroup("frames", bench.frames, "seconds")],
    remarks=bench_remarks,
)
