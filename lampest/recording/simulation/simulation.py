"""Simulated recordings with their truth.

A simulation is the panel, the electronics and the loads. A recording contains its simulation, with
all drawn numbers, in /entry/truth/simulation.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from math import isfinite
from typing import Literal

import numpy as np

from lampest.files.applications import applications
from lampest.files.document import to_yaml
from lampest.files.process import check_memory
from lampest.files.typed import (
    Configuration,
    check_not_negative,
    check_positive_fields,
    check_range,
    typed,
)
from lampest.panel.conditions import Water, water_pressure
from lampest.panel.panel import Array
from lampest.panel.readouts.scan_order import by_columns
from lampest.panel.response import PUBLISHED, AnyResponse, Film, ratio_from_pressure
from lampest.panel.scene import Scene
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.shapes import AnyShape
from lampest.recording.simulation.measure import (
    OPEN_OHM,
    SHORT_OHM,
    Unmodelled,
    measured,
    random_stream,
    raw_sums,
)

# Two cells of the usual panel: a moving load that starts in the middle stays on the panel.
TRAVEL_MM = 20.0
PUMPED_S = 1.0  # duration of a pump, or of the pull before a release; an assumption
# Effects of `unmodelled` that need a readout in the scene.
NEED_CONVERTER = (
    "reference_tolerance outlier_probability noise_factor saturation supply_ripple_lsb "
    "gain_spread inl_lsb"
)
MOMENTS = 8  # time steps of the film's memory within a frame period


@dataclass(frozen=True)
class Course(Configuration):
    """Factors of contact and suction over time.

    By default the load is complete from the first moment.

    Attributes
    ----------
    start_s : float
        First touch, in seconds after the first measured frame; negative: before it, after the last
        unloaded one.
    approach_s, attachment_s : float
        Duration of the growth of contact pressure, and then of suction; 0: a step.
    breathing_hz, breathing_depth : float
        Frequency and relative amplitude of the common oscillation of contact and suction.
    pump_s, pump_loss : float
        Time between pumps of the suction, and the part of it that is lost until the next pump; 0:
        none.
    pull_off : float
        Relative growth of the suction within the second before the release.
    release_at_s, release_s : float, or None
        Start and duration of the release; None: never.

    Source of the pumps: 20 to 200 s apart, -8 to -70 kPa when pulled off: Shi et al., PLoS ONE 16,
    e0247884, 2021.

    >>> lampest.Course(start_s=1.0).start_s
    1.0
    """

    start_s: float = 0.0
    approach_s: float = 0.0
    attachment_s: float = 0.0
    breathing_hz: float = 0.0
    breathing_depth: float = 0.0
    pump_s: float = 0.0
    pump_loss: float = 0.0
    pull_off: float = 0.0
    release_at_s: float | None = None
    release_s: float = 0.0

    def __post_init__(self) -> None:
        check_not_negative(self, *(field.name for field in fields(self) if field.name != "start_s"))
        if not isfinite(self.start_s):
            raise ValueError("start_s must be finite")
        for name in ("breathing_depth", "pump_loss"):
            if getattr(self, name) >= 1:
                raise ValueError(f"{name} must be below 1")

    def contact_and_suction(self, time: Array) -> tuple[Array, Array]:
        """Return the factors of contact pressure and of suction at times (frames,) in s.

        Suction starts at the end of the approach.

        Returns
        -------
        contact, suction : array, shape (frames,)
            Factors of contact pressure and of suction.
        """
        touched = time - self.start_s
        released = time - (np.inf if self.release_at_s is None else self.release_at_s)
        breathing = 1 + self.breathing_depth * np.sin(2 * np.pi * self.breathing_hz * touched)
        factor = breathing * (1 - _ramp(released, self.release_s))
        suction = _ramp(touched - self.approach_s, self.attachment_s)
        # Pumps: an exponential loss by pump_loss per period, made up within PUMPED_S at the begin
        # of the next one.
        if self.pump_s:
            since = np.maximum(touched - self.approach_s - self.attachment_s, 0.0)
            lost = (1 - self.pump_loss) ** (np.mod(since, self.pump_s) / self.pump_s)
            rising = (since >= self.pump_s) * (1 - _ramp(np.mod(since, self.pump_s), PUMPED_S))
            suction = suction * (lost - (lost - 1 + self.pump_loss) * rising)
        suction = suction * (1 + self.pull_off * _ramp(released + PUMPED_S, PUMPED_S))
        return _ramp(touched, self.approach_s) * factor, suction * factor


def _ramp(time: Array, length: float) -> Array:
    """Return 3x² − 2x³ with x = time/length clipped to 0 and 1; a step at 0 for a length of 0."""
    if length == 0:
        return (time >= 0).astype(float)
    part = np.clip(time / length, 0, 1)
    return np.asarray(part**2 * (3 - 2 * part))


@dataclass(frozen=True)
class Cells(Configuration):
    """Unloaded cells, r0 = resistance_ohm · exp(spread · z) with standard normal z.

    Attributes
    ----------
    resistance_ohm : float
        Median resistance in ohm.
    spread : float
        Standard deviation of log r0.
    patch_mm : float
        Edge length of the film of a cell in mm.

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
    """Definition of a simulated recording.

    Attributes
    ----------
    seed : int
        Seed of all random numbers.
    scene : Scene
        Scene of the recording, which is also the estimator's.
    cells : Cells
        The unloaded cells.
    baseline_frames, frames : int
        Unloaded frames (role 0), then measured ones (role 1).
    frame_period_s : float
        Time between frames.
    loads : tuple of AnyShape
        Loads on the panel, absent in the unloaded frames.
    course : Course
        Contact and suction over time.
    water, film, response : Water, Film, AnyResponse, or None
        True depth, film and response if they differ from those of the scene; None: as in the scene.
    unmodelled : Unmodelled
        Effects that the scene does not specify.
    output : str, or None
        Path of the recording, relative to the simulation's file.

    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> lampest.Simulation(schema=1, seed=1, scene=scene, frames=2).frames
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
        check_range("frame_period_s", self.frame_period_s, 1e-9, 1e8, " s")
        film = self.film or self.scene.film
        digital = self.scene.readout is not None
        names = (name for name in NEED_CONVERTER.split() if getattr(self.unmodelled, name))
        electronic = ", ".join(names)
        late = self.course.start_s > -self.frame_period_s
        auto = film is not None and "auto" in (film.hysteresis, film.creep_per_decade)
        for right, message in (
            (0 <= self.seed < 2**64, "seed must lie between 0 and 2^64"),
            (
                self.baseline_frames >= 0 and self.frames >= 1,
                "a recording needs at least one measured frame",
            ),
            (self.values <= 20_000_000, "more than 20000000 values in one recording"),
            (
                late,
                "course.start_s must lie after the last unloaded frame, "
                "one frame_period_s before the first",
            ),
            (digital or not electronic, f"unmodelled: {electronic} need a readout in the scene"),
            (
                digital or self.scene.converter_memory is None,
                "converter_memory needs a readout in the scene",
            ),
            (
                not auto,
                "film: a simulation needs numbers where the scene says auto; "
                "give a film of its own",
            ),
        ):
            if not right:
                raise ValueError(message)
        if self.response is not None:
            self.response.check(self.scene.panel.shape)

    @property
    def values(self) -> int:
        """Number of readings of the recording."""
        return self.all_frames * self.scene.panel.crossings

    @property
    def all_frames(self) -> int:
        """Number of unloaded and measured frames."""
        return self.baseline_frames + self.frames


@typed
def simulate(
    simulation: Simulation, name: str = "simulated", on_frame: Callable[[], None] = lambda: None
) -> Recording:
    """Return a simulated recording with its truth r, and the measured readings of r.

    The truth is r = r0·e^drift·f(p)·e^(α(T − T_b)).

    Parameters
    ----------
    simulation : Simulation
    name : str
        Name of the recording.
    on_frame : callable
        Called after each frame is converted.

    Raises ValueError if a cell's or a measured resistance is out of range.

    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> two = lampest.Simulation(schema=1, seed=1, scene=scene, frames=2)
    >>> lampest.simulate(two).recorded.shape
    (5, 2, 3)
    """
    scene = simulation.scene
    unmodelled = simulation.unmodelled
    frames = simulation.all_frames
    time = np.arange(frames) * simulation.frame_period_s
    moves = bool(unmodelled.load_speed_mm_s)
    ladder = scene.panel.network
    # Memory: pressures, cells, their factors, readings and sums; for moving loads also the cells
    # while each line is read.
    size = 8.0 * (10 + moves * sum(ladder.shape)) * simulation.values
    check_memory(size, f"{frames} frames of {scene.panel.crossings} cells")
    loaded_time = time - time[simulation.baseline_frames]
    cells = cells_under(simulation, time)
    lines = moves * (ladder.columns if by_columns(scene.circuit) else ladder.rows)
    later = ((np.arange(lines) + 0.5) / max(lines, 1) - 0.5) * simulation.frame_period_s
    scanned = [cells_under(simulation, time, part) for part in later.tolist()]
    recorded, sums = measured(
        scene, cells, unmodelled, simulation.seed, simulation.frame_period_s, scanned, on_frame
    )
    raw = raw_sums(scene.readout, sums)
    present = scene.panel.present
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
    """Return p(t) = contact(t)·p_contact + suction(t)·p_suction + p_water over patches.

    The shape is (frames, rows, columns), in kPa.

    Parameters
    ----------
    time : array, shape (frames)
        Times in s after the first measured frame; loads are absent before it.
    later_s : float
        Time after the middle of the scan in s. It changes the position of moving loads, which
        travel TRAVEL_MM along x and back, but not their pressure.
    """
    panel = simulation.scene.panel
    way = (simulation.unmodelled.load_speed_mm_s or 0.0) * (time + later_s)
    way = np.mod(way + TRAVEL_MM / 2, 2 * TRAVEL_MM)
    along, frames = np.unique(
        np.minimum(way, 2 * TRAVEL_MM - way) - TRAVEL_MM / 2, return_inverse=True
    )
    # Contact and suction of loads that are fully there.
    fully = np.zeros((len(along), 2, *panel.shape))
    for number, mm in enumerate(along.tolist()):
        for load in simulation.loads:
            moved = (
                replace(load, centre_mm=(load.centre_mm[0] + mm, load.centre_mm[1])) if mm else load
            )
            fully[number] += moved.mean_pressure(panel, simulation.cells.patch_mm)
    contact, suction = ((time >= 0) * np.stack(simulation.course.contact_and_suction(time)))[
        :, :, None, None
    ]
    water = water_pressure(panel, simulation.water or simulation.scene.water)
    return np.asarray(contact * fully[frames, 0] + suction * fully[frames, 1] + water)


def cells_under(simulation: Simulation, time: Array, later_s: float = 0.0) -> Array:
    """Return the true cells r = r0·e^drift·f(p)·e^(α(T − T_b)), (frames, rows, columns) ohm.

    r0 is log-normal. Each cell drifts at its own rate plus a rate that all cells share. Cells that
    the scene's faults open or short have OPEN_OHM or SHORT_OHM. Raises ValueError if a cell is out
    of range.

    Parameters
    ----------
    simulation : Simulation
    time : array, shape (frames,)
        Times in s after the first frame.
    later_s : float
        See `pressure_at`.
    """
    scene = simulation.scene
    unmodelled = simulation.unmodelled

    def normal(purpose: str) -> Array:
        return random_stream(simulation.seed, purpose).standard_normal(scene.panel.shape)

    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        ratio = _film_ratio(simulation, time, later_s)
        loss = unmodelled.response_loss or 0.0
        spread = unmodelled.response_spread or 0.0
        ratio = ratio ** ((1 - loss) * np.exp(spread * normal("response")))
        rate = unmodelled.drift_per_minute * normal("drift") + (
            unmodelled.common_drift_per_minute or 0.0
        )
        drift = np.exp(rate / 60 * time[:, None, None])
        unloaded = simulation.cells.resistance_ohm * np.exp(
            simulation.cells.spread * normal("cells")
        )
        cells: Array = unloaded * drift * ratio
        if scene.temperature is not None:
            cells[simulation.baseline_frames :] *= np.exp(scene.temperature.logarithm)
    if not np.all((cells > SHORT_OHM) & (cells < OPEN_OHM)):
        raise ValueError(
            f"a cell's resistance leaves the range of {SHORT_OHM:g} to {OPEN_OHM:g} ohm"
        )
    cells[:, scene.open_cells] = OPEN_OHM
    cells[:, scene.shorted_cells] = SHORT_OHM
    return cells


def _film_ratio(simulation: Simulation, time: Array, later_s: float) -> Array:
    """Return r over that of a flat, unloaded film in air, (frames, rows, columns).

    The parameters of the film are drawn from its distributions.
    """
    scene = simulation.scene
    first = time[simulation.baseline_frames]
    step = simulation.frame_period_s / MOMENTS
    response = simulation.response or scene.response or PUBLISHED
    film = simulation.film or scene.film
    if film is None:
        pressure = pressure_at(simulation, time - first, later_s)
        return ratio_from_pressure(pressure, response) ** response.gains
    water = water_pressure(scene.panel, simulation.water or scene.water)

    def strength(name: str, key: str) -> Array:
        stream = random_stream(simulation.seed, f"film {name}")
        # A factor of all cells with the film's deviation, and one of each cell with its spread.
        shared = stream.standard_normal()
        individual = stream.standard_normal(water.shape)
        factor = np.exp(film.deviation * shared + film.cell_spread * individual)
        return np.asarray(np.minimum(getattr(film, key) * factor, film.most[key]))

    hysteresis = strength("hysteresis", "hysteresis")
    creep = strength("creep", "creep_per_decade")
    gain = np.broadcast_to(film.answer * response.gains, water.shape)
    at_rest = applications().required("film", "a film at rest", "film")
    memory = at_rest(hysteresis, creep, gain, water, response)
    ratios = []
    # The film's memory advances in MOMENTS steps per frame; the last step of each frame gives its
    # ratio.
    for begin in range(0, len(time), 64):
        felt = time[begin : begin + 64, None] - step * np.arange(MOMENTS)[::-1] - first
        for number, loaded in enumerate(pressure_at(simulation, felt.ravel(), later_s) - water, 1):
            memory, change = memory.answered(loaded, step)
            if number % MOMENTS == 0:
                ratios.append(np.exp(gain * response.logarithm(water) + change))
    return film.lowering * np.stack(ratios)
