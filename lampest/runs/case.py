"""One case's result: what an estimator made of a recording, with everything that a results file says about it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from math import isfinite
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.runs.columns import AXES, CERTAINTY, ESTIMATED, GIVEN, PRESSURE

SHARED = "recording"  # the group beside the estimators that holds what they were given
LONGEST_NAME = 200


@dataclass(frozen=True)
class StepFigures:
    """Published figures of some steps: mean and standard deviation of solve time (s) and of data error (percent).

    Raises ValueError where a figure is negative or not finite.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    time_s: float | None = None
    time_sd_s: float | None = None
    error_percent: float | None = None
    error_sd_percent: float | None = None

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if value is not None and not (isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be zero or positive, and finite")


@dataclass(frozen=True)
class PublishedFigures:
    """An estimator's figures in a publication: over all steps, or apart where the first is solved with the baseline."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}
    all: StepFigures | None = None
    initial: StepFigures | None = None
    following: StepFigures | None = None


@dataclass(frozen=True, eq=False)
class CaseResult:
    """One case: a recording's measured frames as one estimator understands them.

    Parameters
    ----------
    recording, estimator : the recording's stem and the estimator's name, printable ASCII without '/'.
    case_id, case_yaml : hash and YAML text of the resolved case.
    versions : library → version.
    pitch_mm : distance of neighbouring cells in millimetre.
    series_resistance_ohm : what was taken off every two-point resistance, in ohm.
    frame : (frames) index into the recording; time : (frames) s.
    measured, measured_baseline : (frames, rows, columns) and (rows, columns) ohm, series resistance taken off.
    cell_resistance, two_point_model : (frames, rows, columns) ohm; NaN where a frame failed.
    relative_change : (frames, rows, columns) percent of the baseline; NaN where a frame failed.
    open_cell, at_lower_bound : (frames, rows, columns) 0 or 1.
    baseline_resistance : (rows, columns) ohm.
    status : (frames) how each solve ended, a sentence.
    iterations, solve_time, objective, kkt_residual : (frames), solve_time in s.
    costs, weights : term → (frames). disc : an oral disc's number → (frames), where the cells follow from one.
    baseline_status, baseline_solve_time : how the baseline's solve ended, and its time in s (NaN: not solved apart).
    joint_start : whether the first frame was solved together with the baseline.
    solved : (frames) False where a frame failed.
    truth, truth_baseline : (frames, rows, columns) and (rows, columns) ohm, or None.
    sigma, sigma_baseline : standard deviations of what was measured, same shapes, ohm; None where unknown, infinite
    where a reading is a bound or says nothing.
    top_row_depth_mm : how deep the panel stood under water, or None.
    the fields of CERTAINTY and PRESSURE : as their columns say; None where nobody asked. NaN where a frame failed.

    Raises InputError where a name is unfit, shapes disagree, or a value is impossible.
    """

    recording: str
    estimator: str
    case_id: str
    case_yaml: str
    versions: dict[str, str]
    pitch_mm: float
    series_resistance_ohm: float
    frame: NDArray[np.int64]
    time: Array
    measured: Array
    measured_baseline: Array
    cell_resistance: Array
    relative_change: Array
    two_point_model: Array
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
    top_row_depth_mm: float | None = None
    sigma: Array | None = None
    sigma_baseline: Array | None = None
    cell_resistance_errors: Array | None = None
    cell_resistance_lower: Array | None = None
    cell_resistance_upper: Array | None = None
    relative_change_errors: Array | None = None
    relative_change_lower: Array | None = None
    relative_change_upper: Array | None = None
    resolution: Array | None = None
    data_share: Array | None = None
    baseline_resistance_errors: Array | None = None
    error_bar_time: Array | None = None
    pressure: Array | None = None
    pressure_errors: Array | None = None
    pressure_lower: Array | None = None
    pressure_upper: Array | None = None
    saturated: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        check_name(self.recording, "recording")
        check_name(self.estimator, "estimator")
        if self.estimator == SHARED:
            raise InputError(f"an estimator cannot be called '{SHARED}': results keep the measurement under that name")
        if self.measured.ndim != 3 or self.measured.size == 0:
            raise InputError(
                f"{self._path(SHARED, 'resistance')} must be frames × rows × columns with at least one frame"
            )
        sizes = dict(zip(AXES, self.measured.shape, strict=True))
        for group, columns in ((SHARED, GIVEN), (self.estimator, ESTIMATED)):
            for column in columns:
                value = getattr(self, column.field)
                if value is not None or not column.optional:
                    self._check_shape(group, column.dataset, value, tuple(sizes[axis] for axis in column.axes))
        self._check_shape(SHARED, "time", self.time, (sizes["time"],))
        for folder, figures in (("cost", self.costs), ("weight", self.weights), ("disc", self.disc)):
            for term, figure in figures.items():
                check_name(term, folder)
                self._check_shape(self.estimator, f"{folder}/{term}", figure, (sizes["time"],))
        if len(self.status) != sizes["time"]:
            raise InputError(f"{self._path(self.estimator, 'status')} must hold one sentence for each frame")
        self._check_values()

    def _path(self, group: str, dataset: str) -> str:
        return f"/entry/{self.recording}/{group}/{dataset}"

    def _check_shape(self, group: str, dataset: str, value: Any, shape: tuple[int, ...]) -> None:
        if np.shape(value) != shape:
            found, wanted = (" × ".join(map(str, sizes)) or "one value" for sizes in (np.shape(value), shape))
            raise InputError(f"{self._path(group, dataset)} is {found}; the frames ask for {wanted}")

    def _check_values(self) -> None:
        if not 0 < self.pitch_mm < float("inf"):
            raise InputError(f"/entry/{self.recording}/{SHARED}: pitch_mm must be positive and finite")
        if not np.all(np.isfinite(self.time)):
            raise InputError(f"{self._path(SHARED, 'time')} must be finite")
        for column in GIVEN[1:]:
            value = getattr(self, column.field)
            endless = column.field.startswith("sigma")
            if value is not None and not np.all((np.isfinite(value) | endless) & (value > 0)):
                raise InputError(f"{self._path(SHARED, column.dataset)} must be positive and finite everywhere")
        for name in ("cell_resistance", "relative_change", "two_point_model"):
            number = np.isfinite(getattr(self, name)).all(axis=(1, 2))
            empty = np.isnan(getattr(self, name)).all(axis=(1, 2))
            if not np.all(np.where(self.solved, number, empty)):
                raise InputError(
                    f"{self._path(self.estimator, name)} must be numbers where solved is 1, and NaN elsewhere"
                )
        if np.any(self.cell_resistance <= 0) or np.any(self.two_point_model < 0):
            raise InputError(f"/entry/{self.recording}/{self.estimator}: resistances must be positive")
        for column in (*CERTAINTY, *PRESSURE):
            value = getattr(self, column.field)
            if value is not None and column.field.endswith("_errors") and np.any(value < 0):
                raise InputError(f"{self._path(self.estimator, column.dataset)} must not be negative")
            if value is not None and column.axes == AXES and column.kind is np.float64:
                missing = np.isnan(value)
                if not np.all(np.where(self.solved, ~missing.any(axis=(1, 2)), missing.all(axis=(1, 2)))):
                    raise InputError(
                        f"{self._path(self.estimator, column.dataset)} must be NaN where solved is 0, only"
                    )


@dataclass(frozen=True, eq=False)
class Results:
    """The cases of one file in the order they were given, and published figures by estimator."""

    cases: tuple[CaseResult, ...]
    published: Mapping[str, PublishedFigures] = field(default_factory=dict)

    def recordings(self) -> tuple[str, ...]:
        """The recordings' names in order, each once."""
        return tuple(dict.fromkeys(case.recording for case in self.cases))

    def of(self, recording: str) -> tuple[CaseResult, ...]:
        """The cases of one recording. Raises InputError where there is none."""
        cases = tuple(case for case in self.cases if case.recording == recording)
        if not cases:
            raise InputError(
                f"no results of a recording '{recording}'; there are {', '.join(self.recordings()) or 'none'}"
            )
        return cases


def check_name(name: str, what: str) -> None:
    """Raise InputError unless `name` can name a group: printable ASCII without '/', not '.' or '..', trimmed."""
    fit = name.isascii() and name.isprintable() and "/" not in name and name == name.strip()
    if not fit or name in ("", ".", "..") or len(name) > LONGEST_NAME:
        raise InputError(
            f"{name[:LONGEST_NAME]!r} cannot name a {what}: 1 to {LONGEST_NAME} printable ASCII characters without '/' "
            "or blanks at the ends are needed, other than '.' and '..'"
        )
