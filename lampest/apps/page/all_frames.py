"""Maps of all frames of a recording, one under another, of which a slider shows one."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.image import imsave

from lampest.panel.panel import Array
from lampest.report.compare import MAX_SHOWN
from lampest.report.plots.contours import estimated
from lampest.report.plots.maps import Scale, change_scale
from lampest.report.plots.style import data_uri, new_figure
from lampest.report.strongest import apparent_change, percent_change
from lampest.runs.case import CaseResult

MAX_FRAMES = 200
MAX_PIXELS = 400_000  # of a map's strip: 40 frames of 100 × 100 cells, some hundred kB
MISSING = (0.8, 0.8, 0.8, 1.0)  # grey, as on other maps


@dataclass(frozen=True)
class AllFrames:
    """Maps of the frames of a recording.

    Attributes
    ----------
    strips : dict
        Title → maps of one quantity in every shown frame, one pixel a cell, frames from top to
        bottom: an image of (frames·rows, columns) pixels as a data URI. The quantities are the
        readings, the cells of each estimator, and the truth if it is known.
    bar : str
        Colour bar of all maps as a data URI.
    labels : tuple of str
        Frame number and time of each shown frame, such as 'frame 3 at 0.2 s'.
    first : int
        Index of the frame that is shown first.
    shape : tuple of int
        Rows and columns of the panel.
    left_out : int
        Number of frames that are not shown.
    """

    strips: dict[str, str]
    bar: str
    labels: tuple[str, ...]
    first: int
    shape: tuple[int, int]
    left_out: int


def all_frames(cases: Sequence[CaseResult], place: int) -> AllFrames | None:
    """Return the maps of a recording's frames; None for a recording of one frame.

    Of recordings with many frames, MAX_FRAMES at most are shown, evenly spaced, among them the
    frame at index `place`, which is shown first.
    """
    case = cases[0]
    count = len(case.time)
    rows, columns = case.scene.panel.shape
    if count < 2:
        return None
    most = max(2, min(MAX_FRAMES, MAX_PIXELS // (rows * columns)))
    spread = np.linspace(0, count - 1, min(count, most)).round().astype(int)
    shown = np.unique(np.append(spread, place))
    measured = [
        apparent_change(case.measured[n], case.measured_baseline, case.scene) for n in shown
    ]
    changes = {"measured": np.stack(measured)}
    for other in cases[:MAX_SHOWN]:
        solved = other.solved[shown, None, None]
        changes[estimated(other, cases)] = np.where(solved, other.relative_change[shown], np.nan)
    if case.truth is not None and case.truth_baseline is not None:
        changes["truth"] = percent_change(case.truth[shown], case.truth_baseline)
    scale = change_scale(list(changes.values()), "change of resistance [%]")
    figure = new_figure(0.6)
    figure.colorbar(
        ScalarMappable(scale.norm, scale.colours),
        cax=figure.subplots(),
        orientation="horizontal",
        label=scale.label,
        ticks=scale.ticks,
    )
    return AllFrames(
        {title: _image(change, scale) for title, change in changes.items()},
        data_uri(figure),
        tuple(f"frame {case.frame[n]} at {case.time[n]:.4g} s" for n in shown),
        int(np.flatnonzero(shown == place)[0]),
        (rows, columns),
        count - len(shown),
    )


def _image(change: Array, scale: Scale) -> str:
    """Return changes (frames, rows, columns) as an image of (frames·rows, columns) pixels."""
    pixels = change.reshape(-1, change.shape[2])
    known = np.isfinite(pixels)
    colours = scale.colours(scale.norm(np.where(known, pixels, 0.0)))
    colours[~known] = MISSING
    stream = BytesIO()
    imsave(stream, colours, format="png", metadata={"Software": ""})
    return f"data:image/png;base64,{b64encode(stream.getvalue()).decode('ascii')}"
