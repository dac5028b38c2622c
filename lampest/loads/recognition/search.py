"""Where to begin: a map of the cells, and round patterns laid over it."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from lampest.loads.footprint import cover
from lampest.loads.recognition.baseline import Baseline, network_of
from lampest.loads.recognition.frame import Frame, Weight
from lampest.loads.recognition.loads import Disc
from lampest.panel.panel import Array, Panel

# Outer and inner diameter in mm, and what the inside does to ln r: nothing, or as much as the rim the other way.
PRESSING = ((40.0, 0.0, 0.0), (25.0, 0.0, 0.0), (22.0, 11.0, 0.0))
SHAPES = (
    *PRESSING,
    (42.0, 32.0, 0.0),
    (32.0, 21.0, 0.0),
    (45.0, 32.0, 1.0),
    (34.0, 22.0, 1.0),
    (24.0, 12.0, 1.0),
)
MAP_SD, MAP_STEPS, MAP_STEP = 0.5, 4, 1.5
CLEAR = 1.5  # ln r/r0 beyond which a cell counts no more than one there
PRESSURES = {0.0: (0.0, 8.0), 1.0: (-6.0, 30.0)}  # inside and under the rim, where a fit begins


@dataclass(frozen=True, eq=False)
class Search:
    """Discs of a few sizes about every cell's centre and between four of them.

    discs : (patterns) their places and sizes. patterns : (cells, patterns) ln r/r0 of unit length.
    looks : (cells, some) errors of unit variance that the first of them make of a panel at rest, of unit length.
    """

    discs: tuple[Disc, ...]
    patterns: Array
    looks: Array

    @classmethod
    def over(cls, panel: Panel, patch_mm: float, baseline: Baseline, weight: Weight) -> "Search":
        """All discs on a panel, and what its readings would show of them."""
        discs, changes = [], []
        for shape in SHAPES:
            for shift in (0.0, panel.pitch_mm / 2):
                places, cut = _everywhere(panel, patch_mm, shape, shift)
                changes.append(cut)
                pressures = PRESSURES[float(shape[1] > 0)]
                discs += [Disc(*place, shape[0], shape[1], *pressures, 0.0, 0.0) for place in places]
        patterns = _unit(np.concatenate(changes).reshape(-1, panel.cells).T)
        pressing = patterns[:, : 2 * len(PRESSING) * panel.cells]
        return cls(tuple(discs), patterns, _unit(weight @ (network_of(baseline.logarithm).sensitivity() @ pressing)))

    def stands_out(self, errors: Array) -> float:
        """By how many standard deviations errors of unit variance, against a panel at rest, look like a disc."""
        return float((self.looks.T @ errors).max())

    def starts(self, change: Array, errors: Array) -> list[Disc]:
        """Where each shape fits a map of ln r/r0 (rows, columns) best, then where it fits errors of a panel at rest.

        The map shows strong loads, whose errors are not in proportion; the errors show weak ones through noise.
        """
        on_map = (self.patterns.T @ np.clip(change.ravel(), -CLEAR, CLEAR)).reshape(len(SHAPES), -1)
        in_errors = (self.looks.T @ errors).reshape(len(PRESSING), -1)
        size = on_map.shape[1]
        order = np.argsort(-on_map.max(axis=1))
        places = [shape * size + int(np.argmax(on_map[shape])) for shape in order]
        places += [shape * size + int(np.argmax(row)) for shape, row in enumerate(in_errors)]
        return [self.discs[place] for place in dict.fromkeys(places)]


def cell_map(frame: Frame) -> Array:
    """argmin ‖R − f(r0·e^x)‖² + ‖x/MAP_SD‖², a few Gauss-Newton steps: ln r/r0 of every cell, (rows, columns)."""
    change = np.zeros(frame.measured.shape)
    every = np.arange(change.size)
    covariance = frame.covariance(change)
    for _ in range(MAP_STEPS):
        residual, slope = frame.missed(change, every)
        total = cho_factor(slope @ slope.T * MAP_SD**2 + covariance)
        found = MAP_SD**2 * (slope.T @ cho_solve(total, residual + slope @ change.ravel()))
        change = change + np.clip(found.reshape(change.shape) - change, -MAP_STEP, MAP_STEP)
    return change


def _everywhere(
    panel: Panel, patch_mm: float, shape: tuple[float, float, float], shift: float
) -> tuple[list[tuple[float, float]], Array]:
    """(places, ln r/r0 there (cells, rows, columns)) of a shape about every cell's centre, `shift` further on.

    About another cell it looks the same: it is laid once over a larger panel, and cut out for every cell.
    """
    outer, inner, inside = shape
    across, down = panel.centres_mm()
    large = Panel(2 * panel.rows - 1, 2 * panel.columns - 1, panel.pitch_mm)
    centre = (across[-1] + shift, down[-1] + shift)
    whole, hole = cover(large, patch_mm, centre, (outer, inner or outer)).values[:, 0]
    pattern = ((1 + inside) * hole if inner else 0.0) - whole
    windows = np.lib.stride_tricks.sliding_window_view(pattern, panel.shape)[::-1, ::-1]
    places = [(x + shift, y + shift) for y in down for x in across]
    return places, windows.reshape(-1, *panel.shape)


def _unit(columns: Array) -> Array:
    unit: Array = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return unit
