"""Readings that leap among frames as they come: nobody knows yet whether they come back.

A touch of one cell takes its row and its column along where lines are tied by cells alone: of them a lone leap is told
from the frames before. Where a reading hears its own cell only, it is not, and readings stay as they are.
"""

from dataclasses import dataclass, replace

import numpy as np

from lampest.estimate.noise.outliers import (
    ALONE,
    LEAST_FRAMES,
    NEAREST,
    SHARE,
    TO_SIGMA,
    Expected,
    lines_median,
    median,
    pair_scale,
    strays,
)
from lampest.panel.network import Network
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

ASKED = 5  # cells of a diagonal that tell whether lines follow


@dataclass(frozen=True, eq=False)
class FramesBefore:
    """frames : up to NEAREST readings (rows, columns) as they came, the newest last."""

    frames: tuple[Readings, ...] = ()

    def after(self, readings: Readings) -> "FramesBefore":
        """Once a frame has come."""
        return FramesBefore((*self.frames, readings)[-NEAREST:])

    def without_leaps(
        self, readings: Readings, scene: Scene, resting: Readings, baseline: Array
    ) -> tuple[Readings, int]:
        """(a frame with what those before let expect in the place of readings that leap, how many do).

        resting : unloaded readings, of which baseline is the estimate, ohm, or NaN; all (rows, columns).
        """
        if len(self.frames) < LEAST_FRAMES or readings.sigma is None or np.isnan(baseline).any():
            return readings, 0
        value = np.stack([frame.plain_values for frame in self.frames])
        scale = readings.sigma * np.fmax(pair_scale(value / readings.sigma), 1.0)
        middle = median(value)
        expected: Expected = middle, TO_SIGMA * median(np.abs(value - middle))
        with np.errstate(divide="ignore", invalid="ignore"):
            stray = strays(readings.plain_values[None], scale[None], (expected[0][None], expected[1][None]))[0]
        if not stray.any() or stray.mean() > SHARE:
            return readings, 0
        if not lines_follow(scene.circuit.network(baseline, scene.circuit.ties(resting.value), scene.wiring), scale):
            return readings, 0
        calm = np.where(stray, expected[0], readings.value)
        sigma = np.where(stray, np.hypot(readings.sigma, expected[1]), readings.sigma)
        return replace(readings, value=calm, sigma=sigma), int(stray.sum())


def lines_follow(network: Network, scale: Array) -> bool:
    """Whether a load on one cell moves its row or its column by more than a lone leap may; scale : σ of readings."""
    rows, columns = scale.shape
    for number in range(ASKED):
        place = int((number + 0.5) / ASKED * rows), int((number + 0.5) / ASKED * columns)
        step = np.zeros(scale.shape)
        step[place] = 1.0
        moved = np.abs(network.forward(step)) / scale
        beside = max(lines_median(moved[None], axis)[0][place] for axis in (1, 2))
        if ALONE * beside <= moved[place]:
            return False
    return True
