"""Pictures of detections: a timeline and a map of each recording, and the visits of a season."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from lampest.apps.recognition.detect.answer import CUP, LAMPREY, PRESSES, SUCKS, Detected
from lampest.apps.recognition.detect.visits import DAY_HOURS, HOUR_S, Visit
from lampest.panel.panel import Panel
from lampest.report.plots.maps import ACROSS_LABEL, DOWN_LABEL, MapPainter, Tile, change_scale
from lampest.report.plots.style import (
    PLAIN_NUMBER,
    SMALL_POINT,
    TEXT_POINT,
    dressed,
    new_figure,
)

# Those of Okabe and Ito, apart for the colour-blind.
MAX_NUMBERED = 20  # visits whose numbers fit on a map
# lines of labels, and the share of the axis that the longest label takes
LABEL_LINES = 5
LABEL_WIDTH = 0.22
COLOURS = {LAMPREY: "#D55E00", SUCKS: "#E69F00", CUP: "#56B4E9", PRESSES: "0.6"}
MIN_BAR_H = 0.15  # so that a short visit is visible on a day
MAX_LABELS = 12  # of days or recordings


def timeline(answer: Detected) -> Figure:
    """Draw the difference of the readings from rest over time, and a map.

    A band marks each attachment.
    """
    figure = new_figure(3.4)
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.45, 1))
    _course(halves[0].subplots(), answer)
    _map(halves[1].subplots(), answer)
    figure.suptitle(f"{answer.recording}: {answer.sentence.split(':')[0]}", fontsize=TEXT_POINT)
    return figure


def _course(axes: Axes, answer: Detected) -> None:
    assert answer.course is not None
    time, loudness = answer.course
    axes.semilogy(time, np.maximum(loudness, 0.1), color="#222222", lw=0.9)
    ends = [0.0] * LABEL_LINES  # of the labels in each line, as shares of the axis
    for attachment, name in zip(answer.attachments, answer.called, strict=True):
        end = time[-1] if attachment.until_s is None else attachment.until_s
        axes.axvspan(attachment.since_s, end, color=COLOURS[name], alpha=0.35, lw=0)
        place = (
            1.0 if time[-1] <= time[0] else (attachment.since_s - time[0]) / (time[-1] - time[0])
        )
        line = next((line for line, taken in enumerate(ends) if taken <= place), None)
        if line is not None:  # else there is no room, and its colour alone says what it is
            ends[line] = place + LABEL_WIDTH
            mark = axes.text(
                attachment.since_s,
                0.98 - 0.07 * line,
                f" {name}",
                clip_on=True,
                fontsize=SMALL_POINT,
                va="top",
                transform=axes.get_xaxis_transform(),
            )
            mark.set_path_effects([withStroke(linewidth=2, foreground="white")])
    axes.set_xlim(time[0], time[-1])
    axes.yaxis.set_major_formatter(PLAIN_NUMBER)
    dressed(axes, "time [s]", "readings differ from rest\n[standard deviations]")


def _map(axes: Axes, answer: Detected) -> None:
    """Draw the relative change of the cells at the last recognition with its circle.

    If there are several visits, or contacts of a mat, their places are drawn.
    """
    loads = answer.attachments
    if answer.panel is not None and len(loads) > 1:
        _visits(axes, answer, answer.panel)
        return
    if answer.change is None or answer.panel is None:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "nothing was there", ha="center", va="center", fontsize=SMALL_POINT)
        return
    change = 100 * np.expm1(answer.change)
    painter = MapPainter(answer.panel, change_scale([change], "relative change of resistance [%]"))
    painter.draw(axes, Tile("what was recognised last", change))
    painter.bar(axes.figure, axes, "bottom")
    axes.set_xlabel(ACROSS_LABEL, fontsize=TEXT_POINT)
    axes.set_ylabel(DOWN_LABEL, fontsize=TEXT_POINT)
    for load in loads:
        if load.diameter_mm is not None:  # the outer edge of a load that is round
            circle = Circle(load.place, load.diameter_mm[0] / 2, fill=False, color="black", lw=1.1)
            circle.set_path_effects([withStroke(linewidth=2.6, foreground="white")])
            axes.add_patch(circle)
        axes.plot(*load.place, "+", color="black", ms=5, mew=0.9)


def _visits(axes: Axes, answer: Detected, panel: Panel) -> None:
    """Draw the places of all visits with their numbers.

    A place is a circle of the diameter, or a cross where the diameter is not known.
    """
    across, down = panel.places_mm[:, panel.present]
    axes.plot(across, down, ".", color="0.8", ms=2)
    for number, (load, name) in enumerate(zip(answer.attachments, answer.called, strict=True), 1):
        if load.diameter_mm is not None:
            radius = load.diameter_mm[0] / 2
            axes.add_patch(Circle(load.place, radius, fill=False, color=COLOURS[name], lw=1.1))
        else:
            axes.plot(*load.place, "x", color=COLOURS[name], ms=4, mew=0.9)
        if len(answer.attachments) <= MAX_NUMBERED:
            axes.annotate(str(number), load.place, fontsize=SMALL_POINT, ha="center", va="center")
    (left, right), (top, bottom) = panel.extents_mm
    axes.set(
        xlim=(left - panel.pitch_mm, right + panel.pitch_mm),
        ylim=(bottom + panel.pitch_mm, top - panel.pitch_mm),
    )
    axes.set_aspect("equal")
    what = "contacts" if answer.mat else "visits"
    axes.set_title(f"places of all {what}", fontsize=SMALL_POINT)
    dressed(axes, ACROSS_LABEL, DOWN_LABEL)


def season(visits: Sequence[Visit]) -> Figure:
    """Draw each visit as a bar at its day and hour, and visits of lampreys by hour of the day.

    Visits are in the order of time. Hours are counted from the begin of a recording without a
    clock.
    """
    figure = new_figure(3.4)
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1), sharey=True)
    days = [visit.clock.date().isoformat() if visit.clock else visit.recording for visit in visits]
    seconds = [visit.begin_s for visit in visits]
    for number, visit in enumerate(visits):
        if visit.clock:
            midnight = visit.clock.replace(hour=0, minute=0, second=0, microsecond=0)
            seconds[number] = (visit.clock - midnight).total_seconds()
    hours = np.array(seconds) / HOUR_S
    lasted = np.array([visit.duration_s or 0.0 for visit in visits]) / HOUR_S
    highest = max(24.0, *(hours + lasted))
    names = list(dict.fromkeys(days))
    places = np.array([names.index(day) for day in days])
    look = {"orientation": "horizontal", "rwidth": 0.8, "alpha": 0.8}
    for name in reversed(COLOURS):
        own = np.array([visit.answer == name for visit in visits])
        if own.any():
            bars = np.maximum(lasted, MIN_BAR_H)[own]
            left.bar(places[own], bars, 0.7, hours[own], label=name, color=COLOURS[name], lw=0)
            if name != PRESSES:
                edges = np.arange(0, np.ceil(highest) + 1)
                right.hist(hours[own], edges, color=COLOURS[name], **look)
    step = -(-len(names) // MAX_LABELS)
    turned = 60 if len(names) > 6 else 0
    left.set_xticks(range(0, len(names), step), names[::step], rotation=turned)
    left.set_ylim(min(highest, 48.0), 0)
    left.legend(fontsize=SMALL_POINT, frameon=False, loc="best")
    if any(visit.clock for visit in visits):
        dressed(left, "day", "hour of the day")
        for edge in DAY_HOURS:
            right.axhline(edge, color="0.6", lw=0.6, ls=":")
    else:
        dressed(left, "recording", "hours since its begin")
    dressed(right, "visits in the hour", "")
    return figure
