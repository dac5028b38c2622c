"""The benchmark: every frame of simulated recordings, solved by every solver in turn for as long as there is time.

SciPy's solvers join in docs/studies/bench.py.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from itertools import product
from time import perf_counter
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.stats import linregress

from lampest.estimate.estimator import Estimator
from lampest.estimate.methods.method import Method, OptimalMethod
from lampest.estimate.sequence import first_stream
from lampest.files.typed import Configuration, check_range, check_ranges
from lampest.loads.shapes import AnyShape, Rod
from lampest.panel.kirchhoff import laplacian
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.wiring import Lines
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Course, Simulation, simulate
from lampest.report.compare import Table
from lampest.solvers.solution import Settings
from lampest.studies import common, study
from lampest.studies.study import OnStep, column
from lampest.studies.timing import NO_GAP, TimedFrame, inverse_time, outcome, peak_memory, pushed


def loads(number: int, shape: common.Shape) -> tuple[tuple[AnyShape, ...], Course]:
    """What touches the panel in recording `number`, and when; recordings 0, 1, 2 differ, then they come again.

    0 : a mouth over a third of the shorter side, sucking ever harder, breathing. 1 : three rods that stand. 2 : a mouth
    of 35 mm that presses ever harder, then sucks, beside a rod.
    """
    pitch = Panel(*shape).pitch_mm
    height, width = (pitch * (side - 1) for side in shape)
    places = ((0.3, 0.3, 680.0), (0.7, 0.35, 300.0), (0.4, 0.75, 1200.0))  # shares of width and height, mass in g
    rods = tuple(
        Rod(kind="rod", centre_mm=(right * width, down * height), diameter_mm=40, mass_g=mass)
        for right, down, mass in places
    )
    third = common.lamprey_mouth((0.49 * width, 0.51 * height), 0.35 * pitch * min(shape))
    growing = replace(common.BREATHING, start_s=-0.4, approach_s=2)
    beside = (common.lamprey_mouth((0.6 * width, 0.55 * height)), rods[0])
    return (((third,), common.BREATHING), (rods, Course()), (beside, growing))[number % 3]


@dataclass(frozen=True)
class BenchLimits(Configuration):
    """The largest side, max(rows, columns), at which a solver is run; 0: not at all.

    joint : no solver, but the first pair of relative methods: on larger panels their first frame starts from a baseline
    that was solved alone.
    """

    reduced: int = common.LARGEST_SIDE
    nodal: int = 16
    joint: int = 10

    @property
    def solvers(self) -> tuple[str, ...]:
        """The names of the solvers, in order."""
        return tuple(one.name for one in fields(self) if one.name != "joint")


@dataclass(frozen=True)
class BenchFile(Configuration):
    """What is compared.

    sizes : sides of square panels, or [rows, columns].
    estimators : methods by name, their terms as in a run's file; the paper's five by default.
    recordings : simulated recordings of every panel, each with loads and noise of its own.
    frames, repeats : frames after the first, solved in sequence, and how often each is solved by every solver.
    budget_s : no solve is begun that would probably not end within so many seconds; what is left out is named.
    seed, readout, unmodelled : of the simulated recordings, as in a simulation's file.
    lines : of their scenes; nodal does not know wire and is left out then.
    solver : tolerance and iterations, the same for all.
    limits : the largest side for each solver.
    memory : sides of panels on which the peak memory of a fresh process is measured.
    """

    schema: Literal[1]
    sizes: common.Sizes
    estimators: dict[str, common.SquaredMethod] = field(
        default_factory=lambda: common.paper_methods(common.SquaredMethod)
    )
    recordings: int = 1
    frames: int = 4
    repeats: int = 3
    budget_s: float = 3600.0
    seed: int = 1
    readout: TwoPointReadout = TwoPointReadout(noise_lsb=0.7)
    unmodelled: Unmodelled = field(default_factory=Unmodelled)
    lines: Lines | None = None
    solver: Settings = Settings()
    limits: BenchLimits = BenchLimits()
    memory: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.sizes or not self.estimators:
            raise ValueError("sizes and estimators must hold at least one")
        common.check_sides(self.shapes, 2, common.LARGEST_SIDE)
        check_range("a panel's side", self.memory, 2, common.LARGEST_SIDE)
        for rows, columns in self.shapes:
            if not self.solvers((rows, columns)):
                raise ValueError(f"limits leave no solver for {rows} × {columns}")
        check_ranges(self, 1, 1000, "recordings", "frames", "repeats")
        check_ranges(self, 1e-3, 30 * 86400, "budget_s")

    @property
    def shapes(self) -> tuple[common.Shape, ...]:
        """(rows, columns) of every panel."""
        return common.shapes_of(self.sizes)

    def solvers(self, shape: common.Shape) -> tuple[str, ...]:
        """The names of the solvers that run on a panel."""
        wired = self.lines is not None and self.lines.resist
        known = (name for name in self.limits.solvers if not (wired and name == "nodal"))
        return tuple(name for name in known if max(shape) <= getattr(self.limits, name))

    def estimator(self, method: str, solver: str, shape: common.Shape) -> Estimator:
        """A method with a solver, for a panel: a large one's baseline is solved alone."""
        formulation = self.formulation(solver, max(shape) <= self.limits.joint)
        return Estimator(self.estimators[method].parts, formulation, self.solver, error_bars=False)

    def formulation(self, solver: Any, joint: bool) -> Method:
        """The formulation of a solver's name."""
        return OptimalMethod(kind=solver, joint=joint)

    def recording(self, shape: common.Shape, number: int = 0) -> Recording:
        """One of the recordings of a panel, its loads those of `loads`; 3 unloaded frames."""
        touching, course = loads(number, shape)
        scene = Scene(Panel(*shape), self.readout, common.SERIES_OHM, lines=self.lines)
        known: dict[str, Any] = {"frames": self.frames + 1, "loads": touching, "unmodelled": self.unmodelled}
        simulation = Simulation(1, self.seed + number, scene, course=course, **known)
        return simulate(simulation, str(number))


@dataclass(frozen=True, kw_only=True)
class BenchFrame(TimedFrame):
    """A frame of the benchmark.

    gap : (φ − φ_best)/(φ_best + 1e-9·Σ R²); the last part is the cost of missing every reading by 0.003 %.
    """

    kind: str = column("1", "first: a cold start; pair: together with the baseline; later: from the frame before")
    inverse_s: float = column("s", "a dense inverse of size rows + columns - 1 at that time")


def solve_two_frames(task: tuple[BenchFile, common.Shape, str, str]) -> None:
    """A first frame and the next, for the memory that they take."""
    bench, shape, method, solver = task
    recording = bench.recording(shape)
    readings = recording.readings()
    stream = first_stream(recording, readings, bench.estimator(method, solver, shape))
    for frame in recording.measured_frames()[:2]:
        stream, _ = stream.push(readings[frame])


class BenchPart(NamedTuple):
    """A method on one recording of a panel."""

    recording: int
    shape: common.Shape
    method: str

    def expected_s(self, bench: BenchFile, done: Sequence[BenchFrame]) -> float:
        """As on another recording of the panel; else as on the largest one that is smaller, growing as (M + N)³."""
        solvers, lines = bench.solvers(self.shape), sum(self.shape)
        alike = [one for one in done if one.method == self.method and one.solver in solvers and sum(one.shape) <= lines]
        nearest = max((sum(one.shape) for one in alike), default=lines)
        alike = [one for one in alike if sum(one.shape) == nearest]
        recordings = len({(one.shape, one.recording) for one in alike}) or 1
        return sum(one.seconds for one in alike) / recordings * (lines / nearest) ** 3


LeftOut = tuple[common.Shape, str, str]  # a panel, a method, and what of them there was no time for


class Bench(NamedTuple):
    """frames : of all solvers."""

    settings: BenchFile
    frames: tuple[BenchFrame, ...]
    left_out: tuple[LeftOut, ...] = ()


def run_bench(bench: BenchFile, on_step: OnStep) -> Bench:
    """Measure everything, as far as the budget goes; on_step is called with how many of how many parts are done, and
    what is next.

    All panels' first recordings come first, smallest panels before larger ones, with the memory that they take.
    """
    end, found, missed = perf_counter() + bench.budget_s, list[BenchFrame](), list[LeftOut]()
    parts = [BenchPart(*part) for part in product(range(bench.recordings), bench.shapes, bench.estimators)]
    simulated = lru_cache(maxsize=1)(bench.recording)
    for number, part in enumerate(parts):
        shape, method, name = part.shape, part.method, f"recording {part.recording + 1}"
        on_step(number, len(parts), f"{shape[0]} × {shape[1]} {method}, {name}")
        if part.expected_s(bench, found) > end - perf_counter():
            missed.append((shape, method, name))
            continue
        own = list(_frames(bench, simulated(shape, part.recording), part, end))
        if (frames := own[-1].frame + 1) <= bench.frames:
            missed.append((shape, method, f"{name} after {frames} of {bench.frames + 1} frames"))
        measured = not part.recording and shape[0] == shape[1] and shape[0] in bench.memory
        for solver in bench.solvers(shape) if measured else ():
            # A fresh process takes some 3 s to begin.
            if 3.0 + sum(one.seconds for one in own if one.solver == solver) > end - perf_counter():
                missed.append((shape, method, f"memory of {solver}"))
                continue
            peak = peak_memory(solve_two_frames, (bench, shape, method, solver))
            own = [replace(one, memory_mb=peak) if one.solver == solver else one for one in own]
        found += own
    return Bench(bench, tuple(found), tuple(missed))


def _frames(bench: BenchFile, recording: Recording, part: BenchPart, end: float) -> Iterator[BenchFrame]:
    """Every frame by all solvers; later ones are left out once there is less time than the last one took."""
    estimators = {name: bench.estimator(part.method, name, part.shape) for name in bench.solvers(part.shape)}
    readings, matrix = recording.readings(), laplacian(np.ones(part.shape))[1:, 1:]
    stream = first_stream(recording, readings, bench.estimator(part.method, "reduced", part.shape))
    begun = stream.previous if stream.estimator.relative else None  # without it, the first frame is a cold start
    streams = {name: replace(stream, estimator=estimator, previous=begun) for name, estimator in estimators.items()}
    kind = "pair" if stream.estimator.joint_start else "first"
    for number, frame in enumerate(recording.measured_frames()):
        begin, turns = perf_counter(), []
        for _ in range(bench.repeats if number else 1):
            turns.append({name: pushed(own, readings[frame]) for name, own in streams.items()})
            if sum(one.seconds for one in turns[-1].values()) > 1.0:  # disturbances are small beside so many s
                break
        reached = {name: one.objective for name, one in turns[0].items()}
        best = min(reached, key=lambda name: reached[name])
        size = reached[best] + 1e-9 * float(np.sum(readings[frame].value ** 2))
        for name, one in turns[0].items():
            gap = (one.objective - reached[best]) / size if one.step.solution.solved else np.inf
            yield BenchFrame(
                **outcome(recording, one.step),
                method=part.method,
                solver=name,
                frame=number,
                seconds=min(turn[name].seconds for turn in turns),
                objective=one.step.solution.objective,
                gap=gap if len(streams) > 1 else np.nan,
                kind="later" if number else kind,
                inverse_s=inverse_time(matrix),
            )
        leader = turns[0][best].stream  # all go on from the best estimate, each with what it prepared
        streams = {
            name: replace(leader, estimator=estimator, prepared=turns[0][name].stream.prepared)
            for name, estimator in estimators.items()
        }
        if perf_counter() - begin > end - perf_counter():
            return


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
