"""Pictures of results, without any solve.

To add one, write its `Plot` into a file here and add it to PLOTS. A package adds plots by naming
them in the entry point group `lampest.plots`, a script by handing one to `plot_results`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from mimetypes import guess_type
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lampest.files import hdf5
from lampest.files.errors import InputError, in_words
from lampest.files.typed import installed, of_kind, typed
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.stored import StoredRecording, opened, too_long
from lampest.report.plots.contours import (
    CertaintyPlot,
    ChangePlot,
    ContourPlot,
    Plot,
    PressurePlot,
    ResidualPlot,
    ResistancePlot,
    SweepPlot,
    swept_numbers,
)
from lampest.report.plots.maps import (
    MapPainter,
    Tile,
    change_scale,
    limited,
    log_scale,
    maps_figure,
)
from lampest.report.plots.style import PICTURES, SUFFIXES, WIDTH_INCH, save, verbatim, write_all
from lampest.report.strongest import mean_reading, percent_change, strongest_readings
from lampest.runs.columns import Column
from lampest.runs.results import FORMAT, CaseResult, Results, read_results, stored_cases

Size = tuple[float, float] | None  # width and height in inches; None for that of the maps
PLOTS: tuple[Plot, ...] = (
    ContourPlot(),
    ChangePlot(),
    ResistancePlot(),
    ResidualPlot(),
    PressurePlot(),
    CertaintyPlot(),
    SweepPlot(),
)

FOLDER = "choose a recording, or name a folder"


def plot_of(kind: str) -> Plot:
    """Return the plot of a kind, of lampest or an installed package.

    Raises InputError for none and for two.
    """
    plots: tuple[Plot, ...] = (*PLOTS, *installed("lampest.plots", Plot))
    return of_kind(kind, "plot", plots)


@typed
def plot_results(
    path: str | Path,
    out: str | Path | None = None,
    show: str | Plot | None = None,
    columns: Sequence[Column] = (),
    on_picture: Callable[[int, int], None] = lambda done, total: None,
    *,
    frame: int | None = None,
    estimators: Sequence[str] = (),
    frames: range | None = None,
    recordings: Sequence[str] = (),
) -> list[Path]:
    """Draw every recording of a results file into ``<kind>_<recording>.png``; return the files.

    Raises InputError for an unknown plot, frame, recording or estimator, unreadable results,
    nothing to draw, or a place that cannot be written.

    Parameters
    ----------
    path : path
        The results file.
    out : path, optional
        Folder, by default that of the results, or a .png, .svg or .pdf file for a single picture.
    show : str or Plot, optional
        Kind of plot; by default ``sweep`` after a sweep of numbers, unless a frame is named, and
        else ``contours``.
    columns, frames : sequence of Column, and range, optional
        As in `read_results`.
    on_picture : callable
        Receives the numbers of drawn and of all pictures.
    frame : int, optional
        Index into the recordings; by default a frame of strong change.
    estimators, recordings : sequence of str
        Those that are drawn; by default all.

    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> recording = lampest.simulate(lampest.Simulation(1, 1, scene, frames=2), "mine")
    >>> lampest.reconstruct(recording, [lampest.Misfit()]).save("results.h5", "LSM")
    >>> lampest.plot_results("results.h5", "one.png")[0].name
    'one.png'
    """
    plot = None if show is None else _chosen(show, frame)
    path = Path(path)
    target = path.parent if out is None else Path(out)
    single = out is not None and target.suffix in SUFFIXES
    kind = "" if out is None or single else guess_type(target)[0] or ""
    if kind.startswith(("image/", "application/postscript")):
        raise InputError(f"{target}: {PICTURES}")
    results = _read(path, columns, frame, frames, recordings, estimators)
    if plot is None:
        swept = frame is None and swept_numbers(results.cases)
        plot = _chosen("sweep" if swept else "contours", frame)
    drawn = _drawn(path, results, plot)
    if single and len(drawn) > 1:
        names = ", ".join([*drawn][:3]) + ", …" * (len(drawn) > 3)
        raise InputError(f"{target}: one picture cannot hold {len(drawn)} ({names}): {FOLDER}")
    ending = "" if frame is None else f"_frame{frame}"
    files = [target if single else target / f"{plot.kind}_{name}{ending}.png" for name in drawn]
    return write_all([*drawn.values()], files, on_picture, in_process=isinstance(show, Plot))


def _drawn(path: Path, results: Results, plot: Plot) -> dict[str, Callable[[], Figure]]:
    """Return the functions that draw the recordings which the plot can show, by their names.

    Raises InputError if there is none.
    """
    drawn: dict[str, Callable[[], Figure]] = {}
    for name in results.recordings():
        cases = plot.drawable(results.of(name))
        if cases:
            labelled = tuple(replace(case, estimator=results.label(case)) for case in cases)
            drawn[name] = partial(plot.draw, labelled)
    if not drawn:
        raise InputError(f"{path}: {_lacks(plot)}")
    return drawn


def _read(
    path: Path,
    columns: Sequence[Column],
    frame: int | None,
    frames: range | None,
    recordings: Sequence[str],
    estimators: Sequence[str],
) -> Results:
    """Return the results that are drawn.

    Only the drawn frame is read from recordings too long for memory. Raises InputError for unknown
    names, and for unreadable results.
    """
    if (
        frame is not None
        and frames is None
        and any(too_long(case.frames, case.cells) for case in stored_cases(path))
    ):
        frames = range(frame, frame + 1)
    results = read_results(path, columns, frames)
    try:
        return results.named("recording", recordings).named("estimator", estimators)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def plot_file(path: Path, picture: Path) -> Path:
    """Draw the strongest frame of a recording or of results; return the file of the picture.

    Raises InputError for an unreadable file, a recording without unloaded frames, or a place that
    cannot be written.
    """
    if hdf5.format_of(path) == FORMAT:
        return plot_results(path, picture, recordings=[stored_cases(path)[0].recording])[0]
    recording = opened(path)
    if isinstance(recording, StoredRecording):
        recording = recording.part(recording.blocks[0])
    if strongest_readings(recording) is None:
        raise InputError(f"{path}: has no unloaded frames to compare with; lampest tare names some")
    save(recording_picture(recording), picture)
    return picture


def picture(
    cases: Sequence[CaseResult],
    show: str | Plot,
    frame: int | None = None,
    ax: Axes | None = None,
    figsize: Size = None,
    **ends: float | None,
) -> Figure:
    """Draw the cases of a recording.

    Parameters
    ----------
    cases : sequence of CaseResult
    show : str or Plot
    frame : int, optional
        Index into the recording, by default that of the plot.
    ax : Axes, optional
        Axes for the first case's picture alone; by default a new figure with all pictures.
    figsize : tuple of float, optional
        Width and height of a new figure in inches.
    ends : float or None
        vmin and vmax; see `Plot`.

    Returns
    -------
    Figure
        The new figure, or that of the axes.

    Raises
    ------
    InputError
        For an unknown plot or frame, and if there is nothing to draw.
    """
    specified: dict[str, Any] = {name: end for name, end in ends.items() if end is not None}
    plot = replace(_chosen(show, frame), **specified)
    drawable = plot.drawable(cases)
    if not drawable:
        raise InputError(f"{cases[0].recording}: {_lacks(plot)}")
    return _shown(
        lambda: plot.draw(drawable), lambda axes: plot.draw_on(axes, drawable), ax, figsize
    )


def _shown(
    draw: Callable[[], Figure],
    draw_on: Callable[[Axes], None],
    ax: Axes | None,
    figsize: Size,
) -> Figure:
    """Return a new figure of a size in inches, or the figure of axes, into which is drawn then.

    Raises InputError for another object than axes, for a size that is none, and for the size of the
    figure of axes, which has one.
    """
    with verbatim():
        if ax is None:
            figure = draw()
            if figsize is not None:
                if len(figsize) != 2 or not all(0 < side < 1000 for side in figsize):
                    raise InputError(f"figsize must be width and height in inches, not {figsize!r}")
                figure.set_size_inches(*figsize)
            return figure
        if not isinstance(ax, Axes):
            raise InputError(f"ax must be Matplotlib's Axes, not {in_words(ax)}")
        if figsize is not None:
            raise InputError("figsize is for a new figure, and ax has one")
        draw_on(ax)
    figure_of_axes = ax.get_figure(root=True)  # the axes may be in a part of it
    assert isinstance(figure_of_axes, Figure)
    return figure_of_axes


def recording_picture(
    recording: Recording,
    frame: int | None = None,
    ax: Axes | None = None,
    figsize: Size = None,
    vmin: float | None = None,
    vmax: float | None = None,
) -> Figure:
    """Draw a map of a frame's readings.

    The map shows the change of the readings against the unloaded ones, or the readings if no frame
    is unloaded. Arguments are those of `picture`; by default the frame is that of strongest change,
    or the first. Raises InputError for an unknown frame.
    """
    if frame is not None and not 0 <= frame < len(recording.time):
        raise InputError(
            f"{recording.name}: there is no frame {frame}; there are 0 to {len(recording.time) - 1}"
        )
    strongest = strongest_readings(recording)
    number = frame or 0
    values = recording.recorded[number]
    unit = recording.scene.circuit.unit
    if strongest is None:
        scale = log_scale([values], f"reading [{unit}]", (1e-3, 1e12), "viridis_r")
    else:
        if frame is None:
            number, values = strongest
        else:
            resting = mean_reading(recording.recorded[recording.role == UNLOADED])
            values = percent_change(values, resting)
        scale = change_scale([values], f"change of the reading in {unit} [%]")
    note = f"readings of frame {number} at {recording.time[number]:g} s"
    tile = Tile(recording.name, values, note)
    painter = MapPainter(recording.scene.panel, limited(scale, vmin, vmax))

    def draw_on(axes: Axes) -> None:
        painter.draw(axes, tile)
        painter.bar(axes.figure, axes, "right")

    return _shown(
        lambda: maps_figure([tile], painter.panel, painter.scale, width=WIDTH_INCH / 2),
        draw_on,
        ax,
        figsize,
    )


def _chosen(show: str | Plot, frame: int | None) -> Plot:
    """Return the plot of a word, or the plot itself, for a frame. Raises InputError for others."""
    plot = plot_of(show) if isinstance(show, str) else show
    if not isinstance(plot, Plot):
        raise InputError(f"a plot is a word such as 'contours' or a Plot, not {in_words(plot)}")
    return plot if frame is None else replace(plot, frame=frame)


def _lacks(plot: Plot) -> str:
    needs = f", which needs {', '.join(plot.needs)}" if plot.needs else ""
    return f"holds no {plot.kind} to draw{needs}{plot.hint and f'; {plot.hint}'}"
