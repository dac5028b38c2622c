"""Pressure on every cell, frame by frame: loads averaged over the film patches, times their course, plus water."""

from collections.abc import Sequence

import numpy as np

from lampest.loads.pressure import water_pressure
from lampest.loads.shapes import Load
from lampest.panel.panel import Array, Panel
from lampest.panel.scene import Water
from lampest.recording.simulation.course import Course

POINTS = 8


def pressure_on_cells(
    panel: Panel, patch_mm: float, loads: Sequence[Load], course: Course, water: Water | None, time: Array
) -> Array:
    """p(t) = contact(t)·p_contact + suction(t)·p_suction + p_water, (frames, rows, columns) kPa.

    Parameters
    ----------
    patch_mm : edge of a cell's film; the pressure is the mean over it.
    time : (frames) s after the first measured frame; the loads are absent in frames before it.
    """
    contact, suction = np.zeros(panel.shape), np.zeros(panel.shape)
    for load in loads:
        pressing, sucking = patch_pressure(panel, patch_mm, load)
        contact, suction = contact + pressing, suction + sucking
    loaded = time >= 0
    courses = loaded * course.contact(time), loaded * course.suction(time)
    moving = courses[0][:, None, None] * contact + courses[1][:, None, None] * suction
    return np.asarray(moving + water_pressure(panel, water))


def patch_pressure(panel: Panel, patch_mm: float, load: Load) -> tuple[Array, Array]:
    """Mean contact pressure and mean suction of one load over every patch, two times (rows, columns) kPa."""
    offset = ((np.arange(POINTS) + 0.5) / POINTS - 0.5) * patch_mm
    centre_x, centre_y = panel.centres_mm()
    across = (centre_x[:, None] + offset).ravel() - load.centre_mm[0]
    down = (centre_y[:, None] + offset).ravel() - load.centre_mm[1]
    x, y = np.meshgrid(across, down)
    radius = np.hypot(x, y)
    zones = load.zones()
    direction = np.radians(load.tilt_direction_deg)
    edge = zones[-1].outer_mm / 2
    tilting = 1 + load.tilt * (x * np.cos(direction) + y * np.sin(direction)) / edge
    contact, suction = np.zeros(x.shape), np.zeros(x.shape)
    for zone in zones:
        inside = (radius >= zone.inner_mm / 2) & (radius < zone.outer_mm / 2)
        contact = contact + inside * zone.contact_kpa * tilting
        suction = suction + inside * zone.suction_kpa
    return _patch_mean(panel, contact), _patch_mean(panel, suction)


def _patch_mean(panel: Panel, points: Array) -> Array:
    blocks = points.reshape(panel.rows, POINTS, panel.columns, POINTS)
    return np.asarray(blocks.mean(axis=(1, 3)))
