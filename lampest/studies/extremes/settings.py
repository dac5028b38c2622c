"""The YAML file of an atlas, and the scenes and solves that follow from it."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

from lampest.estimate.methods import MethodName
from lampest.files.document import read_document, validated
from lampest.runs.executors import AnyExecutor
from lampest.runs.terms import FORBID
from lampest.solvers.solution import Settings
from lampest.studies.bench.settings import SquaredMethod, paper_methods
from lampest.studies.extremes.scenes import CASES, AtlasSample

LARGEST_SIDE = 64
MOST_DECADES = 15.0
GRID = "log-uniform"
Shape = tuple[int, int]


@dataclass(frozen=True)
class Grid:
    """Panels of random cells, uniform in the logarithm: every size with every number of decades, noise and seed.

    Parameters
    ----------
    sizes : sides of square panels, or [rows, columns]. decades : between the least and the largest cell.
    noise : relative standard deviation of a reading, percent. seeds : how many panels of each kind.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = FORBID
    sizes: tuple[int | Shape, ...]
    decades: tuple[float, ...] = (1, 2, 3, 4, 5, 6, 7, 8, 9)
    noise: tuple[float, ...] = (0, 0.1, 1, 10)
    seeds: int = 1

    def __post_init__(self) -> None:
        if not all(1 <= side <= LARGEST_SIDE for shape in self.shapes for side in shape):
            raise ValueError(f"a panel's side must lie between 1 and {LARGEST_SIDE}")
        if not all(0 <= decades <= MOST_DECADES for decades in self.decades):
            raise ValueError(f"decades must lie between 0 and {MOST_DECADES:g}")
        if not all(0 <= noise <= 100 for noise in self.noise):
            raise ValueError("noise must lie between 0 and 100 percent")
        if not 0 <= self.seeds <= 1000:
            raise ValueError("seeds must lie between 0 and 1000")

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """(rows, columns) of every panel."""
        return tuple((size, size) if isinstance(size, int) else size for size in self.sizes)


@dataclass(frozen=True)
class AtlasFile:
    """What is tried.

    Parameters
    ----------
    grid : panels of random cells. structured : sizes, contrasts and noise of all other cases.
    nodal : the part of both that the nodal formulation solves too: sizes, decades and noise.
    estimators : methods by name; the paper's five by default.
    solver : tolerance and iterations. audit_cells : the largest panel on which the optimality of every estimate is
    tested a second time, by differences of the exact forward map.
    executor : where the scenes are solved; all cores by default.

    Raises ValueError where a number is out of range.
    """

    __pydantic_config__: ClassVar[Any] = FORBID
    schema: Literal[1]
    grid: Grid
    structured: Grid
    nodal: Grid = Grid(())
    estimators: dict[str, SquaredMethod] = field(default_factory=paper_methods)
    solver: Settings = Settings()
    audit_cells: int = 64
    executor: AnyExecutor | None = None

    def __post_init__(self) -> None:
        if not self.estimators:
            raise ValueError("estimators must hold at least one")
        if not self.tasks:
            raise ValueError("grid and structured hold no scene")

    @property
    def tasks(self) -> tuple["AtlasTask", ...]:
        """Every scene with the formulations that solve it, in the order of the atlas."""
        samples = (
            *_samples(self.grid, (GRID,)),
            *_samples(self.structured, tuple(name for name in CASES if name != GRID)),
        )
        return tuple(AtlasTask(sample, self, self._formulations(sample)) for sample in samples)

    def _formulations(self, sample: AtlasSample) -> tuple[MethodName, ...]:
        part = self.nodal
        own = CASES[sample.case].shapes
        chosen = (sample.shape in part.shapes or (bool(own) and sample.rows * sample.columns < 100)) and (
            100 * sample.noise in part.noise and sample.decades in (*part.decades, 0.0) and sample.seed < part.seeds
        )
        return ("reduced", "nodal") if chosen else ("reduced",)


@dataclass(frozen=True)
class AtlasTask:
    """One scene, and the formulations in which every method solves it."""

    sample: AtlasSample
    atlas: AtlasFile
    formulations: tuple[MethodName, ...]


def _samples(grid: Grid, names: tuple[str, ...]) -> Iterator[AtlasSample]:
    for name in names:
        case = CASES[name]
        for shape in (case.shapes or grid.shapes) if grid.sizes else ():
            for decades in grid.decades if case.contrasted else (0.0,):
                for noise in grid.noise:
                    for seed in range(grid.seeds):
                        yield AtlasSample(name, *shape, decades, noise / 100, seed)


def read_atlas(path: Path, settings: tuple[str, ...] = ()) -> AtlasFile:
    """An atlas' file. Raises InputError with line and column."""
    return cast(AtlasFile, validated(read_document(path, settings), AtlasFile))
