"""Picture of a recording's readings: which of them are missing, impossible, or outliers."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from lampest.files.errors import InputError, counted
from lampest.inference.prepared import Prepared
from lampest.inference.readings.garbled import readings_of
from lampest.inference.readings.judge import Cleaned
from lampest.panel.panel import Array, Numbers
from lampest.recording.readings import Sidedness
from lampest.recording.recording import UNLOADED, Recording
from lampest.recording.stored import StoredRecording, opened
from lampest.report.plots import style

# What becomes of a reading, from the state of most to those that override others.
STATES = (
    "measured",
    "at a rail: a bound",
    "missing in the file",
    "outlier of one frame, kept",
    "outlier, left out",
    "larger than any cells allow, left out",
    "frozen, left out",
    "garbled, left out",
    "no cell, or not read by the scene",
)
MEASURED, BOUND, MISSING, KEPT = range(4)
HEIGHT_INCH = 4.0
MAX_ROW_TICKS = 16


def states_of(cleaned: Cleaned, recorded: Array) -> Numbers:
    """Return the state of each reading of a single network, as an index into STATES.

    Parameters
    ----------
    cleaned : Cleaned
    recorded : array, shape (frames, rows, columns)
        Values as they stand in the file; NaN where missing.

    Returns
    -------
    integer array, same shape
    """
    left_out = cleaned.readings.seen == 0
    alone = cleaned.outliers & ~cleaned.impossible
    missing = np.isnan(recorded)
    states = np.where(cleaned.readings.side == Sidedness.VALUE, MEASURED, BOUND)
    states = np.where(missing, MISSING, states)
    chosen = (
        alone & ~left_out,
        alone & left_out,
        cleaned.impossible,
        np.broadcast_to(cleaned.frozen, recorded.shape),
        readings_of(cleaned.garbled, cleaned.recording),
    )
    for state, flagged in enumerate(chosen, start=KEPT):
        states = np.where(flagged & ~missing, state, states)
    return np.where(cleaned.recording.scene.requested, states, len(STATES) - 1)


def _states(recording: Recording) -> Numbers:
    """Return the states of the readings of one network or of modules, of dead ones missing."""
    prepared = Prepared(recording)
    layout = prepared.layout
    if layout is None:
        return states_of(prepared.cleaned, recording.recorded)
    missing = np.full(recording.modules[0].recorded.shape, MISSING)
    parts = [
        missing if module is None else states_of(module.cleaned, module.recording.recorded)
        for module in prepared.modules
    ]
    return layout.joined(np.stack(parts, axis=-3))


def readings_picture(recording: Recording) -> Figure:
    """Draw the state of each reading of a recording: places downwards, frames to the right."""
    states = _states(recording)
    frames, rows, columns = states.shape
    figure = style.new_figure(HEIGHT_INCH)
    axes = figure.add_subplot()
    colours = colormaps["tab10"](np.arange(len(STATES)))
    colours[MEASURED] = to_rgba("0.93")
    colours[-1] = to_rgba("white")
    axes.imshow(
        states.reshape(frames, -1).T,
        cmap=ListedColormap(colours),
        vmin=-0.5,
        vmax=len(STATES) - 0.5,
        aspect="auto",
        interpolation="nearest",
        extent=(-0.5, frames - 0.5, rows - 0.5, -0.5),
    )
    unloaded = int(np.sum(recording.role == UNLOADED))
    axes.set_xlabel(f"frame [number in the file], {unloaded} unloaded", fontsize=style.TEXT_POINT)
    axes.set_ylabel(
        f"row [number], each with its {columns} columns downwards", fontsize=style.TEXT_POINT
    )
    axes.set_yticks(np.arange(0, rows, -(-rows // MAX_ROW_TICKS)))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.tick_params(labelsize=style.SMALL_POINT)
    axes.set_title(recording.name, fontsize=style.TEXT_POINT)
    figure.legend(
        handles=list(_legend(states, colours)),
        fontsize=style.SMALL_POINT,
        frameon=False,
        ncols=2,
        loc="outside lower center",
    )
    return figure


def _legend(states: Numbers, colours: Array) -> Iterator[Patch]:
    """Yield the colour and the number of readings of each state that occurs."""
    for state, words in enumerate(STATES):
        of_frames = (states == state).any(axis=(1, 2))
        if of_frames.any():
            places = counted(int((states == state).sum()), "reading")
            label = f"{words}: {places} in {counted(int(of_frames.sum()), 'frame')}"
            yield Patch(facecolor=colours[state], edgecolor="0.5", lw=0.3, label=label)


def plot_readings(path: Path, out: Path | None) -> Path:
    """Draw the readings of a recording file; return the picture's file.

    Parameters
    ----------
    path : path
        A recording, of which the first part is drawn where it is too long for memory.
    out : path, optional
        A picture or a folder; by default readings_NAME.png in the folder of the recording.

    Raises
    ------
    InputError
        For an unreadable file, or a place that cannot be written.
    """
    recording = opened(path)
    if isinstance(recording, StoredRecording):
        recording = recording.part(recording.blocks[0])
    target = path.parent if out is None else out
    if target.suffix not in style.SUFFIXES:
        if target.suffix and not target.is_dir():
            raise InputError(f"{target}: {style.PICTURES}")
        target = target / f"readings_{recording.name}.png"
    with style.verbatim():
        style.save(readings_picture(recording), target)
    return target
