"""Picture of a season: the visits over days and hours, and their number by the hour of the day."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from lampest.apps.recognition.detect.answer import CUP, LAMPREY, SUCKS
from lampest.apps.recognition.detect.timeline import COLOURS
from lampest.apps.recognition.detect.visits import DAY_HOURS, HOUR_S, Visit
from lampest.report.plots.style import SMALL_POINT, dressed, new_figure

SHOWN = (LAMPREY, SUCKS, CUP)  # other contacts are grey and behind
MIN_BAR_H = 0.15  # so that a short visit is visible on a day
MAX_LABELS = 12  # of days or recordings


def season(visits: Sequence[Visit]) -> Figure:
    """Draw each visit as a bar at its day and hour, and visits of lampreys by hour of the day.

    Hours are counted from the begin of a recording if it has no clock.
    """
    figure = new_figure(3.4)
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1), sharey=True)
    rows = list(
        dict.fromkeys(_row(visit) for visit in sorted(visits, key=lambda visit: visit.visit))
    )
    for visit in sorted(visits, key=lambda visit: visit.answer in SHOWN):
        left.bar(
            rows.index(_row(visit)),
            max((visit.duration_s or 0.0) / HOUR_S, MIN_BAR_H),
            width=0.7,
            bottom=_hour(visit),
            label=visit.answer,
            color=COLOURS[visit.answer],
            lw=0,
        )
    step = -(-len(rows) // MAX_LABELS)
    labelled = range(0, len(rows), step)
    left.set_xticks(labelled, rows[::step], rotation=60 if len(rows) > 6 else 0)
    ends = (_hour(visit) + (visit.duration_s or 0.0) / HOUR_S for visit in visits)
    highest = max(24.0, *ends)
    left.set_ylim(min(highest, 48.0), 0)
    clocked = any(visit.clock is not None for visit in visits)
    dressed(
        left,
        "day" if clocked else "recording",
        "hour of the day" if clocked else "hours since its begin",
    )
    handles, labels = left.get_legend_handles_labels()
    known = dict(zip(labels, handles, strict=True))
    left.legend(known.values(), known.keys(), fontsize=SMALL_POINT, frameon=False, loc="best")
    for name in SHOWN:
        hours = [_hour(visit) for visit in visits if visit.answer == name]
        counts, edges = np.histogram(hours, bins=np.arange(0, np.ceil(highest) + 1))
        right.barh(edges[:-1] + 0.5, counts, height=0.8, color=COLOURS[name], alpha=0.8)
    if clocked:
        for edge in DAY_HOURS:
            right.axhline(edge, color="0.6", lw=0.6, ls=":")
    dressed(right, "visits in the hour", "")
    return figure


def _row(visit: Visit) -> str:
    return visit.recording if visit.clock is None else visit.clock.date().isoformat()


def _hour(visit: Visit) -> float:
    """Return the hour of the day of the arrival.

    Hours are counted from the begin of the recording if it has no clock.
    """
    if visit.clock is None:
        return visit.begin_s / HOUR_S
    return visit.clock.hour + visit.clock.minute / 60 + visit.clock.second / HOUR_S
