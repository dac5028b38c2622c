"""A simulation: what is on the panel and how it is measured → a recording with its truth."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from lampest.files.document import to_yaml
from lampest.files.process import check_memory
from lampest.files.typed import Configuration, check_positive_fields, check_range, typed
from lampest.loads.pressure import water_pressure
from lampest.loads.response import PUBLISHED, ratio_from_pressure
from lampest.loads.shapes import AnyShape
from lampest.panel.film import Film
from lampest.panel.panel import Array
from lampest.panel.response import AnyResponse
from lampest.panel.scene import Scene, Water
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.simulation.measure import OPEN_OHM, SHORT_OHM, Unmodelled, measured, random_stream, raw_sums
from lampest.recording.simulation.pressure import Course, pressure_on_cells, remembered_ratio


@dataclass(frozen=True)
class Cells(Configuration):
    """r0 = resistance_ohm · exp(spread · z), z standard normal: the unloaded cells; patch_mm is the edge of their film.

    >>> lampest.Cells(resistance_ohm=3000.0).resistance_ohm
    3000.0
    """

    resistance_ohm: float = 3050.0
    spread: float = 0.2
    patch_mm: float = 6.0

    def __post_init__(self) -> None:
        check_positive_fields(self, "resistance_ohm", "patch_mm")
        check_range("spread", self.spread, 0, 5)


@dataclass(frozen=True)
class Simulation(Configuration):
    """All that makes a simulated recording.

    seed : every random number follows from it. scene : what the estimator gets. cells : the unloaded cells.
    baseline_frames, frames : unloaded frames (role 0), then measured ones (role 1). frame_period_s : between frames.
    loads, course : what touches the panel, and when; absent in the unloaded frames.
    water, film, response : how deep the panel truly stands, what the film truly does beside its response, and how it
        answers to pressure, where the scene leaves that open or is wrong; None: as the scene says.
    unmodelled : effects that the scene does not name.
    output : where the recording goes, relative to the file that says so.

    >>> lampest.Simulation(schema=1, seed=1, scene=recording.scene, frames=2).frames
    2
    """

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
        check_range("frame_period_s", self.frame_period_s, 1e-9, 1e8, " s")
        if self.values > 20_000_000:
            raise ValueError("more than 20000000 values in one recording")
        if self.course.start_s <= -self.frame_period_s:
            raise ValueError(
                "course.start_s must lie after the last unloaded frame, one frame_period_s before the first"
            )
        if self.scene.readout is None and (electronic := self.unmodelled.needs_converter):
            raise ValueError(f"unmodelled: {', '.join(electronic)} need a readout in the scene")
        if self.scene.readout is None and self.scene.converter_memory is not None:
            raise ValueError("converter_memory needs a readout in the scene")
        film = self.film or self.scene.film
        if film is not None and "auto" in (film.hysteresis, film.creep_per_decade):
            raise ValueError("film: a simulation needs numbers where the scene says auto; give a film of its own")
        if self.response is not None:
            self.response.check(self.scene.panel.shape)

    @property
    def values(self) -> int:
        return self.all_frames * self.scene.panel.crossings

    @property
    def all_frames(self) -> int:
        return self.baseline_frames + self.frames


@typed
def simulate(simulation: Simulation, name: str = "simulated", on_frame: Callable[[], None] = lambda: None) -> Recording:
    """r = r0·e^drift·f(p)·e^(α(T − T_b)), y = network(r), measured: the recording with its truth, all from the seed.

    on_frame : called after each frame was converted.
    Raises ValueError where a cell's or a measured resistance leaves its range.

    >>> lampest.simulate(lampest.Simulation(schema=1, seed=1, scene=recording.scene, frames=2)).recorded.shape
    (5, 2, 3)
    """
    scene, unmodelled, frames = simulation.scene, simulation.unmodelled, simulation.all_frames
    time, moves = np.arange(frames) * simulation.frame_period_s, bool(unmodelled.load_speed_mm_s)
    each = scene.panel.networks[0]
    # Pressures, cells, their factors, readings, sums; and cells while each line is read.
    check_memory(
        8.0 * (10 + moves * sum(each.shape)) * simulation.values, f"{frames} frames of {scene.panel.crossings} cells"
    )
    loaded_time = time - time[simulation.baseline_frames]
    cells = cells_under(simulation, time)
    lines = (each.columns if scene.circuit.by_columns else each.rows) if moves else 0
    later = ((np.arange(lines) + 0.5) / max(lines, 1) - 0.5) * simulation.frame_period_s
    scanned = [cells_under(simulation, time, float(part)) for part in later]
    recorded, sums = measured(scene, cells, unmodelled, simulation.seed, simulation.frame_period_s, scanned, on_frame)
    raw, present = raw_sums(scene.readout, sums), scene.panel.present
    return Recording(
        scene=scene,
        recorded=recorded,
        time=time,
        role=np.where(loaded_time < 0, UNLOADED, MEASURED).astype(np.uint8),
        truth_cell_resistance=np.where(present, cells, np.nan),
        truth_pressure=np.where(present, pressure_at(simulation, loaded_time), np.nan),
        raw_sums=raw,
        raw_readings=None if raw is None or scene.readout is None else scene.readout.readings,
        name=name,
        simulation=to_yaml(simulation),
    )


def pressure_at(simulation: Simulation, time: Array, later_s: float = 0.0) -> Array:
    """Pressure on every cell (frames, rows, columns) kPa; time : (frames) s after the first measured frame.

    later_s : from the middle of the scan; loads that travel are elsewhere then, and press as much.
    """
    panel, water = simulation.scene.panel, simulation.water or simulation.scene.water
    speed, patch = simulation.unmodelled.load_speed_mm_s or 0.0, simulation.cells.patch_mm
    return pressure_on_cells(panel, patch, simulation.loads, simulation.course, water, time, speed, later_s)


def cells_under(simulation: Simulation, time: Array, later_s: float = 0.0) -> Array:
    """r = r0·e^drift·f(p)·e^(α(T − T_b)), (frames, rows, columns) ohm; later_s : as `pressure_at` has it.

    r0 is log-normal, and each cell drifts at its own rate, beside one that all share. Raises ValueError where a cell
    leaves its range.
    """
    scene, unmodelled = simulation.scene, simulation.unmodelled

    def normal(purpose: str) -> Array:
        return random_stream(simulation.seed, purpose).standard_normal(scene.panel.shape)

    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        ratio = _film_ratio(simulation, time, later_s)
        if unmodelled.response_loss or unmodelled.response_spread:
            loss, spread = unmodelled.response_loss or 0.0, unmodelled.response_spread or 0.0
            ratio = ratio ** ((1 - loss) * np.exp(spread * normal("response")))
        rate = unmodelled.drift_per_minute * normal("drift") + (unmodelled.common_drift_per_minute or 0.0)
        drift = np.exp(rate / 60 * time[:, None, None])
        unloaded = simulation.cells.resistance_ohm * np.exp(simulation.cells.spread * normal("cells"))
        cells: Array = unloaded * drift * ratio
        if scene.temperature is not None:
            cells[simulation.baseline_frames :] *= np.exp(scene.temperature.logarithm)
    if not np.all((cells > SHORT_OHM) & (cells < OPEN_OHM)):
        raise ValueError(f"a cell's resistance leaves the range of {SHORT_OHM:g} to {OPEN_OHM:g} ohm")
    return cells


def _film_ratio(simulation: Simulation, time: Array, later_s: float) -> Array:
    """r over that of a film that is flat, in air and unloaded, (frames, rows, columns)."""
    scene, film, first = simulation.scene, simulation.film or simulation.scene.film, time[simulation.baseline_frames]
    response = simulation.response or scene.response or PUBLISHED

    def pressure(at: Array) -> Array:
        return pressure_at(simulation, at - first, later_s)

    if film is None:
        return np.asarray(ratio_from_pressure(pressure(time), response) ** response.gains)
    water, period = water_pressure(scene.panel, simulation.water or scene.water), simulation.frame_period_s
    return film.lowering * remembered_ratio(film, simulation.seed, pressure, water, time, period, response)
