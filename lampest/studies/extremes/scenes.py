"""Scenes of the atlas and its YAML file: panels at the limits of sensors, faults and files."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np

from lampest.estimate.methods import MethodName
from lampest.files.typed import Configuration, check_range
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.floating import two_point_resistance
from lampest.panel.scene import Faults, Scene
from lampest.recording.recording import Recording
from lampest.runs.executors import AnyExecutor
from lampest.solvers.solution import Settings
from lampest.studies.common import Shape, Sizes, SquaredMethod, paper_methods, shapes_of
from lampest.studies.study import column

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
