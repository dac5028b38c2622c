"""One case's result: what an estimator made of a recording, with everything that a results file says about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError, extra
from lampest.files.typed import Validated
from lampest.panel.panel import Array, beyond_any_panel
from lampest.panel.scene import Scene, scene_text
from lampest.recording.recording import coordinates
from lampest.runs.columns import COLUMNS, FIGURES, FRAME, FRAMES, MAPS, MEASURED, TIME, Column, all_columns
from lampest.runs.columns.column import flag_attributes

if TYPE_CHECKING:
    from pandas import DataFrame as DataFrame
    from xarray import Dataset as Dataset

SHARED = "recording"  # the group beside the estimators that holds what they were given
# Attribute of a case's group in a file → what a case calls this sentence; not there where it is empty.
SENTENCES = {
    "model_check": "model_sentence",
    "model_explains": "model_mark",
    "noise_check": "noise_sentence",
    "noise_learned": "noise_learned",
    "film": "film_sentence",
    "warnings": "warnings",
}


@dataclass(frozen=True, eq=False)
class CaseResult(Validated):
    """One case: a recording's measured frames as one estimator understands them.

    recording, estimator : the recording's stem and the estimator's name, printable ASCII without '/'.
    case_id, case_yaml : hash and YAML text of the resolved case. versions : library → version.
    scene : the recording's, as given to the estimator.
    costs, weights, disc, contacts, misfit : name → (frames), see `lampest.runs.columns.FIGURES`; with `_errors` behind
        a name its standard deviation.
    baseline_status, baseline_solve_time : how the baseline's solve ended, and its time in s (NaN: not solved apart).
    joint_start : whether the first frame was solved together with the baseline.
    model_mark, model_sentence : whether the circuit explains the recording ('yes', 'no', 'noise', 'not checked'; empty
        where an older file does not say), and the sentence that says so.
    noise_sentence, noise_learned, film_sentence : what frames say against the scene's noise, what was learned from
        them, what the scene leaves open of the film; ''.
    warnings : what speaks against the case, lines of a text.
    reading_error : standard deviation of the logarithm of a factor on each reading, learned from still cells; 0: none.
    frame_noise : what the readings of a frame share by chance; empty: nothing.
    start_time : date and time at 0 s, ISO 8601, with its zone where that is known; '' where it is not.
    the other arrays : as the columns of their names say; None where nobody asked. NaN where a frame failed.
    extra : name → values of the columns that installed packages or scripts add.

    Raises InputError where a name is unfit, shapes disagree, or a value is impossible.

    >>> found.result().estimator
    'misfit'
    """

    recording: str
    estimator: str
    case_id: str
    case_yaml: str
    versions: dict[str, str]
    scene: Scene
    frame: NDArray[np.int64]
    time: Array
    measured: Array
    measured_baseline: Array
    cell_resistance: Array
    relative_change: Array
    reading_model: Array
    open_cell: NDArray[np.uint8]
    at_lower_bound: NDArray[np.uint8]
    baseline_resistance: Array
    status: tuple[str, ...]
    iterations: NDArray[np.int64]
    solve_time: Array
    objective: Array
    kkt_residual: Array
    costs: dict[str, Array]
    weights: dict[str, Array]
    baseline_status: str
    baseline_solve_time: float
    joint_start: bool
    solved: NDArray[np.bool_]
    truth: Array | None = None
    truth_baseline: Array | None = None
    disc: dict[str, Array] = field(default_factory=dict)
    contacts: dict[str, Array] = field(default_factory=dict)
    misfit: dict[str, Array] = field(default_factory=dict)
    model_mark: str = ""
    model_sentence: str = ""
    noise_sentence: str = ""
    noise_learned: str = ""
    warnings: str = ""
    reading_error: float = 0.0
    frame_noise: dict[str, Array] = field(default_factory=dict)
    film_sentence: str = ""
    start_time: str = ""
    sigma: Array | None = None
    sigma_baseline: Array | None = None
    reading_side: NDArray[np.int8] | None = None
    missing_readings: NDArray[np.int64] | None = None
    starts: NDArray[np.int64] | None = None
    bound_readings: NDArray[np.int64] | None = None
    cell_resistance_errors: Array | None = None
    cell_resistance_lower: Array | None = None
    cell_resistance_upper: Array | None = None
    relative_change_errors: Array | None = None
    relative_change_lower: Array | None = None
    relative_change_upper: Array | None = None
    sigma_own: Array | None = None
    sigma_common: Array | None = None
    resolution: Array | None = None
    data_share: Array | None = None
    baseline_resistance_errors: Array | None = None
    error_bar_time: Array | None = None
    pressure: Array | None = None
    pressure_errors: Array | None = None
    pressure_lower: Array | None = None
    pressure_upper: Array | None = None
    saturated: NDArray[np.uint8] | None = None
    tared: tuple[str, ...] | None = None
    extra: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_name(self.recording, "recording")
        check_name(self.estimator, "estimator")
        if self.estimator == SHARED:
            raise InputError(f"an estimator cannot be called '{SHARED}': results keep the measurement under that name")
        if self.measured.ndim != 3 or self.measured.size == 0:
            raise InputError(f"{self._path(MEASURED)} must be frames × rows × columns with at least one frame")
        if self.measured.shape[1:] != self.scene.panel.shape:
            rows, columns = self.scene.panel.shape
            raise InputError(f"{self._path(MEASURED)} does not have the {rows} × {columns} cells of the scene's panel")
        for folder in FIGURES:
            for name, values in getattr(self, folder.name).items():
                check_name(name, folder.folder)
                self._check_shape(f"/entry/{self.recording}/{self.estimator}/{folder.folder}/{name}", values, FRAMES)
        self.check(COLUMNS)

    @property
    def local_optima(self) -> tuple[int, int, int] | None:
        """How many frames end at a local optimum, and from how few and how many starts; None where unknown."""
        optima = np.array([status.startswith(("optimum", "an optimum,")) for status in self.status])
        if self.starts is None or not optima.any():
            return None
        return int(optima.sum()), int(self.starts[optima].min()), int(self.starts[optima].max())

    @property
    def error_words(self) -> str:
        """'each cell +- 0.4 %, all together +- 3 %': medians of both standard deviations; '' without them."""
        if self.sigma_own is None or self.sigma_common is None or not np.isfinite(self.sigma_own).any():
            return ""
        known = np.isfinite(self.sigma_own) & (self.sigma_own > 0)
        own, common = (100 * float(np.median(part[known])) for part in (self.sigma_own, self.sigma_common))
        return f"each cell +- {own:.2g} %, all together +- {common:.2g} %"

    @property
    def valued(self) -> NDArray[np.bool_]:
        """(frames, rows, columns) whether a reading is a value, neither a bound nor missing."""
        valued = np.isfinite(self.measured)
        valued &= True if self.sigma is None else np.isfinite(self.sigma)
        valued &= True if self.reading_side is None else self.reading_side == 0
        return np.asarray(valued)

    @classmethod
    def of(cls, values: Mapping[str, Any], **rest: Any) -> CaseResult:
        """From the values of columns, those without an attribute as `extra`, and the rest."""
        extra = {name: value for name, value in values.items() if name not in TYPED}
        return cls(**{name: value for name, value in values.items() if name in TYPED}, **rest, extra=extra)

    def column(self, name: str) -> Any:
        """The values of a column, or None where the case has none."""
        return getattr(self, name) if name in TYPED else self.extra.get(name)

    def shown(self, column: Column) -> Any:
        """The values of a column for others: a flag is NaN where a cell has no estimate."""
        values, missing = self.column(column.name), np.isnan(self.cell_resistance)
        if values is None or column.shared or column.axes != MAPS or not column.flags or not missing.any():
            return values
        return np.where(missing, np.nan, values)

    def to_xarray(self, columns: Sequence[Column] = ()) -> Dataset:
        """The case as an xarray.Dataset over time (s), row and column, with x and y in mm; units in every `attrs`.

        columns : of `extra`, as `read_results` takes them. Raises InputError where an extra has no column, or xarray is
        not installed.
        """
        return dataset_of(self, self.described(columns))

    def to_dataframe(self, columns: Sequence[Column] = ()) -> DataFrame:
        """The case as a long pandas.DataFrame: time, frame, row, column, and a column for each of the case's.

        One line for every cell of every frame; units in `attrs["units"]`. Raises InputError as `to_xarray`.
        """
        return table_of(self, self.described(columns))

    def described(self, columns: Sequence[Column] = ()) -> tuple[Column, ...]:
        """All columns: those of lampest, of installed packages, and further ones.

        Raises InputError where values do not fit them, or an extra is none of them.
        """
        table = all_columns(columns)
        self.check(table)
        for name in self.extra:
            if name not in {column.name for column in table}:
                raise InputError(f"{self.recording} × {self.estimator}: no column says what the extra '{name}' is")
        return table

    def check(self, columns: Sequence[Column]) -> None:
        """Raise InputError where the values of a column have another shape than its axes or are impossible."""
        values = {column: self.column(column.name) for column in columns}
        filled = {column: held for column, held in values.items() if column.name in REQUIRED or held is not None}
        for column, held in filled.items():
            self._check_shape(self._path(column), held, column.axes)
        for column, held in filled.items():
            if column.name in PHYSICAL and np.any(out := beyond_any_panel(held)):
                raise InputError(f"{self._path(column)} holds {np.asarray(held)[out][0]:.6g}, which no panel has")
            tested = self._by_module(held) if column.axes[-2:] == MAPS[-2:] else held
            solved = self._solved_modules if column.axes == MAPS else self.solved
            for fault in (check(tested, solved) for check in column.checks):
                if fault is not None:
                    raise InputError(f"{self._path(column)} {fault}")

    def _by_module(self, maps: Any) -> Any:
        """(frames, rows, columns) as (frames · modules, rows, columns) of each; listed cells in one row."""
        panel, maps = self.scene.panel, np.asarray(maps)
        if panel.cells is not None:
            return maps[..., panel.present][..., None, :]
        if panel.modules is None or maps.ndim < len(MAPS):
            return maps
        return panel.modules.split(maps).reshape(-1, *panel.networks[0].shape)

    @property
    def _solved_modules(self) -> NDArray[np.bool_]:
        """(frames · modules) whether each has an estimate, as its first cell says; none in a frame that failed."""
        layout = self.scene.panel.modules
        if layout is None:
            return self.solved
        known = np.isfinite(self._by_module(self.cell_resistance)[:, 0, 0])
        return np.asarray(known & np.repeat(self.solved, layout.count))

    def _path(self, column: Column) -> str:
        group = SHARED if column.shared else self.estimator
        return f"/entry/{self.recording}/{group}/{column.of(self.scene.circuit).path}"

    def _check_shape(self, path: str, values: Any, axes: tuple[str, ...]) -> None:
        sizes = dict(zip(MAPS, self.measured.shape, strict=True))
        shape = tuple(sizes[axis] for axis in axes)
        if np.shape(values) != shape:
            held, wanted = (" × ".join(map(str, sizes)) or "one value" for sizes in (np.shape(values), shape))
            raise InputError(f"{path} is {held}; the frames ask for {wanted}")


@dataclass(frozen=True)
class StoredCase:
    """A case in a file that holds it alone, or with others; too long a one is known by no more than this."""

    path: Path
    recording: str
    estimator: str
    case_id: str
    frames: int
    cells: int


PHYSICAL = (
    *("measured", "measured_baseline", "sigma", "sigma_baseline", "truth", "truth_baseline", "time"),
    *("cell_resistance", "baseline_resistance", "reading_model"),
)
# Columns that have an attribute of their own, and those of them that a case cannot be without.
TYPED = {item.name: item.default for item in fields(CaseResult) if item.name in {column.name for column in COLUMNS}}
REQUIRED = frozenset(name for name, default in TYPED.items() if default is MISSING)


def check_name(name: str, what: str) -> None:
    """Raise InputError unless `name` can name a group: printable ASCII without '/', not '.' or '..', trimmed."""
    fit = name.isascii() and name.isprintable() and "/" not in name and name == name.strip()
    if not fit or name in ("", ".", "..") or len(name) > 200:
        raise InputError(
            f"{name[:200]!r} cannot name a {what}: 1 to 200 printable ASCII characters without '/' "
            "or blanks at the ends are needed, other than '.' and '..'"
        )


@dataclass(frozen=True, eq=False)
class Series:
    """One thing that a case holds, as labelled arrays, tables and exports have it.

    axes : time, row, column. values : an array over them, or texts. flags : what each value means where values are no
    amounts. shared : True for what was measured.
    """

    name: str
    axes: tuple[str, ...]
    values: Any
    units: str
    long_name: str
    flags: tuple[tuple[int, str], ...] = ()
    shared: bool = False
    dtype: type[Any] = np.float64

    @property
    def stored(self) -> Any:
        """The values with 0 and 1 for truth values."""
        return np.asarray(self.values, np.uint8) if self.dtype is bool else self.values

    @property
    def meaning(self) -> str:
        """The long name, with what each value of a flag means."""
        flags = "; ".join(f"{value}: {word.replace('_', ' ')}" for value, word in self.flags)
        return f"{self.long_name} ({flags})" if flags else self.long_name

    @property
    def attributes(self) -> dict[str, Any]:
        """Units, long name and flags."""
        return {"units": self.units, "long_name": self.long_name} | flag_attributes(self.flags, self.dtype)


def series_of(case: CaseResult, columns: Sequence[Column]) -> dict[str, Series]:
    """Every column and figure that the case holds, by name, in its readout's unit; a cost is called cost_misfit."""
    held: dict[str, Series] = {}
    for column in (column.of(case.scene.circuit) for column in columns):
        if (values := case.shown(column)) is not None:
            about = column.units, column.long_name, column.flags, column.shared, column.dtype
            held[column.label] = Series(column.label, column.axes, values, *about)
    for folder in FIGURES:
        for figure, values in getattr(case, folder.name).items():
            name = f"{folder.folder}_{figure}"
            held[name] = Series(name, FRAMES, np.asarray(values), folder.units(figure), folder.long_name(figure))
    return held


def places_of(case: CaseResult) -> dict[str, Series]:
    """row and column, y and x in mm."""
    places = coordinates(case.scene.panel).items()
    return {name: Series(name, along, values, units, words) for name, (along, values, units, words) in places}


def dataset_of(case: CaseResult, columns: Sequence[Column]) -> Dataset:
    """Everything of a case over time, row and column, with units and long names as in results files.

    Coordinates: time (s) and frame, row and column with y and x (mm). Raises InputError where xarray is not installed.
    """
    with extra("xarray"):
        from xarray import Dataset
    held = series_of(case, columns)
    axes = {name: held.pop(name) for name in (TIME.name, FRAME.name)} | places_of(case)
    parts = [
        {name: (one.axes, np.asarray(one.values), one.attributes) for name, one in p.items()} for p in (held, axes)
    ]
    return Dataset(*parts, about(case))


def table_of(case: CaseResult, columns: Sequence[Column]) -> DataFrame:
    """One line for every cell of every frame: time, frame, row, column, y and x in mm, then all columns of the case.

    What only a frame or only a cell has stands in each of its lines. Units are in `attrs["units"]`, by column.
    """
    with extra("tables"):
        from pandas import DataFrame  # takes 0.3 s

    sizes = dict(zip(MAPS, case.measured.shape, strict=True))
    known, named = series_of(case, columns), {column.of(case.scene.circuit).label for column in columns}
    held = {name: known.pop(name) for name in (TIME.name, FRAME.name)} | places_of(case)
    held |= {name: one for name, one in known.items() if name in named}
    table = DataFrame({name: _lines(one.values, one.axes, sizes) for name, one in held.items()})
    table.attrs = about(case) | {"units": {n: one.units for n, one in held.items() if n not in ("row", "column")}}
    return table


def _lines(values: Any, axes: tuple[str, ...], sizes: Mapping[str, int]) -> NDArray[Any]:
    """Values over some of the axes, one for every cell of every frame, in that order."""
    shape = [sizes[axis] if axis in axes else 1 for axis in MAPS]
    return np.broadcast_to(np.reshape(values, shape), list(sizes.values())).ravel()


def about(case: CaseResult) -> dict[str, Any]:
    """What is no column: names, the resolved case and the scene as YAML, sentences; texts all."""
    sentences = {"start_time": case.start_time, "baseline_status": case.baseline_status}
    sentences |= {name: getattr(case, field) for name, field in SENTENCES.items() if name != "model_explains"}
    names = {"recording": case.recording, "estimator": case.estimator, "case_id": case.case_id}
    texts = {"case": case.case_yaml, "scene": scene_text(case.scene)}
    versions = {f"{library}_version": text for library, text in sorted(case.versions.items())}
    return names | texts | {name: text for name, text in sentences.items() if text} | versions
