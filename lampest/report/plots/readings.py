"""Picture of a recording's readings: which of them are missing, impossible, or outliers."""

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
from lampest.report.plots.style import (
    PICTURES,
    SMALL_POINT,
    SUFFIXES,
    TEXT_POINT,
    new_figure,
    save,
    verbatim,
)

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
    readings = cleaned.readings
    left_out = readings.seen == 0
    alone = cleaned.outliers & ~cleaned.impossible
    states = np.where(readings.side == Sidedness.VALUE, MEASURED, BOUND)
    chosen = (
        alone & ~left_out,
        alone & left_out,
        cleaned.impossible,
        cleaned.frozen,
        readings_of(cleaned.garbled, cleaned.recording),
    )
    for state, flagged in enumerate(chosen, start=KEPT):
        states = np.where(flagged, state, states)
    states = np.where(np.isnan(recorded), MISSING, states)
    return np.where(cleaned.recording.scene.requested, states, len(STATES) - 1)


def readings_picture(recording: Recording) -> Figure:
    """Draw the state of each reading of a recording: places downwards, frames to the right."""
    prepared = Prepared(recording)
    if prepared.layout is None:
        states = states_of(prepared.cleaned, recording.recorded)
    else:  # modules, of which dead ones are missing
        missing = np.full(recording.modules[0].recorded.shape, MISSING)
        parts = [
            missing if module is None else states_of(module.cleaned, module.recording.recorded)
            for module in prepared.modules
        ]
        states = prepared.layout.joined(np.stack(parts, axis=-3))
    frames, rows, columns = states.shape
    figure = new_figure(HEIGHT_INCH)
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
    unloaded = np.sum(recording.role == UNLOADED)
    axes.set_xlabel(f"frame [number in the file], {unloaded} unloaded", fontsize=TEXT_POINT)
    axes.set_ylabel(f"row [number], each with its {columns} columns downwards", fontsize=TEXT_POINT)
    axes.set_yticks(np.arange(0, rows, -(-rows // MAX_ROW_TICKS)))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.tick_params(labelsize=SMALL_POINT)
    axes.set_title(recording.name, fontsize=TEXT_POINT)
    patches = []
    for state, words in enumerate(STATES):
        of_frames = (states == state).sum(axis=(1, 2))
        if of_frames.any():
            places = counted(int(of_frames.sum()), "reading")
            label = f"{words}: {places} in {counted(int(np.sum(of_frames > 0)), 'frame')}"
            patches.append(Patch(facecolor=colours[state], edgecolor="0.5", lw=0.3, label=label))
    figure.legend(
        handles=patches,
        fontsize=SMALL_POINT,
        frameon=False,
        ncols=2,
        loc="outside lower center",
    )
    return figure


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
    if target.suffix not in SUFFIXES:
        if target.suffix and not target.is_dir():
            raise InputError(f"{target}: {PICTURES}")
        target = target / f"readings_{recording.name}.png"
    with verbatim():
        save(readings_picture(recording), target)
    return target
