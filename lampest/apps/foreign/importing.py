"""Import of foreign measurements as recordings, with notes on everything inferred or assumed."""

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lampest.apps.foreign.arrays import (
    MAX_BYTES,
    READERS,
    Arrays,
    Frames,
    Layout,
    Shape,
    arrays_of,
    frames_of_arrays,
    joined_frames,
)
from lampest.apps.foreign.clocks import Clock
from lampest.apps.foreign.division import frames_of
from lampest.apps.foreign.form import readings_table
from lampest.apps.foreign.lines import FieldLines, lines_of_sheets, lines_of_text
from lampest.apps.foreign.own_layouts import LAYOUTS
from lampest.apps.foreign.records import READERS as RECORDS
from lampest.apps.foreign.records import panel_of, records_of
from lampest.apps.foreign.unit import understood_unit
from lampest.files.errors import InputError, counted, first_and_more, meant, printable
from lampest.files.typed import installed, typed
from lampest.files.whole import note_read
from lampest.inference.readings.garbled import garbled_lines
from lampest.panel.panel import Array, Mask, Panel
from lampest.panel.scene import Scene
from lampest.recording.processed import AS_CONVERTED, normalised, processing_of, restored
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.unit import RESISTANCES, check_unit, recorded_values

NOT_READ = {
    ".xls": "save it as .xlsx",
    ".ods": "save it as .xlsx or .csv",
    ".xlsb": "save it as .xlsx",
    **dict.fromkeys(
        (".pkl", ".pickle", ".p"),
        "a pickle runs code when it is opened; save the array as .npy, .json or .csv",
    ),
    **dict.fromkeys((".zip", ".gz", ".bz2", ".xz", ".zst", ".7z", ".tar"), "unpack it first"),
    **dict.fromkeys((".bag", ".db3", ".mcap"), "save the topic's arrays as .npy"),
    **dict.fromkeys((".db", ".sqlite", ".tdms"), "save its table as .csv"),
}
MAX_FILES = 10_000  # of a folder
SHEETS = (".xlsx", ".xlsm")
NAMED = (*sorted(set(READERS) - {".npy"}), *SHEETS, ".json", ".jsonl", ".parquet")


@typed
def import_file(  # noqa: PLR0913 # the options of a command
    path: str | Path,
    rows: int | None = None,
    columns: int | None = None,
    scene: Scene | None = None,
    unit: str | None = None,
    baseline_frames: int = 0,
    *,
    transpose: bool = False,
    variable: str | None = None,
    period: float | None = None,
    missing: str = "mark",
    layout: str | Layout | None = None,
    time_unit: Literal["s", "ms", "us"] | None = None,
    resting: str | Path | None = None,
    skip_lines: int = 0,
) -> tuple[Recording, tuple[str, ...]]:
    r"""Import a file as a recording of rows × columns cells.

    The suffix determines the format: .xlsx, .npy, .npz, .mat, .h5, .json, .jsonl, .parquet, those
    of layouts, and a text table for any other; a folder of such files holds frames one after the
    other. docs/apps/foreign/import.md.

    Parameters
    ----------
    path : str or Path
    rows, columns : int, or None
        Size of the panel; None: the scene's.
    scene : Scene, or None
        None: a panel of this size, and resistances alone.
    unit : {'ohm', 'kohm', 'volt', 'mV', 'code'}, or None
        None: by the header, otherwise by the values and the scene.
    baseline_frames : int
        Number of unloaded frames at the beginning.
    transpose : bool
        Whether the file's rows are the panel's columns.
    variable : str, or None
        Array of a .mat, .npz or HDF5 file, or sheet of an .xlsx file; required if several fit.
    period : float, or None
        Time between frames in s, in place of the file's times.
    missing : {'mark', 'skip-frame', 'refuse'}
        Missing readings become NaN, their frames are left out, or they are an error.
    layout : str, Layout, or None
        Names of the columns as in a header, 'time,row,column,value'; or a `Layout`, or its kind.
        None: the layout of the file's suffix, otherwise by the header, or by the number of columns.
    time_unit : {'s', 'ms', 'us'}, or None
        Unit of times that are numbers; None: by the column's name, otherwise by the numbers.
    resting : str, Path, or None
        File with the resting frame that the firmware subtracted, for scenes with `baseline:
        subtracted`: it is added again, and becomes the only unloaded frame.
    skip_lines : int
        Lines at the beginning of a text file that are left out: a greeting, or rows before the
        first whole frame.

    Returns
    -------
    recording : Recording
    notes : tuple of str
        Sentences on everything inferred or assumed about the file.

    Raises
    ------
    InputError
        With file and place, if anything does not fit.

    >>> from pathlib import Path
    >>> _ = Path("mine.csv").write_text("500,510,490\n505,515,250\n")
    >>> mine, notes = lampest.import_file("mine.csv", rows=1, columns=3, unit="ohm")
    >>> mine.recorded[1]
    array([[505., 515., 250.]])
    """
    path = Path(path)
    if missing not in ("mark", "skip-frame", "refuse"):
        raise InputError(
            f"missing readings: '{missing}' is unknown; there are mark, skip-frame, refuse"
        )
    panel = panel_of(rows, columns, scene)
    check_unit(unit, scene, path)
    layout = _layout_of(path, layout)
    if skip_lines < 0:
        raise InputError(f"`skip_lines` is {skip_lines}; it must be 0 or more")
    frames = _frames(path, panel, Chosen(variable, layout, skip_lines), transpose=transpose)
    subtracted = None
    if resting is not None:
        file = Path(resting)
        subtracted = (file, _frames(file, panel, Chosen(None, layout, 0)))
    return _recording(
        path, frames, panel, scene, unit, baseline_frames, missing, period, time_unit, subtracted
    )


class Chosen(NamedTuple):
    """Choices of the user on a file: an array or sheet, its layout, and lines left out."""

    variable: str | None
    layout: str | Layout | None
    skip_lines: int


def _layout_of(path: Path, layout: str | Layout | None) -> str | Layout | None:
    """Return the layout of a kind or, by default, of the file's suffix; names of columns as is.

    Raises InputError for a name that resembles the kind of a layout.
    """
    by_name: dict[str, Layout] = {}
    for candidate in (*LAYOUTS, *installed("lampest.layouts", Layout)):
        by_name |= dict.fromkeys((candidate.kind, *candidate.suffixes), candidate)
    if layout is None:
        return by_name.get(path.suffix.lower())
    if isinstance(layout, Layout):
        return layout
    if layout in by_name:
        return by_name[layout]
    hint = meant(layout, by_name)
    if hint:
        raise InputError(f"`layout='{layout}'` is no import format{hint}")
    return layout


def _recording(  # noqa: PLR0913 # the options of an import
    path: Path,
    frames: Frames,
    panel: Panel,
    scene: Scene | None,
    unit: str | None,
    baseline_frames: int,
    missing: str,
    period: float | None,
    time_unit: str | None,
    resting: tuple[Path, Frames] | None,
) -> tuple[Recording, tuple[str, ...]]:
    """Return frames as a recording in the scene's unit, and the notes; see `import_file`."""
    values = frames.values
    count = len(values)
    values[~panel.present & ~(values > 0)] = np.nan
    if not 0 <= baseline_frames <= count:
        raise InputError(
            f"{path}: {baseline_frames} baseline frames asked for, "
            f"but the file holds {count} frames"
        )
    clock = _clock(frames, period, time_unit, path)
    if missing == "refuse":
        for frame, row, column in np.argwhere(np.isnan(values) & panel.present).tolist():
            place = frames.place(frame, row, column)
            raise InputError(f"{place}: the reading of row {row}, column {column} is missing")
    unit, reason = understood_unit(values, unit, frames.words, scene, path)
    source = "by the scene" if scene else "assumed; a scene says otherwise"
    scene = scene or Scene(panel)
    role = np.where(np.arange(count) < baseline_frames, UNLOADED, MEASURED).astype(np.uint8)
    if resting is not None or scene.baseline == "subtracted":
        values, scene = _restored(values, scene, role, resting, path)
    elif scene.baseline is None and scene.readout is not None and unit not in RESISTANCES:
        # Readings in volt or codes that firmware has changed are refused.
        readout = scene.readout
        if readout.floor_code is None:
            lowest = -np.inf if readout.characteristic.signed else 0.0
            changed = processing_of(values, role == UNLOADED, panel.present, lowest)
            if not changed and unit == "volt":
                changed = normalised(values, readout.full_scale_volt)
            if changed:
                raise InputError(
                    f"{path}: these are no readings as the converter gives them: {changed}"
                )
    recorded = recorded_values(values, unit, scene, frames.place, path)
    kept, gaps = _without_missing(np.isnan(recorded) & panel.present, missing, path)
    recording = Recording(
        scene,
        recorded[kept],
        clock.seconds[kept],
        role[kept],
        name=path.stem,
        start_time=clock.start,
    )
    assumed = _assumed(scene, source)
    notes = (*frames.notes, reason, clock.sentence, assumed, gaps, *_summary(recording))
    return recording, tuple(map(printable, filter(None, notes)))


def _restored(
    values: Array,
    scene: Scene,
    role: NDArray[np.uint8],
    resting: tuple[Path, Frames] | None,
    path: Path,
) -> tuple[Array, Scene]:
    """Return readings with the resting frame of a file added, and the scene without it.

    Unloaded frames are returned as this frame.

    Raises InputError unless both the scene and a file say that a frame was subtracted.
    """
    if scene.baseline != "subtracted":
        raise InputError(
            f"{path}: a resting frame is added where the scene says baseline: subtracted"
        )
    if resting is None:
        raise InputError(
            f"{path}: the scene says baseline: subtracted; "
            f"give the resting frame that was subtracted (--resting FILE), or {AS_CONVERTED}"
        )
    file, frames = resting
    with np.errstate(invalid="ignore"):
        frame = frames.values.mean(axis=0)
    if not np.all(np.isfinite(frame[scene.panel.present])):
        raise InputError(f"{file}: the resting frame has no value at a cell")
    raw = restored(values, frame)
    unloaded = role == UNLOADED
    if not np.any(unloaded):
        raise InputError(
            f"{path}: say how many frames at the beginning are unloaded (--baseline); "
            "the resting frame is theirs"
        )
    raw[unloaded] = frame
    return raw, replace(scene, baseline="raw")


def _frames(path: Path, panel: Panel, chosen: Chosen, *, transpose: bool = False) -> Frames:
    """Return the file's frames over the panel, or with one value for each listed cell."""
    read = partial(_read_frames, path, chosen=chosen)
    turned = panel.shape[::-1]
    if transpose:
        frames = read(turned)
        return frames.arranged(
            frames.number.swapaxes(1, 2), "transposed: the file's rows are the panel's columns"
        )
    try:
        frames = read(panel.shape)
    except InputError as error:
        cells = [cell[:2] for cell in panel.cells or ()]
        if cells:
            with suppress(InputError):
                frames = read((1, len(cells)))
                number = np.full((len(frames.number), *panel.shape), -1)
                number[:, *np.transpose(cells)] = frames.number[:, 0]
                note = f"{len(cells)} values are the cells in the order of the scene's list"
                return frames.arranged(number, note)
        fits_turned = False
        with suppress(InputError):  # frames with their times
            _clock(read(turned), None, None, path)
            fits_turned = turned != panel.shape
        if fits_turned:
            raise InputError(f"{error}; with `transpose` it would fit") from error
        raise
    modules = panel.modules
    if modules is not None and frames.parts == modules.count:
        number = modules.of_parts(frames.number)
        return frames.arranged(number, f"{frames.parts} parts of a line are the modules")
    return frames


def _read_frames(path: Path, shape: Shape, chosen: Chosen) -> Frames:
    """Read the frames of a file by its suffix.

    Raises InputError if it is unreadable, too large, or does not fit.
    """
    kind = path.suffix.lower()
    variable, layout, skip = chosen
    try:
        note_read(path)
        size = path.stat().st_size
        if path.is_dir():
            return _of_folder(path, shape, chosen)
        if not path.is_file():
            raise InputError(f"{path}: no file")
        if size > MAX_BYTES:
            raise InputError(f"{path}: {size} bytes, more than {MAX_BYTES} are not imported")
        if isinstance(layout, Layout):
            return layout.frames(path, shape)
        if kind in NOT_READ:
            raise InputError(f"{path}: {kind} files are not read; {NOT_READ[kind]}")
        if variable is not None and kind not in NAMED:
            raise InputError(f"{path}: holds nothing by name; `variable` is for {', '.join(NAMED)}")
        if skip and kind in (*READERS, *RECORDS, *SHEETS):
            raise InputError(f"{path}: has no lines of text; `skip_lines` is for text tables")
        if layout is not None and kind in READERS:
            raise InputError(f"{path}: holds arrays; `layout` is for tables")
        notes: tuple[str, ...] = ()
        content: Arrays | FieldLines
        if kind in SHEETS:
            return _of_sheets(path, shape, variable, layout)
        if kind in READERS:
            content = arrays_of(path)
        elif kind in RECORDS:
            content, notes = records_of(path)
        else:
            content = lines_of_text(path, skip)
        if isinstance(content, FieldLines):
            frames = frames_of(readings_table(content, layout), shape)
        else:
            frames = frames_of_arrays(path, content, shape, variable)
        return replace(frames, notes=(*frames.notes, *notes))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    except MemoryError as error:
        raise InputError(f"{path}: claims more data than the memory holds") from error


def _of_folder(path: Path, shape: Shape, chosen: Chosen) -> Frames:
    """Return the frames of all files in a folder, in the order of the numbers in their names."""
    # Hidden files, and those of a desktop that shows the folder, are none of the recording's.
    files = sorted(
        (
            file
            for file in path.iterdir()
            if file.is_file()
            and not file.name.startswith(".")
            and file.name.lower() not in ("thumbs.db", "desktop.ini")
        ),
        key=lambda file: [part.zfill(20) for part in re.split(r"(\d+)", file.name)],
    )
    if not files:
        raise InputError(f"{path}: no file in this folder")
    kinds = sorted({file.suffix.lower() or "no suffix" for file in files})
    if len(kinds) > 1:
        raise InputError(
            f"{path}: a folder of frames holds files of one kind, not {', '.join(kinds)}"
        )
    if len(files) > MAX_FILES:
        raise InputError(f"{path}: {len(files)} files, more than {MAX_FILES} are not imported")
    if sum(file.stat().st_size for file in files) > MAX_BYTES:
        raise InputError(f"{path}: more than {MAX_BYTES} bytes are not imported")
    names = [file.name for file in files]
    parts = [_read_frames(file, shape, chosen) for file in files]
    total = sum(len(part.number) for part in parts)
    unused = "; times within them are not used" if any(part.timing for part in parts) else ""
    order = f"in the order of their names, from {names[0]} to {names[-1]}"
    note = f"{counted(total, 'frame')} of {counted(len(files), 'file')}, {order}{unused}"
    return joined_frames(parts, names, str(path), note)


def _of_sheets(path: Path, shape: Shape, sheet: str | None, layout: str | None) -> Frames:
    """Return the frames of the only sheet that fits; if none fits, raise the error of the first."""
    fitting = {}
    wrong = None
    for title, lines in lines_of_sheets(path, sheet).items():
        try:
            fitting[title] = frames_of(readings_table(lines, layout), shape)
        except InputError as error:
            wrong = wrong or error
    if len(fitting) > 1:
        raise InputError(
            f"{path}: the sheets {', '.join(fitting)} would all fit; say which with `variable`"
        )
    if not fitting:
        raise wrong or InputError(f"{path}: holds no values")
    return next(iter(fitting.values()))


def _clock(frames: Frames, period: float | None, unit: str | None, path: Path) -> Clock:
    """Return the times of frames: by a period, from the file, or one frame a second."""
    sentence = "no time in the file: one frame a second is assumed; `period` says otherwise"
    if period is not None:
        if not 0 < period < np.inf:
            raise InputError("the period must be positive and finite")
        unused = "; those of the file are not used" if frames.timing else ""
        sentence = f"time: a frame every {period:g} s, as specified{unused}"
    elif frames.timing:
        return frames.timing(unit)
    elif unit is not None:
        raise InputError(f"{path}: holds no times that could be in {unit}; `period` sets them")
    return Clock(np.arange(len(frames.number)) * (period or 1.0), None, sentence)


def _without_missing(blank: Mask, missing: str, path: Path) -> tuple[Mask, str]:
    """Return the frames that are kept, boolean (frames,), and a note.

    Raises InputError if none would be kept.
    """
    gaps = np.asarray(blank.any(axis=(1, 2)))
    if not np.any(gaps):
        return ~gaps, "no reading is missing"
    if np.all(blank):
        raise InputError(f"{path}: all readings are missing")
    note = (
        f"{counted(int(blank.sum()), 'reading')} missing, "
        f"in {int(gaps.sum())} of {counted(len(blank), 'frame')}"
    )
    if missing == "mark":
        return np.ones_like(gaps), f"{note}: NaN in the recording"
    if np.all(gaps):
        raise InputError(
            f"{path}: {note}, so that no frame would be left; `missing='mark'` keeps them"
        )
    return ~gaps, f"{note}: these frames are left out"


def _assumed(scene: Scene, source: str) -> str:
    """Return a note on the numbers of the scene that affect the recording, and on assumed ones.

    `source` says where the former are from.
    """
    series = f"series resistance {scene.series_text}" if scene.circuit.unit == "ohm" else ""
    pitch = "" if "panel.pitch_mm" in scene.assumed else f"pitch {scene.panel.pitch_mm:g} mm"
    values = " and ".join(filter(None, (series, pitch)))
    origin = values and f"{values}, {source}"
    assumed = scene.assumed_text and f"{scene.assumed_text} assumed: the scene does not say"
    return "; ".join(filter(None, (origin, assumed)))


def _summary(recording: Recording) -> Iterator[str]:
    """Yield notes on readings at the converter's rails, the number of frames, and garbled lines.

    Readings at the rails count as bounds.
    """
    scene = recording.scene
    recorded = recording.recorded
    least, largest = (0.0, np.inf) if scene.readout is None else scene.readout.rails()
    rail = "zero or infinite" if scene.readout is None else "at or beyond a rail of the converter"
    at_rail = (recorded < least) | (recorded > largest) | (recorded == 0) | np.isposinf(recorded)
    if np.any(at_rail):
        yield f"{counted(int(np.sum(at_rail)), 'reading')} {rail}: kept as bounds"
    cells = " × ".join(map(str, scene.panel.shape))
    unloaded = int(np.sum(recording.role == UNLOADED))
    yield f"{counted(len(recorded), 'frame')} of {cells} cells, the first {unloaded} unloaded"
    garbled = [lines.name_in_words for lines in garbled_lines(recording)]
    if garbled:
        places = first_and_more(garbled)
        yield f"garbled, or lost, doubled or swapped: {places}; kept, and left out of estimates"
