"""The columns that lampest ships: what an estimator was given, what it made of it, how sure it is, what presses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lampest.cost.terms import Term, term_kind
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


def _map(name: str, units: str, long_name: str, *checks: Check, **more: Any) -> Column:
    """A column over frames and cells."""
    return Column(name, MAPS, units, long_name, checks=checks, **more)


def _frames(name: str, units: str, long_name: str, *checks: Check, **more: Any) -> Column:
    """A column over frames."""
    return Column(name, FRAMES, units, long_name, checks=checks, **more)


def _count(name: str, long_name: str, **more: Any) -> Column:
    """A column of whole numbers over frames."""
    return Column(name, FRAMES, "1", long_name, dtype=np.int64, **more)


def _flag(name: str, long_name: str, unset: str, then: str) -> Column:
    """A column of 0 and 1 over frames and cells, with a word for each."""
    return Column(name, MAPS, "1", long_name, dtype=np.uint8, flags=((0, unset), (1, then)))


def _truth(estimates: Estimates) -> Array | None:
    truth = estimates.recording.truth_cell_resistance
    return None if truth is None else truth[estimates.frame]


def _truth_baseline(estimates: Estimates) -> Array | None:
    truth = estimates.recording.truth_cell_resistance
    unloaded = estimates.recording.role == UNLOADED
    return truth[unloaded].mean(axis=0) if truth is not None and np.any(unloaded) else None


TIME = _frames("time", "s", "time of the frame", finite, shared=True)
FRAME = _count(
    "frame",
    "index of the frame in the recording",
    value=lambda done: done.frame if done.recording.number is None else done.recording.number[done.frame],
    shared=True,
)
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
    Column(
        "measured_baseline",
        CELLS,
        "ohm",
        "mean of the unloaded frames, series taken off",
        checks=(positive_or_missing,),
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
    Column(
        "sigma_baseline",
        CELLS,
        "ohm",
        "standard deviation of the baseline",
        checks=(positive_or_infinite,),
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
    Column(
        "truth_baseline", CELLS, "ohm", "mean true unloaded cell resistance", _truth_baseline, (positive,), shared=True
    ),
)
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
    Column("baseline_resistance", CELLS, "ohm", "estimated unloaded cell resistance"),
    _frames("status", "1", "how the solve ended", dtype=str),
    _count("iterations", "iterations of the solver", value=of_steps(lambda step: step.solution.iterations)),
    _count(
        "starts",
        "starts of the solve; the estimate is the lowest local optimum that they reached",
        value=of_steps(lambda step: step.solution.starts),
    ),
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
# What is known of an estimate beyond its value; absent where the noise of the readings is unknown or nobody asked.
CERTAINTY = (
    *(
        column
        for name, units, what in (
            ("cell_resistance", "ohm", "posterior standard deviation of the cell resistance"),
            ("relative_change", "percent", "posterior standard deviation of the relative change"),
        )
        for column in (
            _map(f"{name}_errors", units, what, not_negative, known_if_solved),
            _map(f"{name}_lower", units, "95 % interval, lower end", known_if_solved),
            _map(f"{name}_upper", units, "95 % interval, upper end", known_if_solved),
        )
    ),
    _map("sigma_own", "1", "standard deviation of ln r: each cell's own error", not_negative, known_if_solved),
    _map(
        "sigma_common",
        "1",
        "standard deviation of ln r: what all cells share, or those of a line",
        not_negative,
        known_if_solved,
    ),
    _map("resolution", "1", "diagonal of the averaging kernel", known_if_solved),
    _map("data_share", "1", "share of the estimate that comes from the data", known_if_solved),
    _frames("error_bar_time", "s", "wall time of the error bars"),
    Column(
        "baseline_resistance_errors",
        CELLS,
        "ohm",
        "posterior standard deviation of the unloaded cell resistance",
        checks=(not_negative,),
    ),
)
# What presses on the cells, where there are error bars: without them nobody can say what the response shows.
PRESSURE = (
    _map("pressure", "kPa", "pressure of the load on the cell", known_if_solved),
    _map("pressure_errors", "kPa", "standard deviation of the pressure", not_negative, known_if_solved),
    _map("pressure_lower", "kPa", "95 % interval, lower end", known_if_solved),
    _map("pressure_upper", "kPa", "95 % interval, upper end", known_if_solved),
    _flag(
        "saturated",
        "1: the response does not tell the pressure",
        "response_tells_pressure",
        "response_does_not_tell_pressure",
    ),
    _frames("tared", "1", "why the zero of pressures was taken anew after the frame; empty: it was not", dtype=str),
)


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


UNITS = {"_mm": "mm", "_kpa": "kPa"}  # of a disc's numbers, by the end of their names
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
    Figures(
        "contacts",
        "contact",
        _contacts,
        lambda name: "ohm",
        lambda name: (
            f"{'standard deviation of the ' if name.endswith('_errors') else ''}contact resistance of "
            f"{name.removesuffix('_errors').replace('_', ' ')}"
        ),
    ),
    Figures(
        "costs",
        "cost",
        lambda done: _of_terms(done, [step.solution.costs for step in done.steps]),
        lambda name: "1",
        lambda name: f"cost of the term {name}",
    ),
    Figures(
        "weights",
        "weight",
        lambda done: _of_terms(done, [step.weights for step in done.steps]),
        lambda name: "1",
        lambda name: f"weight of the term {name}",
    ),
    Figures(
        "disc",
        "disc",
        _disc,
        lambda name: next((unit for end, unit in UNITS.items() if name.removesuffix("_errors").endswith(end)), "1"),
        lambda name: f"oral disc: {name.replace('_', ' ')}",
    ),
    Figures("misfit", "model_check", lambda done: done.misfit, lambda name: "1", lambda name: MISFIT.get(name, name)),
)
