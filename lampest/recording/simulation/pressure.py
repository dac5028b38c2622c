"""Pressure on every cell, frame by frame: loads averaged over the film patches, times their course, plus water."""

from collections.abc import Sequence

import numpy as np

from lampest.loads.pressure import water_pressure
from lampest.loads.shapes import Shape
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Water
from lampest.recording.simulation.course import Course


def pressure_on_cells(
    panel: Panel, patch_mm: float, loads: Sequence[Shape], course: Course, water: Water | None, time: Array
) -> Array:
    """p(t) = contact(t)·p_contact + suction(t)·p_suction + p_water, (frames, rows, columns) kPa.

    Parameters
    ----------
    patch_mm : edge of a cell's film; the pressure is the mean over it.
    time : (frames) s after the first measured frame; the loads are absent in frames before it.
    """
    contact, suction = np.zeros(panel.shape), np.zeros(panel.shape)
    for load in loads:
        pressing, sucking = load.mean_pressure(panel, patch_mm)
        contact, suction = contact + pressing, suction + sucking
    loaded = time >= 0
    courses = loaded * course.contact(time), loaded * course.suction(time)
    moving = courses[0][:, None, None] * contact + courses[1][:, None, None] * suction
    return np.asarray(moving + water_pressure(panel, water))
