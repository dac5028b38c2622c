"""A simulation: what is on the panel and how it is measured → a recording with its truth."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, ClassVar, Literal

import numpy as np

from lampest.files.document import to_yaml
from lampest.files.memory import check_memory
from lampest.files.typed import Validated, typed
from lampest.loads.pressure import water_pressure
from lampest.loads.response import PUBLISHED, ratio_from_pressure
from lampest.loads.shapes import AnyShape
from lampest.panel.film import Film
from lampest.panel.panel import Array
from lampest.panel.response import AnyResponse
from lampest.panel.scene import Scene, Water
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.simulation.measure import measured, raw_sums
from lampest.recording.simulation.pressure import Course, pressure_on_cells, remembered_ratio, travelled
from lampest.recording.simulation.unmodelled import Unmodelled, random_stream

MOST_VALUES = 20_000_000
LEAST_OHM, MOST_OHM = 1e-3, 1e12
SHORTEST_S, LONGEST_S = 1e-9, 1e8  # three years
MOST_CELLS = 100_000
COPIES = 10  # of all values, at the worst: pressures, cells, their factors, readings, sums


@dataclass(frozen=True)
class Cells(Validated):
    """r0 = resistance_ohm · exp(spread · z), z standard normal: the unloaded cells; patch_mm is the edge of their film.

    Raises ValueError where a number is out of range.

    >>> lampest.Cells(resistance_ohm=3000.0).resistance_ohm
    3000.0
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    resistance_ohm: float = 3050.0
    spread: float = 0.2
    patch_mm: float = 6.0

    def __post_init__(self) -> None:
        if not (isfinite(self.resistance_ohm) and self.resistance_ohm > 0):
            raise ValueError("resistance_ohm must be positive and finite")
        if not 0 <= self.spread <= 5:
            raise ValueError("spread must lie between 0 and 5")
        if not (isfinite(self.patch_mm) and self.patch_mm > 0):
            raise ValueError("patch_mm must be positive and finite")


@dataclass(frozen=True)
class Simulation(Validated):
    """All that makes a simulated recording.

    Parameters
    ----------
    schema : version of this format.
    seed : every random number follows from it.
    scene : what the estimator gets.
    cells : the unloaded cells.
    baseline_frames, frames : unloaded frames (role 0), then measured ones (role 1).
    frame_period_s : time between frames.
    loads, course : what touches the panel, and when; absent in the unloaded frames.
    water : how deep the panel truly stands, where the scene does not tell or is wrong; None: as the scene says.
    film : what the film truly does beside its response, where the scene does not tell or is wrong; likewise.
    response : how the film truly answers to pressure, likewise.
    unmodelled : effects that the scene does not name.
    output : where the recording goes, relative to the file that says so; see `lampest.recording.simulation.files`.

    Raises ValueError where a number is out of range.

    >>> lampest.Simulation(schema=1, seed=1, scene=recording.scene, frames=2).frames
    2
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    schema: Literal[1]
    seed: int
    scene: Scene
    cells: Cells = field(default_factory=Cells)
    baseline_frames: int = 3
    frames: int = 21
    frame_period_s: float = 1.0
    loads: tuple[AnyShape, ...] = ()
    course: Course = field(default_factory=Course)
    water: Water | None = None
    film: Film | None = None
    response: AnyResponse | None = None
    unmodelled: Unmodelled = field(default_factory=Unmodelled)
    output: str | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**64:
            raise ValueError("seed must lie between 0 and 2^64")
        if self.baseline_frames < 0 or self.frames < 1:
            raise ValueError("a recording needs at least one measured frame")
        if not SHORTEST_S <= self.frame_period_s <= LONGEST_S:
            raise ValueError(f"frame_period_s must be positive and finite, between {SHORTEST_S:g} and {LONGEST_S:g} s")
        if self.values > MOST_VALUES:
            raise ValueError(f"more than {MOST_VALUES} values in one recording")
        if self.scene.panel.crossings > MOST_CELLS:
            raise ValueError(f"more than {MOST_CELLS} cells are not simulated")
        if self.course.start_s <= -self.frame_period_s:
            raise ValueError(
                "course.start_s must lie after the last unloaded frame, one frame_period_s before the first"
            )
        electronic = self.unmodelled.needs_converter
        if self.scene.readout is None and electronic:
            raise ValueError(f"unmodelled: {', '.join(electronic)} need a readout in the scene")
        if self.scene.readout is None and self.scene.converter_memory is not None:
            raise ValueError("converter_memory needs a readout in the scene")
        film = self.true_film
        if film is not None and "auto" in (film.hysteresis, film.creep_per_decade):
            raise ValueError("film: a simulation needs numbers where the scene says auto; give a film of its own")
        if self.response is not None:
            self.response.check(self.scene.panel.shape)

    @property
    def true_film(self) -> Film | None:
        """What the film does beside its response; None: nothing."""
        return self.film or self.scene.film

    @property
    def values(self) -> int:
        """frames · rows · columns, unloaded frames included."""
        return self.all_frames * self.scene.panel.crossings

    @property
    def all_frames(self) -> int:
        """Frames, unloaded ones included."""
        return self.baseline_frames + self.frames


@typed
def simulate(simulation: Simulation, name: str = "simulated", on_frame: Callable[[], None] = lambda: None) -> Recording:
    """r = r0·e^drift·f(p)·e^(α(T − T_b)), y = network(r), measured: the recording with its truth, all from the seed.

    on_frame : called after each frame was converted.
    Raises ValueError where a cell's or a measured resistance leaves its range.

    >>> lampest.simulate(lampest.Simulation(schema=1, seed=1, scene=recording.scene, frames=2)).recorded.shape
    (5, 2, 3)
    """
    frames, passes = simulation.all_frames, sum(simulation.scene.panel.networks[0].shape)
    copies = COPIES + (passes if simulation.unmodelled.load_speed_mm_s else 0)
    check_memory(8.0 * copies * simulation.values, f"{frames} frames of {simulation.scene.panel.crossings} cells")
    time = np.arange(frames) * simulation.frame_period_s
    loaded_time = time - time[simulation.baseline_frames]
    pressure = pressure_at(simulation, loaded_time)
    cells = cells_under(simulation, time)
    scanned = scanned_cells(simulation, time) if simulation.unmodelled.load_speed_mm_s else ()
    recorded, sums = measured(
        simulation.scene, cells, simulation.unmodelled, simulation.seed, simulation.frame_period_s, scanned, on_frame
    )
    raw = raw_sums(simulation.scene.readout, sums)
    return Recording(
        scene=simulation.scene,
        recorded=recorded,
        time=time,
        role=np.where(loaded_time < 0, UNLOADED, MEASURED).astype(np.uint8),
        truth_cell_resistance=cells,
        truth_pressure=pressure,
        raw_sums=raw,
        raw_readings=None if raw is None or simulation.scene.readout is None else simulation.scene.readout.readings,
        name=name,
        simulation=to_yaml(simulation),
    )


def pressure_at(simulation: Simulation, time: Array, later_s: float = 0.0) -> Array:
    """Pressure on every cell (frames, rows, columns) kPa; time : (frames) s after the first measured frame.

    later_s : from the middle of the scan; loads that travel are elsewhere then, and press as much.
    """
    water = simulation.water or simulation.scene.water
    speed = simulation.unmodelled.load_speed_mm_s
    along = travelled(speed, time + later_s) if speed else None
    return pressure_on_cells(
        simulation.scene.panel, simulation.cells.patch_mm, simulation.loads, simulation.course, water, time, along
    )


def cells_under(simulation: Simulation, time: Array, later_s: float = 0.0) -> Array:
    """r = r0·e^drift·f(p)·e^(α(T − T_b)), (frames, rows, columns) ohm; later_s : as `pressure_at` has it.

    Raises ValueError where a cell leaves its range.
    """
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        response = answered(film_ratio(simulation, time, later_s), simulation.unmodelled, simulation.seed)
        cells: Array = unloaded_cells(simulation) * drift(simulation, time) * response
        if simulation.scene.temperature is not None:
            cells[simulation.baseline_frames :] *= np.exp(simulation.scene.temperature.logarithm)
    if not np.all((cells > LEAST_OHM) & (cells < MOST_OHM)):
        raise ValueError(f"a cell's resistance leaves the range of {LEAST_OHM:g} to {MOST_OHM:g} ohm")
    return cells


def scanned_cells(simulation: Simulation, time: Array) -> tuple[Array, ...]:
    """The cells (frames, rows, columns) ohm while each scanned line is read, in the order of the lines."""
    scene = simulation.scene
    each = scene.panel.networks[0]
    lines = each.columns if scene.circuit.by_columns else each.rows
    later = ((np.arange(lines) + 0.5) / lines - 0.5) * simulation.frame_period_s
    return tuple(cells_under(simulation, time, float(part)) for part in later)


def film_ratio(simulation: Simulation, time: Array, later_s: float) -> Array:
    """r over that of a film that is flat, in air and unloaded, (frames, rows, columns)."""
    first, film = time[simulation.baseline_frames], simulation.true_film
    response = simulation.response or simulation.scene.response or PUBLISHED
    if film is None:
        pressure = pressure_at(simulation, time - first, later_s)
        return np.asarray(ratio_from_pressure(pressure, response) ** response.gains)
    scene, period = simulation.scene, simulation.frame_period_s
    water = water_pressure(scene.panel, simulation.water or scene.water)
    return film.lowering * remembered_ratio(
        film, simulation.seed, lambda at: pressure_at(simulation, at - first, later_s), water, time, period, response
    )


def answered(ratio: Array, unmodelled: Unmodelled, seed: int) -> Array:
    """What a film makes of the ratio r/r0 (frames, rows, columns) that its response promises: a power of it."""
    if not (unmodelled.response_loss or unmodelled.response_spread):
        return ratio
    normal = random_stream(seed, "response").standard_normal(ratio.shape[1:])
    loss, spread = unmodelled.response_loss or 0.0, unmodelled.response_spread or 0.0
    return np.asarray(ratio ** ((1 - loss) * np.exp(spread * normal)))


def unloaded_cells(simulation: Simulation) -> Array:
    """r0, (rows, columns) ohm, log-normal."""
    normal = random_stream(simulation.seed, "cells").standard_normal(simulation.scene.panel.shape)
    return np.asarray(simulation.cells.resistance_ohm * np.exp(simulation.cells.spread * normal))


def drift(simulation: Simulation, time: Array) -> Array:
    """exp(rate · t), (frames, rows, columns): every cell at its own rate, part of the truth."""
    normal = random_stream(simulation.seed, "drift").standard_normal(simulation.scene.panel.shape)
    rate = simulation.unmodelled.drift_per_minute / 60 * normal
    return np.asarray(np.exp(rate * time[:, None, None]))
