"""Trade-off between accuracy and speed.

All formulations solve every recording in turn, A B C A B C. Time and cell error are those of the
formulation's own sequence. Objectives of relative methods depend on the previous estimate.
Therefore each estimate is evaluated with the same cost, given the previous frame of the reference,
`reduced`, and compared with the lowest value of all formulations. A joint first pair is evaluated
by its second frame, given the reference's baseline.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from operator import attrgetter
from pathlib import Path
from string import ascii_lowercase
from time import perf_counter
from typing import Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lampest.apps.studies import common, study
from lampest.apps.studies.common import MIN_GAP, TimedFrame, outcome
from lampest.apps.studies.study import OnStep, column, read_settings
from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.estimate.estimates import Estimates
from lampest.estimate.methods import AnyMethod, MethodName, named_method
from lampest.estimate.methods.approximate import TruncatedMethod
from lampest.estimate.methods.method import Method
from lampest.estimate.sequence import first_stream, reconstruct
from lampest.files.errors import InputError
from lampest.files.typed import (
    Configuration,
    check_not_negative,
    check_positive_fields,
    check_ranges,
)
from lampest.panel.panel import Array
from lampest.panel.readouts import TwoPointReadout
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.simulation.measure import Unmodelled
from lampest.recording.simulation.simulation import Simulation, simulate
from lampest.report.compare import Columns, grouped, relative_error
from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, dressed, new_figure, shared_legend
from lampest.runs.case import check_name
from lampest.runs.config import recording_paths
from lampest.solvers.solution import Settings

REFERENCE = "reduced"


@dataclass(frozen=True)
class TradeoffLimits(Configuration):
    """Largest side, max(rows, columns), of panels for each formulation; 0: none.

    All others are measured on every panel.

    Attributes
    ----------
    nodal, per_pixel : int
        Largest side for the formulation of this name.
    joint : int
        Largest side for methods that compare frames, whose joint first pair takes minutes on larger
        panels.
    """

    nodal: int = 16
    per_pixel: int = 10
    joint: int = 16


@dataclass(frozen=True)
class Simulated(Configuration):
    """Simulated recordings of a lamprey on panels of 10 mm pitch, for every size, noise and scene.

    Attributes
    ----------
    sizes
        Sides of square panels, or [rows, columns].
    noise
        Readouts by name.
    scenes
        Unmodelled effects by name.
    diameter_mm
        Diameter of the mouth.
    seed
        Seed of all random numbers.
    """

    sizes: common.Sizes
    noise: dict[str, TwoPointReadout] = field(default_factory=lambda: {"10bit": TwoPointReadout()})
    scenes: dict[str, Unmodelled] = field(default_factory=lambda: {"clean": Unmodelled()})
    diameter_mm: float = 35.0
    seed: int = 1

    def __post_init__(self) -> None:
        if not self.sizes or not self.noise or not self.scenes:
            raise ValueError("sizes, noise and scenes must hold at least one")
        common.check_sides(common.shapes_of(self.sizes), 8, common.MAX_SIDE)
        for name in (*self.noise, *self.scenes):
            check_name(name, "noise or scene")
        check_positive_fields(self, "diameter_mm")
        check_ranges(self, 0, 2**64 - 1, "seed")

    def simulations(self, frames: int) -> Iterator[tuple[str, Simulation]]:
        """Yield name, <panel>_<scene>_<noise>, and simulation in order of size.

        Simulations have 3 unloaded frames and `frames`.
        """
        course = common.shipped_lamprey().course
        for (rows, columns), (noise, readout), (effect, unmodelled) in product(
            common.shapes_of(self.sizes), self.noise.items(), self.scenes.items()
        ):
            mouth = common.lamprey_mouth(
                (10 * (columns // 2) - 6, 10 * (rows // 2) - 4), self.diameter_mm
            )
            simulation = Simulation(
                1,
                self.seed,
                common.simple_scene((rows, columns), readout),
                frames=frames,
                loads=(mouth,),
                course=course,
                unmodelled=unmodelled,
            )
            yield f"{rows}x{columns}_{effect}_{noise}", simulation


@dataclass(frozen=True)
class TradeoffFile(Configuration):
    """Settings of a trade-off. Raises ValueError for missing entries and numbers out of range.

    Attributes
    ----------
    recordings
        Files, relative to this one.
    simulated
        Simulated recordings.
    estimators
        Methods by name; by default the five of the paper.
    formulations
        Formulations, by default all. They must include `reduced`, the reference.
    frames
        Maximal number of measured frames of each recording.
    repeats, patience_s
        Number of passes of every formulation through a recording; none begins after `patience_s`.
    solver
        Tolerance and iterations of all solvers.
    limits
        Largest side for each formulation.
    """

    schema: Literal[1]
    recordings: tuple[str, ...] = ()
    simulated: Simulated | None = None
    estimators: dict[str, common.StudyMethod] = field(default_factory=common.paper_methods)
    formulations: tuple[MethodName | AnyMethod, ...] = (
        "naive",
        "scaled",
        "linearised",
        *(TruncatedMethod(steps=steps) for steps in (1, 2, 4)),
        "reduced",
        "nodal",
        "per_pixel",
    )
    frames: int = 5
    repeats: int = 3
    patience_s: float = 3.0
    solver: Settings = Settings()
    limits: TradeoffLimits = TradeoffLimits()

    def __post_init__(self) -> None:
        if not self.recordings and self.simulated is None:
            raise ValueError("name recordings, or say what is simulated")
        if not self.estimators:
            raise ValueError("estimators must hold at least one")
        for name in self.estimators:
            check_name(name, "estimator")
        if REFERENCE not in self.ladder:
            raise ValueError(
                f"formulations must hold {REFERENCE}, which the others are compared with"
            )
        if len(self.ladder) < len(self.formulations):
            raise ValueError("formulations names a rung twice")
        check_ranges(self, 2, 1000, "frames")
        check_ranges(self, 1, 1000, "repeats")
        check_not_negative(self, "patience_s")

    @property
    def ladder(self) -> dict[str, Method]:
        """Formulations by their names in tables and figures.

        A name is the kind, with its number of steps if it has one.
        """
        rungs = [named_method(formulation) for formulation in self.formulations]
        return {f"{rung.kind} {getattr(rung, 'steps', '')}".strip(): rung for rung in rungs}

    def rungs(self, shape: common.Shape) -> dict[str, Method]:
        """Return the formulations that are measured on a panel, by name."""
        return {
            name: rung
            for name, rung in self.ladder.items()
            if max(shape) <= getattr(self.limits, rung.kind, common.MAX_SIDE)
        }

    def methods(self, shape: common.Shape) -> list[str]:
        """Return the methods that are measured on a panel."""
        small = max(shape) <= self.limits.joint
        return [
            name
            for name, method in self.estimators.items()
            if small or not any(term.needs_previous for term in method.parts)
        ]


class Plan(NamedTuple):
    """Settings of a trade-off with its recordings, cut to their first frames."""

    settings: TradeoffFile
    recordings: list[Recording]


def read_plan(path: Path, assigned: tuple[str, ...] = ()) -> Plan:
    """Read the settings of a trade-off and its recordings.

    Raises InputError with line and column.
    """
    settings = read_settings(TradeoffFile)(path, assigned)
    files = recording_paths(path, list(settings.recordings))
    recordings = [common.first_frames(Recording.load(file), settings.frames) for file in files]
    if settings.simulated is not None:
        try:
            for name, simulation in settings.simulated.simulations(settings.frames):
                size = name.partition("_")[0]
                recordings.append(replace(simulate(simulation, size), name=name))
        except ValueError as error:
            raise InputError(f"{path}: simulated: {error}") from error
    for name, count in Counter(recording.name for recording in recordings).items():
        if count > 1:
            raise InputError(f"{path}: two recordings are called {name}")
    return Plan(settings, recordings)


@dataclass(frozen=True, kw_only=True)
class TradeoffFrame(TimedFrame):
    """A frame of a method and a formulation.

    The objective is the cost that the module describes, NaN of a failed frame. The gap is
    (φ − φ_best)/(φ_best + φ_noise), where φ_noise is the cost of residuals of one standard
    deviation; a gap far below 1 is invisible in the readings.
    """

    baseline_s: float = column(
        "s", "time of the unloaded baseline; 0 where it is solved with the first frame"
    )
    cell_error: float = column("percent", "median error of the cells against the truth")
    changed_error: float = column(
        "percent", "the same of cells that the load has changed by more than 5 percent"
    )


def run_tradeoff(plan: Plan, on_step: OnStep = lambda done, total: None) -> list[TradeoffFrame]:
    """Measure all methods and formulations.

    `on_step` receives the numbers of finished and of all parts.
    """
    parts = [
        (recording, method)
        for recording in plan.recordings
        for method in plan.settings.methods(recording.scene.panel.shape)
    ]
    measured = list[TradeoffFrame]()
    for done, part in enumerate(parts, 1):
        measured += _measure(plan.settings, *part)
        on_step(done, len(parts))
    return measured


def _measure(settings: TradeoffFile, recording: Recording, method: str) -> Iterator[TradeoffFrame]:
    """Measure all formulations with a method on a recording."""
    rungs = settings.rungs(recording.scene.panel.shape)
    begin = perf_counter()
    runs: dict[str, list[Estimates]] = {name: [] for name in rungs}
    for turn in range(settings.repeats):
        if turn and perf_counter() - begin > settings.patience_s:
            break
        for name, formulation in rungs.items():
            estimator = settings.estimators[method].estimator(formulation, settings.solver)
            runs[name].append(reconstruct(recording, estimator))
    costs = list(_costs(runs[REFERENCE][0]))
    objective = np.array(
        [
            [
                Evaluation.at(*cost, cells[None]).objective
                for cost, cells in zip(costs, run[0].cell_resistance, strict=True)
            ]
            for run in runs.values()
        ]
    )
    # (φ − φ_best)/(φ_best + φ_noise)
    least = np.nanmin(objective, axis=0)
    gaps = (objective - least) / (least + [_noise_cost(*cost) for cost in costs])
    for (name, run), values, gap in zip(
        runs.items(), objective.tolist(), gaps.tolist(), strict=True
    ):
        first = run[0]
        baseline_s = (
            0.0 if first.joint_start else min(estimates.baseline.seconds for estimates in run)
        )
        for number, (steps, cell, changed) in enumerate(
            zip(zip(*(each.steps for each in run), strict=True), *errors(first), strict=True)
        ):
            yield TradeoffFrame(
                **outcome(recording, steps[0]),
                method=method,
                solver=name,
                frame=number,
                seconds=min(step.seconds for step in steps),
                objective=values[number],
                gap=gap[number],
                baseline_s=baseline_s,
                cell_error=float(cell),
                changed_error=float(changed),
            )


def errors(estimates: Estimates) -> tuple[Array, Array]:
    """Return median errors of the cells of every frame in percent; NaN if unknown.

    Returns
    -------
    of_all : array, shape (frames,)
        Median over all cells.
    of_changed : array, shape (frames,)
        Median over the changed cells.
    """
    recording = estimates.recording
    truth = recording.truth_cell_resistance
    if truth is None:
        unknown = np.full(len(estimates.frame), np.nan)
        return unknown, unknown
    # changed cells: by more than 5 % from the median of the true unloaded cells
    unloaded = recording.role == UNLOADED
    resting = np.median(truth[unloaded], axis=0) if unloaded.any() else truth[0]
    loaded = truth[estimates.frame]
    error = relative_error(estimates.cell_resistance, loaded)
    error = np.where(recording.scene.broken, np.nan, error)
    # The threshold is that of `TradeoffFrame.changed_error`.
    changed = np.abs(loaded / resting - 1) > 0.05
    inside = [
        np.nanmedian(part[cells]) if cells.any() else np.nan
        for part, cells in zip(error, changed, strict=True)
    ]
    return np.nanmedian(error, axis=(1, 2)), np.array(inside)


def _costs(reference: Estimates) -> Iterator[tuple[Cost, Data]]:
    """Yield cost and data of every frame, with the reference's estimate of the previous frame."""
    recording = reference.recording
    estimator = reference.estimator
    readings = recording.readings()
    stream = replace(first_stream(recording, readings, estimator), baseline=reference.baseline)
    estimates = np.concatenate(
        [reference.baseline_resistance[None], reference.cell_resistance[:-1]]
    )
    for frame, previous in zip(reference.frame, estimates, strict=True):
        data, _ = replace(stream, previous=previous).data_and_start(readings[frame])
        yield estimator.cost(recording.scene, len(data.measured), partial=data.partial), data


def _noise_cost(cost: Cost, data: Data) -> float:
    """Return the misfit terms for residuals of one standard deviation."""
    costs = Evaluation(cost, data, data.apparent_resistance, data.measured + data.sigma, ()).costs
    return float(
        sum(value for term, value in zip(cost.terms, costs, strict=True) if term.reads_measurement)
    )


# Column → label.
FIGURES = {"changed_error": "median error of changed cells [%]", "gap": "objective gap"}
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
SCREEN: Columns = {
    "panel": "{rows} × {columns}",
    "method": "{method}",
    "formulation": "{formulation}",
    "first [ms]": "{first_ms:.3g}",
    "frame [ms]": "{frame_ms:.3g}",
    "cell error [%]": "{cell_error:.3g}",
    "of changed cells [%]": "{changed_error:.3g}",
    "gap median / worst": "{gap:.0e} / {worst_gap:.0e}",
    "reached [%]": lambda row: f"{100 * row.reached:.0f}",
    "failed": "{failed}/{frames}",
    "front": "{front}",
}


def ladder_rows(frames: Sequence[TradeoffFrame], *names: str) -> list[study.Row]:
    """Return a row for each panel size, formulation and further named fields."""
    return study.rows_by(attrgetter("shape", "solver", *names), _row)(frames)


def _row(measured: Sequence[TradeoffFrame]) -> study.Row:
    """Return medians over frames.

    `first_ms` includes the baseline, `reached` is the share of gaps up to 1e-6.
    """
    first = [frame.baseline_s + frame.seconds for frame in measured if not frame.frame]
    later = [frame.seconds for frame in measured if frame.frame]
    gaps = [frame.gap if np.isfinite(frame.gap) else np.inf for frame in measured]

    def only(name: str) -> str:
        """Return the text that all frames have, or 'all' for several."""
        texts = {getattr(frame, name) for frame in measured}
        return texts.pop() if len(texts) == 1 else "all"

    def median(name: str) -> float | None:
        """Return the median of the finite numbers; None without any."""
        numbers = [getattr(frame, name) for frame in measured]
        finite = [number for number in numbers if np.isfinite(number)]
        return float(np.median(finite)) if finite else None

    return study.Row(
        **study.named_values(measured[0], "rows", "columns"),
        recording=only("recording"),
        method=only("method"),
        formulation=measured[0].solver,
        first_ms=1e3 * float(np.median(first)),
        frame_ms=1e3 * float(np.median(later)),
        cell_error=median("cell_error"),
        changed_error=median("changed_error"),
        gap=float(np.median(gaps)),
        worst_gap=max(gaps),
        reached=float(np.mean(np.array(gaps) <= 1e-6)),
        frames=len(measured),
        failed=sum(not frame.solved for frame in measured),
    )


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of the Pareto front, ordered by the first coordinate.

    Smaller is better.
    """
    order = sorted(range(len(points)), key=lambda index: points[index])
    # The least error of all faster points.
    least = np.minimum.accumulate([np.inf, *(points[index][1] for index in order)])
    return [index for index, before in zip(order, least, strict=False) if points[index][1] < before]


def table_rows(frames: Sequence[TradeoffFrame]) -> list[study.Row]:
    """Return the rows of the first method.

    `front` marks those on the front of time and cell error, or time and gap.
    """
    rows = ladder_rows([frame for frame in frames if frame.method == frames[0].method])
    for panel_rows in grouped(rows, attrgetter("rows", "columns")).values():
        errors = [
            (row.frame_ms, np.inf if row.changed_error is None else row.changed_error)
            for row in panel_rows
        ]
        best = {*front(errors), *front([(row.frame_ms, row.gap) for row in panel_rows])}
        for number, row in enumerate(panel_rows):
            row.front = "*" * (number in best)
    return rows


def tradeoff_figure(rows: Sequence[study.Row]) -> Figure:
    """Draw the error of changed cells and the gap over time, for every panel size.

    Numbers are the formulations of the first method, the line is their Pareto front, small dots are
    further methods. Gaps below MIN_GAP are drawn at MIN_GAP. `rows` are those of all methods, with
    the recordings of a size together.
    """
    sizes = grouped(rows, attrgetter("rows", "columns"))
    methods, rungs = (
        list(dict.fromkeys(getattr(row, name) for row in rows))
        for name in ("method", "formulation")
    )
    figure = new_figure(2.2 * len(sizes) + 0.8)
    grid = figure.subplots(len(sizes), 2, squeeze=False, sharex="row")
    panels = product(sizes.items(), FIGURES.items())
    for axes, letter, ((shape, of_size), quantity) in zip(
        grid.flat, ascii_lowercase, panels, strict=False
    ):
        _draw(axes, of_size, methods, rungs, *quantity)
        axes.set_title(f"({letter}) {shape[0]} × {shape[1]} cells", fontsize=TEXT_POINT, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("time per frame [ms]", fontsize=TEXT_POINT)
    named = "    ".join(
        f"{number} {name.replace('_', ' ')}" for number, name in enumerate(rungs, 1)
    )
    shared_legend(figure, grid[:1, 1:], "lower center", title=named, title_fontsize=SMALL_POINT)
    return figure


def _draw(
    axes: Axes,
    rows: Sequence[study.Row],
    methods: list[str],
    rungs: list[str],
    name: str,
    label: str,
) -> None:
    """Draw a figure of the rows of a panel size over time."""
    dressed(axes, "", label)
    axes.set(xscale="log", yscale="log")
    places: dict[str, dict[str, tuple[float, float]]] = {method: {} for method in methods}
    for row in rows:
        value = getattr(row, name)
        if value is not None and np.isfinite(value):
            places[row.method][row.formulation] = row.frame_ms, max(value, MIN_GAP)
    first, *further = methods
    for method, colour in zip(further, COLOURS, strict=False):
        if places[method]:
            times, values = zip(*places[method].values(), strict=True)
            axes.plot(times, values, "o", label=method, color=colour, ms=2.8, mew=0, alpha=0.75)
    if not places[first]:
        axes.text(0.5, 0.5, "no truth", transform=axes.transAxes, ha="center", fontsize=TEXT_POINT)
        return
    # The Pareto front, and the number of each rung; those of the front are filled.
    points = list(places[first].values())
    on_front = [points[index] for index in front(points)]
    times, values = zip(*on_front, strict=True)
    axes.step(times, values, where="post", color="0.3", lw=0.9, label=f"{first}: Pareto front")
    for rung, point in places[first].items():
        fill, text = ("black", "white") if point in on_front else ("white", "black")
        axes.plot(*point, "o", ms=8, mfc=fill, mec="black", mew=0.8, zorder=3)
        axes.annotate(
            str(rungs.index(rung) + 1),
            point,
            color=text,
            ha="center",
            va="center_baseline",
            zorder=4,
            fontsize=SMALL_POINT - 1,
        )
    if min(value for _, value in places[first].values()) <= MIN_GAP:
        axes.axhline(MIN_GAP, color="0.5", lw=0.6, ls=":")
        axes.set_ylim(bottom=MIN_GAP / 30)
    axes.margins(0.12, 0.14)


STUDY: study.Study[Plan, list[TradeoffFrame]] = study.Study(
    "tradeoff",
    "measurements",
    "tradeoff.yaml",
    read_plan,
    run_tradeoff,
    rows=lambda frames: [
        *ladder_rows(frames),
        *ladder_rows(frames, "method"),
        *ladder_rows(frames, "method", "recording"),
    ],
    sheets=lambda frames: [("", table_rows(frames), SCREEN)],
    form="tradeoff/2",
    records=lambda frames: [study.RecordGroup("frames", frames, "seconds")],
    figures=lambda frames: {"tradeoff": tradeoff_figure(ladder_rows(frames, "method"))},
)
