"""What the atlas measures: panels at the edge of what a sensor, a fault or a file can bring about."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.two_point.exact import two_point_resistance
from lampest.panel.scene import Faults, Scene
from lampest.recording.recording import Recording

USUAL_OHM = 3000.0
OPEN, SHORT = 1e9, 1e-9
LEAST_NOISE = 1e-9  # σ of readings that are exact, relative
CHANGED, CHANGE = 0.2, 0.5
READOUT = TwoPointReadout(readings=1)
SERIES_OHM = 140.0
Generator = np.random.Generator


@dataclass(frozen=True)
class AtlasSample:
    """One scene of the atlas.

    Parameters
    ----------
    case : name in `CASES`. rows, columns : of the panel. decades : between the least and the largest sound cell.
    noise : relative standard deviation of a reading. seed : of cells and noise.
    """

    case: str
    rows: int
    columns: int
    decades: float
    noise: float
    seed: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.rows, self.columns


@dataclass(frozen=True, eq=False)
class Made:
    """Cells (2, rows, columns) ohm, unloaded and loaded, with what the scene says of them.

    still : both frames are the same, noise included. weight : of all penalties in place of their own, or None.
    scale : the estimate must be this times that from readings smaller by as much.
    """

    cells: Array
    faults: Faults | None = None
    readout: TwoPointReadout | None = None
    series_ohm: float = 0.0
    still: bool = False
    weight: float | None = None
    scale: float = 1.0


@dataclass(frozen=True)
class Extreme:
    """How a scene is made from the usual cells, and what it stands for.

    single_fault : one cell or line is broken. contrasted : its contrast is the sample's.
    shapes : the panels that it is about, in place of the atlas' own.
    """

    make: Callable[[Array, AtlasSample, Generator], Made]
    single_fault: bool = False
    contrasted: bool = False
    shapes: tuple[tuple[int, int], ...] = ()


def made(sample: AtlasSample) -> Made:
    """The scene's cells; the same for every noise."""
    rng = np.random.default_rng([sample.seed, sample.rows, sample.columns, 1])
    usual = USUAL_OHM * 10 ** rng.uniform(-0.15, 0.15, sample.shape)
    cells = np.stack([usual, np.where(rng.random(sample.shape) < CHANGED, CHANGE, 1.0) * usual])
    return CASES[sample.case].make(cells, sample, rng)


def recording_of(sample: AtlasSample) -> tuple[Recording, Made]:
    """The scene's readings: exact ones, times 1 + noise, through the converter where there is one."""
    scene = made(sample)
    rng = np.random.default_rng([sample.seed, sample.rows, sample.columns, 2])
    exact = two_point_resistance(scene.cells)
    noise = 1 + sample.noise * rng.standard_normal(exact.shape)
    if scene.still:
        noise[1] = noise[0]
    network = exact * np.maximum(noise, 0.01)
    total = network + scene.series_ohm
    if scene.series_ohm:
        total = np.maximum(total + sample.noise * scene.series_ohm * rng.standard_normal(exact.shape), 1e-3)
    sigma: Array | None = max(sample.noise, LEAST_NOISE) * total
    if scene.readout is not None:
        total, sigma = _converted(scene.readout, total, rng), None
    total, sigma = _filled(total, sigma)
    place = Scene(Panel(*sample.shape), scene.readout, scene.series_ohm, scene.faults)
    role = np.array([0, 1], dtype=np.uint8)
    return Recording(place, total, np.arange(2.0), role, sigma, name=sample.case), scene


def _converted(readout: TwoPointReadout, total: Array, rng: Generator) -> Array:
    """What one conversion says of a resistance."""
    noise = readout.noise_volt() * rng.standard_normal(total.shape)
    code = readout.code_from_volt(readout.volt_from_recorded(total) + noise)
    return readout.recorded_from_volt(readout.volt_from_code(code.astype(float)))


def _filled(total: Array, sigma: Array | None) -> tuple[Array, Array | None]:
    """Readings that say nothing hold any finite number."""
    usable = np.isfinite(total) & (total > 0)
    filled = np.where(usable, total, USUAL_OHM)
    return filled, None if sigma is None else np.where(usable, sigma, USUAL_OHM)


def _changed(where: Callable[[AtlasSample], object], factor: float) -> Callable[[Array, AtlasSample, Generator], Made]:
    """The cells with some of them times a factor."""

    def make(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
        cells = cells.copy()
        for frame in cells:
            frame[where(sample)] *= factor
        return Made(cells)

    return make


def _known(factor: float, faults: Callable[[AtlasSample], Faults], where: Callable[[AtlasSample], object]) -> Extreme:
    def make(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
        return replace(_changed(where, factor)(cells, sample, rng), faults=faults(sample))

    return Extreme(make, single_fault=True)


def _cell(sample: AtlasSample) -> tuple[int, int]:
    return sample.rows // 2, sample.columns // 3


def _row(sample: AtlasSample) -> int:
    return sample.rows // 2


def _column(sample: AtlasSample) -> tuple[slice, int]:
    return slice(None), sample.columns // 3


def _log_uniform(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    return Made(_spread(cells, 10 ** rng.uniform(-sample.decades / 2, sample.decades / 2, sample.shape), sample))


def _clusters(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    """Two blocks of good conductors that only bad ones connect."""
    first = np.add.outer(np.arange(sample.rows) < sample.rows // 2, np.arange(sample.columns) < sample.columns // 2)
    return Made(_spread(cells, np.where(first == 1, 10.0**sample.decades, 1.0), sample))


def _checkerboard(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    odd = np.add.outer(np.arange(sample.rows), np.arange(sample.columns)) % 2
    return Made(_spread(cells, 10.0 ** (sample.decades * odd), sample))


def _spread(cells: Array, factor: Array, sample: AtlasSample) -> Array:
    """The cells times a factor that is the same in both frames, around the usual resistance."""
    return cells * factor / 10 ** (np.ptp(np.log10(factor)) / 2 if factor.min() == 1 else 0)


def _milliohm_to_gigaohm(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    levels = np.logspace(-3, 9, cells[0].size)
    return Made(cells / USUAL_OHM * rng.permutation(levels).reshape(sample.shape))


def _usual(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    return Made(cells)


def _weighted(weight: float) -> Extreme:
    return Extreme(lambda cells, sample, rng: Made(cells, weight=weight))


def _rails(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    """A row of readings beyond one end of the converter, a cell beyond the other."""
    cells = cells.copy()
    cells[:, _row(sample)] *= 1e6
    cells[:, 0, 0] *= 1e-6
    return Made(cells, readout=READOUT)


def _at_series(cells: Array, sample: AtlasSample, rng: Generator) -> Made:
    """One cell that is nothing beside the resistance in series with it."""
    cells = cells.copy()
    cells[(slice(None), *_cell(sample))] = 1e-3
    return Made(cells, series_ohm=SERIES_OHM)


CASES: dict[str, Extreme] = {
    "log-uniform": Extreme(_log_uniform, contrasted=True),
    "two clusters": Extreme(_clusters, contrasted=True),
    "checkerboard": Extreme(_checkerboard, contrasted=True),
    "open cell": Extreme(_changed(_cell, OPEN), single_fault=True),
    "open row": Extreme(_changed(_row, OPEN), single_fault=True),
    "open column": Extreme(_changed(_column, OPEN), single_fault=True),
    "shorted cell": Extreme(_changed(_cell, SHORT), single_fault=True),
    "shorted row": Extreme(_changed(_row, SHORT), single_fault=True),
    "open cell, known": _known(np.inf, lambda sample: Faults(open=(_cell(sample),)), _cell),
    "dead row, known": _known(np.inf, lambda sample: Faults(dead_rows=(_row(sample),)), _row),
    "dead column, known": _known(np.inf, lambda sample: Faults(dead_columns=(sample.columns // 3,)), _column),
    "shorted cell, known": _known(0.0, lambda sample: Faults(shorted=(_cell(sample),)), _cell),
    "1 mΩ to 1 GΩ": Extreme(_milliohm_to_gigaohm),
    "1 × 1": Extreme(_usual, shapes=((1, 1),)),
    "1 × N": Extreme(_usual, shapes=((1, 9),)),
    "M × 1": Extreme(_usual, shapes=((9, 1),)),
    "2 × 64": Extreme(_usual, shapes=((2, 64),)),
    "identical frames": Extreme(lambda cells, sample, rng: Made(np.stack([cells[0]] * 2), still=True)),
    "weight 0": _weighted(0.0),
    "weight 1e-12": _weighted(1e-12),
    "weight 1e12": _weighted(1e12),
    "codes at both rails": Extreme(_rails),
    "at the series resistance": Extreme(_at_series, single_fault=True),
    "all times 10⁶": Extreme(lambda cells, sample, rng: Made(1e6 * cells, scale=1e6)),
}
