"""Content of a case, field by field: columns of a results file, attributes, figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.files.typed import Validated, installed
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.runs import columns as col
from lampest.runs.columns import Column


def _attribute(name: str, default: Any = "") -> Any:
    """Return a field that is an attribute of the estimator's group, omitted in the file at its default."""
    return field(default=default, metadata={"attribute": name})


@dataclass(frozen=True, eq=False, kw_only=True)
class Held(Validated):
    """The fields of `lampest.runs.case.CaseResult`."""

    recording: str
    estimator: str
    scene: Scene
    case_id: str = _attribute("case_id")
    case_yaml: str = _attribute("case")
    swept_json: str = _attribute("swept")
    versions: dict[str, str] = field(default_factory=dict)
    baseline_status: str = _attribute("baseline_status")
    baseline_solve_time: float = _attribute("baseline_solve_time_s", float("nan"))
    joint_start: bool = _attribute("joint_start", default=False)
    model_mark: str = _attribute("model_explains")
    model_sentence: str = _attribute("model_check")
    noise_sentence: str = _attribute("noise_check")
    noise_learned: str = _attribute("noise_learned")
    film_sentence: str = _attribute("film")
    warnings: str = _attribute("warnings")
    reading_error: float = _attribute("reading_error", 0.0)
    frame_noise: dict[str, Array] = field(default_factory=dict)
    start_time: str = ""
    # The measurement that all estimates of a recording share: frames, readings with their noise, and the truth.
    time: Array = col.frames("s", "time of the frame", col.finite, shared=True)
    frame: NDArray[np.int64] = col.counts("index of the frame in the recording", value=col.frame_numbers, shared=True)
    measured: Array = col.maps(
        "ohm",
        "reading between the lines without series resistance; NaN where missing",
        col.positive_or_missing,
        dataset="resistance",
        as_volt="volt",
        shared=True,
    )
    measured_baseline: Array = col.cells(
        "mean of the unloaded frames", col.positive_or_missing, dataset="baseline", as_volt="baseline", shared=True
    )
    sigma: Array | None = col.maps(
        "ohm", "standard deviation of the reading", col.positive_or_infinite, as_volt="sigma", shared=True, default=None
    )
    sigma_baseline: Array | None = col.cells(
        "standard deviation of the baseline",
        col.positive_or_infinite,
        as_volt="sigma_baseline",
        shared=True,
        default=None,
    )
    reading_side: NDArray[np.int8] | None = col.maps(
        "1",
        "0: a value; a bound: 1 the truth is at least this, -1 at most",
        value=lambda done: done.readings.side,
        dtype=np.int8,
        flags=((-1, "truth_is_at_most_this"), (0, "value"), (1, "truth_is_at_least_this")),
        shared=True,
        default=None,
    )
    missing_readings: NDArray[np.int64] | None = col.counts("readings that say nothing", shared=True, default=None)
    bound_readings: NDArray[np.int64] | None = col.counts(
        "readings at a rail, zero, or below the series resistance", shared=True, default=None
    )
    truth: Array | None = col.maps(
        "ohm", "true cell resistance", col.positive, value=col.truth, shared=True, default=None
    )
    truth_baseline: Array | None = col.cells(
        "mean true unloaded cell resistance", col.positive, value=col.truth_baseline, shared=True, default=None
    )
    # The estimate of every frame, and the outcome of its solve.
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
    reading_sigma: Array | None = col.maps(
        "ohm", "standard deviation of a reading about the model's, noise and model error included", default=None
    )
    open_cell: NDArray[np.uint8] = col.flag(
        "1: cannot be distinguished from an open cell", "conducts", "cannot_be_told_from_open"
    )
    at_lower_bound: NDArray[np.uint8] = col.flag(
        "1: cell resistance stands at its lower bound", "above_lower_bound", "at_lower_bound"
    )
    baseline_resistance: Array = col.cells("estimated unloaded cell resistance", col.possible)
    status: tuple[str, ...] = col.frames("1", "how the solve ended", dtype=str)
    iterations: NDArray[np.int64] = col.counts("iterations of the solver", value=col.of_solutions("iterations"))
    starts: NDArray[np.int64] | None = col.counts(
        "number of starts; the estimate is the best local optimum that they reached",
        value=col.of_solutions("starts"),
        default=None,
    )
    solve_time: Array = col.frames("s", "wall time of the solve", value=col.of_steps(lambda step: step.seconds))
    objective: Array = col.frames("1", "value of the cost function", value=col.of_solutions("objective"))
    kkt_residual: Array = col.frames(
        "1", "violation of the optimality conditions", value=col.of_solutions("kkt_residual")
    )
    solved: NDArray[np.bool_] = col.frames(
        "1", "1: solved, 0: failed", dtype=bool, flags=((0, "failed"), (1, "solved"))
    )
    # The uncertainty of an estimate; absent where the noise is unknown or error bars were not requested.
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
        "1", "standard deviation of ln r: error common to all cells, or to those of a line"
    )
    resolution: Array | None = col.maps("1", "diagonal of the averaging kernel", col.known_if_solved, default=None)
    data_share: Array | None = col.maps(
        "1", "share of the estimate that comes from the data", col.known_if_solved, default=None
    )
    error_bar_time: Array | None = col.frames("s", "wall time of the error bars", default=None)
    baseline_resistance_errors: Array | None = col.cells(
        "posterior standard deviation of the unloaded cell resistance", col.not_negative, default=None
    )
    # Pressures of the cells; absent without error bars, which the uncertainty of pressures requires.
    pressure: Array | None = col.maps("kPa", "pressure of the load on the cell", col.known_if_solved, default=None)
    pressure_errors: Array | None = col.deviation("kPa", "standard deviation of the pressure")
    pressure_own: Array | None = col.deviation("kPa", "standard deviation of the pressure: each cell's own error")
    pressure_common: Array | None = col.deviation(
        "kPa", "standard deviation of the pressure: common error of all cells"
    )
    pressure_lower: Array | None = col.end("kPa", "lower")
    pressure_upper: Array | None = col.end("kPa", "upper")
    saturated: NDArray[np.uint8] | None = col.flag(
        "1: the response leaves the pressure open",
        *("response_tells_pressure", "response_does_not_tell_pressure"),
        default=None,
    )
    pressing: NDArray[np.uint8] | None = col.flag(
        "1: a load presses on the cell, beyond errors and what the film keeps of earlier loads",
        *("no_load_presses", "load_presses"),
        default=None,
    )
    tared: tuple[str, ...] | None = col.frames(
        "1", "why the zero of pressures was taken anew after the frame; empty: it was not", dtype=str, default=None
    )
    contacts: dict[str, Array] = field(default_factory=dict)
    costs: dict[str, Array] = field(default_factory=dict)
    weights: dict[str, Array] = field(default_factory=dict)
    weight_sigma: dict[str, Array] = field(default_factory=dict)
    misfit: dict[str, Array] = field(default_factory=dict)
    extra: Mapping[str, Array] = field(default_factory=dict)


COLUMNS = tuple(Column(item.name, **item.metadata["column"]) for item in fields(Held) if "column" in item.metadata)
TIME, FRAME, MEASURED = (column for column in COLUMNS if column.name in ("time", "frame", "measured"))
NAMES = frozenset(column.name for column in COLUMNS)
REQUIRED = frozenset(item.name for item in fields(Held) if item.name in NAMES and item.default is MISSING)
# Attribute of an estimator's group → its field, and the value if the attribute is missing.
ATTRIBUTES: dict[str, tuple[str, Any]] = {
    item.metadata["attribute"]: (item.name, item.default) for item in fields(Held) if "attribute" in item.metadata
}


def all_columns(further: Sequence[Column] = ()) -> tuple[Column, ...]:
    """Return the columns of lampest, of installed packages, and further ones.

    Raises InputError for a repeated name.
    """
    columns = (*COLUMNS, *installed("lampest.columns", Column), *further)
    for names in ([column.name for column in columns], [column.path for column in columns]):
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two columns of results are called {name}")
    return columns
