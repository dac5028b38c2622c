"""The columns of results. To add one: write its `Column` into a file here, name it in COLUMNS.

A package adds columns by naming them in the entry point group `lampest.columns`, a script by handing them to
`case_result`, `write_results` and `read_results`. All of them are filled, checked, written and read alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lampest.cost.terms import Term, term_kind
from lampest.files.errors import InputError
from lampest.files.typed import installed
from lampest.panel.panel import Array
from lampest.recording.recording import UNLOADED
from lampest.runs.columns.column import (
    CELLS,
    FRAMES,
    MAPS,
    Check,
    Column,
    Figures,
    finite,
    known_if_solved,
    not_negative,
    not_zero_or_less,
    numbers_if_solved,
    of_steps,
    positive,
    positive_or_infinite,
    positive_or_missing,
    whole_frames_if_solved,
)

if TYPE_CHECKING:
    from lampest.estimate.estimates import Estimates

__all__ = ["CELLS", "COLUMNS", "FIGURES", "FRAMES", "MAPS", "Column", "Figures", "all_columns", "of_steps"]


def _map(name: str, units: str, long_name: str, *checks: Check, **more: Any) -> Column:
    return Column(name, MAPS, units, long_name, checks=checks, **more)


def _cells(name: str, long_name: str, *checks: Check, **more: Any) -> Column:
    return Column(name, CELLS, "ohm", long_name, checks=checks, **more)


def _frames(name: str, units: str, long_name: str, *checks: Check, **more: Any) -> Column:
    return Column(name, FRAMES, units, long_name, checks=checks, **more)


def _count(name: str, long_name: str, **more: Any) -> Column:
    return Column(name, FRAMES, "1", long_name, dtype=np.int64, **more)


def _flag(name: str, long_name: str, unset: str, then: str) -> Column:
    return Column(name, MAPS, "1", long_name, dtype=np.uint8, flags=((0, unset), (1, then)))


def _sure(name: str, units: str, what: str) -> tuple[Column, ...]:
    """A standard deviation and the ends of an interval."""
    return (
        _map(f"{name}_errors", units, what, not_negative, known_if_solved),
        _map(f"{name}_lower", units, "95 % interval, lower end", known_if_solved),
        _map(f"{name}_upper", units, "95 % interval, upper end", known_if_solved),
    )


def _numbers(done: Estimates) -> NDArray[np.intp]:
    return done.frame if done.recording.number is None else done.recording.number[done.frame]


def _truth(done: Estimates) -> Array | None:
    truth = done.recording.truth_cell_resistance
    return None if truth is None else truth[done.frame]


def _truth_baseline(done: Estimates) -> Array | None:
    truth, unloaded = done.recording.truth_cell_resistance, done.recording.role == UNLOADED
    return truth[unloaded].mean(axis=0) if truth is not None and np.any(unloaded) else None


TIME = _frames("time", "s", "time of the frame", finite, shared=True)
FRAME = _count("frame", "index of the frame in the recording", value=_numbers, shared=True)
MEASURED = _map(
    "measured",
    "ohm",
    "measured two-point resistance, series taken off; NaN where a reading says nothing",
    positive_or_missing,
    dataset="resistance",
    shared=True,
    as_volt=("volt", "measured voltage, as the network is read"),
)
# What every estimate of a recording was given: its frames, the readings with their noise, and the truth.
GIVEN = (
    TIME,
    FRAME,
    MEASURED,
    _cells(
        "measured_baseline",
        "mean of the unloaded frames, series taken off",
        positive_or_missing,
        dataset="baseline",
        shared=True,
        as_volt=("baseline", "mean of the unloaded frames"),
    ),
    _map(
        "sigma",
        "ohm",
        "standard deviation of the measured two-point resistance",
        positive_or_infinite,
        shared=True,
        as_volt=("sigma", "standard deviation of the measured voltage"),
    ),
    _cells(
        "sigma_baseline",
        "standard deviation of the baseline",
        positive_or_infinite,
        shared=True,
        as_volt=("sigma_baseline", "standard deviation of the baseline"),
    ),
    _map(
        "reading_side",
        "1",
        "0: a value; a bound: 1 the truth is at least this, -1 at most",
        value=lambda done: done.readings.side,
        dtype=np.int8,
        shared=True,
        flags=((-1, "truth_is_at_most_this"), (0, "value"), (1, "truth_is_at_least_this")),
    ),
    _count("missing_readings", "readings that say nothing", shared=True),
    _count("bound_readings", "readings at a rail, zero, or below the series resistance", shared=True),
    _map("truth", "ohm", "true cell resistance", positive, value=_truth, shared=True),
    _cells("truth_baseline", "mean true unloaded cell resistance", positive, value=_truth_baseline, shared=True),
)
OPTIMA = "starts of the solve; the estimate is the lowest local optimum that they reached"
# What an estimator made of every frame, and how each of its solves ended.
ESTIMATE = (
    _map("cell_resistance", "ohm", "estimated cell resistance", numbers_if_solved, not_zero_or_less),
    _map("relative_change", "percent", "cell resistance against its baseline", whole_frames_if_solved),
    _map(
        "reading_model",
        "ohm",
        "two-point resistance of the estimated cells",
        numbers_if_solved,
        not_negative,
        value=of_steps(lambda step: step.solution.reading[-1]),
        dataset="two_point_model",
        as_volt=("reading_model", "what is read of the estimated cells"),
    ),
    _flag("open_cell", "1: cannot be told from an open cell", "conducts", "cannot_be_told_from_open"),
    _flag("at_lower_bound", "1: cell resistance stands at its lower bound", "above_lower_bound", "at_lower_bound"),
    _cells("baseline_resistance", "estimated unloaded cell resistance"),
    _frames("status", "1", "how the solve ended", dtype=str),
    _count("iterations", "iterations of the solver", value=of_steps(lambda step: step.solution.iterations)),
    _count("starts", OPTIMA, value=of_steps(lambda step: step.solution.starts)),
    _frames("solve_time", "s", "wall time of the solve", value=of_steps(lambda step: step.seconds)),
    _frames("objective", "1", "value of the cost function", value=of_steps(lambda step: step.solution.objective)),
    _frames(
        "kkt_residual",
        "1",
        "violation of the optimality conditions",
        value=of_steps(lambda step: step.solution.kkt_residual),
    ),
    _frames("solved", "1", "1: solved, 0: failed", dtype=bool, flags=((0, "failed"), (1, "solved"))),
)
COMMON = "standard deviation of ln r: what all cells share, or those of a line"
# What is known of an estimate beyond its value; absent where the noise of the readings is unknown or nobody asked.
CERTAINTY = (
    *_sure("cell_resistance", "ohm", "posterior standard deviation of the cell resistance"),
    *_sure("relative_change", "percent", "posterior standard deviation of the relative change"),
    _map("sigma_own", "1", "standard deviation of ln r: each cell's own error", not_negative, known_if_solved),
    _map("sigma_common", "1", COMMON, not_negative, known_if_solved),
    _map("resolution", "1", "diagonal of the averaging kernel", known_if_solved),
    _map("data_share", "1", "share of the estimate that comes from the data", known_if_solved),
    _frames("error_bar_time", "s", "wall time of the error bars"),
    _cells("baseline_resistance_errors", "posterior standard deviation of the unloaded cell resistance", not_negative),
)
UNSAID = "response_tells_pressure", "response_does_not_tell_pressure"
# What presses on the cells, where there are error bars: without them nobody can say what the response shows.
PRESSURE = (
    _map("pressure", "kPa", "pressure of the load on the cell", known_if_solved),
    *_sure("pressure", "kPa", "standard deviation of the pressure"),
    _flag("saturated", "1: the response does not tell the pressure", *UNSAID),
    _frames("tared", "1", "why the zero of pressures was taken anew after the frame; empty: it was not", dtype=str),
)
COLUMNS = (*GIVEN, *ESTIMATE, *CERTAINTY, *PRESSURE)


def all_columns(further: Sequence[Column] = ()) -> tuple[Column, ...]:
    """Those of lampest, those of installed packages, and further ones. Raises InputError where a name comes twice."""
    columns = (*COLUMNS, *installed("lampest.columns", Column), *further)
    for names in ([column.name for column in columns], [column.path for column in columns]):
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two columns of results are called {name}")
    return columns


def _of_terms(done: Estimates, values: Sequence[Array] | Sequence[tuple[float, ...]]) -> dict[str, Array]:
    """Term → values of every step's terms."""
    names = _names(done.estimator.terms)
    return {name: np.array([one[number] for one in values]) for number, name in enumerate(names)}


def _names(terms: Sequence[Term]) -> list[str]:
    """The kind of every term; `kind_2` and so on for further ones of a kind, which only a script can give."""
    kinds = [term_kind(term) for term in terms]
    before = [kinds[:number].count(kind) for number, kind in enumerate(kinds)]
    return [f"{kind}_{count + 1}" if count else kind for kind, count in zip(kinds, before, strict=True)]


def _disc(done: Estimates) -> dict[str, Array]:
    """Every number of the discs and its standard deviation; NaN where a frame failed. None without any disc."""
    discs = [step.disc for step in done.steps]
    first = next((disc for disc in discs if disc is not None), None)
    numbers = {}
    for name in () if first is None else first.disc._fields:
        for end, part in (("", "disc"), ("_errors", "disc_errors")):
            values = [np.nan if disc is None else getattr(getattr(disc, part), name) for disc in discs]
            numbers[name + end] = np.array(values, dtype=float)
    return numbers


def _contacts(done: Estimates) -> dict[str, Array]:
    """Every line's contact and its standard deviation, the same in every frame; none where the scene names none."""
    if done.contacts is None:
        return {}
    shape, every = done.recording.scene.panel.shape, np.ones(len(done.steps))
    lines = [f"{side}_{line}" for side, count in zip(("row", "column"), shape, strict=True) for line in range(count)]
    ohm, errors = done.contacts.mean(shape), done.contacts.deviation(shape)
    return dict(zip(lines, np.outer(ohm, every), strict=True)) | {
        f"{line}_errors": error * every for line, error in zip(lines, errors, strict=True)
    }


def _unit_of_disc(name: str) -> str:
    ends = {"_mm": "mm", "_kpa": "kPa"}
    return next((unit for end, unit in ends.items() if name.removesuffix("_errors").endswith(end)), "1")


def _of_contact(name: str) -> str:
    line = name.removesuffix("_errors")
    deviation = "" if name == line else "standard deviation of the "
    return f"{deviation}contact resistance of {line.replace('_', ' ')}"


MISFIT = {
    "chi_square": "sum of squared residuals over their noise",
    "degrees_of_freedom": "readings less what the estimate follows of them",
    "tail": "probability of as large a chi square by noise alone",
    "worst_row": "row that holds most of chi square",
    "worst_row_share": "share of that row",
    "worst_column": "column that holds most of chi square",
    "worst_column_share": "share of that column",
}
FIGURES = (
    Figures("contacts", "contact", _contacts, _of_contact, lambda name: "ohm"),
    Figures(
        "costs",
        "cost",
        lambda done: _of_terms(done, [step.solution.costs for step in done.steps]),
        lambda name: f"cost of the term {name}",
    ),
    Figures(
        "weights",
        "weight",
        lambda done: _of_terms(done, [step.weights for step in done.steps]),
        lambda name: f"weight of the term {name}",
    ),
    Figures("disc", "disc", _disc, lambda name: f"oral disc: {name.replace('_', ' ')}", _unit_of_disc),
    Figures("misfit", "model_check", lambda done: done.misfit, lambda name: MISFIT.get(name, name)),
)
