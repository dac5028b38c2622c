"""Atlas of extreme scenes.

They are panels at the limits of sensors, faults and files, and how each solve ended. Solves are
verified by 50-digit arithmetic and a second test of optimality, which share no code with the
solvers.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, product
from math import nan
from typing import Any, Literal, NamedTuple

import numpy as np

from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import first_stream, frame_period
from lampest.estimate.stream import Stream
from lampest.files.errors import InputError
from lampest.files.typed import Configuration, check_range
from lampest.panel.faults import Faults
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.floating import exact_two_point_resistance, two_point_resistance
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.report.compare import Columns, grouped
from lampest.runs.executors import AnyExecutor, Processes, each_of
from lampest.solvers.solution import VERIFIED, Settings
from lampest.studies import study
from lampest.studies.certified import (
    correct_digits,
    exact_cost,
    exact_residual,
    exact_scale,
    fifty_digit_library,
    fifty_digits,
)
from lampest.studies.common import Shape, Sizes, StudyMethod, paper_methods, shapes_of
from lampest.studies.study import OnStep, column

GRID = "log-uniform"
OPEN = 1e9  # factor of a broken cell that the scene does not state; its inverse is that of a short
USUAL_OHM = 3000.0  # resistance of a cell before a case changes it


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

    @property
    def cell(self) -> Shape:
        """Row and column of the cell, row or column that breaks."""
        return self.rows // 2, self.columns // 3


class Extreme(NamedTuple):
    """Kind of scene.

    Attributes
    ----------
    factor : callable
        (row, column, sample, generator) → factors (rows, columns) of the usual cells.
    single_fault : bool
        Whether one cell or line is broken.
    contrasted : bool
        Whether it has the contrast of the sample.
    shapes : tuple of Shape
        Its panels, instead of those of the atlas.
    stated : str
        Key of the fault in the scene; '' for none.
    readout, series_ohm
        Entries of the scene.
    still : bool
        Whether both frames are equal, including noise.
    weight : float or None
        Weight of all penalties, instead of their own.
    """

    factor: Callable[[Any, Any, AtlasSample, np.random.Generator], Any] = (
        lambda row, column, sample, rng: 1.0
    )
    single_fault: bool = False
    contrasted: bool = False
    shapes: tuple[Shape, ...] = ()
    stated: str = ""
    readout: TwoPointReadout | None = None
    series_ohm: float = 0.0
    still: bool = False
    weight: float | None = None

    def faults(self, cell: Shape) -> Faults | None:
        """Return the faults that the scene states."""
        places: dict[str, Any] = {
            "dead_rows": cell[:1],
            "dead_columns": cell[1:],
            "open": (cell,),
            "shorted": (cell,),
        }
        return Faults(**{self.stated: places[self.stated]}) if self.stated else None


def recording_of(sample: AtlasSample) -> tuple[Recording, Array]:
    """Return a recording of a scene, and its cells (2, rows, columns) ohm, unloaded and loaded.

    Cells are equal for every noise. Readings are exact ones times 1 + noise, digitised if there is
    a converter.
    """
    case = CASES[sample.case]
    rng = np.random.default_rng([sample.seed, *sample.shape, 1])
    # cells within a factor of 2 of each other; a fifth of them have half their resistance under
    # load
    usual = USUAL_OHM * 10 ** rng.uniform(-0.15, 0.15, sample.shape)
    cells = np.stack([usual, np.where(rng.random(sample.shape) < 0.2, 0.5, 1.0) * usual])
    if case.still:
        cells[1] = cells[0]
    row, column = np.indices(sample.shape)
    cells *= case.factor(row, column, sample, rng)
    rng = np.random.default_rng([sample.seed, *sample.shape, 2])
    exact = two_point_resistance(cells)
    readout = case.readout
    noise = 1 + sample.noise * rng.standard_normal(exact.shape)
    if case.still:
        noise[1] = noise[0]
    total = exact * np.maximum(noise, 0.01) + case.series_ohm
    if case.series_ohm:
        total = np.maximum(
            total + sample.noise * case.series_ohm * rng.standard_normal(exact.shape), 1e-3
        )
    sigma: Array | None = max(sample.noise, 1e-9) * total
    if readout is not None:
        volt = readout.volt_from_recorded(total) + readout.noise_volt() * rng.standard_normal(
            total.shape
        )
        codes = readout.code_from_volt(volt).astype(float)
        total = readout.recorded_from_volt(readout.volt_from_code(codes))
        sigma = None
    usable = np.isfinite(total) & (total > 0)  # readings that are no value hold any finite number
    sigma = None if sigma is None else np.where(usable, sigma, USUAL_OHM)
    scene = Scene(Panel(*sample.shape), readout, case.series_ohm, case.faults(sample.cell))
    about = (
        np.where(usable, total, USUAL_OHM),
        np.arange(2.0),
        np.array([0, 1], dtype=np.uint8),
        sigma,
    )
    return Recording(scene, *about, name=sample.case), cells


def _broken(part: Literal["cell", "row", "column"], factor: float, stated: str = "") -> Extreme:
    """Return a case with a cell, row or column times a factor.

    The scene states it under a key.
    """

    def times(row: Array, column: Array, sample: AtlasSample, rng: np.random.Generator) -> Array:
        in_row = row == sample.cell[0]
        in_column = column == sample.cell[1]
        return np.where(
            {"cell": in_row & in_column, "row": in_row, "column": in_column}[part], factor, 1.0
        )

    return Extreme(times, single_fault=True, stated=stated)


CASES: dict[str, Extreme] = {
    GRID: Extreme(
        lambda _, __, at, rng: 10 ** rng.uniform(-at.decades / 2, at.decades / 2, at.shape),
        contrasted=True,
    ),
    # One block of good conductors beside three of bad ones.
    "two clusters": Extreme(
        lambda j, k, at, _: (
            10 ** (at.decades * (((j < at.rows // 2) | (k < at.columns // 2)) - 0.5))
        ),
        contrasted=True,
    ),
    "checkerboard": Extreme(
        lambda j, k, at, _: 10 ** (at.decades * ((j + k) % 2 - 0.5)), contrasted=True
    ),
    "open cell": _broken("cell", OPEN),
    "open row": _broken("row", OPEN),
    "open column": _broken("column", OPEN),
    "shorted cell": _broken("cell", 1 / OPEN),
    "shorted row": _broken("row", 1 / OPEN),
    "open cell, known": _broken("cell", np.inf, "open"),
    "dead row, known": _broken("row", np.inf, "dead_rows"),
    "dead column, known": _broken("column", np.inf, "dead_columns"),
    "shorted cell, known": _broken("cell", 0.0, "shorted"),
    "1 mOhm to 1 GOhm": Extreme(
        lambda j, _, at, rng: (
            rng.permutation(np.logspace(-3, 9, j.size)).reshape(at.shape) / USUAL_OHM
        )
    ),
    "1 x 1": Extreme(shapes=((1, 1),)),
    "1 x N": Extreme(shapes=((1, 9),)),
    "M x 1": Extreme(shapes=((9, 1),)),
    "2 x 64": Extreme(shapes=((2, 64),)),
    "identical frames": Extreme(still=True),
    "weight 0": Extreme(weight=0.0),
    "weight 1e-12": Extreme(weight=1e-12),
    "weight 1e12": Extreme(weight=1e12),
    # A row of readings beyond one end of the converter, and a cell beyond the other.
    "codes at both rails": Extreme(
        lambda j, k, at, _: np.where(j == at.cell[0], 1e6, 1.0) * np.where(j + k == 0, 1e-6, 1.0),
        readout=TwoPointReadout(readings=1),
    ),
    # A cell of about 1 mΩ, which is negligible against the series resistance.
    "at the series resistance": _broken("cell", 1e-3 / USUAL_OHM)._replace(series_ohm=140.0),
    "all times 1e6": Extreme(lambda *_: 1e6),
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
    estimators: dict[str, StudyMethod] = field(default_factory=paper_methods)
    solver: Settings = Settings()
    audit_cells: int = 64
    executor: AnyExecutor | None = None

    def __post_init__(self) -> None:
        if not self.estimators:
            raise ValueError("estimators must hold at least one")
        if not all(
            term.loss.squared for method in self.estimators.values() for term in method.parts
        ):
            raise ValueError("only squared losses can be tested by differences of the cost")
        if not self.samples:
            raise ValueError("grid and structured hold no scene")

    @property
    def samples(self) -> list[AtlasSample]:
        """Every scene in the order of the atlas."""
        structured = chain.from_iterable(
            self.structured.samples(name) for name in CASES if name != GRID
        )
        return [*self.grid.samples(GRID), *structured]

    def formulations(self, sample: AtlasSample) -> tuple[Literal["reduced", "nodal"], ...]:
        """Return the formulations in which every method solves a scene."""
        part = self.nodal
        small_special = bool(CASES[sample.case].shapes) and sample.rows * sample.columns < 100
        known = 100 * sample.noise in part.noise and sample.decades in (*part.decades, 0.0)
        chosen = (
            known and sample.seed < part.seeds and (small_special or sample.shape in part.shapes)
        )
        return ("reduced", "nodal") if chosen else ("reduced",)


CRASHED = "crashed: "
REFUSED = "refused: "


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
    audited: float = column(
        "1", "the same by differences of the exact forward map; NaN on large panels", nan
    )
    excess: float = column(
        "1", "cost of the estimate over that of the truth within the bounds, scaled", nan
    )
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
    """Solve all scenes in the order of the atlas.

    on_step : receives the numbers of finished and of all scenes.

    Raises InputError if mpmath is not installed.
    """
    fifty_digit_library()

    def lost(sample: AtlasSample, error: BaseException) -> tuple[Solve]:
        return (_failed(sample, "", "", "", error),)

    solves = each_of(
        partial(solves_of, atlas), atlas.samples, on_step, atlas.executor or Processes(), lost
    )
    return tuple(chain.from_iterable(solves))


def _failed(
    sample: AtlasSample, method: str, formulation: str, part: str, error: BaseException
) -> Solve:
    """Return a solve that ended with an exception."""
    status = (
        f"{REFUSED}{error}"
        if isinstance(error, InputError)
        else f"{CRASHED}{type(error).__name__}: {error}"
    )
    return Solve(
        **vars(sample),
        method=method,
        formulation=formulation,
        part=part,
        solved=False,
        status=status,
    )


def solves_of(atlas: AtlasFile, sample: AtlasSample) -> tuple[Solve, ...]:
    """Return all solves of a scene."""
    recording, cells = recording_of(sample)
    forward = min(
        correct_digits(two_point_resistance(frame), fifty_digits(frame)) for frame in cells
    )
    weight = CASES[sample.case].weight
    solves = list[Solve]()
    for formulation, (name, method) in product(
        atlas.formulations(sample), atlas.estimators.items()
    ):
        try:
            estimator = method.estimator(formulation, atlas.solver)
            if weight is not None:
                weights = [
                    float(term.weight) if term.reads_measurement else weight
                    for term in estimator.terms
                ]
                estimator = estimator.with_weights(weights)
            solves += judged(sample, name, estimator, recording, cells, atlas.audit_cells)
        except Exception as error:  # whatever it is, the atlas shows it
            solves.append(_failed(sample, name, formulation, "frame", error))
    return tuple(replace(solve, forward_digits=forward) for solve in solves)


def judged(
    sample: AtlasSample,
    name: str,
    estimator: Estimator,
    recording: Recording,
    truth: Array,
    audit_cells: int,
) -> list[Solve]:
    """Return the solves of baseline and frame, or of the pair, judged by the cells of the scene.

    Parameters
    ----------
    sample, name, estimator, recording
        The scene, and the method with its name.
    truth : array, shape (2, rows, columns)
        Ohm.
    audit_cells : int
        Largest panel with a second test of optimality.
    """
    readings = recording.readings()
    stream = first_stream(recording, readings, estimator)
    data, _ = stream.data_and_start(readings[1])
    joint = len(data.measured) == 2
    parts = [
        (
            "pair" if joint else "frame",
            truth[0 if joint else 1 :],
            estimator,
            data,
            stream.push(readings[1])[1],
        )
    ]
    if stream.baseline is not None:
        absolute = replace(estimator, terms=estimator.absolute_terms)
        blank = Stream(absolute, recording.scene, frame_period(recording), readings[0])
        parts.insert(
            0,
            (
                "baseline",
                truth[:1],
                absolute,
                blank.data_and_start(blank.resting)[0],
                stream.baseline,
            ),
        )
    solves = []
    for part, cells, fit, data, step in parts:
        solution = step.solution
        cost = fit.cost(recording.scene, len(data.measured), partial=data.partial)
        about: dict[str, Any] = {
            **vars(sample),
            "method": name,
            "formulation": fit.method.kind,
            "part": part,
        }
        about |= study.named_values(solution, "solved", "iterations")
        about |= {"status": solution.status.value, "residual": solution.kkt_residual}
        if solution.solved:
            estimate = solution.cell_resistance
            costs = [
                exact_cost(cost, data, point)
                for point in (estimate, np.clip(cells, data.lower, data.upper))
            ]
            about["audited"] = (
                exact_residual(cost, data, estimate) if estimate[0].size <= audit_cells else nan
            )
            about["excess"] = (costs[0] - costs[1]) / exact_scale(cost, data, estimate)
            about["model_digits"] = correct_digits(
                solution.reading, exact_two_point_resistance(estimate)
            )
        solves.append(Solve(**about))
    return solves


def _row(group: Sequence[Solve]) -> study.Row:
    """Summarise solves; digits are the least, residuals the largest.

    verified : confirmed estimates; named : failures with a reason; doubtful : estimates that the
    audit does not confirm; crashed : failures without a reason; worse : estimates that cost more
    than the truth.
    """
    solved = [solve for solve in group if solve.solved]
    statuses = Counter(solve.status for solve in group).most_common()
    iterations = [solve.iterations for solve in group]
    return study.Row(
        **study.named_values(
            group[0], "case", "decades", "rows", "columns", "noise", "method", "formulation"
        ),
        solves=len(group),
        verified=sum(solve.verified for solve in group),
        named=sum(not solve.solved and not solve.crashed for solve in group),
        doubtful=sum(solve.doubtful for solve in group),
        crashed=sum(solve.crashed for solve in group),
        worse=sum(solve.excess > VERIFIED for solve in solved),
        forward_digits=float(
            np.fmin.reduce([solve.forward_digits for solve in group], initial=nan)
        ),
        model_digits=float(np.fmin.reduce([solve.model_digits for solve in solved], initial=nan)),
        residual=float(np.fmax.reduce([solve.residual for solve in solved], initial=nan)),
        audited=float(np.fmax.reduce([solve.audited for solve in solved], initial=nan)),
        iterations=float(np.median(iterations)),
        most_iterations=max(iterations),
        statuses="; ".join(f"{count} × {status}" for status, count in statuses),
    )


atlas_rows = study.rows_by(  # for each cell of the atlas
    lambda solve: (
        solve.case,
        solve.decades,
        solve.shape,
        solve.noise,
        solve.method,
        solve.formulation,
    ),
    _row,
)
# All methods, sizes and noises together.
case_rows = study.rows_by(lambda solve: (solve.case, solve.decades), _row)
SCREEN: Columns = {
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
    """Return whether a verified optimum is promised.

    It is for noise up to 1 %, and a contrast up to 10⁶ or a single fault.
    """
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
        *((f"  {case}", own) for case, own in grouped(tame, lambda solve: solve.case).items()),
    ):
        lines.append(
            f"{title}: {_share(sum(solve.verified for solve in chosen), len(chosen), 'verified')}"
        )
    # A refusal without the numbers of its scene.
    kinds = (
        solve.status.split(":")[0] if solve.status.startswith(REFUSED) else solve.status
        for solve in solves
    )
    ended = Counter(kind for kind, solve in zip(kinds, solves, strict=True) if not solve.solved)
    return lines + [f"{count} × {status}" for status, count in ended.most_common()]


def _share(part: int, whole: int, noun: str) -> str:
    return f"{part} of {whole} {noun} ({f'{100 * part / whole:.2f} %' if whole else 'none tried'})"


STUDY: study.Study[AtlasFile, Sequence[Solve]] = study.Study(
    "extremes",
    "scenes",
    "extremes.yaml",
    study.read_settings(AtlasFile),
    run_atlas,
    rows=atlas_rows,
    sheets=lambda solves: [("", case_rows(solves), SCREEN)],
    form="extremes/2",
    records=lambda solves: [
        study.RecordGroup("solves", solves, "solved", attributes={"verified_below": VERIFIED})
    ],
    remarks=atlas_remarks,
)
