"""Pressure on every cell, frame by frame: loads averaged over the film patches, times their course, plus water."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lampest.loads.pressure import water_pressure
from lampest.loads.shapes import Shape
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Water
from lampest.recording.simulation.course import Course

TRAVEL_MM = 20.0  # two cells of the usual panel: a load that starts in the middle stays on it


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
