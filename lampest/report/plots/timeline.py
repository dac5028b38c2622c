"""What was attached, over time: probabilities, diameter, pressures and place; and the strongest frame with circles."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from lampest.loads.recognition.candidates import KINDS
from lampest.panel.panel import Array
from lampest.report.detect.detection import Detection
from lampest.report.detect.events import events
from lampest.report.plots.maps import ACROSS_LABEL, DOWN_LABEL, MapPainter, Tile, stepped_scale
from lampest.report.plots.style import SMALL_POINT, TEXT_POINT, new_figure, write_all
from lampest.report.strongest import percent_change, strongest_index
from lampest.runs.case import SHARED
from lampest.runs.results import CaseResult, Results

HEIGHT_INCH = 4.6
NEAR = 0.14  # of the width: the names of events that are closer stand one above the other
# In the order of KINDS, from the first again for more loads than these, then 'unlike any': those of Okabe and Ito,
# apart for the colour-blind.
UNIFORM_COLOURS, LOAD_COLOURS = ("0.93", "0.75"), ("#56B4E9", "#0072B2", "#E69F00", "#D55E00", "#009E73", "#F0E442")
UNLIKE_COLOUR = "0.45"
LINE, OTHER = "#222222", "#CC79A7"
X, Y, DIAMETER, WIDTH, INSIDE, RIM = range(6)
STEPS_PERCENT, TICKS_PERCENT = (5, 20, 40, 60, 80, 100), (-100, -60, -20, 20, 60, 100)


def plot_timelines(
    results: Results,
    detections: Sequence[Detection],
    folder: str | Path,
    on_picture: Callable[[int, int], None] = lambda done, total: None,
) -> list[Path]:
    """Draw every recording into timeline_<recording>.png in a folder; returns the files.

    on_picture : gets how many of how many pictures are drawn. Raises InputError where the folder cannot be written.
    """
    shown = [detection for detection in detections if detection.source == SHARED]
    files = [Path(folder) / f"timeline_{detection.recording}.png" for detection in shown]
    return write_all([partial(timeline, one, results.of(one.recording)) for one in shown], files, on_picture)


def timeline(detection: Detection, cases: Sequence[CaseResult]) -> Figure:
    """Five panels of one recording: probabilities of the loads, diameter, pressures, place; and a map with the circles.

    Bands are one standard deviation. The map is the first estimate's relative change in the frame that
    `strongest_index` chooses; vertical lines are the events.
    """
    figure = new_figure(HEIGHT_INCH)
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.45, 1))
    left, right = halves
    panels = left.subplots(5, 1, sharex=True, height_ratios=(1.1, 1, 1, 1, 1))
    _probabilities(panels[0], detection)
    _line(panels[1], detection, ((DIAMETER, LINE, "over the rim"),), "diameter\n[mm]")
    _line(panels[2], detection, ((INSIDE, LINE, "inside"),), "inside\n[kPa]")
    _line(panels[3], detection, ((RIM, LINE, "rim"),), "rim\n[kPa]")
    _line(panels[4], detection, ((X, LINE, "x"), (Y, OTHER, "y")), "centre\n[mm]")
    panels[4].legend(fontsize=SMALL_POINT, frameon=False, ncols=2, loc="best", handlelength=1.2)
    panels[4].set_xlabel("time [s]", fontsize=TEXT_POINT)
    _events(panels, detection)
    left.align_ylabels(panels)
    _map(right, cases[0], detection, strongest_index(cases))
    title = f"{detection.recording}: what is attached, from the two-point resistances"
    figure.suptitle(title, fontsize=TEXT_POINT + 1)
    return figure


def _probabilities(axes: Axes, detection: Detection) -> None:
    """A column for every frame, shared among the kinds; white where a frame was not solved."""
    edges = _edges(detection.time)
    below = np.zeros(len(detection.time))
    colours = (*UNIFORM_COLOURS, *islice(cycle(LOAD_COLOURS), len(KINDS) - len(UNIFORM_COLOURS) - 1), UNLIKE_COLOUR)
    for kind, colour, part in zip(KINDS, colours, np.nan_to_num(detection.probabilities).T, strict=True):
        axes.bar(edges[:-1], part, np.diff(edges), bottom=below, align="edge", color=colour, linewidth=0, label=kind)
        below = below + part
    axes.set_ylim(0, 1)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylabel("probability", fontsize=TEXT_POINT)
    axes.tick_params(labelsize=SMALL_POINT)
    look: dict[str, Any] = {"fontsize": SMALL_POINT, "frameon": False, "handlelength": 1.0, "columnspacing": 1.0}
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.3), ncols=len(KINDS), **look)


def _edges(time: Array) -> Array:
    """Half-way between the frames, (frames + 1) s."""
    if len(time) == 1:
        return np.array([time[0] - 0.5, time[0] + 0.5])
    middle = (time[1:] + time[:-1]) / 2
    return np.concatenate([[2 * time[0] - middle[0]], middle, [2 * time[-1] - middle[-1]]])


def _line(axes: Axes, detection: Detection, lines: Sequence[tuple[int, str, str]], label: str) -> None:
    for quantity, colour, name in lines:
        value, error = detection.values[:, quantity], detection.errors[:, quantity]
        axes.fill_between(detection.time, value - error, value + error, color=colour, alpha=0.2, linewidth=0)
        axes.plot(detection.time, value, ".-", color=colour, ms=3, lw=0.9, label=name)
    if not np.isfinite(detection.values[:, [line[0] for line in lines]]).any():
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", fontsize=SMALL_POINT)
        axes.set_yticks([])
    else:
        _limits(axes, detection, [line[0] for line in lines])
    axes.set_ylabel(label, fontsize=TEXT_POINT)
    axes.tick_params(labelsize=SMALL_POINT)
    axes.grid(True, color="0.9", linewidth=0.5)
    axes.set_axisbelow(True)


def _limits(axes: Axes, detection: Detection, quantities: list[int]) -> None:
    """What nine tenths of the frames need with their errors; a few wild ones must not hide the rest."""
    value, error = detection.values[:, quantities], detection.errors[:, quantities]
    good = np.isfinite(value) & np.isfinite(error)
    low, high = np.percentile((value - error)[good], 5), np.percentile((value + error)[good], 95)
    room = max(0.15 * (high - low), 0.5)
    axes.set_ylim(low - room, high + room)


def _events(panels: Sequence[Axes], detection: Detection) -> None:
    edges = _edges(detection.time)
    last, level = -np.inf, 0
    for event in events(detection):
        edge = edges[event.number]
        level = 1 - level if edge - last < NEAR * (edges[-1] - edges[0]) else 0
        last = edge
        for axes in panels:
            axes.axvline(edge, color="black", lw=0.7, ls=(0, (3, 2)))
        look: dict[str, Any] = {"fontsize": SMALL_POINT, "va": "bottom", "transform": panels[0].get_xaxis_transform()}
        mark = panels[0].text(edge, 1.02 + 0.16 * level, f" {event.kind}", **look)
        mark.set_path_effects([withStroke(linewidth=2, foreground="white")])


def _map(figure: Any, case: CaseResult, detection: Detection, index: int) -> None:
    """Relative change of the cells, and the circles of what was seen there."""
    axes = figure.subplots()
    change, name = case.relative_change[index], case.estimator
    if not case.solved[index]:
        change, name = percent_change(case.measured[index], case.measured_baseline), "two-point resistance"
    values, errors = detection.values[index], detection.errors[index]
    title, note = f"frame {case.frame[index]} at {case.time[index]:g} s: {detection.labels[index]}", ""
    if np.isfinite(values[DIAMETER]):
        note = f"diameter {values[DIAMETER]:.1f} ± {errors[DIAMETER]:.1f} mm"
    scale = stepped_scale(STEPS_PERCENT, f"relative change of resistance [%], {name}", TICKS_PERCENT)
    painter = MapPainter(case.scene.panel, scale)
    painter.draw(axes, Tile(title, change, note))
    painter.bar(figure, axes, "bottom")
    axes.set_xlabel(ACROSS_LABEL, fontsize=TEXT_POINT)
    axes.set_ylabel(DOWN_LABEL, fontsize=TEXT_POINT)
    for one in (values, *(numbers[index] for numbers, _ in detection.further)):
        if np.isfinite(one[DIAMETER]):
            _circles(axes, one)


def _circles(axes: Axes, values: Array) -> None:
    """The outer edge of a load, the inner one where it has a rim, and its centre."""
    radii = [values[DIAMETER] / 2]
    if np.isfinite(values[WIDTH]):
        radii.append(values[DIAMETER] / 2 - values[WIDTH])
    for radius in radii:
        circle = Circle((values[X], values[Y]), radius, fill=False, color="black", lw=1.1)
        circle.set_path_effects([withStroke(linewidth=2.6, foreground="white")])
        axes.add_patch(circle)
    axes.plot(values[X], values[Y], "+", color="black", ms=5, mew=0.9)
