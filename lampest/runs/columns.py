"""Content of a case, each part declared once.

The parts are columns of a results file with their checks, attributes, figures. A package adds
columns by naming them in the entry point group `lampest.columns`, a script by handing them to
`named_result`, `write_results` and `read_results`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, replace
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.levels import Witness
from lampest.files.typed import Validated
from lampest.panel.panel import Array, beyond_any_panel
from lampest.panel.readouts.readout import Readout
from lampest.panel.scene import Scene
from lampest.recording.recording import UNLOADED

if TYPE_CHECKING:  # readers of results need not load the solvers
    from lampest.estimate.estimates import Estimates
    from lampest.estimate.model_check import ModelCheck
    from lampest.estimate.state import Step

FRAMES = ("time",)
CELLS = ("row", "column")
MAPS = FRAMES + CELLS
# Names in the groups of a results file that are no columns.
RESERVED = (
    *CELLS,
    "x",
    "y",
    "scene",
    "start_time",
    "cost",
    "weight",
    "weight_sigma",
    "model_check",
)

# (values, mask of expected estimates) → fault, the end of a sentence that begins with the path;
# None: no fault.
Check = Callable[[Any, NDArray[np.bool_]], str | None]


def possible(values: Array, solved: NDArray[np.bool_]) -> str | None:
    """Return a fault if a number exceeds that of any panel."""
    beyond = np.asarray(values)[beyond_any_panel(values)]
    return f"holds {beyond[0]:.6g}, which no panel has" if beyond.size else None


def _check(
    sentence: str, right: Callable[[Array, NDArray[np.bool_]], Any], *, physical: bool = True
) -> Check:
    """Return a check of values.

    They must be possible, too, where they are measured or comparable.
    """

    def fault(values: Any, solved: NDArray[np.bool_]) -> str | None:
        beyond = possible(values, solved) if physical else None
        return beyond or (None if np.all(right(np.asarray(values), solved)) else sentence)

    return fault


finite = _check("must be finite", lambda values, solved: np.isfinite(values))
positive_or_missing = _check(
    "must be positive and finite, or NaN",
    lambda values, solved: np.isnan(values) | ((values > 0) & (values < np.inf)),
)
positive_or_infinite = _check("must be positive everywhere", lambda values, solved: values > 0)
not_negative = _check("must not be negative", lambda values, solved: ~(values < 0), physical=False)
not_zero_or_less = _check("must be positive", lambda values, solved: ~(values <= 0), physical=False)
numbers_if_solved = _check(
    "must be numbers where solved is 1, and NaN elsewhere",
    lambda values, solved: np.where(solved, np.isfinite(values), np.isnan(values)),
)
known_if_solved = _check(  # numbers, or infinite
    "must be NaN where solved is 0, only",
    lambda values, solved: np.isnan(values) != solved,
    physical=False,
)
missing_unless_solved = _check(
    "must be numbers or NaN where solved is 1, and NaN elsewhere",
    lambda values, solved: np.isnan(values) | (solved & np.isfinite(values)),
    physical=False,
)


@dataclass(frozen=True)
class Column(Validated):
    """One dataset of a results file.

    Parameters
    ----------
    name : attribute of a case, and name of the dataset unless `dataset` is given.
    axes : MAPS (frames, rows, columns), CELLS (rows, columns) or FRAMES. units, long_name :
        attributes in the file.
    value : estimates → values over the axes, or None without values; by default their attribute of
        the same name.
    checks : functions that return a fault of the values, the end of a sentence that begins with
        their path, or None.
    dtype : float, bool, an integer kind, or str.
    shared : whether it is a measurement, which all estimates of a recording share.
    as_volt : name of the dataset if the readout's unit is volt, which is then the unit; '' if the
        unit is fixed.
    flags : meanings of values that are no amounts: (value, a word of ASCII letters and _).

    Raises InputError where the name, the axes or a flag's word are invalid.

    >>> taken = lambda estimates: estimates.time
    >>> force = lampest.Column("force", ("time",), "newton", "total force", value=taken)
    >>> found.result(columns=[force]).extra["force"].shape
    (2,)
    """

    name: str
    axes: tuple[str, ...]
    units: str
    long_name: str
    value: Callable[[Estimates], ArrayLike | None] | None = None
    checks: tuple[Check, ...] = ()
    dtype: type[Any] = np.float64
    dataset: str = ""
    shared: bool = False
    as_volt: str = ""
    flags: tuple[tuple[int, str], ...] = ()

    def __post_init__(self) -> None:
        if not (self.path.isidentifier() and self.path.isascii()) or self.path in RESERVED:
            raise InputError(
                f"{self.path!r} cannot name a column: a word of ASCII letters is needed, none of "
                f"{RESERVED}"
            )
        if self.axes not in (MAPS, CELLS, FRAMES):
            raise InputError(
                f"the column {self.name} cannot lie along {self.axes}: only {MAPS}, {CELLS} or "
                f"{FRAMES}"
            )
        for _, word in self.flags:
            if not (word.isidentifier() and word.isascii()):
                raise InputError(
                    f"the column {self.name} says {word!r} of a value; a word of ASCII letters is "
                    "needed"
                )

    @property
    def path(self) -> str:
        """Name of the dataset."""
        return self.dataset or self.name

    @property
    def label(self) -> str:
        """Name in labelled arrays, tables and exports.

        It is that of the dataset, except for measurements.
        """
        return self.name if self.shared else self.path

    def of(self, readout: Readout) -> Column:
        """Return the column in the unit of a readout, 'ohm' or 'volt'."""
        follows = self.as_volt and readout.unit == "volt"
        return replace(self, dataset=self.as_volt, units=readout.unit) if follows else self

    def filled(self, estimates: Estimates) -> Any:
        """Return the values for a case: an array, a tuple of texts, or None."""
        values = getattr(estimates, self.name) if self.value is None else self.value(estimates)
        if values is None:
            return None
        return (
            tuple(np.asarray(values).tolist())
            if self.dtype is str
            else np.asarray(values, self.dtype)
        )

    def read(self, file: Any, group: str, sizes: Mapping[str, int], part: slice = hdf5.ALL) -> Any:
        """Read the values in a group of a file.

        Raises InputError for missing, damaged and unfit values.

        Parameters
        ----------
        file, group
            Open file and path of the group.
        sizes : mapping
            Axis → length.
        part : slice
            Frames that are read.
        """
        path = f"{group}/{self.path}"
        shape = tuple(sizes[axis] for axis in self.axes)
        part = part if self.axes[:1] == FRAMES else hdf5.ALL
        if self.dtype is str:
            return hdf5.read_texts(file, path, shape[0], part)
        integer = (
            None
            if np.dtype(self.dtype).kind == "f"
            else np.uint8
            if self.dtype is bool
            else self.dtype
        )
        return hdf5.read_array(file, path, len(shape), shape, part, integer).astype(self.dtype)


@dataclass(frozen=True, eq=False)
class Series:
    """Values of a case with their description, for files, labelled arrays, tables and exports.

    Attributes
    ----------
    name, units, long_name : str
    axes : tuple of str
        Some of time, row, column.
    values : array or texts
        Values over the axes.
    flags : tuple of (int, str)
        Values of a flag and their meanings.
    shared : bool
        True for measurements.
    dtype : type
    path : str
        Dataset in its group.
    """

    name: str
    axes: tuple[str, ...]
    values: Any
    units: str
    long_name: str
    flags: tuple[tuple[int, str], ...] = ()
    shared: bool = False
    dtype: type[Any] = np.float64
    path: str = ""

    @property
    def stored(self) -> Any:
        """Values for a file: texts in ASCII, truth values as 0 and 1."""
        if self.dtype is str:
            return hdf5.ascii_array(self.values)
        return np.asarray(self.values).astype(np.uint8 if self.dtype is bool else self.dtype)

    @property
    def meaning(self) -> str:
        """Long name with the meanings of a flag's values."""
        flags = "; ".join(f"{value}: {word.replace('_', ' ')}" for value, word in self.flags)
        return f"{self.long_name} ({flags})" if flags else self.long_name

    @property
    def attributes(self) -> dict[str, Any]:
        """Units, long name, and flags as the CF conventions have them (section 3.5)."""
        attributes = {"units": self.units, "long_name": self.long_name}
        if not self.flags:
            return attributes
        values = np.array(
            [value for value, _ in self.flags], dtype=np.uint8 if self.dtype is bool else self.dtype
        )
        return attributes | {
            "flag_values": values,
            "flag_meanings": " ".join(word for _, word in self.flags),
        }


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
_given = partial(_cells, shared=True)


def _flag(words: str, unset: str, then: str, **more: Any) -> Any:
    """Return a field of flags of cells."""
    return _maps("1", words, dtype=np.uint8, flags=((0, unset), (1, then)), **more)


def _deviation(units: str, words: str) -> Any:
    """Return a field of standard deviations of cells."""
    return _maps(units, words, not_negative, known_if_solved, default=None)


def _share(words: str, units: str = "1") -> Any:
    """Return an optional field of cells that is known where a frame is solved."""
    return _maps(units, words, known_if_solved, default=None)


def _attribute(name: str, source: str = "", default: Any = "", value: Any = None) -> Any:
    """Return a field that is an attribute of the estimator's group.

    It is omitted in the file at its default. Its value is that of estimates: a function of them, or
    the dotted name of an attribute.
    """
    return field(
        default=default,
        metadata={"attribute": name, "value": value or (attrgetter(source) if source else None)},
    )


def of_steps(value: Callable[[Step], ArrayLike]) -> Callable[[Estimates], Array]:
    """Return a function that stacks values of all steps, shape (frames, ...)."""
    return lambda done: np.stack([np.asarray(value(step)) for step in done.steps])


def _of_solutions(name: str) -> Callable[[Estimates], Array]:
    """Return a function that stacks an attribute of all solutions, shape (frames,)."""
    return of_steps(lambda step: getattr(step.solution, name))


def _of_witness(name: str, absent: float) -> Callable[[Estimates], Array | None]:
    """Return a function that stacks a field of the verifications, shape (frames,).

    None where no frame was verified.
    """

    def values(done: Estimates) -> Array | None:
        if all(step.verification is None for step in done.steps):
            return None
        return np.array([getattr(step.verification, name, absent) for step in done.steps])

    return values


def _frame_numbers(done: Estimates) -> NDArray[np.intp]:
    """Return indices into the recording, of which only a part may have been read."""
    return done.frame if done.recording.number is None else done.recording.number[done.frame]


def _unloaded_frames(done: Estimates) -> int:
    """Return the number of frames of which the baseline is the mean; 0 where none is unloaded."""
    return int(np.sum(done.recording.role == UNLOADED))


def _truth(done: Estimates) -> Array | None:
    """Return true cells, (frames, rows, columns) ohm, or None.

    NaN where the scene has no intact cell.
    """
    cells = done.recording.truth_cell_resistance
    return (
        None if cells is None else np.where(done.recording.scene.broken, np.nan, cells[done.frame])
    )


def _truth_baseline(done: Estimates) -> Array | None:
    """Return the mean of true unloaded cells, (rows, columns) ohm, or None.

    NaN without an intact cell.
    """
    cells = done.recording.truth_cell_resistance
    unloaded = done.recording.role == UNLOADED
    if cells is None or not np.any(unloaded):
        return None
    return np.where(done.recording.scene.broken, np.nan, cells[unloaded].mean(axis=0))


def _of_terms(
    done: Estimates, values: Sequence[Array] | Sequence[tuple[float, ...]]
) -> dict[str, Array]:
    """Map terms to values of all steps.

    Repeated kinds, which scripts can give, are `kind_2` and so on.
    """
    from lampest.cost.terms import term_kind  # with CasADi, which reading results does not need

    kinds = [term_kind(term) for term in done.estimator.terms]
    counts = [kinds[:number].count(kind) for number, kind in enumerate(kinds, 1)]
    names = [
        kind if count == 1 else f"{kind}_{count}" for kind, count in zip(kinds, counts, strict=True)
    ]
    return {name: np.array([step[number] for step in values]) for number, name in enumerate(names)}


def _costs(done: Estimates) -> dict[str, Array]:
    """Map terms to their costs in every frame."""
    return _of_terms(done, [step.solution.costs for step in done.steps])


def _weights(done: Estimates) -> dict[str, Array]:
    """Map terms to their weights in every frame."""
    return _of_terms(done, [step.weights for step in done.steps])


def _chosen(done: Estimates) -> dict[str, Array]:
    """Map terms with weights chosen by the data to the deviation of ln λ in every frame.

    It is the standard deviation.
    """
    size = len(done.estimator.terms)
    by_term = _of_terms(
        done, [np.array(step.weight_sigma or [np.nan] * size) for step in done.steps]
    )
    return {name: values for name, values in by_term.items() if np.isfinite(values).any()}


def _contacts(done: Estimates) -> dict[str, Array]:
    """Return contact resistances of the lines and their standard deviations.

    They are equal in all frames; empty if unknown.
    """
    if done.contacts is None:
        return {}
    shape = done.recording.scene.panel.shape
    per_frame = np.ones(len(done.steps))
    lines = [
        f"{side}_{line}"
        for side, count in zip(("row", "column"), shape, strict=True)
        for line in range(count)
    ]
    ohm = done.contacts.mean(shape)
    errors = done.contacts.deviation(shape)
    names = [*lines, *(f"{line}_errors" for line in lines)]
    return dict(zip(names, np.outer([*ohm, *errors], per_frame), strict=True))


def _of_contact(name: str) -> str:
    line = name.removesuffix("_errors")
    deviation = "" if name == line else "standard deviation of the "
    return f"{deviation}contact resistance of {line.replace('_', ' ')}"


@dataclass(frozen=True)
class Figures:
    """Columns over the frames whose names depend on the case, in a group of their own.

    Attributes
    ----------
    folder : str
        Group in the file.
    value : callable
        Estimates → name → values (frames).
    long_name : callable
        Name → description.
    units : str
    name : str
        Attribute of a case.
    """

    folder: str
    value: Callable[[Estimates], Mapping[str, Array]]
    long_name: Callable[[str], str]
    units: str = "1"
    name: str = ""


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


def _verdict(done: Estimates) -> ModelCheck:
    """Return the verdict on the scene's circuit."""
    # With all of the estimate, which the reading of results does without.
    from lampest.audit.verdict import verdict

    return verdict(done.model_check, done.prepared)


def _advice(done: Estimates) -> str:
    """Return the advice on the scene, one line each."""
    from lampest.audit.advice import Audit

    return "\n".join(finding.text for finding in Audit(done.prepared).advice)


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
    model_mark: str = _attribute("model_explains", value=lambda done: _verdict(done).mark)
    model_sentence: str = _attribute("model_check", value=lambda done: _verdict(done).sentence)
    advice: str = _attribute("advice", value=lambda done: _advice(done))
    noise_sentence: str = _attribute("noise_check", "noise.sentence")
    noise_learned: str = _attribute("noise_learned", "noise.summary")
    film_sentence: str = _attribute(
        "film", value=lambda done: "" if done.film is None else done.film.sentence
    )
    warnings: str = _attribute("warnings", value=lambda done: "\n".join(done.checks))
    reading_error: float = _attribute("reading_error", "noise.reading_error", 0.0)
    error_in_sigma: float = _attribute("reading_error_in_sigma", "noise.error_in_sigma", 0.0)
    model_factor: float = _attribute("model_factor", "noise.model_factor", 1.0)
    unloaded_frames: int = _attribute("unloaded_frames", default=0, value=_unloaded_frames)
    frame_noise: dict[str, Array] = field(default_factory=dict)
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
    sigma: Array | None = _maps(
        "ohm",
        "standard deviation of the reading",
        positive_or_infinite,
        as_volt="sigma",
        shared=True,
        default=None,
    )
    sigma_baseline: Array | None = _cells(
        "standard deviation of the baseline",
        positive_or_infinite,
        as_volt="sigma_baseline",
        shared=True,
        default=None,
    )
    reading_side: NDArray[np.int8] | None = _maps(
        "1",
        "0: a value; a bound: 1 the truth is at least this, -1 at most",
        value=lambda done: done.readings.side,
        dtype=np.int8,
        flags=((-1, "truth_is_at_most_this"), (0, "value"), (1, "truth_is_at_least_this")),
        shared=True,
        default=None,
    )
    missing_readings: NDArray[np.int64] | None = _counts(
        "readings that say nothing", shared=True, default=None
    )
    bound_readings: NDArray[np.int64] | None = _counts(
        "readings at a rail, zero, or below the series resistance", shared=True, default=None
    )
    truth: Array | None = _maps(
        "ohm", "true cell resistance", positive_or_missing, value=_truth, shared=True, default=None
    )
    truth_baseline: Array | None = _cells(
        "mean true unloaded cell resistance",
        positive_or_missing,
        value=_truth_baseline,
        shared=True,
        default=None,
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
        value=of_steps(lambda step: step.solution.reading[-1]),
        dataset="two_point_model",
        as_volt="reading_model",
    )
    reading_sigma: Array | None = _maps(
        "ohm",
        "standard deviation of a reading about the model's, noise and model error included",
        as_volt="reading_sigma",
        default=None,
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
    solver: tuple[str, ...] | None = _frames(
        "1",
        "solver that gave the estimate; empty where none did",
        dtype=str,
        value=lambda done: tuple(step.solution.solver for step in done.steps),
        default=None,
    )
    verified: NDArray[np.uint8] | None = _frames(
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
        default=None,
    )
    verified_difference: Array | None = _frames(
        "1",
        "largest difference of ln r from the second solve; NaN without one",
        value=_of_witness("difference", np.nan),
        default=None,
    )
    verified_decrease: Array | None = _frames(
        "1",
        "decrease of the cost by the second solve, relative to the first; 0 unless that was lower",
        value=_of_witness("decrease", 0.0),
        default=None,
    )
    starts: NDArray[np.int64] | None = _counts(
        "number of starts; the estimate is the best local optimum that they reached",
        value=_of_solutions("starts"),
        default=None,
    )
    solve_time: Array = _frames(
        "s", "wall time of the solve", value=of_steps(lambda step: step.seconds)
    )
    objective: Array = _frames("1", "value of the cost function", value=_of_solutions("objective"))
    kkt_residual: Array = _frames(
        "1", "violation of the optimality conditions", value=_of_solutions("kkt_residual")
    )
    solved: NDArray[np.bool_] = _frames(
        "1", "1: solved, 0: failed", dtype=bool, flags=((0, "failed"), (1, "solved"))
    )
    # The uncertainty of an estimate; absent where the noise is unknown or error bars were not
    # requested.
    cell_resistance_errors: Array | None = _deviation(
        "ohm", "posterior standard deviation of the cell resistance"
    )
    cell_resistance_lower: Array | None = _share("95 % interval, lower end", "ohm")
    cell_resistance_upper: Array | None = _share("95 % interval, upper end", "ohm")
    relative_change_errors: Array | None = _deviation(
        "percent", "posterior standard deviation of the relative change"
    )
    relative_change_lower: Array | None = _share("95 % interval, lower end", "percent")
    relative_change_upper: Array | None = _share("95 % interval, upper end", "percent")
    sigma_own: Array | None = _deviation("1", "standard deviation of ln r: each cell's own error")
    sigma_common: Array | None = _deviation(
        "1", "standard deviation of ln r: error common to all cells, or to those of a line"
    )
    resolution: Array | None = _share("diagonal of the averaging kernel")
    data_share: Array | None = _share("share of the estimate that comes from the data")
    error_bar_time: Array | None = _frames("s", "wall time of the error bars", default=None)
    baseline_resistance_errors: Array | None = _cells(
        "posterior standard deviation of the unloaded cell resistance", not_negative, default=None
    )
    # Pressures of the cells; absent without error bars, which the uncertainty of pressures
    # requires.
    pressure: Array | None = _share("pressure of the load on the cell", "kPa")
    pressure_errors: Array | None = _deviation("kPa", "standard deviation of the pressure")
    pressure_own: Array | None = _deviation(
        "kPa", "standard deviation of the pressure: each cell's own error"
    )
    pressure_common: Array | None = _deviation(
        "kPa", "standard deviation of the pressure: common error of all cells"
    )
    pressure_lower: Array | None = _share("95 % interval, lower end", "kPa")
    pressure_upper: Array | None = _share("95 % interval, upper end", "kPa")
    saturated: NDArray[np.uint8] | None = _flag(
        "1: the response leaves the pressure open",
        *("response_tells_pressure", "response_does_not_tell_pressure"),
        default=None,
    )
    pressing: NDArray[np.uint8] | None = _flag(
        "1: a load presses on the cell, beyond errors and what the film keeps of earlier loads",
        *("no_load_presses", "load_presses"),
        default=None,
    )
    tared: tuple[str, ...] | None = _frames(
        "1",
        "why the zero of pressures was taken anew after the frame; empty: it was not",
        dtype=str,
        default=None,
    )
    contacts: dict[str, Array] = _figures("contact", _contacts, _of_contact, "ohm")
    costs: dict[str, Array] = _figures("cost", _costs, "cost of the term {}".format)
    weights: dict[str, Array] = _figures("weight", _weights, "weight of the term {}".format)
    weight_sigma: dict[str, Array] = _figures(
        "weight_sigma",
        _chosen,
        "standard deviation of ln of the chosen weight of the term {}".format,
    )
    misfit: dict[str, Array] = _figures(
        "model_check", attrgetter("misfit"), lambda name: MISFIT.get(name, name)
    )
    extra: Mapping[str, Array] = field(default_factory=dict)
