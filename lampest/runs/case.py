"""One case's result: what an estimator made of a recording, with everything that a results file says about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError, extra
from lampest.files.typed import Validated, installed
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.runs import columns as col
from lampest.runs.columns import CELLS, FIGURES, FRAMES, MAPS, Column
from lampest.runs.series import about, attributes_of, places_of, series_of

if TYPE_CHECKING:
    from pandas import DataFrame as DataFrame
    from xarray import Dataset as Dataset

SHARED = "recording"  # the group beside the estimators that holds what they were given


def _attribute(name: str, default: Any = "") -> Any:
    """A field that is an attribute of the estimator's group, or not there where it has its default."""
    return field(default=default, metadata={"attribute": name})


@dataclass(frozen=True, eq=False, kw_only=True)
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
    scene: Scene
    case_id: str = _attribute("case_id")
    case_yaml: str = _attribute("case")
    versions: dict[str, str] = field(default_factory=dict)
    baseline_status: str = _attribute("baseline_status")
    baseline_solve_time: float = _attribute("baseline_solve_time_s", float("nan"))
    joint_start: bool = _attribute("joint_start", False)
    model_mark: str = _attribute("model_explains")
    model_sentence: str = _attribute("model_check")
    noise_sentence: str = _attribute("noise_check")
    noise_learned: str = _attribute("noise_learned")
    film_sentence: str = _attribute("film")
    warnings: str = _attribute("warnings")
    reading_error: float = _attribute("reading_error", 0.0)
    frame_noise: dict[str, Array] = field(default_factory=dict)
    start_time: str = ""
    # What every estimate of a recording was given: its frames, the readings with their noise, and the truth.
    time: Array = col.frames("s", "time of the frame", col.finite, **col.GIVEN)
    frame: NDArray[np.int64] = col.counts("index of the frame in the recording", value=col.frame_numbers, **col.GIVEN)
    measured: Array = col.maps(
        "ohm",
        "reading as the network is read, series resistance taken off; NaN where it says nothing",
        col.positive_or_missing,
        dataset="resistance",
        as_volt="volt",
        **col.GIVEN,
    )
    measured_baseline: Array = col.cells(
        "mean of the unloaded frames", col.positive_or_missing, dataset="baseline", as_volt="baseline", **col.GIVEN
    )
    sigma: Array | None = col.maps(
        "ohm", "standard deviation of the reading", col.positive_or_infinite, as_volt="sigma", **col.GIVEN | col.MAYBE
    )
    sigma_baseline: Array | None = col.cells(
        "standard deviation of the baseline",
        col.positive_or_infinite,
        as_volt="sigma_baseline",
        **col.GIVEN | col.MAYBE,
    )
    reading_side: NDArray[np.int8] | None = col.maps(
        "1",
        "0: a value; a bound: 1 the truth is at least this, -1 at most",
        value=lambda done: done.readings.side,
        dtype=np.int8,
        flags=((-1, "truth_is_at_most_this"), (0, "value"), (1, "truth_is_at_least_this")),
        **col.GIVEN | col.MAYBE,
    )
    missing_readings: NDArray[np.int64] | None = col.counts("readings that say nothing", **col.GIVEN | col.MAYBE)
    bound_readings: NDArray[np.int64] | None = col.counts(
        "readings at a rail, zero, or below the series resistance", **col.GIVEN | col.MAYBE
    )
    truth: Array | None = col.maps(
        "ohm", "true cell resistance", col.positive, value=col.truth, **col.GIVEN | col.MAYBE
    )
    truth_baseline: Array | None = col.cells(
        "mean true unloaded cell resistance", col.positive, value=col.truth_baseline, **col.GIVEN | col.MAYBE
    )
    # What an estimator made of every frame, and how each of its solves ended.
    cell_resistance: Array = col.maps("ohm", "estimated cell resistance", col.numbers_if_solved, col.not_zero_or_less)
    relative_change: Array = col.maps("percent", "cell resistance against its baseline", col.missing_unless_solved)
    reading_model: Array = col.maps(
        "ohm",
        "reading of the estimated cells",
        col.numbers_if_solved,
        col.not_negative,
        value=col.of_steps(lambda step: step.solution.reading[-1]),
        dataset="two_point_model",
        as_volt="reading_model",
    )
    open_cell: NDArray[np.uint8] = col.flag(
        "1: cannot be told from an open cell", "conducts", "cannot_be_told_from_open"
    )
    at_lower_bound: NDArray[np.uint8] = col.flag(
        "1: cell resistance stands at its lower bound", "above_lower_bound", "at_lower_bound"
    )
    baseline_resistance: Array = col.cells("estimated unloaded cell resistance", col.possible)
    status: tuple[str, ...] = col.frames("1", "how the solve ended", dtype=str)
    iterations: NDArray[np.int64] = col.counts("iterations of the solver", value=col.of_solutions("iterations"))
    starts: NDArray[np.int64] | None = col.counts(
        "starts of the solve; the estimate is the lowest local optimum that they reached",
        value=col.of_solutions("starts"),
        **col.MAYBE,
    )
    solve_time: Array = col.frames("s", "wall time of the solve", value=col.of_steps(lambda step: step.seconds))
    objective: Array = col.frames("1", "value of the cost function", value=col.of_solutions("objective"))
    kkt_residual: Array = col.frames(
        "1", "violation of the optimality conditions", value=col.of_solutions("kkt_residual")
    )
    solved: NDArray[np.bool_] = col.frames(
        "1", "1: solved, 0: failed", dtype=bool, flags=((0, "failed"), (1, "solved"))
    )
    # What is known of an estimate beyond its value; absent where the noise is unknown or nobody asked.
    cell_resistance_errors: Array | None = col.deviation("ohm", "posterior standard deviation of the cell resistance")
    cell_resistance_lower: Array | None = col.end("ohm", "lower")
    cell_resistance_upper: Array | None = col.end("ohm", "upper")
    relative_change_errors: Array | None = col.deviation(
        "percent", "posterior standard deviation of the relative change"
    )
    relative_change_lower: Array | None = col.end("percent", "lower")
    relative_change_upper: Array | None = col.end("percent", "upper")
    sigma_own: Array | None = col.deviation("1", "standard deviation of ln r: each cell's own error")
    sigma_common: Array | None = col.deviation(
        "1", "standard deviation of ln r: what all cells share, or those of a line"
    )
    resolution: Array | None = col.maps("1", "diagonal of the averaging kernel", col.known_if_solved, **col.MAYBE)
    data_share: Array | None = col.maps(
        "1", "share of the estimate that comes from the data", col.known_if_solved, **col.MAYBE
    )
    error_bar_time: Array | None = col.frames("s", "wall time of the error bars", **col.MAYBE)
    baseline_resistance_errors: Array | None = col.cells(
        "posterior standard deviation of the unloaded cell resistance", col.not_negative, **col.MAYBE
    )
    # What presses on the cells, where there are error bars: without them nobody can say what the response shows.
    pressure: Array | None = col.maps("kPa", "pressure of the load on the cell", col.known_if_solved, **col.MAYBE)
    pressure_errors: Array | None = col.deviation("kPa", "standard deviation of the pressure")
    pressure_lower: Array | None = col.end("kPa", "lower")
    pressure_upper: Array | None = col.end("kPa", "upper")
    saturated: NDArray[np.uint8] | None = col.flag(
        "1: the response does not tell the pressure",
        *("response_tells_pressure", "response_does_not_tell_pressure"),
        **col.MAYBE,
    )
    tared: tuple[str, ...] | None = col.frames(
        "1", "why the zero of pressures was taken anew after the frame; empty: it was not", dtype=str, **col.MAYBE
    )
    contacts: dict[str, Array] = field(default_factory=dict)
    costs: dict[str, Array] = field(default_factory=dict)
    weights: dict[str, Array] = field(default_factory=dict)
    disc: dict[str, Array] = field(default_factory=dict)
    misfit: dict[str, Array] = field(default_factory=dict)
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
        extra = {name: value for name, value in values.items() if name not in NAMES}
        return cls(**{name: value for name, value in values.items() if name in NAMES}, **rest, extra=extra)

    def column(self, name: str) -> Any:
        """The values of a column, or None where the case has none."""
        return getattr(self, name) if name in NAMES else self.extra.get(name)

    def to_xarray(self, columns: Sequence[Column] = ()) -> Dataset:
        """The case as an xarray.Dataset over time (s), row and column, with x and y in mm; units in every `attrs`.

        columns : of `extra`, as `read_results` takes them. Raises InputError where an extra has no column, or xarray is
        not installed.
        """
        with extra("xarray"):
            from xarray import Dataset
        held = series_of(self, self.described(columns))
        axes = {name: held.pop(name) for name in (TIME.name, FRAME.name)} | places_of(self)
        parts = [
            {name: (one.axes, np.asarray(one.values), one.attributes) for name, one in part.items()}
            for part in (held, axes)
        ]
        return Dataset(*parts, about(self))

    def to_dataframe(self, columns: Sequence[Column] = ()) -> DataFrame:
        """The case as a long pandas.DataFrame: time, frame, row, column, and a column for each of the case's.

        One line for every cell of every frame; what only a frame or a cell has stands in each of its lines. Units are
        in `attrs["units"]`. Raises InputError as `to_xarray`.
        """
        with extra("tables"):
            from pandas import DataFrame  # takes 0.3 s

        held = series_of(self, self.described(columns))
        first = {name: held.pop(name) for name in (TIME.name, FRAME.name)} | places_of(self)
        held = first | {name: one for name, one in held.items() if "/" not in one.path}
        sizes = dict(zip(MAPS, self.measured.shape, strict=True))
        lines = {}
        for name, one in held.items():
            shape = [size if axis in one.axes else 1 for axis, size in sizes.items()]
            lines[name] = np.broadcast_to(np.reshape(one.values, shape), self.measured.shape).ravel()
        table = DataFrame(lines)
        table.attrs = about(self) | {"units": {n: one.units for n, one in held.items() if n not in CELLS}}
        return table

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
        present, estimated = self.scene.panel.present, self._estimated()
        for column, held in filled.items():
            tested, solved = np.asarray(held), self.solved
            if column.axes[-2:] == CELLS:
                tested, solved = tested[..., present], estimated[..., present]
            for fault in (check(tested, solved) for check in column.checks):
                if fault is not None:
                    raise InputError(f"{self._path(column)} {fault}")

    def _estimated(self) -> NDArray[np.bool_]:
        """(frames, rows, columns) whether an estimate is expected: of solved frames, in modules that have any."""
        estimated, layout = np.broadcast_to(self.solved[:, None, None], self.measured.shape), self.scene.panel.modules
        if layout is None:
            return estimated
        known = layout.split(np.isfinite(self.cell_resistance))
        known = np.broadcast_to(known.any(axis=(-2, -1), keepdims=True), known.shape)
        return np.asarray(estimated & layout.joined(known))

    def _path(self, column: Column) -> str:
        group = SHARED if column.shared else self.estimator
        return f"/entry/{self.recording}/{group}/{column.of(self.scene.circuit).path}"

    def _check_shape(self, path: str, values: Any, axes: tuple[str, ...]) -> None:
        sizes = dict(zip(MAPS, self.measured.shape, strict=True))
        shape = tuple(sizes[axis] for axis in axes)
        if np.shape(values) != shape:
            held, wanted = (" × ".join(map(str, sizes)) or "one value" for sizes in (np.shape(values), shape))
            raise InputError(f"{path} is {held}; the frames ask for {wanted}")


COLUMNS = tuple(
    Column(item.name, **item.metadata["column"]) for item in fields(CaseResult) if "column" in item.metadata
)
TIME, FRAME, MEASURED = COLUMNS[:3]
NAMES = frozenset(column.name for column in COLUMNS)
REQUIRED = frozenset(item.name for item in fields(CaseResult) if item.name in NAMES and item.default is MISSING)
ATTRIBUTES = attributes_of(CaseResult)


@dataclass(frozen=True)
class StoredCase:
    """A case in a file that holds it alone, or with others; too long a one is known by no more than this."""

    path: Path
    recording: str
    estimator: str
    case_id: str
    frames: int
    cells: int


def all_columns(further: Sequence[Column] = ()) -> tuple[Column, ...]:
    """Those of lampest, those of installed packages, and further ones. Raises InputError where a name comes twice."""
    columns = (*COLUMNS, *installed("lampest.columns", Column), *further)
    for names in ([column.name for column in columns], [column.path for column in columns]):
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two columns of results are called {name}")
    return columns


def check_name(name: str, what: str) -> None:
    """Raise InputError unless `name` can name a group: printable ASCII without '/', not '.' or '..', trimmed."""
    fit = name.isascii() and name.isprintable() and "/" not in name and name == name.strip()
    if not fit or name in ("", ".", "..") or len(name) > 200:
        raise InputError(
            f"{name[:200]!r} cannot name a {what}: 1 to 200 printable ASCII characters without '/' "
            "or blanks at the ends are needed, other than '.' and '..'"
        )
