"""Readings and cells of one frame side by side on one logarithmic scale: for recordings without unloaded frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from lampest.panel.panel import Array
from lampest.report.plots.maps import ACROSS_LABEL, DOWN_LABEL, MapPainter, Scale, Tile
from lampest.report.plots.plot import Plot, frame_title, shown_index
from lampest.report.plots.style import TALLEST_INCH, TEXT_POINT, WIDTH_INCH, new_figure, short_title
from lampest.runs.case import CaseResult

MOST_MAPS = 6  # side by side


@dataclass(frozen=True)
class ResistancePlot(Plot):
    """Maps of one frame: what was measured, each of the first estimators' cells, the truth; r in ohm, dark where low.

    `frame` is an index into the recording; without it `strongest_index` chooses.
    """

    kind: ClassVar[str] = "resistance"

    def draw(self, cases: Sequence[CaseResult]) -> Figure:
        """One picture. Raises InputError where the frame has no results."""
        index, first = shown_index(cases, self.frame), cases[0]
        tiles = [Tile("measured", first.measured[index])]
        for case in cases[:MOST_MAPS]:
            cells = case.cell_resistance[index] if case.solved[index] else None
            tiles.append(Tile(short_title(case.estimator), cells))
        if first.truth is not None:
            tiles.append(Tile("truth", first.truth[index]))
        scale = log_scale([tile.values for tile in tiles if tile.values is not None], "resistance [ohm]")
        painter = MapPainter(first.scene.panel, scale)
        places = first.scene.panel.places_mm
        wide, tall = (float(np.nanmax(one) - np.nanmin(one)) + first.scene.panel.pitch_mm for one in places)
        width = min((WIDTH_INCH - 1.2) / len(tiles), (TALLEST_INCH - 1.2) * wide / tall)
        figure = new_figure(width * tall / wide + 1.2)
        grid = figure.subplots(1, len(tiles), squeeze=False, sharex=True, sharey=True)
        painter.draw_all(grid, tiles)
        painter.bar(figure, grid, "right")
        figure.supxlabel(ACROSS_LABEL, fontsize=TEXT_POINT)
        figure.supylabel(DOWN_LABEL, fontsize=TEXT_POINT)
        figure.suptitle(f"{first.recording}: {frame_title(first, index, self.frame)}", fontsize=TEXT_POINT + 1)
        return figure


def log_scale(values: Sequence[Array], label: str) -> Scale:
    """From the 2nd to the 90th percentile of all values: cells in the air reach to any resistance."""
    numbers = np.concatenate([part[np.isfinite(part) & (part > 0)] for part in values])
    low, high = np.percentile(numbers, [2, 90]) if numbers.size else (1.0, 10.0)
    rounded = (float(step * 10.0**power) for power in range(-6, 10) for step in (1, 2, 5))
    ticks = tuple(tick for tick in rounded if low <= tick <= high)
    return Scale(LogNorm(low, max(high, 1.1 * low)), colormaps["viridis"], label, "both", ticks or None)
