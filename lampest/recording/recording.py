"""Recordings: frames of readings with their scene and, if simulated, their truth, in memory."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.files.applications import applications
from lampest.files.errors import InputError, extra
from lampest.files.typed import Validated, typed
from lampest.panel.panel import Array, Numbers, Panel, as_panels_have
from lampest.panel.scene import Scene
from lampest.recording.acquisition import Acquisition, group_of, stored_fields
from lampest.recording.file import read_frames, recording_file, write_frames
from lampest.recording.readings import Readings, check_sigma, mean_change, strongest_frame

UNLOADED = 0
MEASURED = 1
ROLES = (UNLOADED, MEASURED)
UNREFERENCED = (
    "no frame is unloaded (role 0), so changes and pressures are against the first measured frame"
)
TOUCHED = "something touched the panel while its unloaded frames were taken"
UNEVENLY = (
    "a load may lie on the panel in the unloaded frames: its cells are uneven in the shape of one"
)
# Least relative change of readings or cells by a load or a common error, far above drift.
MIN_CHANGE = 0.01
AnyScene = Scene | str | Path | None  # a scene, its file, or none
MAX_NEIGHBOURS = 2  # frames or networks that decide with the strongest one


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Validated):
    """Frames of one panel in temporal order.

    Parameters
    ----------
    scene : Scene
        Scene that the estimator gets.
    recorded : array, shape (frames, rows, columns)
        In ohm for two-point readouts, including series resistance; otherwise in volt at the
        converter. NaN if missing; for bounds see `Readings.of`.
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

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
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
    number: Numbers | None = None
    of_module: bool = False
    board_log_change: Array | None = None

    def __post_init__(self) -> None:
        shape = self.scene.panel.shape
        frames = len(self.recorded) if self.recorded.ndim else 0
        if self.recorded.shape[1:] != shape or frames == 0:
            actual = " × ".join(str(size) for size in self.recorded.shape)
            raise InputError(
                f"{self.name}: {self.path} is {actual}, but the scene's panel asks for "
                f"frames × {shape[0]} × {shape[1]} with at least one frame"
            )
        where = f"{self.name}: {self._group}/"
        check_sigma(self.scene, self.recorded, self.sigma, where)
        # No value refuses a recording.
        object.__setattr__(self, "recorded", as_panels_have(self.recorded))
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
        super().__post_init__()

    def __repr__(self) -> str:
        """Return a description in one line: '24 frames (3 unloaded) of 10 × 10 cells'."""
        unloaded = int(np.sum(self.role == UNLOADED))
        rows, columns = self.scene.panel.shape
        frames = f"{len(self.role)} frames ({unloaded} unloaded)"
        span = f"{self.time.min():g} to {self.time.max():g} s"
        return f"Recording({self.name}: {frames} of {rows} × {columns} cells, {span})"

    def _check_unit(self) -> None:
        """Raise InputError if the values are probably in kohm.

        Values without raw sums are in kohm if all are below the series resistance.
        """
        circuit = self.scene.circuit
        valid = self.recorded[np.isfinite(self.recorded) & (self.recorded > 0)]
        if not circuit.two_point or self.raw_sums is not None or self.of_module or not valid.size:
            return
        series = float(np.min(self.scene.series_ohm))
        code = circuit.code_from_volt(circuit.volt_from_recorded(np.array(1000 * np.median(valid))))
        largest = valid.max()
        stuck = valid.min() == largest  # at the converter's rail: a module without contact
        if not stuck and largest < series and 8 <= code < 2**circuit.adc_bits - 8:
            raise InputError(
                f"{self.name}: {self.path} is at most {largest:.4g} ohm, "
                f"less than the {series:.4g} ohm in series; are these kohm?"
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
            raise InputError(
                f"{self.name}: its readout gives {self.scene.circuit.unit}, not resistances"
            )
        return self.recorded

    @classmethod
    @typed
    def load(cls, path: str | Path, part: slice = hdf5.ALL) -> "Recording":
        """Return the recording of a file, finished or not.

        `part` selects frames of a finished file. Raises InputError with the path of an invalid
        dataset.
        """
        path = Path(path)
        with recording_file(path) as (file, scene, _):
            fields = read_frames(file, scene, part)
            fields.setdefault("role", np.full(len(fields["recorded"]), MEASURED, dtype=np.uint8))
            return cls(scene, name=path.stem, **fields)

    @classmethod
    @typed
    def from_array(
        cls,
        values: Array,
        unit: str = "ohm",
        baseline: int = 0,
        scene: AnyScene = None,
        time: Array | None = None,
    ) -> "Recording":
        """Return the recording of an array of readings.

        Parameters
        ----------
        values : array_like, shape (frames, rows, columns)
            Readings; NaN where missing. Voltages and codes at a rail of the converter, and
            resistances of zero or infinity, are bounds.
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
        known = _scene_of(scene)
        rows, columns = ("rows", "columns") if known is None else known.panel.shape
        fits = known is None or array.shape[1:] == known.panel.shape
        if array.ndim != 3 or array.size == 0 or not fits:
            raise InputError(
                f"values must have the shape (frames, {rows}, {columns}) "
                f"with at least one frame, not {array.shape}"
            )
        if not 0 <= baseline <= len(array):
            raise InputError(
                f"baseline must be a number of frames from 0 to {len(array)}, not {baseline}"
            )
        from lampest.recording.unit import check_unit, recorded_values  # not for files

        check_unit(unit, known, "values")
        known = known or Scene(Panel(*array.shape[1:]))
        recorded = recorded_values(
            array, unit, known, lambda *at: f"values[{', '.join(map(str, at))}]", "values"
        )
        role = np.where(np.arange(len(array)) < baseline, UNLOADED, MEASURED).astype(np.uint8)
        seconds = np.arange(len(array), dtype=float) if time is None else time.astype(float)
        return cls(known, recorded, seconds, role)

    @classmethod
    def from_dataframe(
        cls,
        table: Any,
        unit: str | None = None,
        baseline: int = 0,
        scene: AnyScene = None,
        rows: int | None = None,
        columns: int | None = None,
    ) -> "Recording":
        """Return the recording of a pandas.DataFrame, or of another table.

        The other table has `columns` and `itertuples`. The names of its columns are understood as
        those of a file's header (docs/apps/foreign/import.md): a line for each frame, each row of a
        frame, or each value. An index with a name, or of dates, is a column, too.

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
        >>> cells = {"r0c0": [510.2, 505.1], "r0c1": [480.4, 250.3]}
        >>> table = pd.DataFrame({"time_s": [0.0, 0.5], **cells})
        >>> lampest.Recording.from_dataframe(table, rows=1, columns=2)
        Recording(recording: 2 frames (0 unloaded) of 1 × 2 cells, 0 to 0.5 s)
        """
        known = _scene_of(scene)
        understood = applications().required("foreign", "a table", "from_dataframe")
        values, named, panel, clock = understood(table, unit, known, rows, columns)
        seconds = None if clock is None else clock.seconds
        made = cls.from_array(values, named, baseline, known or Scene(panel), seconds)
        return made if clock is None else replace(made, start_time=clock.start)

    @classmethod
    def from_xarray(
        cls,
        data: Any,
        unit: str | None = None,
        baseline: int = 0,
        scene: AnyScene = None,
    ) -> "Recording":
        """Return the recording of an xarray.DataArray over time, row and column, in any order.

        Parameters
        ----------
        data : DataArray
            Dimensions are recognised by their names: time (or frame), row (or y), column (or x).
            Coordinates of the time in s, or dates, are the times of the frames.
        unit : str or None
            None: its attribute `units`, otherwise ohm.
        baseline, scene
            As for `from_array`.

        Raises
        ------
        InputError
            If dimensions are not recognised, or a value is impossible in this unit and scene.

        >>> import numpy as np
        >>> import xarray
        >>> values = np.full((2, 3, 4), 500.0)
        >>> axes = ("row", "column", "time")
        >>> data = xarray.DataArray(values, dims=axes, attrs={"units": "ohm"})
        >>> lampest.Recording.from_xarray(data, baseline=1)
        Recording(recording: 4 frames (1 unloaded) of 2 × 3 cells, 0 to 3 s)
        """
        understood = applications().required("foreign", "a labelled array", "from_xarray")
        values, seconds, named = understood(data)
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
        """Return a Matplotlib figure with a map of a frame's readings.

        If the recording has unloaded frames, the map shows the change against them.

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
            # Loaded where a picture is asked for.
            from lampest.report.plots import recording_picture

        return recording_picture(self, frame, ax, figsize, vmin, vmax)

    def save(self, path: str | Path) -> None:
        """Write the recording, completely or not at all.

        Raises InputError if the file cannot be written.
        """
        with hdf5.new_file(Path(path)) as file:
            write_frames(file, self.scene, vars(self))

    @cached_property
    def modules(self) -> tuple["Recording", ...]:
        """Recordings of the single modules; the recording itself without modules."""
        layout = self.scene.panel.modules
        if layout is None:
            return (self,)
        names = set(stored_fields(self.scene.circuit)) - {"time", "role"}
        maps = {name: values for name in names if (values := getattr(self, name)) is not None}
        return tuple(
            replace(
                self,
                scene=scene,
                of_module=True,
                **{name: values[(..., *layout.cells(number))] for name, values in maps.items()},
            )
            for number, scene in enumerate(self.scene.of_modules)
        )

    def readings(self) -> Readings:
        """Return the readings of the frames, for an estimator."""
        return Readings.of(self.scene, self.recorded, self.sigma)

    def measured_frames(self) -> Numbers:
        """Return the indices of the frames with role 1. Raises InputError if there is none."""
        frames = np.flatnonzero(self.role == MEASURED)
        if len(frames) == 0:
            raise InputError(f"{self.name}: {self._group}/role has no measured frame (role 1)")
        return frames


def baseline_readings(recording: Recording, readings: Readings) -> Readings:
    """Return the mean of the unloaded frames.

    Without any, or where too little of them was read, the first frame of which enough was read.
    """
    unloaded = np.flatnonzero(recording.role == UNLOADED)
    mean = readings[unloaded if len(unloaded) else [0]].mean()
    usable = np.flatnonzero(readings.enough(recording.scene))
    return mean if mean.enough(recording.scene) or not len(usable) else readings[usable[:1]].mean()


def deciding_frames(recording: Recording, readings: Readings, resting: Readings) -> Numbers:
    """Return the measured frame that differs most from rest, and frames that decide with it.

    The further frames are spread evenly over those that differ half as far from rest. Frames
    without enough readings are left out.
    """
    frames = recording.measured_frames()
    frames = frames[readings.enough(recording.scene)[frames]]
    if not len(frames):
        return frames
    change = mean_change(readings.plain_values, resting.value)
    strongest = strongest_frame(readings.plain_values, resting.value, frames)
    loaded = frames[(change[frames] >= change[strongest] / 2) & (frames != strongest)]
    spread = np.linspace(0, len(loaded) - 1, MAX_NEIGHBOURS if len(loaded) else 0)
    return np.append(strongest, loaded[np.unique(spread.round().astype(int))])


def _scene_of(scene: AnyScene) -> Scene | None:
    """Return a scene, read from its file where a path is given."""
    if not isinstance(scene, str | Path):
        return scene
    from lampest.panel.scene import read_scene  # for a file alone

    return read_scene(scene)
