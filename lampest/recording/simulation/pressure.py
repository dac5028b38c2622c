"""Pressure on every cell over time, and what the film makes of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import isfinite

import numpy as np

from lampest.files.typed import Configuration, check_not_negative
from lampest.loads.film import FilmMemory
from lampest.loads.pressure import water_pressure
from lampest.loads.shapes import Shape
from lampest.panel.film import MOST_CREEP, MOST_HYSTERESIS, Film
from lampest.panel.panel import Array, Panel
from lampest.panel.response import Response
from lampest.panel.scene import Water
from lampest.recording.simulation.measure import random_stream

TRAVEL_MM = 20.0  # two cells of the usual panel: a load that starts in the middle stays on it


@dataclass(frozen=True)
class Course(Configuration):
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

    start_s: float = 0.0
    approach_s: float = 0.0
    attachment_s: float = 0.0
    breathing_hz: float = 0.0
    breathing_depth: float = 0.0
    release_at_s: float | None = None
    release_s: float = 0.0

    def __post_init__(self) -> None:
        check_not_negative(self, *(field.name for field in fields(self) if field.name != "start_s"))
        if not isfinite(self.start_s):
            raise ValueError("start_s must be finite")
        if self.breathing_depth >= 1:
            raise ValueError("breathing_depth must be below 1")

    def contact(self, time: Array) -> Array:
        """Factor of the contact pressure, (frames) s → 1."""
        return self._grown(time, 0.0, self.approach_s)

    def suction(self, time: Array) -> Array:
        """Factor of the suction, (frames) s → 1; it begins when the approach is over."""
        return self._grown(time, self.approach_s, self.attachment_s)

    def _grown(self, time: Array, after_s: float, length: float) -> Array:
        touched = time - self.start_s
        breathing = 1 + self.breathing_depth * np.sin(2 * np.pi * self.breathing_hz * touched)
        grown = np.asarray(ramp(touched - after_s, length) * breathing)
        return grown if self.release_at_s is None else grown * (1 - ramp(time - self.release_at_s, self.release_s))


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

    def resting(along: float) -> Array:
        """(contact and suction, rows, columns) of loads that are fully there."""
        there = [replace(load, centre_mm=(load.centre_mm[0] + along, load.centre_mm[1])) for load in loads]
        each = [load.mean_pressure(panel, patch_mm) for load in (there if along else loads)]
        return np.asarray(sum(map(np.array, each), np.zeros((2, *panel.shape))))

    fully = resting(0.0)[None] if along_mm is None else np.stack([resting(float(mm)) for mm in along_mm])
    courses = (time >= 0) * np.stack([course.contact(time), course.suction(time)])
    moving = courses[0][:, None, None] * fully[:, 0] + courses[1][:, None, None] * fully[:, 1]
    return np.asarray(moving + water_pressure(panel, water))


def travelled(speed_mm_s: float, time: Array) -> Array:
    """Where loads are that go TRAVEL_MM along x and back at one speed, (frames) mm from the middle of their way."""
    way = np.mod(speed_mm_s * time + TRAVEL_MM / 2, 2 * TRAVEL_MM)
    return np.asarray(np.minimum(way, 2 * TRAVEL_MM - way) - TRAVEL_MM / 2)


def remembered_ratio(
    film: Film,
    seed: int,
    pressure: Callable[[Array], Array],
    water: Array,
    time: Array,
    period: float,
    response: Response,
) -> Array:
    """r over that of a flat, unloaded film in air, (frames, rows, columns).

    pressure : moments (n) s → (n, rows, columns) kPa of load and water. water : (rows, columns) kPa, since ever. time :
    (frames) s, `period` apart.
    """
    # Moments within a frame's period at which the film feels the load, and frames that are looked at together.
    moments, at_once = 8, 64
    memory = _true_memory(film, seed, water, response)
    rest = memory.gain * response.logarithm(water)
    step, parts = period / moments, []
    for first in range(0, len(time), at_once):
        felt = time[first : first + at_once, None] - step * np.arange(moments)[::-1]
        for number, loaded in enumerate(pressure(felt.ravel()) - water, 1):
            memory, change = memory.answered(loaded, step)
            if number % moments == 0:
                parts.append(np.exp(rest + change))
    return np.stack(parts)


def _true_memory(film: Film, seed: int, water: Array, response: Response) -> FilmMemory:
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
