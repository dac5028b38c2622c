"""Atlas of extreme scenes: panels at the limits of sensors, faults and files, and how each solve ended.

Solves are verified by 50-digit arithmetic and a second test of optimality, which share no code with the solvers.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, product
from math import nan
from typing import Any, Literal, NamedTuple

import numpy as np

from lampest.cost.problem import Data
from lampest.estimate.estimator import Estimator
from lampest.estimate.methods import MethodName
from lampest.estimate.sequence import first_stream, frame_period
from lampest.estimate.state import Step
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.files.typed import Configuration, check_range
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.floating import exact_two_point_resistance, two_point_resistance
from lampest.panel.scene import Faults, Scene
from lampest.recording.recording import Recording
from lampest.runs.executors import AnyExecutor, Processes, each_of
from lampest.solvers.solution import VERIFIED, Settings
from lampest.studies import study
from lampest.studies.certified import correct_digits, exact_cost, exact_residual, exact_scale, fifty_digits
from lampest.studies.common import Shape, Sizes, SquaredMethod, paper_methods, shapes_of
from lampest.studies.study import OnStep, column

GRID = "log-uniform"
OPEN = 1e9  # factor of a broken cell that the scene does not state; its inverse is that of a short
USUAL_OHM = 3000.0  # resistance of a cell before a case changes it
Generator = np.random.Generator


@dataclass(frozen=True)
class AtlasSample:
    """A scene of the atlas."""

    case: str = column("1", "name of the scene")
    rows: int = column("1", "row lines")
    columns: int = column("1", "column lines")
    decades: float = column("1", "decades between the least and the largest sound cell")
    noise: float = column("1", "relative standard deviation of a reading")
    seed: int = column("1", "seed of cells and noise")

    @property
    def shape(self) -> Shape:
        """Rows and columns."""
        return self.rows, self.columns


class Made(NamedTuple):
    """Cells (2, rows, columns) ohm, unloaded and loaded, with statements of the scene about them.

    Attributes
    ----------
    cells : array, shape (2, rows, columns)
    faults, readout, series_ohm
        Entries of the scene.
    still : bool
        Whether both frames are equal, including noise.
    weight : float or None
        Weight of all penalties, instead of their own.
    """

    cells: Array
    faults: Faults | None = None
    readout: TwoPointReadout | None = None
    series_ohm: float = 0.0
    still: bool = False
    weight: float | None = None


class Extreme(NamedTuple):
    """Kind of scene.

    Attributes
    ----------
    make : callable
        Usual cells → scene.
    single_fault : bool
        Whether one cell or line is broken.
    contrasted : bool
        Whether it has the contrast of the sample.
    shapes : tuple of Shape
        Its panels, instead of those of the atlas.
    """

    make: Callable[[Array, AtlasSample, Generator], Made]
    single_fault: bool = False
    contrasted: bool = False
    shapes: tuple[Shape, ...] = ()


def recording_of(sample: AtlasSample) -> tuple[Recording, Made]:
    """Return a recording of a scene, and the scene.

    Cells are equal for every noise. Readings are exact ones times 1 + noise, digitised if there is a converter.
    """
    rng = np.random.default_rng([sample.seed, sample.rows, sample.columns, 1])
    # cells within a factor of 2 of each other; a fifth of them have half their resistance under load
    usual = USUAL_OHM * 10 ** rng.uniform(-0.15, 0.15, sample.shape)
    cells = np.stack([usual, np.where(rng.random(sample.shape) < 0.2, 0.5, 1.0) * usual])
    scene = CASES[sample.case].make(cells, sample, rng)
    rng = np.random.default_rng([sample.seed, sample.rows, sample.columns, 2])
    exact, readout = two_point_resistance(scene.cells), scene.readout
    noise = 1 + sample.noise * rng.standard_normal(exact.shape)
    if scene.still:
        noise[1] = noise[0]
    total = exact * np.maximum(noise, 0.01) + scene.series_ohm
    if scene.series_ohm:
        total = np.maximum(total + sample.noise * scene.series_ohm * rng.standard_normal(exact.shape), 1e-3)
    sigma: Array | None = max(sample.noise, 1e-9) * total
    if readout is not None:
        volt = readout.volt_from_recorded(total) + readout.noise_volt() * rng.standard_normal(total.shape)
        codes = readout.code_from_volt(volt).astype(float)
        total, sigma = readout.recorded_from_volt(readout.volt_from_code(codes)), None
    usable = np.isfinite(total) & (total > 0)  # readings that are no value hold any finite number
    total = np.where(usable, total, USUAL_OHM)
    sigma = None if sigma is None else np.where(usable, sigma, USUAL_OHM)
    place = Scene(Panel(*sample.shape), readout, scene.series_ohm, scene.faults)
    role = np.array([0, 1], dtype=np.uint8)
    return Recording(place, total, np.arange(2.0), role, sigma, name=sample.case), scene


def _cell(sample: AtlasSample) -> tuple[int, int]:
    return sample.rows // 2, sample.columns // 3


def _times(factor: float, part: str, *, known: bool = False) -> Extreme:
    """Return a case with a cell, row or column times a factor; known : whether the scene states it."""

    def make(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
        row, column = _cell(sample)
        place = {"cell": (row, column), "row": (row,), "column": (slice(None), column)}[part]
        cells = cells.copy()
        cells[(slice(None), *place)] *= factor
        stated: dict[str, Any] = {"row": {"dead_rows": (row,)}, "column": {"dead_columns": (column,)}}
        stated["cell"] = {"shorted" if factor == 0 else "open": ((row, column),)}
        return Made(cells, Faults(**stated[part]) if known else None)

    return Extreme(make, single_fault=True)


def _contrasted(pattern: Callable[[Array, Array, AtlasSample, Generator], Array]) -> Extreme:
    """Return a case with cells times 10^pattern(row, column) around the usual resistance."""

    def make(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
        row, column = np.indices(sample.shape, dtype=float)
        factor = 10.0 ** pattern(row, column, sample, rng)
        return Made(cells * factor / 10 ** (np.ptp(np.log10(factor)) / 2 if factor.min() == 1 else 0))

    return Extreme(make, contrasted=True)


def _milliohm_to_gigaohm(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    levels = np.logspace(-3, 9, cells[0].size)
    return Made(cells / USUAL_OHM * rng.permutation(levels).reshape(sample.shape))


def _usual(*shapes: Shape, scale: float = 1.0, **stated: Any) -> Extreme:
    """Return a case with the usual cells, with its own shapes if given, and statements of the scene."""
    return Extreme(lambda cells, sample, rng: Made(scale * cells, **stated), shapes=shapes)


def _rails(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    """Make a row of readings beyond one end of the converter, and a cell beyond the other."""
    cells = cells.copy()
    cells[:, sample.rows // 2] *= 1e6
    cells[:, 0, 0] *= 1e-6
    return Made(cells, readout=TwoPointReadout(readings=1))


def _at_series(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    """Make a cell that is negligible against the series resistance."""
    cells = cells.copy()
    cells[(slice(None), *_cell(sample))] = 1e-3
    return Made(cells, series_ohm=140.0)


CASES: dict[str, Extreme] = {
    GRID: _contrasted(lambda _, __, at, rng: rng.uniform(-at.decades / 2, at.decades / 2, at.shape)),
    # One block of good conductors beside three of bad ones.
    "two clusters": _contrasted(lambda j, k, at, rng: at.decades * ((j < at.rows // 2) | (k < at.columns // 2))),
    "checkerboard": _contrasted(lambda row, column, sample, rng: sample.decades * ((row + column) % 2)),
    "open cell": _times(OPEN, "cell"),
    "open row": _times(OPEN, "row"),
    "open column": _times(OPEN, "column"),
    "shorted cell": _times(1 / OPEN, "cell"),
    "shorted row": _times(1 / OPEN, "row"),
    "open cell, known": _times(np.inf, "cell", known=True),
    "dead row, known": _times(np.inf, "row", known=True),
    "dead column, known": _times(np.inf, "column", known=True),
    "shorted cell, known": _times(0.0, "cell", known=True),
    "1 mOhm to 1 GOhm": Extreme(_milliohm_to_gigaohm),
    "1 x 1": _usual((1, 1)),
    "1 x N": _usual((1, 9)),
    "M x 1": _usual((9, 1)),
    "2 x 64": _usual((2, 64)),
    "identical frames": Extreme(lambda cells, sample, rng: Made(np.stack([cells[0]] * 2), still=True)),
    "weight 0": _usual(weight=0.0),
    "weight 1e-12": _usual(weight=1e-12),
    "weight 1e12": _usual(weight=1e12),
    "codes at both rails": Extreme(_rails),
    "at the series resistance": Extreme(_at_series, single_fault=True),
    "all times 1e6": _usual(scale=1e6),
}


@dataclass(frozen=True)
class Grid(Configuration):
    """Panels of random cells, log-uniform: every size with every number of decades, noise and seed.

    Attributes
    ----------
    sizes
        Sides of square panels, or [rows, columns].
    decades
        Decades between the least and the largest cell.
    noise
        Relative standard deviation of a reading in percent.
    seeds
        Number of panels of each kind.
    """

    sizes: Sizes
    decades: tuple[float, ...] = (1, 2, 3, 4, 5, 6, 7, 8, 9)
    noise: tuple[float, ...] = (0, 0.1, 1, 10)
    seeds: int = 1

    def __post_init__(self) -> None:
        check_range("a panel's side", [side for shape in self.shapes for side in shape], 1, 64)
        check_range("decades", self.decades, 0, 15)
        check_range("noise", self.noise, 0, 100, " percent")
        check_range("seeds", self.seeds, 0, 1000)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """Shapes (rows, columns) of the panels."""
        return shapes_of(self.sizes)

    def samples(self, name: str) -> Iterator[AtlasSample]:
        """Yield the samples of a case."""
        case = CASES[name]
        shapes = (case.shapes or self.shapes) if self.sizes else ()
        decades = self.decades if case.contrasted else (0.0,)
        for shape, decade, noise, seed in product(shapes, decades, self.noise, range(self.seeds)):
            yield AtlasSample(name, *shape, decade, noise / 100, seed)


@dataclass(frozen=True)
class AtlasFile(Configuration):
    """Settings of the atlas.

    Attributes
    ----------
    grid
        Panels of random cells.
    structured
        Sizes, contrasts and noise of all other cases.
    nodal
        Sizes, decades and noise of the scenes that the nodal formulation solves, too.
    estimators
        Methods by name; by default the five of the paper.
    solver
        Tolerance and iterations.
    audit_cells
        Largest panel on which optimality is tested by differences of the exact forward map.
    executor
        Where the scenes are solved; by default on all cores.
    """

    schema: Literal[1]
    grid: Grid
    structured: Grid
    nodal: Grid = Grid(())
    estimators: dict[str, SquaredMethod] = field(default_factory=lambda: paper_methods(SquaredMethod))
    solver: Settings = Settings()
    audit_cells: int = 64
    executor: AnyExecutor | None = None

    def __post_init__(self) -> None:
        if not self.estimators:
            raise ValueError("estimators must hold at least one")
        if not self.tasks:
            raise ValueError("grid and structured hold no scene")

    @property
    def tasks(self) -> list["AtlasTask"]:
        """Every scene with the formulations that solve it, in the order of the atlas."""
        named = [(self.grid, GRID), *((self.structured, name) for name in CASES if name != GRID)]
        samples = (sample for grid, name in named for sample in grid.samples(name))
        return [AtlasTask(sample, self, self._formulations(sample)) for sample in samples]

    def _formulations(self, sample: AtlasSample) -> tuple[MethodName, ...]:
        part, own = self.nodal, bool(CASES[sample.case].shapes) and sample.rows * sample.columns < 100
        known = 100 * sample.noise in part.noise and sample.decades in (*part.decades, 0.0)
        chosen = known and sample.seed < part.seeds and (own or sample.shape in part.shapes)
        return ("reduced", "nodal") if chosen else ("reduced",)


class AtlasTask(NamedTuple):
    """One scene, and the formulations in which every method solves it."""

    sample: AtlasSample
    atlas: AtlasFile
    formulations: tuple[MethodName, ...]


CRASHED, REFUSED = "crashed: ", "refused: "


@dataclass(frozen=True)
class Solve(AtlasSample):
    """A solve of the atlas; digits are log relative errors (NIST StRD)."""

    method: str = column("1", "method")
    formulation: str = column("1", "formulation")
    part: str = column("1", "baseline, frame, or the pair of both")
    solved: bool = column("1", "1: there is an estimate")
    status: str = column("1", "how the solve ended")
    iterations: int = column("1", "iterations of the solver", 0)
    residual: float = column("1", "KKT residual of the accepted estimate", nan)
    audited: float = column("1", "the same by differences of the exact forward map; NaN on large panels", nan)
    excess: float = column("1", "cost of the estimate over that of the truth within the bounds, scaled", nan)
    forward_digits: float = column("1", "LRE of the forward map, 50 digits", nan)
    model_digits: float = column("1", "LRE of the estimate's two-point resistance", nan)

    @property
    def doubtful(self) -> bool:
        """Whether the second test of optimality does not confirm an estimate."""
        return self.solved and self.audited > 10 * VERIFIED  # of a residual by differences

    @property
    def verified(self) -> bool:
        """Whether there is an estimate without objections."""
        return self.solved and not self.doubtful

    @property
    def crashed(self) -> bool:
        """Whether there is neither an estimate nor a reason."""
        return self.status.startswith(CRASHED)


def run_atlas(atlas: AtlasFile, on_step: OnStep = lambda done, total: None) -> tuple[Solve, ...]:
    """Solve all scenes in the order of the atlas. on_step : receives the numbers of finished and of all scenes.

    Raises InputError if mpmath is not installed.
    """
    fifty_digits(np.ones((1, 1)))

    def lost(task: AtlasTask, error: BaseException) -> tuple[Solve]:
        return (_failed(task.sample, "", "", "", f"{CRASHED}{type(error).__name__}: {error}"),)

    solves = each_of(solves_of, atlas.tasks, on_step, atlas.executor or Processes(), lost)
    return tuple(chain.from_iterable(solves))


def solves_of(task: AtlasTask) -> tuple[Solve, ...]:
    """Return all solves of a scene."""
    sample, atlas = task.sample, task.atlas
    recording, scene = recording_of(sample)
    forward = min(correct_digits(two_point_resistance(cells), fifty_digits(cells)) for cells in scene.cells)
    solves: list[Solve] = []
    for formulation in task.formulations:
        for name, method in atlas.estimators.items():
            terms = method.parts
            if scene.weight is not None:
                terms = tuple(term if term.reads_measurement else replace(term, weight=scene.weight) for term in terms)
            try:
                parts = _parts(Estimator(terms, formulation, atlas.solver, method.bounds), recording)
                solves += [_judged(task, name, part, recording, scene.cells) for part in parts]
            except InputError as error:
                solves.append(_failed(sample, name, formulation, "frame", f"{REFUSED}{error}"))
            except Exception as error:  # whatever it is, the atlas shows it
                solves.append(_failed(sample, name, formulation, "frame", f"{CRASHED}{type(error).__name__}: {error}"))
    return tuple(replace(solve, forward_digits=forward) for solve in solves)


def _failed(sample: AtlasSample, method: str, formulation: str, part: str, status: str) -> Solve:
    return Solve(**vars(sample), method=method, formulation=formulation, part=part, solved=False, status=status)


class _Part(NamedTuple):
    """Solve of a sequence with its data.

    Attributes
    ----------
    frames : slice
        Slice of the scene's.
    estimator : Estimator
        That of its cost.
    """

    name: str
    frames: slice
    estimator: Estimator
    data: Data
    step: Step


def _parts(estimator: Estimator, recording: Recording) -> Iterator[_Part]:
    """Yield the solves of baseline and frame, or of the pair."""
    readings = recording.readings()
    stream = first_stream(recording, readings, estimator)
    if stream.baseline is not None:
        alone = replace(estimator, terms=estimator.absolute_terms)
        blank = Stream(alone, recording.scene, frame_period(recording), readings[0])
        yield _Part("baseline", slice(0, 1), alone, blank.given(blank.resting)[0], stream.baseline)
    data, _ = stream.given(readings[1])
    _, step = stream.push(readings[1])
    joint = len(data.measured) == 2
    yield _Part("pair" if joint else "frame", slice(0 if joint else 1, 2), estimator, data, step)


def _judged(task: AtlasTask, method: str, part: _Part, recording: Recording, cells: Array) -> Solve:
    """Judge a solve by the cells of the scene, (2, rows, columns) ohm."""
    solution, data, estimator = part.step.solution, part.data, part.estimator
    cost = estimator.cost(recording.scene, len(data.measured), partial=data.partial)
    solve = Solve(
        **vars(task.sample),
        method=method,
        formulation=estimator.method.kind,
        part=part.name,
        solved=solution.solved,
        status=solution.status.value,
        iterations=solution.iterations,
        residual=solution.kkt_residual,
    )
    if not solution.solved:
        return solve
    cells, truth = solution.cell_resistance, np.clip(cells[part.frames], data.lower, data.upper)
    return replace(
        solve,
        audited=exact_residual(cost, data, cells) if cells[0].size <= task.atlas.audit_cells else nan,
        excess=(exact_cost(cost, data, cells) - exact_cost(cost, data, truth)) / exact_scale(cost, data, cells),
        model_digits=correct_digits(solution.reading, exact_two_point_resistance(cells)),
    )


def _row(own: Sequence[Solve]) -> study.Row:
    """Summarise solves; digits are the least, residuals the largest.

    verified : confirmed estimates; named : failures with a reason; doubtful : estimates that the audit does not
    confirm; crashed : failures without a reason; worse : estimates that cost more than the truth.
    """
    solved = [solve for solve in own if solve.solved]
    statuses = Counter(solve.status for solve in own).most_common()
    return study.Row(
        **study.named_values(own[0], "case", "decades", "rows", "columns", "noise", "method", "formulation"),
        solves=len(own),
        verified=sum(solve.verified for solve in own),
        named=sum(not solve.solved and not solve.crashed for solve in own),
        doubtful=sum(solve.doubtful for solve in own),
        crashed=sum(solve.crashed for solve in own),
        worse=sum(solve.excess > VERIFIED for solve in solved),
        forward_digits=_of(min, own, "forward_digits"),
        model_digits=_of(min, solved, "model_digits"),
        residual=_of(max, solved, "residual"),
        audited=_of(max, solved, "audited"),
        iterations=float(np.median([solve.iterations for solve in own])),
        most_iterations=max(solve.iterations for solve in own),
        statuses="; ".join(f"{count} × {status}" for status, count in statuses),
    )


def _of(reduce: Callable[[Any], float], solves: Sequence[Solve], what: str) -> float:
    """Return a reduction of all numbers, or NaN."""
    known = [value for solve in solves if np.isfinite(value := getattr(solve, what))]
    return float(reduce(known)) if known else float("nan")


atlas_rows = study.rows_by(  # for each cell of the atlas
    lambda solve: (solve.case, solve.decades, solve.shape, solve.noise, solve.method, solve.formulation), _row
)
case_rows = study.rows_by(lambda solve: (solve.case, solve.decades), _row)  # all methods, sizes and noises together
SCREEN: study.Screen = {
    "case": "{case}",
    "decades": lambda row: f"{row.decades:g}" if CASES[row.case].contrasted else "",
    "verified": "{verified}/{solves}",
    "named": lambda row: f"{row.named or ''}",
    "doubtful": lambda row: f"{row.doubtful or ''}",
    "crashed": lambda row: f"{row.crashed or ''}",
    "worse than truth": lambda row: f"{row.worse or ''}",
    "digits: forward": "{forward_digits:.1f}",
    "model": "{model_digits:.1f}",
    "worst KKT": "{residual:.0e}",
    "audited": "{audited:.0e}",
    "iterations (most)": "{iterations:.0f} ({most_iterations})",
}


def mild(solve: Solve) -> bool:
    """Return whether a verified optimum is promised: noise up to 1 %, and a contrast up to 10⁶ or a single fault."""
    case = CASES[solve.case]
    return ((case.contrasted and solve.decades <= 6) or case.single_fault) and solve.noise <= 0.01


def atlas_remarks(solves: Sequence[Solve]) -> list[str]:
    """Return the share of verified optima, and the counts of other endings."""
    named = sum(not solve.crashed and not solve.doubtful for solve in solves)
    tame = [solve for solve in solves if mild(solve)]
    lines = [_share(named, len(solves), "solves end with a verified optimum or a sentence")]
    for title, chosen in (
        ("all", solves),
        ("contrast up to 10⁶ or a single fault, noise up to 1 %", tame),
        *((f"  {case}", own) for case, own in study.grouped(tame, lambda solve: solve.case).items()),
    ):
        lines.append(f"{title}: {_share(sum(solve.verified for solve in chosen), len(chosen), 'verified')}")
    # A refusal without the numbers of its scene.
    kinds = (solve.status.split(":")[0] if solve.status.startswith(REFUSED) else solve.status for solve in solves)
    ended = Counter(kind for kind, solve in zip(kinds, solves, strict=True) if not solve.solved)
    return lines + [f"{count} × {status}" for status, count in ended.most_common()]


def _share(part: int, whole: int, what: str) -> str:
    return f"{part} of {whole} {what} ({f'{100 * part / whole:.2f} %' if whole else 'none tried'})"


STUDY: study.Study[AtlasFile, Sequence[Solve]] = study.Study(
    "extremes",
    "scenes",
    "extremes.yaml",
    study.read_settings(AtlasFile),
    run_atlas,
    rows=atlas_rows,
    tables=lambda solves: [("", study.screen_table(case_rows(solves), SCREEN))],
    form="extremes/2",
    records=lambda solves: [study.RecordGroup("solves", solves, "solved", attributes={"verified_below": VERIFIED})],
    remarks=atlas_remarks,
)
