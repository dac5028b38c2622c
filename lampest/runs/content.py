"""Content of a case: the table of its columns, attributes and figures, each declared once.

A field of `Content` is a column with axes, unit, meaning, checks and its value from estimates, an
attribute of the estimator's group, or a group of figures whose names depend on the case.
Writers, readers, labelled arrays and tables follow from these declarations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.levels import Witness
from lampest.files.typed import Validated
from lampest.panel.panel import Array, Mask, Numbers
from lampest.panel.scene import Scene
from lampest.recording.recording import UNLOADED
from lampest.runs.columns import (
    CELLS,
    FRAMES,
    MAPS,
    Check,
    Figures,
    finite,
    known_if_solved,
    missing_unless_solved,
    not_negative,
    not_zero_or_less,
    numbers_if_solved,
    positive_or_infinite,
    positive_or_missing,
    possible,
)

if TYPE_CHECKING:  # readers of results need not load the solvers
    from lampest.estimate.estimates import Estimates


NamedValues = dict[str, Array]
Known = Array | None  # None: not computed, or absent


def _declared(
    axes: tuple[str, ...],
    units: str,
    words: str,
    *checks: Check,
    default: Any = MISSING,
    **more: Any,
) -> Any:
    """Return a dataclass field that is a column, optional if `default` is None.

    `more` are arguments of `Column`.
    """
    about = {"axes": axes, "units": units, "long_name": words, "checks": checks} | more
    return field(default=default, metadata={"column": about})


_maps = partial(_declared, MAPS)
_frames = partial(_declared, FRAMES)
_cells = partial(_declared, CELLS, "ohm")
_counts = partial(_frames, "1", dtype=np.int64)
_optional_maps, _optional_frames, _optional_cells = (
    partial(declared, default=None) for declared in (_maps, _frames, _cells)
)


def _flag(words: str, unset: str, then: str, **more: Any) -> Any:
    """Return a field of flags of cells."""
    return _maps("1", words, dtype=np.uint8, flags=((0, unset), (1, then)), **more)


def _deviation(units: str, words: str) -> Any:
    """Return a field of standard deviations of cells."""
    return _optional_maps(units, words, not_negative, known_if_solved)


def _share(words: str, units: str = "1") -> Any:
    """Return an optional field of cells that is known where a frame is solved."""
    return _optional_maps(units, words, known_if_solved)


def _attribute(name: str, source: str = "", default: Any = "", value: Any = None) -> Any:
    """Return a field that is an attribute of the estimator's group.

    The file omits an attribute that has its default. Its value is that of estimates: a function of
    them, or the dotted name of an attribute.
    """
    return field(
        default=default,
        metadata={"attribute": name, "value": value or (attrgetter(source) if source else None)},
    )


def _of_solutions(name: str) -> Callable[[Estimates], Array]:
    """Return a function that stacks an attribute of all solutions, shape (frames,)."""
    return lambda done: np.array([getattr(step.solution, name) for step in done.steps])


def _of_witness(name: str, absent: float) -> Callable[[Estimates], Array | None]:
    """Return a function that stacks a field of the verifications, shape (frames,).

    The function returns None if no frame was verified.
    """

    def values(done: Estimates) -> Array | None:
        if all(step.verification is None for step in done.steps):
            return None
        return np.array([getattr(step.verification, name, absent) for step in done.steps])

    return values


def _frame_numbers(done: Estimates) -> Numbers:
    """Return indices into the recording, which may have been read in part."""
    return done.frame if done.recording.number is None else done.recording.number[done.frame]


def _true_cells(done: Estimates) -> Array | None:
    """Return true cells, (frames of the recording, rows, columns) ohm, or None.

    Places without an intact cell are NaN.
    """
    cells = done.recording.truth_cell_resistance
    return None if cells is None else np.where(done.recording.scene.broken, np.nan, cells)


def _truth(done: Estimates) -> Array | None:
    """Return true cells, (frames, rows, columns) ohm, or None."""
    cells = _true_cells(done)
    return None if cells is None else cells[done.frame]


def _truth_baseline(done: Estimates) -> Array | None:
    """Return the mean of true unloaded cells, (rows, columns) ohm, or None."""
    cells = _true_cells(done)
    unloaded = done.recording.role == UNLOADED
    return None if cells is None or not np.any(unloaded) else cells[unloaded].mean(axis=0)


def _of_terms(
    done: Estimates, values: Sequence[Array] | Sequence[tuple[float, ...]]
) -> NamedValues:
    """Map terms to values of all steps.

    Repeated kinds, which scripts can give, are `kind_2` and so on.
    """
    from lampest.cost.terms import term_kind  # with CasADi, which reading results does not need

    kinds = [term_kind(term) for term in done.estimator.terms]
    named = {}
    for number, kind in enumerate(kinds):
        count = kinds[: number + 1].count(kind)
        name = kind if count == 1 else f"{kind}_{count}"
        named[name] = np.array([step[number] for step in values])
    return named


def weights_of(done: Estimates) -> NamedValues:
    """Map terms to their weights in every frame."""
    return _of_terms(done, [step.weights for step in done.steps])


def _chosen(done: Estimates) -> NamedValues:
    """Map terms with weights chosen by the data to the deviations of ln λ, one for each frame."""
    size = len(done.estimator.terms)
    sigmas = [np.array(step.weight_sigma or [np.nan] * size) for step in done.steps]
    by_term = _of_terms(done, sigmas)
    return {name: values for name, values in by_term.items() if np.isfinite(values).any()}


def _contacts(done: Estimates) -> NamedValues:
    """Return contact resistances of the lines and their standard deviations, equal in all frames.

    The mapping is empty if contact resistances are unknown.
    """
    if done.contacts is None:
        return {}
    shape = done.recording.scene.panel.shape
    sides = zip(("row", "column"), shape, strict=True)
    lines = [f"{side}_{number}" for side, count in sides for number in range(count)]
    ohm = [*done.contacts.mean(shape), *done.contacts.deviation(shape)]
    names = [*lines, *(f"{line}_errors" for line in lines)]
    return dict(zip(names, np.outer(ohm, np.ones(len(done.steps))), strict=True))


def _of_contact(name: str) -> str:
    line = name.removesuffix("_errors")
    deviation = "" if name == line else "standard deviation of the "
    return f"{deviation}contact resistance of {line.replace('_', ' ')}"


def _figures(*about: Any) -> Any:
    """Return a dataclass field that holds figures."""
    return field(default_factory=dict, metadata={"figures": Figures(*about)})


MISFIT = {
    "chi_square": "sum of squared residuals over their noise",
    "degrees_of_freedom": "readings less the trace of the resolution",
    "tail": "probability of a chi square this large from noise alone",
    "worst_row": "row that holds most of chi square",
    "worst_row_share": "share of that row",
    "worst_column": "column that holds most of chi square",
    "worst_column_share": "share of that column",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Content(Validated):
    """Fields of a case, see `lampest.runs.case.CaseResult`."""

    recording: str
    estimator: str
    scene: Scene
    case_id: str = _attribute("case_id")
    case_yaml: str = _attribute("case")
    swept_json: str = _attribute("swept")
    versions: dict[str, str] = field(default_factory=dict)
    baseline_status: str = _attribute("baseline_status", "baseline.status")
    baseline_solve_time: float = _attribute(
        "baseline_solve_time_s", "baseline.seconds", float("nan")
    )
    joint_start: bool = _attribute("joint_start", "joint_start", default=False)
    model_mark: str = _attribute("model_explains")
    model_sentence: str = _attribute("model_check")
    advice: str = _attribute("advice")
    noise_sentence: str = _attribute("noise_check", "noise.sentence")
    noise_learned: str = _attribute("noise_learned", "noise.summary")
    film_sentence: str = _attribute(
        "film", value=lambda done: "" if done.film is None else done.film.sentence
    )
    warnings: str = _attribute("warnings")
    reading_error: float = _attribute("reading_error", "noise.reading_error", 0.0)
    model_factor: float = _attribute("model_factor", "noise.model_factor", 1.0)
    unloaded_frames: int = _attribute(
        "unloaded_frames",
        default=0,
        value=lambda done: int(np.sum(done.recording.role == UNLOADED)),
    )
    frame_noise: NamedValues = field(default_factory=dict)
    start_time: str = ""
    # The measurement that all estimates of a recording share: frames, readings with their noise,
    # and the truth.
    time: Array = _frames("s", "time of the frame", finite, shared=True)
    frame: NDArray[np.int64] = _counts(
        "index of the frame in the recording", value=_frame_numbers, shared=True
    )
    measured: Array = _maps(
        "ohm",
        "reading between the lines without series resistance; NaN where missing",
        positive_or_missing,
        dataset="resistance",
        as_volt="volt",
        shared=True,
    )
    measured_baseline: Array = _cells(
        "mean of the unloaded frames",
        positive_or_missing,
        dataset="baseline",
        as_volt="baseline",
        shared=True,
    )
    sigma: Known = _optional_maps(
        "ohm",
        "standard deviation of the reading",
        positive_or_infinite,
        as_volt="sigma",
        shared=True,
    )
    sigma_baseline: Known = _optional_cells(
        "standard deviation of the baseline",
        positive_or_infinite,
        as_volt="sigma_baseline",
        shared=True,
    )
    reading_side: NDArray[np.int8] | None = _optional_maps(
        "1",
        "0: a value; a bound: 1 the truth is at least this, -1 at most",
        value=lambda done: done.readings.side,
        dtype=np.int8,
        flags=((-1, "truth_is_at_most_this"), (0, "value"), (1, "truth_is_at_least_this")),
        shared=True,
    )
    missing_readings: NDArray[np.int64] | None = _counts(
        "readings that say nothing", shared=True, default=None
    )
    bound_readings: NDArray[np.int64] | None = _counts(
        "readings at a rail, zero, or below the series resistance", shared=True, default=None
    )
    truth: Known = _optional_maps(
        "ohm",
        "true cell resistance",
        positive_or_missing,
        value=_truth,
        shared=True,
    )
    truth_baseline: Known = _optional_cells(
        "mean true unloaded cell resistance",
        positive_or_missing,
        value=_truth_baseline,
        shared=True,
    )
    # The estimate of every frame, and the outcome of its solve.
    cell_resistance: Array = _maps(
        "ohm", "estimated cell resistance", numbers_if_solved, not_zero_or_less
    )
    relative_change: Array = _maps(
        "percent", "cell resistance against its baseline", missing_unless_solved
    )
    reading_model: Array = _maps(
        "ohm",
        "reading of the estimated cells",
        numbers_if_solved,
        not_negative,
        dataset="two_point_model",
        as_volt="reading_model",
    )
    reading_sigma: Known = _optional_maps(
        "ohm",
        "standard deviation of a reading about the model's, noise and model error included",
        as_volt="reading_sigma",
    )
    open_cell: NDArray[np.uint8] = _flag(
        "1: cannot be distinguished from an open cell", "conducts", "cannot_be_told_from_open"
    )
    at_lower_bound: NDArray[np.uint8] = _flag(
        "1: cell resistance stands at its lower bound", "above_lower_bound", "at_lower_bound"
    )
    baseline_resistance: Array = _cells("estimated unloaded cell resistance", possible)
    status: tuple[str, ...] = _frames("1", "how the solve ended", dtype=str)
    iterations: NDArray[np.int64] = _counts(
        "iterations of the solver", value=_of_solutions("iterations")
    )
    solver: tuple[str, ...] | None = _optional_frames(
        "1",
        "solver that gave the estimate; empty where none did",
        dtype=str,
        value=_of_solutions("solver"),
    )
    verified: NDArray[np.uint8] | None = _optional_frames(
        "1",
        "the frame solved again by IPOPT on the nodal program, from another start",
        dtype=np.uint8,
        value=_of_witness("witness", Witness.NONE),
        flags=(
            (Witness.NONE, "not_solved_again"),
            (Witness.SAME, "same_optimum"),
            (Witness.HIGHER, "ipopt_ended_higher"),
            (Witness.LOWER, "ipopt_ended_lower_and_was_kept"),
            (Witness.FAILED, "ipopt_reached_no_optimum"),
        ),
    )
    verified_difference: Known = _optional_frames(
        "1",
        "largest difference of ln r from the second solve; NaN without one",
        value=_of_witness("difference", np.nan),
    )
    verified_decrease: Known = _optional_frames(
        "1",
        "decrease of the cost by the second solve, relative to the first; 0 unless that was lower",
        value=_of_witness("decrease", 0.0),
    )
    starts: NDArray[np.int64] | None = _counts(
        "number of starts; the estimate is the best local optimum that they reached",
        value=_of_solutions("starts"),
        default=None,
    )
    solve_time: Array = _frames("s", "wall time of the solve")
    objective: Array = _frames("1", "value of the cost function", value=_of_solutions("objective"))
    kkt_residual: Array = _frames(
        "1", "violation of the optimality conditions", value=_of_solutions("kkt_residual")
    )
    solved: Mask = _frames(
        "1", "1: solved, 0: failed", dtype=bool, flags=((0, "failed"), (1, "solved"))
    )
    # The uncertainty of an estimate; absent where the noise is unknown or error bars were not
    # requested.
    cell_resistance_errors: Known = _deviation(
        "ohm", "posterior standard deviation of the cell resistance"
    )
    cell_resistance_lower: Known = _share("95 % interval, lower end", "ohm")
    cell_resistance_upper: Known = _share("95 % interval, upper end", "ohm")
    relative_change_errors: Known = _deviation(
        "percent", "posterior standard deviation of the relative change"
    )
    relative_change_lower: Known = _share("95 % interval, lower end", "percent")
    relative_change_upper: Known = _share("95 % interval, upper end", "percent")
    sigma_own: Known = _deviation("1", "standard deviation of ln r: each cell's own error")
    sigma_common: Known = _deviation(
        "1", "standard deviation of ln r: error common to all cells, or to those of a line"
    )
    resolution: Known = _share("diagonal of the averaging kernel")
    data_share: Known = _share("share of the estimate that comes from the data")
    error_bar_time: Known = _optional_frames("s", "wall time of the error bars")
    baseline_resistance_errors: Known = _optional_cells(
        "posterior standard deviation of the unloaded cell resistance", not_negative
    )
    contacts: NamedValues = _figures("contact", _contacts, _of_contact, "ohm")
    costs: NamedValues = _figures(
        "cost",
        lambda done: _of_terms(done, [step.solution.costs for step in done.steps]),
        "cost of the term {}".format,
    )
    weights: NamedValues = _figures("weight", weights_of, "weight of the term {}".format)
    weight_sigma: NamedValues = _figures(
        "weight_sigma",
        _chosen,
        "standard deviation of ln of the chosen weight of the term {}".format,
    )
    misfit: NamedValues = _figures(
        "model_check", attrgetter("misfit"), lambda name: MISFIT.get(name, name)
    )
    extra: Mapping[str, Array] = field(default_factory=dict)
