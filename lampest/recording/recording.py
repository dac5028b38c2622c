"""Recordings: frames of readings with their scene and, if simulated, their truth; in memory, or read in parts."""

import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.document import parse_document, validated
from lampest.files.errors import InputError, extra
from lampest.files.parts import join_parts
from lampest.files.process import check_memory
from lampest.files.typed import Validated, typed
from lampest.files.whole import folder_beside
from lampest.panel.panel import Array, Panel, as_panels_have
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene, read_scene, scene_text
from lampest.panel.systematic import SERIES
from lampest.recording.acquisition import FORMAT, Acquisition, group_of, stored_fields, undamaged_frames
from lampest.recording.foreign.labelled import frames_of_table, labelled_array, named_units, panel_of
from lampest.recording.foreign.unit import check_unit, recorded_values, understood_unit
from lampest.recording.readings import Readings, check_sigma

UNLOADED, MEASURED = ROLES = 0, 1
FORMER_SERIES = "series_ohm"  # key of `systematic: {series_tolerance_ohm}` in recordings of version 0.1
UNREFERENCED = "no frame is unloaded (role 0), so changes and pressures are against the first measured frame"
MIN_CHANGE = 0.01  # least relative change of readings or cells by a load or a common error, far above drift
MAX_READINGS = 2_000_000  # readings of a recording in memory at once: 2 GB, because error bars take 1 kB for each
PART_READINGS = 500_000  # readings of a part of a longer recording
FOREIGN = (".csv", ".txt", ".log", ".tsv", ".xlsx", ".xlsm", ".npy", ".npz", ".mat")  # suffixes of `import_file`


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Validated):
    """Frames of one panel in temporal order.

    Parameters
    ----------
    scene : Scene
        Scene that the estimator gets.
    recorded : array, shape (frames, rows, columns)
        In ohm for two-point readouts, including series resistance; otherwise in volt at the converter. NaN if missing;
        for bounds see `Readings.of`.
    time : array, shape (frames,)
        Times of the frames in s.
    role : array, shape (frames,)
        0 for the unloaded baseline, 1 for measured frames.
    sigma : array, shape (frames, rows, columns) or (rows, columns), or None
        Standard deviations in the same unit; None: those of the readout.
    truth_cell_resistance, truth_pressure : array, shape (frames, rows, columns), or None
        Truth of simulated recordings, in ohm and kPa.
    raw_sums : array, shape (frames, rows, columns), or None
        Sums of converter codes.
    board_log_change : array, shape (frames, rows, columns), or None
        ln(r / r unloaded) that the board estimated itself; NaN where it did not.
    raw_readings : int, or None
        Number of codes in each sum.
    name : str
        Name in results; the file's stem.
    simulation : str, or None
        Definition of a simulated recording as YAML.
    acquisition : Acquisition, or None
        Clocks, gaps and events of a recording from a board.
    start_time : str, or None
        Date and time at 0 s, ISO 8601, with the zone if it is known.
    number : array, shape (frames,), or None
        Indices of the frames in a longer recording; None: these are all frames.
    of_module : bool
        Whether this is one module of a panel; the unit is checked on the readings of all modules.

    Raises InputError if shapes disagree, times decrease, or a standard deviation is not positive.

    >>> recording
    Recording(mine: 4 frames (2 unloaded) of 2 × 3 cells, 0 to 3 s)
    """

    scene: Scene
    recorded: Array
    time: Array
    role: NDArray[np.uint8]
    sigma: Array | None = None
    truth_cell_resistance: Array | None = None
    truth_pressure: Array | None = None
    raw_sums: NDArray[np.uint16] | None = None
    raw_readings: int | None = None
    name: str = "recording"
    simulation: str | None = None
    acquisition: Acquisition | None = None
    start_time: str | None = None
    number: NDArray[np.intp] | None = None
    of_module: bool = False
    board_log_change: Array | None = None

    def __post_init__(self) -> None:
        shape = self.scene.panel.shape
        frames = len(self.recorded) if self.recorded.ndim else 0
        if self.recorded.shape[1:] != shape or frames == 0:
            actual = " × ".join(str(size) for size in self.recorded.shape)
            raise InputError(
                f"{self.name}: {self.path} is {actual}, but the scene's panel asks for frames × "
                f"{shape[0]} × {shape[1]} with at least one frame"
            )
        where = f"{self.name}: {self._group}/"
        check_sigma(self.scene, self.recorded, self.sigma, where)
        object.__setattr__(self, "recorded", as_panels_have(self.recorded))  # no value refuses a recording
        if np.any(np.abs(self.time) > 1e13):  # clocks count milliseconds since 1970, with room
            raise InputError(f"{where}time goes beyond 1e+13 s")
        if self.time.shape != (frames,) or not np.all(np.isfinite(self.time)):
            raise InputError(f"{where}time must hold one finite time for each frame")
        if np.any(np.diff(self.time) < 0):
            raise InputError(f"{where}time must not decrease")
        self._check_unit()
        if self.role.shape != (frames,) or not np.all(np.isin(self.role, ROLES)):
            raise InputError(f"{where}role must hold 0 or 1 for each frame")
        for field, (path, *_) in stored_fields(self.scene.circuit).items():
            values = getattr(self, field) if field.startswith(("truth", "board")) else None
            if values is not None and values.shape != self.recorded.shape:
                raise InputError(f"{self.name}: /entry/{path} has another shape than the frames")
        if self.acquisition is not None and len(self.acquisition.host_time) != frames:
            raise InputError(f"{self.name}: /entry/acquisition has another length than the frames")

    def __repr__(self) -> str:
        """Return a description in one line: '24 frames (3 unloaded) of 10 × 10 cells'."""
        unloaded, (rows, columns) = int(np.sum(self.role == UNLOADED)), self.scene.panel.shape
        frames = f"{len(self.role)} frames ({unloaded} unloaded)"
        span = f"{self.time.min():g} to {self.time.max():g} s"
        return f"Recording({self.name}: {frames} of {rows} × {columns} cells, {span})"

    def _check_unit(self) -> None:
        """Raise InputError if the values are probably in kohm: without raw sums, all below the series resistance."""
        circuit = self.scene.circuit
        valid = self.recorded[np.isfinite(self.recorded) & (self.recorded > 0)]
        if not isinstance(circuit, TwoPointReadout) or self.raw_sums is not None or self.of_module or not valid.size:
            return
        series = float(np.min(self.scene.series_ohm))
        code = circuit.code_from_volt(circuit.volt_from_recorded(np.array(1000 * np.median(valid))))
        stuck = valid.min() == valid.max()  # at the converter's rail: a module without contact
        if not stuck and valid.max() < series and 8 <= code < 2**circuit.adc_bits - 8:
            raise InputError(
                f"{self.name}: {self.path} is at most {valid.max():.4g} ohm, less than the {series:.4g} ohm in series; "
                "are these kohm?"
            )

    @property
    def _group(self) -> str:
        """Group of the frames in a file."""
        return f"/entry/{group_of(self.scene.circuit)}"

    @property
    def path(self) -> str:
        """Path of the recorded values in a file."""
        return f"{self._group}/{self.scene.circuit.signal}"

    @property
    def resistance(self) -> Array:
        """Values `recorded` of a two-point readout, ohm. Raises InputError for other readouts."""
        if self.scene.circuit.unit != "ohm":
            raise InputError(f"{self.name}: its readout gives {self.scene.circuit.unit}, not resistances")
        return self.recorded

    @classmethod
    @typed
    def load(cls, path: str | Path, part: slice = hdf5.ALL) -> "Recording":
        """Return the recording of a file, finished or not.

        `part` selects frames of a finished file. Raises InputError with the path of an invalid dataset.
        """
        path = Path(path)
        with recording_file(path) as (file, scene, _, _):
            places = {field: f"/entry/{path}" for field, (path, *_) in stored_fields(scene.circuit).items()}
            places = {field: place for field, place in places.items() if hdf5.has(file, place)}
            chosen = part
            if part == hdf5.ALL:
                chosen = undamaged_frames(file, scene)
                _check_held(file, places)
            held = dict[str, Any]()
            dimensions: dict[str, int | tuple[int, int]] = {"time": 1, "role": 1, "sigma": (2, 3)}
            for field, place in places.items():
                flat = field == "sigma" and len(hdf5.shape_of(file, place)) == 2
                kind = np.uint16 if field == "raw_sums" else None
                rows = hdf5.ALL if flat else chosen
                held[field] = hdf5.read_array(file, place, dimensions.get(field, 3), part=rows, kind=kind)
            for field, name in (("start_time", "start_time"), ("simulation", "truth/simulation")):
                held[field] = hdf5.read_text(file, f"/entry/{name}") if hdf5.has(file, f"/entry/{name}") else None
            if "raw_sums" in held:
                held["raw_readings"] = int(hdf5.read_number(file, "/entry/raw", "readings", 0))
            frames = len(held["recorded"])
            acquisition = Acquisition.read(file, chosen)
            if acquisition is not None and held["start_time"] is None and frames and "time" in held:
                held["start_time"] = acquisition.start(float(held["time"][0]))
            number = (chosen.start or 0) + np.arange(frames)
            held = {"time": number.astype(float), "role": np.full(frames, MEASURED, dtype=np.uint8)} | held
            numbers = None if part == hdf5.ALL else number
            return cls(scene, name=path.stem, acquisition=acquisition, number=numbers, **held)

    @classmethod
    @typed
    def from_array(
        cls,
        values: Array,
        unit: str = "ohm",
        baseline: int = 0,
        scene: Scene | str | Path | None = None,
        time: Array | None = None,
    ) -> "Recording":
        """Return the recording of an array of readings.

        Parameters
        ----------
        values : array_like, shape (frames, rows, columns)
            Readings; NaN where missing. Voltages and codes at a rail of the converter, and resistances of zero or
            infinity, are bounds.
        unit : str
            'ohm', 'kohm', 'volt', 'mV' or 'code'.
        baseline : int
            Number of frames at the beginning in which nothing loads the panel.
        scene : Scene, path of a scene's YAML file, or None
            None: a panel of this shape with a pitch of 10 mm, and resistances alone.
        time : array_like, shape (frames,), or None
            Times of the frames in s; None: a frame a second.

        Raises
        ------
        InputError
            If shapes disagree, or a value is impossible in this unit and scene.

        >>> import numpy as np
        >>> lampest.Recording.from_array(np.full((4, 2, 3), 0.5), unit="kohm", baseline=2)
        Recording(recording: 4 frames (2 unloaded) of 2 × 3 cells, 0 to 3 s)
        """
        array = values.astype(float)
        known = read_scene(scene) if isinstance(scene, str | Path) else scene
        requested = ("rows", "columns") if known is None else known.panel.shape
        if array.ndim != 3 or array.size == 0 or (known is not None and array.shape[1:] != requested):
            shapes = f"(frames, {requested[0]}, {requested[1]}) with at least one frame, not {array.shape}"
            raise InputError(f"values must have the shape {shapes}")
        if not 0 <= baseline <= len(array):
            raise InputError(f"baseline must be a number of frames from 0 to {len(array)}, not {baseline}")
        check_unit(unit, known, "values")
        known = known or Scene(Panel(*array.shape[1:]))
        recorded = recorded_values(array, unit, known, lambda *at: f"values[{', '.join(map(str, at))}]", "values")
        role = np.where(np.arange(len(array)) < baseline, UNLOADED, MEASURED).astype(np.uint8)
        seconds = np.arange(len(array), dtype=float) if time is None else time.astype(float)
        return cls(known, recorded, seconds, role)

    @classmethod
    def from_dataframe(
        cls,
        table: Any,
        unit: str | None = None,
        baseline: int = 0,
        scene: Scene | str | Path | None = None,
        rows: int | None = None,
        columns: int | None = None,
    ) -> "Recording":
        """Return the recording of a pandas.DataFrame, or of another table with `columns` and `itertuples`.

        The names of its columns are understood as those of a file's header (docs/howto/import.md): a line for each
        frame, each row of a frame, or each value. An index with a name, or of dates, is a column, too.

        Parameters
        ----------
        table : DataFrame
        unit : str or None
            As for `import_file`.
        baseline : int
            Number of frames at the beginning in which nothing loads the panel.
        scene : Scene, path of a scene's YAML file, or None
        rows, columns : int or None
            Size of the panel; None: the scene's.

        Raises
        ------
        InputError
            If the table does not fit the panel, with the line and the column.

        >>> import pandas as pd
        >>> table = pd.DataFrame({"time_s": [0.0, 0.5], "r0c0": [510.2, 505.1], "r0c1": [480.4, 250.3]})
        >>> lampest.Recording.from_dataframe(table, rows=1, columns=2)
        Recording(recording: 2 frames (0 unloaded) of 1 × 2 cells, 0 to 0.5 s)
        """
        known = read_scene(scene) if isinstance(scene, str | Path) else scene
        panel = panel_of(rows, columns, known)
        check_unit(unit, known, "table")
        frames = frames_of_table(table, panel.shape)
        values = np.where(panel.present, frames.values, np.nan)
        named = unit or understood_unit(values, named_units(frames, "table"), known, "table")[0]
        clock = None if frames.timing is None else frames.timing(None)
        made = cls.from_array(values, named, baseline, known or Scene(panel), None if clock is None else clock.seconds)
        return made if clock is None else replace(made, start_time=clock.start)

    @classmethod
    def from_xarray(
        cls,
        data: Any,
        unit: str | None = None,
        baseline: int = 0,
        scene: Scene | str | Path | None = None,
    ) -> "Recording":
        """Return the recording of an xarray.DataArray over time, row and column, in any order.

        Parameters
        ----------
        data : DataArray
            Dimensions are recognised by their names: time (or frame), row (or y), column (or x). Coordinates of the
            time in s, or dates, are the times of the frames.
        unit : str or None
            None: its attribute `units`, otherwise ohm.
        baseline, scene
            As for `from_array`.

        Raises
        ------
        InputError
            If dimensions are not recognised, or a value is impossible in this unit and scene.

        >>> import xarray
        >>> data = xarray.DataArray(np.full((2, 3, 4), 500.0), dims=("row", "column", "time"), attrs={"units": "ohm"})
        >>> lampest.Recording.from_xarray(data, baseline=1)
        Recording(recording: 4 frames (1 unloaded) of 2 × 3 cells, 0 to 3 s)
        """
        values, seconds, named = labelled_array(data)
        return cls.from_array(values, unit or named or "ohm", baseline, scene, seconds)

    def plot(
        self,
        frame: int | None = None,
        *,
        ax: Any = None,
        figsize: tuple[float, float] | None = None,
        vmin: float | None = None,
        vmax: float | None = None,
    ) -> Any:
        """Return a Matplotlib figure with a map of a frame's readings, against the unloaded ones where there are some.

        Parameters
        ----------
        frame : int, optional
            By default that of the strongest change, or the first.
        ax, figsize, vmin, vmax
            As for `Reconstruction.plot`.

        Raises
        ------
        InputError
            If there is no such frame.
        """
        with extra():
            from lampest.report.plots import recording_picture  # loaded where a picture is asked for

        return recording_picture(self, frame, ax, figsize, vmin, vmax)

    def save(self, path: str | Path) -> None:
        """Write the recording, completely or not at all. Raises InputError if the file cannot be written."""
        with hdf5.new_file(Path(path)) as file:
            self._write(file)

    def _write(self, file: h5py.File) -> None:
        hdf5.set_attributes(file, NX_class="NXroot", default="entry", lampest_format=FORMAT)
        entry = file.create_group("entry")
        hdf5.set_attributes(entry, NX_class="NXentry", default=group_of(self.scene.circuit))
        hdf5.write_text(entry, "scene", scene_text(self.scene))
        if self.start_time is not None:
            hdf5.write_text(entry, "start_time", self.start_time)  # NeXus has it under this name
        axes = {1: ("time",), 2: ("row", "column"), 3: ("time", "row", "column")}
        flags = {"flag_values": np.array(ROLES, dtype=np.uint8), "flag_meanings": "unloaded measured"}
        for field, (path, kind, units, long_name) in stored_fields(self.scene.circuit).items():
            name, signal = path.split("/")
            values = None if field == "raw_sums" and self.raw_readings is None else getattr(self, field)
            if values is None or field == "time":  # each group has a time of its own
                continue
            group = entry[name] if name in entry else self._frames_group(entry, name, signal)
            meanings: dict[str, Any] = flags if field == "role" else {}
            hdf5.write_dataset(group, signal, values.astype(kind), units, long_name, axes[values.ndim], **meanings)
        if "raw" in entry:
            hdf5.set_attributes(entry["raw"], readings=np.uint16(self.raw_readings or 0))
        if self.truth_cell_resistance is not None and self.simulation is not None:
            hdf5.write_text(entry["truth"], "simulation", self.simulation)
        if self.acquisition is not None:
            self.acquisition.write(entry, self.time)

    def _frames_group(self, entry: h5py.Group, name: str, signal: str) -> h5py.Group:
        group = entry.create_group(name)
        hdf5.set_attributes(group, NX_class="NXdata", signal=signal, axes=["time", "row", "column"])
        hdf5.write_scale(group, "time", self.time, "s", "time of the frame")
        for name, (axes, values, units, long_name) in coordinates(self.scene.panel).items():
            if (name,) == axes:
                hdf5.write_scale(group, name, values, units, long_name)
            else:
                hdf5.write_dataset(group, name, values, units, long_name, axes)
        return group

    @cached_property
    def modules(self) -> tuple["Recording", ...]:
        """Recordings of the single modules; the recording itself without modules."""
        layout = self.scene.panel.modules
        if layout is None:
            return (self,)
        names = set(stored_fields(self.scene.circuit)) - {"time", "role"}
        maps = {name: values for name in names if (values := getattr(self, name)) is not None}
        cells = [(..., *layout.cells(number)) for number in range(layout.count)]
        return tuple(
            replace(self, scene=scene, of_module=True, **{name: column[inside] for name, column in maps.items()})
            for inside, scene in zip(cells, self.scene.of_modules, strict=True)
        )

    def readings(self) -> Readings:
        """Return the readings of the frames, for an estimator."""
        return Readings.of(self.scene, self.recorded, self.sigma)

    def measured_frames(self) -> NDArray[np.intp]:
        """Return the indices of the frames with role 1. Raises InputError if there is none."""
        frames = np.flatnonzero(self.role == MEASURED)
        if len(frames) == 0:
            raise InputError(f"{self.name}: {self._group}/role has no measured frame (role 1)")
        return frames


@contextmanager
def recording_file(path: Path) -> Iterator[tuple[h5py.File, Scene, str, str]]:
    """Yield an open recording file, its scene, the group of its frames and their signal.

    Raises InputError if the file is no recording, or has no valid scene.
    """
    if path.suffix.lower() in FOREIGN:
        raise InputError(f"{path}: is no recording; lampest.import_file (lampest import) makes one of it")
    with hdf5.existing_file(path) as file:
        if str(hdf5.read_attribute(file, "/", "lampest_format")).startswith("results/"):
            raise InputError(f"{path}: holds results; lampest.read_results reads them")
        scene = _scene_of(hdf5.read_text(file, "/entry/scene"), f"{path}:/entry/scene")
        group = f"/entry/{group_of(scene.circuit)}"
        signal = scene.circuit.signal
        if len(hdf5.shape_of(file, f"{group}/{signal}")) != 3:
            raise InputError(f"{path}: {group}/{signal} must be frames × rows × columns")
        yield file, scene, group, signal


@lru_cache(maxsize=8)  # a recording that is too long for memory is opened again for every part
def _scene_of(text: str, where: str) -> Scene:
    document = parse_document(text, where)
    errors = document.content.get("systematic") if isinstance(document.content, dict) else None
    if isinstance(errors, dict) and FORMER_SERIES in errors:
        renamed = {SERIES.setting if key == FORMER_SERIES else key: value for key, value in errors.items()}
        document = document.with_value(("systematic",), renamed)
    scene: Scene = validated(document, Scene)
    return scene


def _check_held(file: h5py.File, places: Mapping[str, str]) -> None:
    """Raise InputError if memory does not suffice for a recording and the working copies of its readings."""
    shape = hdf5.shape_of(file, places["recorded"])
    besides = set(places) - {"recorded", "time", "role", "raw_sums"}
    held = sum(prod(hdf5.shape_of(file, places[field])) for field in besides)
    label = f"{file.filename}: {shape[0]} frames of {prod(shape[1:])} cells at once"
    check_memory(8.0 * (6 * prod(shape) + held), label)  # 49 bytes a reading were counted at 100,000,000 readings


def coordinates(panel: Panel) -> dict[str, tuple[tuple[str, ...], NDArray[Any], str, str]]:
    """Return (axes, values, unit, long name) of the coordinates row, column, y and x, by name.

    y depends on the row and x on the column. For listed cells both depend on the cell, with NaN without a cell.
    """
    lines = zip(("row", "column"), map(np.arange, panel.shape), strict=True)
    axes = {line: ((line,), number, "1", f"{line} line") for line, number in lines}
    if panel.cells is not None:
        places = zip("xy", panel.places_mm, strict=True)
        return axes | {name: (("row", "column"), at, "mm", "position of the cell") for name, at in places}
    x, y = panel.centres_mm()
    centres = (("y", "row", y), ("x", "column", x))
    return axes | {name: ((line,), at, "mm", f"position of the {line}") for name, line, at in centres}


def frames_named(text: str, frames: int | None = None) -> range:
    """Return the range of frames for a text such as '40:50', frames 40 to 49; either side may be omitted.

    `frames` is the number of frames of the recording, if it is known. Raises InputError for an invalid or empty range.
    """
    match = re.fullmatch(r"\s*(\d{0,9})\s*:\s*(\d{0,9})\s*", text)
    if match is None:
        raise InputError(f"--frames must be FIRST:END such as 40:50, which is 40 to 49, not {text!r}")
    named = range(int(match[1] or 0), int(match[2] or frames or sys.maxsize))
    if frames is not None and not named.start < named.stop <= frames:
        raise InputError(f"--frames {text}: the recording has frames 0 to {frames - 1}, and some must be named")
    return named


def tared(recording: Recording, frames: range) -> tuple[Recording, float]:
    """Return the recording with given frames as the only unloaded ones, and the change of readings within them.

    The change is the largest relative change of a reading from the first half of the frames to the second half; 0 for a
    single frame. Raises InputError if no measured frame would remain.
    """
    if len(frames) == len(recording.role):
        raise InputError(f"{recording.name}: where all frames are unloaded, none is left to measure")
    role = np.full(len(recording.role), MEASURED, dtype=np.uint8)
    role[frames.start : frames.stop] = UNLOADED
    shown = recording.readings()[frames.start : frames.stop].shown
    half = len(shown) // 2
    change = 0.0
    if half:
        known = np.isfinite(shown).all(axis=0)
        before = shown[:half, known].mean(axis=0)
        after = shown[half:, known].mean(axis=0)
        change = float(np.abs(after / before - 1).max(initial=0.0))
    return replace(recording, role=role), change


@dataclass(frozen=True, eq=False)
class StoredRecording:
    """Recording file that is read in parts.

    Attributes
    ----------
    path : Path
    scene : Scene
    frames : int
        Number of frames.
    start_time : str or None
        See `Recording`.
    """

    path: Path
    scene: Scene
    frames: int
    start_time: str | None

    @classmethod
    def of(cls, path: Path) -> "StoredRecording":
        """Return the stored recording of a file. Raises InputError if it is no recording, or its datasets disagree."""
        with recording_file(path) as (file, scene, group, signal):
            shape = hdf5.shape_of(file, f"{group}/{signal}")
            if not shape[0]:
                raise InputError(f"{path}: {group}/{signal} holds no frame")
            end = undamaged_frames(file, scene).stop
            for axis in (f"{group}/time", f"{group}/role") if end is None else ():
                if hdf5.has(file, axis) and hdf5.shape_of(file, axis) != shape[:1]:
                    raise InputError(f"{path}: {axis} does not have one value for each of the {shape[0]} frames")
        return cls(path, scene, shape[0] if end is None else end, Recording.load(path, slice(0, 1)).start_time)

    @property
    def name(self) -> str:
        """Name of the recording in results."""
        return self.path.stem

    @property
    def length(self) -> int:
        """Number of frames of a part."""
        return max(16, PART_READINGS // self.scene.panel.crossings)

    @cached_property
    def role(self) -> NDArray[Any]:
        """Roles of the frames; measured where the file has none."""
        with hdf5.existing_file(self.path) as file:
            path = f"/entry/{group_of(self.scene.circuit)}/role"
            known = hdf5.has(file, path)
            return hdf5.read_array(file, path, 1, part=slice(0, self.frames)) if known else np.ones(self.frames)

    @cached_property
    def blocks(self) -> tuple[range, ...]:
        """Ranges of frames that are estimated and written part by part.

        If possible, a part ends with a chunk of the measured frames in results.
        """
        chunk = max(1, hdf5.CHUNK // self.scene.panel.crossings)
        ends = [0]
        measured = self.role == MEASURED
        full = measured & (np.cumsum(measured) % chunk == 0)
        while ends[-1] < self.frames:
            end = min(ends[-1] + self.length, self.frames)
            last = np.flatnonzero(full[ends[-1] : end])
            ends.append(ends[-1] + int(last[-1]) + 1 if len(last) and end < self.frames else end)
        return tuple(range(first, end) for first, end in pairwise(ends))

    @property
    def measured_blocks(self) -> tuple[int, ...]:
        """Numbers of the blocks with measured frames."""
        return tuple(n for n, part in enumerate(self.blocks) if np.any(self.role[part.start : part.stop] == MEASURED))

    def part(self, frames: range, beside: int = 0) -> Recording:
        """Return a range of frames with up to `beside` further ones on either side. Raises as `Recording.load`."""
        within = slice(max(frames.start - beside, 0), min(frames.stop + beside, self.frames))
        return replace(Recording.load(self.path, within), start_time=self.start_time)


def joined(parts: Sequence[Recording], chosen: NDArray[Any] | None = None) -> Recording:
    """Return the frames of concatenated parts, without acquisition data and raw sums.

    `chosen` are their indices or a mask; None: each numbered frame of overlapping parts once.
    """
    first = parts[0]
    names = ["recorded", "time", "role", "number", "board_log_change", "truth_cell_resistance", "truth_pressure"]
    names += ["sigma"] if first.sigma is not None and first.sigma.ndim == 3 else []
    present = [name for name in names if getattr(first, name) is not None]
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in present}
    frames = np.unique(columns["number"], return_index=True)[1] if chosen is None else chosen
    chosen_of_each = {name: values[frames] for name, values in columns.items()}
    return replace(first, **chosen_of_each, raw_sums=None, raw_readings=None, acquisition=None)


def first_unloaded(stored: StoredRecording, most: int) -> Recording | None:
    """Return at most `most` unloaded frames from the beginning of a recording; None if there is none."""
    numbers = np.flatnonzero(stored.role == UNLOADED)[:most]
    parts = (stored.part(frames) for frames in stored.blocks if np.isin(numbers, frames).any())
    chosen = [joined((part,), np.isin(part.number, numbers)) for part in parts if part.number is not None]
    return joined(chosen) if chosen else None


def measured_part(stored: StoredRecording, frames: range, beside: int) -> Recording | None:
    """Return the measured frames of a range, and of `beside` frames on either side; None if the range has none."""
    part = stored.part(frames, beside)
    assert part.number is not None
    measured = part.role == MEASURED
    inside = (part.number >= frames.start) & (part.number < frames.stop)
    return joined((part,), measured) if np.any(measured & inside) else None


def save_parts(path: Path, parts: Iterable[Recording]) -> None:
    """Write a recording from its parts, completely or not at all.

    Until all parts exist they are files in a temporary folder next to it. Raises InputError if it cannot be written.
    """
    files: list[Path] = []
    with folder_beside(path) as folder:
        for number, part in enumerate(parts):
            files.append(folder / f"{number}.h5")
            part.save(files[-1])
        with hdf5.new_large_file(path, sum(file.stat().st_size for file in files)) as file:
            join_parts(files, file.create_group("entry"), "/entry")
            with hdf5.existing_file(files[0]) as first:
                file.attrs.update(first.attrs)


def too_long(frames: int, cells: int) -> bool:
    """Return whether a recording of this many frames and cells is too large for memory."""
    return frames * cells > MAX_READINGS


def opened(path: Path) -> Recording | StoredRecording:
    """Return the recording of a file, as parts if it is too long for memory. Raises InputError as `Recording.load`."""
    with recording_file(path) as (file, _, group, signal):
        readings = prod(hdf5.shape_of(file, f"{group}/{signal}"))
    return StoredRecording.of(path) if readings > MAX_READINGS else Recording.load(path)
