"""Result of a case, with the complete content of a results file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lampest.files.errors import InputError, brief, extra
from lampest.files.typed import installed
from lampest.panel.panel import Array, Mask
from lampest.panel.scene import scene_text
from lampest.recording.file import coordinates
from lampest.runs.columns import CELLS, FRAMES, MAPS, Column, Columns, ReservedColumn
from lampest.runs.content import Content

if TYPE_CHECKING:
    from pandas import DataFrame as DataFrame
    from xarray import Dataset as Dataset

SHARED = "recording"  # group with the measurement that all estimators share
COLUMNS = tuple(
    Column(item.name, **item.metadata["column"])
    for item in fields(Content)
    if "column" in item.metadata
)
TIME, FRAME, MEASURED = (
    column for column in COLUMNS if column.name in ("time", "frame", "measured")
)
NAMES = frozenset(column.name for column in COLUMNS)
REQUIRED = frozenset(
    item.name for item in fields(Content) if item.name in NAMES and item.default is MISSING
)
FIGURES = tuple(
    replace(item.metadata["figures"], name=item.name)
    for item in fields(Content)
    if "figures" in item.metadata
)
# Attribute of an estimator's group → its field, and the value if the attribute is missing.
ATTRIBUTES: dict[str, tuple[str, Any]] = {
    item.metadata["attribute"]: (item.name, item.default)
    for item in fields(Content)
    if "attribute" in item.metadata
}


def all_columns(further: Columns = ()) -> tuple[Column, ...]:
    """Return the columns of lampest, of applications and installed packages, and further ones.

    Raises InputError for a repeated name.
    """
    columns = (*COLUMNS, *installed("lampest.columns", Column), *further)
    for names in ([column.name for column in columns], [column.path for column in columns]):
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two columns of results are called {name}")
    return columns


# Beginnings of the statuses of local optima; the second one is that of files before version 0.2.
OPTIMA = ("local optimum", "optimum", "an optimum,")


@dataclass(frozen=True, eq=False, kw_only=True)
class CaseResult(Content):
    """Result of a case: the estimates of a recording's measured frames by an estimator.

    Raises InputError for unfit names, wrong shapes and impossible values. Arrays that are not
    listed are described by the columns of their names; they are None if not computed, and NaN in
    failed frames.

    Attributes
    ----------
    recording, estimator : str
        Stem of the recording and name of the estimator, printable ASCII without '/'.
    case_id, case_yaml : str
        Hash and YAML text of the resolved case.
    versions : mapping
        Library → version.
    swept_json : str
        Values of a sweep by key.
    costs, weights, weight_sigma, contacts, misfit : mapping
        Name → values (frames), see `FIGURES`; names with `_errors` are
        standard deviations.
    baseline_status, baseline_solve_time : str, float
        Outcome of the baseline's solve, and its time in s (NaN: not solved separately).
    model_mark : str
        Whether the circuit explains the recording: 'yes', 'doubtful' or 'no'.
    advice : str
        What the recording suggests beyond its scene, one line each.
    reading_error : float
        Standard deviation of ln of a constant factor on each reading, estimated from still cells;
        0: none.
    model_factor : float
        Factor by which the model's error widens `sigma`; 1: none.
    unloaded_frames : int
        Number of frames of which the baseline is the mean; 0: unknown, or none is unloaded.
    frame_noise : mapping
        Noise that the readings of a frame share; empty: none.
    start_time : str
        Date and time at 0 s (ISO 8601), with time zone if known; '' if unknown.
    extra : mapping
        Name → values of columns of applications, such as `pressure`, of installed packages or
        scripts.

    Examples
    --------
    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> estimate.result().estimator
    'misfit'
    """

    def __repr__(self) -> str:
        """Return the object in one line, arrays by their shapes."""
        return brief(self)

    def __post_init__(self) -> None:
        check_name(self.recording, "recording")
        check_name(self.estimator, "estimator")
        path = self._path(MEASURED)
        base = f"/entry/{self.recording}/{self.estimator}"
        if self.measured.ndim != 3 or self.measured.size == 0:
            raise InputError(f"{path} must be frames × rows × columns with at least one frame")
        if self.measured.shape[1:] != self.scene.panel.shape:
            rows, columns = self.scene.panel.shape
            raise InputError(
                f"{path} does not have the {rows} × {columns} cells of the scene's panel"
            )
        for folder in FIGURES:
            for name, values in getattr(self, folder.name).items():
                check_name(name, folder.folder)
                self._check_shape(f"{base}/{folder.folder}/{name}", values, FRAMES)
        self.check(COLUMNS)
        self.swept  # noqa: B018
        super().__post_init__()

    @property
    def chosen_weights(self) -> str:
        """Weights chosen by the data with the standard deviation of ln λ, as text."""
        messages = []
        for term, sigma in self.weight_sigma.items():
            weights = self.weights[term]
            if np.isfinite(sigma).any() and np.isfinite(weights).any():
                weight, deviation = np.nanmedian(weights), np.nanmedian(sigma)
                messages.append(f"{term} λ = {weight:.3g} (ln λ ± {deviation:.2g})")
        return ", ".join(messages)

    @cached_property
    def swept(self) -> dict[str, Any]:
        """Values by key that a sweep set for this case. Raises InputError for an invalid text."""
        try:
            return dict(json.loads(self.swept_json or "{}"))
        except (ValueError, TypeError) as error:
            raise InputError(
                f"/entry/{self.recording}/{self.estimator}@swept is no mapping in JSON"
            ) from error

    @property
    def unswept_name(self) -> str:
        """Name of the estimator without the values of a sweep."""
        return self.estimator.partition("@")[0] if self.swept else self.estimator

    @property
    def local_optima(self) -> tuple[int, int, int] | None:
        """Number of frames at a local optimum, and least and largest number of their starts.

        None stands for unknown numbers of starts, or no frame at an optimum.
        """
        optima = np.array([status.startswith(OPTIMA) for status in self.status])
        if self.starts is None or not optima.any():
            return None
        starts = self.starts[optima]
        return len(starts), int(starts.min()), int(starts.max())

    @property
    def error_words(self) -> str:
        """Medians of own and common standard deviations as text; '' if unknown."""
        own = self.sigma_own
        if own is None or self.sigma_common is None or not np.isfinite(own).any():
            return ""
        determined = np.isfinite(own) & (own > 0)
        words = "own {:.2g} {unit}, common {:.2g} {unit}"
        medians = (100 * np.median(part[determined]) for part in (own, self.sigma_common))
        message = f"standard deviation of cells: {words.format(*medians, unit='%')}"
        parts = self.pressed_errors(self.solved)
        if parts is None or not parts[0].size:
            return message
        return f"{message}; of pressures: {words.format(*map(np.median, parts), unit='kPa')}"

    def pressed_errors(self, chosen: Mask) -> tuple[Array, Array] | None:
        """Return standard deviations of the pressures of cells that are pressed in chosen frames.

        Returns None if the case has no pressures.

        Returns
        -------
        own, common : array, shape (values,)
            Standard deviations of each cell's own error, and of the common error, kPa.
        """
        names = ("pressing", "pressure_own", "pressure_common")
        pressing, own, common = map(self.column, names)
        if pressing is None or own is None or common is None:
            return None
        pressed = (pressing != 0) & chosen[:, None, None]
        return own[pressed], common[pressed]

    @property
    def valued(self) -> Mask:
        """Mask (frames, rows, columns) of readings that are values, neither bounds nor missing."""
        valued = np.isfinite(self.measured)
        valued &= True if self.sigma is None else np.isfinite(self.sigma)
        valued &= True if self.reading_side is None else self.reading_side == 0
        return valued

    @classmethod
    def of(cls, values: Mapping[str, Any], **further: Any) -> CaseResult:
        """Return a case with values of columns; those without an attribute become `extra`."""
        extra = {name: value for name, value in values.items() if name not in NAMES}
        return cls(
            **{name: value for name, value in values.items() if name in NAMES},
            **further,
            extra=extra,
        )

    def column(self, name: str) -> Any:
        """Return the values of a column, or None."""
        return getattr(self, name) if name in NAMES else self.extra.get(name)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return the values of a column of an application, such as `pressure`, or None."""
            if name in {column.name for column in all_columns()} - NAMES:
                return self.extra.get(name)
            raise AttributeError(f"a case has no attribute {name!r}")

    @property
    def attributes(self) -> dict[str, Any]:
        """Texts of the case: names, resolved case and scene as YAML, sentences, versions."""
        names = {"recording": self.recording, "estimator": self.estimator}
        names["scene"] = scene_text(self.scene)
        stored = {name: field for name, (field, _) in ATTRIBUTES.items()}
        texts = {
            name: text
            for name, field in (stored | {"start_time": "start_time"}).items()
            if isinstance(text := getattr(self, field), str) and text
        }
        versions = {f"{library}_version": text for library, text in sorted(self.versions.items())}
        return names | texts | versions

    @property
    def coordinates(self) -> dict[str, Column]:
        """Row and column, and y and x (of outlines in space z, too) in mm, by name."""
        return {
            name: ReservedColumn(name, along, units, words, dtype=at.dtype.type, values=at)
            for name, (along, at, units, words) in coordinates(self.scene.panel).items()
        }

    def variables(self, columns: Columns = (), *, raw: bool = False) -> dict[str, Column]:
        """Return every column and figure by label, in the unit of the readout.

        Parameters
        ----------
        columns : sequence of Column
            Descriptions of `extra`, besides those of installed packages.
        raw : bool
            Whether flags have the values of files; otherwise they are NaN for cells without an
            estimate.
        """
        variables = list[Column]()
        missing = np.isnan(self.cell_resistance)
        for column in all_columns(columns):
            values = self.column(column.name)
            if values is None:
                continue
            flagged = column.flags and column.axes == MAPS and not column.shared
            if flagged and not raw and missing.any():
                values = np.where(missing, np.nan, values)
                column = replace(column, dtype=np.float64)
            variables.append(replace(column.of(self.scene.circuit), values=values))
        for figures in FIGURES:
            held = getattr(self, figures.name)
            variables += [figures.column(name, held[name]) for name in held]
        return {column.label: column for column in variables}

    def to_xarray(self, columns: Columns = ()) -> Dataset:
        """Return an xarray.Dataset over time (s), row and column, with x and y in mm.

        Units are in `attrs`. `columns` are descriptions of `extra`, as in `read_results`. Raises
        InputError for an extra without column and if xarray is not installed.
        """
        with extra("xarray"):
            from xarray import Dataset
        self.described(columns)
        held = self.variables(columns)
        axes = {name: held.pop(name) for name in (TIME.name, FRAME.name)} | self.coordinates
        parts = [
            {
                name: (each.axes, np.asarray(each.values), each.attributes)
                for name, each in part.items()
            }
            for part in (held, axes)
        ]
        return Dataset(*parts, self.attributes)

    def to_dataframe(self, columns: Columns = ()) -> DataFrame:
        """Return a long pandas.DataFrame with a line for every cell of every frame.

        The columns are time, frame, row, column and those of the case; values of frames and of
        cells are repeated. Units are in `attrs["units"]`. Raises InputError as `to_xarray`.
        """
        held = self.long_columns(columns)
        table = data_frame({name: column.values for name, column in held.items()})
        table.attrs = self.attributes | {
            "units": {name: each.units for name, each in held.items() if name not in CELLS}
        }
        return table

    def long_columns(self, columns: Columns = ()) -> dict[str, Column]:
        """Return the columns of `to_dataframe`, without need of pandas.

        Raises InputError as `to_xarray`.
        """
        self.described(columns)
        held = self.variables(columns)
        first = {name: held.pop(name) for name in (TIME.name, FRAME.name)} | self.coordinates
        # Figures depend on the case, and are left out.
        held = first | {name: each for name, each in held.items() if "/" not in each.path}
        sizes = dict(zip(MAPS, self.measured.shape, strict=True))
        for name, column in held.items():
            shape = [size if axis in column.axes else 1 for axis, size in sizes.items()]
            values = np.broadcast_to(np.reshape(column.values, shape), self.measured.shape)
            held[name] = replace(column, values=values.ravel())
        return held

    def described(self, columns: Columns = ()) -> tuple[Column, ...]:
        """Return all columns: those of lampest, of installed packages, and the given ones.

        Raises InputError for values that do not fit and for an extra without column.
        """
        table = all_columns(columns)
        self.check(table)
        for name in self.extra.keys() - {column.name for column in table}:
            raise InputError(
                f"{self.recording} × {self.estimator}: no column says what the extra '{name}' is"
            )
        return table

    def check(self, columns: Columns) -> None:
        """Raise InputError for wrong shapes and impossible values."""
        filled = {
            column: held
            for column in columns
            if (held := self.column(column.name)) is not None or column.name in REQUIRED
        }
        for column, held in filled.items():
            self._check_shape(self._path(column), held, column.axes)
        present = self.scene.panel.present
        # Estimates are expected in solved frames, of modules that have any.
        estimated = np.broadcast_to(self.solved[:, None, None], self.measured.shape)
        layout = self.scene.panel.modules
        if layout is not None:
            known = layout.split(np.isfinite(self.cell_resistance))
            known = np.broadcast_to(known.any(axis=(-2, -1), keepdims=True), known.shape)
            estimated = estimated & layout.joined(known)
        for column, held in filled.items():
            tested = np.asarray(held)
            solved = self.solved
            if column.axes[-2:] == CELLS:
                tested = tested[..., present]
                solved = estimated[..., present]
            for fault in (check(tested, solved) for check in column.checks):
                if fault is not None:
                    raise InputError(f"{self._path(column)} {fault}")

    def _path(self, column: Column) -> str:
        group = SHARED if column.shared else self.estimator
        return f"/entry/{self.recording}/{group}/{column.of(self.scene.circuit).path}"

    def _check_shape(self, path: str, values: Any, axes: tuple[str, ...]) -> None:
        """Raise InputError unless the values lie along these axes of the case."""
        sizes = dict(zip(MAPS, self.measured.shape, strict=True))
        shape = tuple(sizes[axis] for axis in axes)
        if np.shape(values) != shape:
            held, requested = (
                " × ".join(map(str, sizes)) or "one value" for sizes in (np.shape(values), shape)
            )
            raise InputError(f"{path} is {held}; the frames ask for {requested}")


@dataclass(frozen=True)
class StoredCase:
    """Reference to a case in a file.

    Attributes
    ----------
    path : Path
        Results file.
    recording, estimator : str
        Names of the case.
    frames, cells : int
        Numbers of its frames, and of the cells of a frame.
    case_id, warnings, advice : str
        Attributes of the case, see `CaseResult`.
    verdict : (str, str) or None
        Mark and sentence on the circuit, which results have with `warnings` and `advice` in place
        of those in the file; None: those in the file.
    """

    path: Path
    recording: str
    estimator: str
    frames: int
    cells: int
    case_id: str = ""
    warnings: str = ""
    advice: str = ""
    verdict: tuple[str, str] | None = None


Cases = Sequence[CaseResult]


def check_name(name: str, noun: str) -> None:
    """Raise InputError unless `name` can name a group.

    A name is printable ASCII without '/', trimmed, and not reserved.
    """
    fit = name.isascii() and name.isprintable() and "/" not in name and name == name.strip()
    if not fit or name in ("", ".", "..") or len(name) > 200:
        raise InputError(
            f"{name[:200]!r} cannot name this {noun}: 1 to 200 printable ASCII characters "
            "without '/' or blanks at the ends are needed, other than '.' and '..'"
        )
    if (noun, name) == ("estimator", SHARED):
        raise InputError(
            f"an estimator cannot be called '{SHARED}': "
            "results keep the measurement under that name"
        )


def data_frame(columns: Any) -> DataFrame:
    """Return columns by name, or rows by column, as a pandas.DataFrame.

    Raises InputError if pandas is missing.
    """
    with extra("tables"):
        from pandas import DataFrame  # takes 0.3 s

    return DataFrame(columns)
