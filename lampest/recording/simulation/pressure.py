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
MOMENTS, AT_ONCE = 8, 64  # within a frame's period at which the film feels the load, and frames looked at together


@dataclass(frozen=True)
class Course(Configuration):
    """Factors of contact and suction over time; the defaults are a load that is fully there from the first moment.

    start_s : first touch, in seconds after the first measured frame; negative: before it, after the last unloaded one.
    approach_s, attachment_s : how long the contact grows to its full pressure, and then the suction; 0: at once.
    breathing_hz, breathing_depth : rhythm and relative amplitude by which contact and suction swing together.
    release_at_s, release_s : when the release begins, and how long it takes; None: never.

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

    def contact_and_suction(self, time: Array) -> tuple[Array, Array]:
        """Factors of contact pressure and suction, (frames) s → 1; the suction begins when the approach is over."""
        touched = time - self.start_s
        factor = 1 + self.breathing_depth * np.sin(2 * np.pi * self.breathing_hz * touched)
        if self.release_at_s is not None:
            factor = factor * (1 - _ramp(time - self.release_at_s, self.release_s))
        suction = _ramp(touched - self.approach_s, self.attachment_s)
        return _ramp(touched, self.approach_s) * factor, suction * factor


def _ramp(time: Array, length: float) -> Array:
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
    speed_mm_s: float = 0.0,
    later_s: float = 0.0,
) -> Array:
    """p(t) = contact(t)·p_contact + suction(t)·p_suction + p_water, (frames, rows, columns) kPa; the mean over patches.

    patch_mm : edge of a cell's film. time : (frames) s after the first measured frame; loads are absent before it.
    speed_mm_s : at which loads go TRAVEL_MM along x and back; later_s : and are elsewhere after the frame's middle.
    """
    way = np.mod(speed_mm_s * (time + later_s) + TRAVEL_MM / 2, 2 * TRAVEL_MM)
    along, frames = np.unique(np.minimum(way, 2 * TRAVEL_MM - way) - TRAVEL_MM / 2, return_inverse=True)
    fully = np.zeros((len(along), 2, *panel.shape))  # contact and suction of loads that are fully there
    for number, mm in enumerate(along.tolist()):
        for load in loads:
            moved = replace(load, centre_mm=(load.centre_mm[0] + mm, load.centre_mm[1])) if mm else load
            fully[number] += moved.mean_pressure(panel, patch_mm)
    contact, suction = ((time >= 0) * np.stack(course.contact_and_suction(time)))[:, :, None, None]
    return np.asarray(contact * fully[frames, 0] + suction * fully[frames, 1] + water_pressure(panel, water))


def remembered_ratio(
    film: Film,
    seed: int,
    pressure: Callable[[Array], Array],
    water: Array,
    time: Array,
    period: float,
    response: Response,
) -> Array:
    """r over that of a flat, unloaded film in air, (frames, rows, columns); the film is drawn as is known of it.

    pressure : moments (n) s → (n, rows, columns) kPa of load and water. water : (rows, columns) kPa, since ever. time :
    (frames) s, `period` apart.
    """
    strengths = []
    for name, value, most in (
        ("hysteresis", film.hysteresis, MOST_HYSTERESIS),
        ("creep", film.creep_per_decade, MOST_CREEP),
    ):
        assert value != "auto"
        stream = random_stream(seed, f"film {name}")  # all cells together by its deviation, each by its spread
        shared, own = stream.standard_normal(), stream.standard_normal(water.shape)
        strengths.append(np.minimum(value * np.exp(film.deviation * shared + film.cell_spread * own), most))
    gain = np.broadcast_to(film.answer * response.gains, water.shape)
    memory = FilmMemory.at_rest(strengths[0], strengths[1], gain, water, response)
    rest, step, parts = gain * response.logarithm(water), period / MOMENTS, []
    for first in range(0, len(time), AT_ONCE):
        felt = time[first : first + AT_ONCE, None] - step * np.arange(MOMENTS)[::-1]
        for number, loaded in enumerate(pressure(felt.ravel()) - water, 1):
            memory, change = memory.answered(loaded, step)
            if number % MOMENTS == 0:
                parts.append(np.exp(rest + change))
    return np.stack(parts)
