"""Pressure on every cell over time, and what the film makes of it."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, ClassVar

import numpy as np

from lampest.files.typed import Validated
from lampest.loads.film import FilmMemory
from lampest.loads.pressure import water_pressure
from lampest.loads.response import PUBLISHED
from lampest.loads.shapes import Shape
from lampest.panel.film import MOST_CREEP, MOST_HYSTERESIS, Film
from lampest.panel.panel import Array, Panel
from lampest.panel.response import Response
from lampest.panel.scene import Water
from lampest.recording.simulation.unmodelled import random_stream

TRAVEL_MM = 20.0  # two cells of the usual panel: a load that starts in the middle stays on it
# Moments within a frame's period at which a film that remembers feels the load, and frames that are looked at together.
MOMENTS, AT_ONCE = 8, 64


@dataclass(frozen=True)
class Course(Validated):
    """Factors of contact and suction over time; the defaults are a load that is fully there from the first moment.

    Parameters
    ----------
    start_s : first touch, in seconds after the first measured frame; negative: before it, after the last unloaded one.
    approach_s : how long the contact grows to its full pressure; 0: at once.
    attachment_s : how long, after the approach, the suction grows; 0: at once.
    breathing_hz, breathing_depth : rhythm and relative amplitude by which contact and suction swing together.
    release_at_s, release_s : when the release begins, and how long it takes; None: never.

    Raises ValueError where a number is out of range.

    >>> lampest.Course(start_s=1.0).start_s
    1.0
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    start_s: float = 0.0
    approach_s: float = 0.0
    attachment_s: float = 0.0
    breathing_hz: float = 0.0
    breathing_depth: float = 0.0
    release_at_s: float | None = None
    release_s: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None and not (isfinite(value) and (value >= 0 or field.name == "start_s")):
                raise ValueError(f"{field.name} must be zero or positive, and finite")
        if self.breathing_depth >= 1:
            raise ValueError("breathing_depth must be below 1")

    def contact(self, time: Array) -> Array:
        """Factor of the contact pressure, (frames) s → 1."""
        touched = time - self.start_s
        return ramp(touched, self.approach_s) * self._breathing(touched) * self._released(time)

    def suction(self, time: Array) -> Array:
        """Factor of the suction, (frames) s → 1; it begins when the approach is over."""
        touched = time - self.start_s
        return ramp(touched - self.approach_s, self.attachment_s) * self._breathing(touched) * self._released(time)

    def _breathing(self, touched: Array) -> Array:
        return np.asarray(1 + self.breathing_depth * np.sin(2 * np.pi * self.breathing_hz * touched))

    def _released(self, time: Array) -> Array:
        if self.release_at_s is None:
            return np.ones_like(time)
        return 1 - ramp(time - self.release_at_s, self.release_s)


def ramp(time: Array, length: float) -> Array:
    """3x² − 2x³ with x = time/length held within 0 and 1; a step at 0 for no length."""
    if length == 0:
        return (time >= 0).astype(float)
    part = np.clip(time / length, 0, 1)
    return np.asarray(part**2 * (3 - 2 * part))


def pressure_on_cells(
    panel: Panel,
    patch_mm: float,
    loads: Sequence[Shape],
    course: Course,
    water: Water | None,
    time: Array,
    along_mm: Array | None = None,
) -> Array:
    """p(t) = contact(t)·p_contact + suction(t)·p_suction + p_water, (frames, rows, columns) kPa.

    Parameters
    ----------
    patch_mm : edge of a cell's film; the pressure is the mean over it.
    time : (frames) s after the first measured frame; the loads are absent in frames before it.
    along_mm : (frames) how far along x the loads are from their places; None: at them.
    """
    if along_mm is None:
        contact, suction = resting_pressure(panel, patch_mm, loads)
    else:
        frames = [resting_pressure(panel, patch_mm, [moved(load, mm) for load in loads]) for mm in along_mm]
        contact, suction = np.stack(frames, axis=1)
    loaded = time >= 0
    courses = loaded * course.contact(time), loaded * course.suction(time)
    moving = courses[0][:, None, None] * contact + courses[1][:, None, None] * suction
    return np.asarray(moving + water_pressure(panel, water))


def resting_pressure(panel: Panel, patch_mm: float, loads: Sequence[Shape]) -> tuple[Array, Array]:
    """(contact, suction) of loads that are fully there, (rows, columns) kPa each."""
    contact, suction = np.zeros(panel.shape), np.zeros(panel.shape)
    for load in loads:
        pressing, sucking = load.mean_pressure(panel, patch_mm)
        contact, suction = contact + pressing, suction + sucking
    return contact, suction


def travelled(speed_mm_s: float, time: Array) -> Array:
    """Where loads are that go TRAVEL_MM along x and back at one speed, (frames) mm from the middle of their way."""
    way = np.mod(speed_mm_s * time + TRAVEL_MM / 2, 2 * TRAVEL_MM)
    return np.asarray(np.minimum(way, 2 * TRAVEL_MM - way) - TRAVEL_MM / 2)


def moved(load: Shape, along_mm: float) -> Shape:
    """The load elsewhere."""
    return replace(load, centre_mm=(load.centre_mm[0] + float(along_mm), load.centre_mm[1]))


def remembered_ratio(
    film: Film,
    seed: int,
    pressure: Callable[[Array], Array],
    water: Array,
    time: Array,
    period: float,
    response: Response = PUBLISHED,
) -> Array:
    """r over that of a flat, unloaded film in air, (frames, rows, columns).

    pressure : moments (n) s → (n, rows, columns) kPa of load and water. water : (rows, columns) kPa, since ever. time :
    (frames) s, `period` apart.
    """
    memory = true_memory(film, seed, water, response)
    rest = memory.gain * response.logarithm(water)
    step, parts = period / MOMENTS, []
    for first in range(0, len(time), AT_ONCE):
        frames = time[first : first + AT_ONCE]
        moments = (frames[:, None] - step * np.arange(MOMENTS)[::-1]).ravel()
        for number, loaded in enumerate(pressure(moments) - water):
            memory, change = memory.answered(loaded, step)
            if number % MOMENTS == MOMENTS - 1:
                parts.append(np.exp(rest + change))
    return np.stack(parts)


def true_memory(film: Film, seed: int, water: Array, response: Response = PUBLISHED) -> FilmMemory:
    """A film at rest, drawn as is known of it: all cells together by its deviation, each by its spread."""
    strengths = []
    for name, value, most in (
        ("hysteresis", film.hysteresis, MOST_HYSTERESIS),
        ("creep", film.creep_per_decade, MOST_CREEP),
    ):
        assert value != "auto"
        stream = random_stream(seed, f"film {name}")
        shared, own = stream.standard_normal(), stream.standard_normal(water.shape)
        strengths.append(np.minimum(value * np.exp(film.deviation * shared + film.cell_spread * own), most))
    hysteresis, creep = strengths
    gain = np.broadcast_to(film.answer * response.gains, water.shape)
    return FilmMemory.at_rest(hysteresis, creep, gain, water, response)
