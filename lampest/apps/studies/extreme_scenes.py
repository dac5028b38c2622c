"""Scenes at the limits of sensors and faults: random panels, clusters, broken cells and lines."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np

from lampest.apps.studies.common import Shape, Sizes, shapes_of
from lampest.apps.studies.study import column
from lampest.files.typed import Configuration, check_range
from lampest.panel.faults import Faults
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.converter import noise_volt
from lampest.panel.readouts.floating import two_point_resistance
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording

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
    """Return a recording of a scene with its true cells.

    Cells are equal for every noise. Readings are exact ones times 1 + noise, digitised if there is
    a converter.

    Returns
    -------
    recording : Recording
        One unloaded and one loaded frame.
    cells : array, shape (2, rows, columns)
        True resistances in ohm.
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
        volt = readout.volt_from_recorded(total) + noise_volt(readout) * rng.standard_normal(
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
