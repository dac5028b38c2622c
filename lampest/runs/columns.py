"""Columns of results: dataset, meaning, values and validation.

Those of lampest are the fields of `lampest.runs.case.CaseResult`. A package adds further ones by naming them in the
entry point group `lampest.columns`, a script by handing them to `named_result`, `write_results` and `read_results`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.typed import Validated
from lampest.panel.panel import Array, beyond_any_panel
from lampest.panel.readouts.readout import Readout
from lampest.recording.recording import UNLOADED

if TYPE_CHECKING:  # readers of results need not load the solvers
    from lampest.estimate.estimates import Estimates
    from lampest.estimate.state import Step

FRAMES, CELLS = ("time",), ("row", "column")
MAPS = FRAMES + CELLS
# Names in the groups of a results file that are no columns.
RESERVED = (*CELLS, "x", "y", "scene", "start_time", "cost", "weight", "weight_sigma", "model_check")

# (values, mask of expected estimates) → fault, the end of a sentence that begins with the path; None: no fault.
Check = Callable[[Any, NDArray[np.bool_]], str | None]


def _unless(right: Callable[[Array, NDArray[np.bool_]], Any], said: str) -> Check:
    return lambda values, solved: None if np.all(right(np.asarray(values), solved)) else said


def possible(values: Array, solved: NDArray[np.bool_]) -> str | None:
    """Return a fault if a number exceeds that of any panel."""
    beyond = np.asarray(values)[beyond_any_panel(values)]
    return f"holds {beyond[0]:.6g}, which no panel has" if beyond.size else None


def _physical(right: Callable[[Array, NDArray[np.bool_]], Any], said: str) -> Check:
    """Return a check of measured or comparable values, which must be possible, too."""
    return lambda values, solved: possible(values, solved) or _unless(right, said)(values, solved)


finite = _physical(lambda values, solved: np.isfinite(values), "must be finite")
positive = _physical(lambda values, solved: (values > 0) & (values < np.inf), "must be positive and finite everywhere")
positive_or_missing = _physical(
    lambda values, solved: np.isnan(values) | ((values > 0) & (values < np.inf)), "must be positive and finite, or NaN"
)
positive_or_infinite = _physical(lambda values, solved: values > 0, "must be positive everywhere")
not_negative = _unless(lambda values, solved: ~(values < 0), "must not be negative")
not_zero_or_less = _unless(lambda values, solved: ~(values <= 0), "must be positive")
numbers_if_solved = _physical(
    lambda values, solved: np.where(solved, np.isfinite(values), np.isnan(values)),
    "must be numbers where solved is 1, and NaN elsewhere",
)
known_if_solved = _unless(  # numbers, or infinite
    lambda values, solved: np.isnan(values) != solved, "must be NaN where solved is 0, only"
)
missing_unless_solved = _unless(
    lambda values, solved: np.isnan(values) | (solved & np.isfinite(values)),
    "must be numbers or NaN where solved is 1, and NaN elsewhere",
)


@dataclass(frozen=True)
class Column(Validated):
    """One dataset of a results file.

    Parameters
    ----------
    name : attribute of a case, and name of the dataset unless `dataset` is given.
    axes : MAPS (frames, rows, columns), CELLS (rows, columns) or FRAMES. units, long_name : attributes in the file.
    value : estimates → values over the axes, or None without values; by default their attribute of the same name.
    checks : functions that return a fault of the values, the end of a sentence that begins with their path, or None.
    dtype : float, bool, an integer kind, or str.
    shared : whether it is a measurement, which all estimates of a recording share.
    as_volt : name of the dataset if the readout's unit is volt, which is then the unit; '' if the unit is fixed.
    flags : meanings of values that are no amounts: (value, a word of ASCII letters and _).

    Raises InputError where the name, the axes or a flag's word are invalid.

    >>> force = lampest.Column("force", ("time",), "newton", "total force", value=lambda estimates: estimates.time)
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
                f"{self.path!r} cannot name a column: a word of ASCII letters is needed, none of {RESERVED}"
            )
        if self.axes not in (MAPS, CELLS, FRAMES):
            raise InputError(f"the column {self.name} cannot lie along {self.axes}: only {MAPS}, {CELLS} or {FRAMES}")
        for _, word in self.flags:
            if not (word.isidentifier() and word.isascii()):
                raise InputError(f"the column {self.name} says {word!r} of a value; a word of ASCII letters is needed")

    @property
    def path(self) -> str:
        """Name of the dataset."""
        return self.dataset or self.name

    @property
    def label(self) -> str:
        """Name in labelled arrays, tables and exports: that of the dataset, except for measurements."""
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
        return tuple(np.asarray(values).tolist()) if self.dtype is str else np.asarray(values, self.dtype)

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
        path, shape = f"{group}/{self.path}", tuple(sizes[axis] for axis in self.axes)
        part = part if self.axes[:1] == FRAMES else hdf5.ALL
        if self.dtype is str:
            return hdf5.read_texts(file, path, shape[0], part)
        whole = None if np.dtype(self.dtype).kind == "f" else np.uint8 if self.dtype is bool else self.dtype
        return hdf5.read_array(file, path, len(shape), shape, part, whole).astype(self.dtype)


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
        values = np.array([value for value, _ in self.flags], dtype=np.uint8 if self.dtype is bool else self.dtype)
        return attributes | {"flag_values": values, "flag_meanings": " ".join(word for _, word in self.flags)}


def declared(axes: tuple[str, ...], units: str, words: str, *checks: Check, default: Any = MISSING, **more: Any) -> Any:
    """Return a dataclass field that is a column, optional if `default` is None; `more` are arguments of `Column`."""
    about = {"axes": axes, "units": units, "long_name": words, "checks": checks} | more
    return field(default=default, metadata={"column": about})


maps, frames, cells = partial(declared, MAPS), partial(declared, FRAMES), partial(declared, CELLS, "ohm")
counts = partial(frames, "1", dtype=np.int64)


def flag(words: str, unset: str, then: str, **more: Any) -> Any:
    """Return a field of flags of cells."""
    return maps("1", words, dtype=np.uint8, flags=((0, unset), (1, then)), **more)


def deviation(units: str, words: str) -> Any:
    """Return a field of standard deviations of cells."""
    return maps(units, words, not_negative, known_if_solved, default=None)


def end(units: str, which: str) -> Any:
    """Return a field of interval ends of cells."""
    return maps(units, f"95 % interval, {which} end", known_if_solved, default=None)


def of_steps(value: Callable[[Step], ArrayLike]) -> Callable[[Estimates], Array]:
    """Return a function that stacks values of all steps, shape (frames, ...)."""
    return lambda estimates: np.stack([np.asarray(value(step)) for step in estimates.steps])


def of_solutions(name: str) -> Callable[[Estimates], Array]:
    """Return a function that stacks an attribute of all solutions, shape (frames,)."""
    return of_steps(lambda step: getattr(step.solution, name))


def frame_numbers(done: Estimates) -> NDArray[np.intp]:
    """Return indices into the recording, of which only a part may have been read."""
    return done.frame if done.recording.number is None else done.recording.number[done.frame]


def truth(done: Estimates) -> Array | None:
    """Return true cells, (frames, rows, columns) ohm, or None."""
    cells = done.recording.truth_cell_resistance
    return None if cells is None else cells[done.frame]


def truth_baseline(done: Estimates) -> Array | None:
    """Return the mean of true unloaded cells, (rows, columns) ohm, or None."""
    cells, unloaded = done.recording.truth_cell_resistance, done.recording.role == UNLOADED
    return cells[unloaded].mean(axis=0) if cells is not None and np.any(unloaded) else None


@dataclass(frozen=True)
class Figures:
    """Columns over the frames whose names depend on the case, in a group of their own.

    Attributes
    ----------
    name : str
        Attribute of a case.
    folder : str
        Group in the file.
    value : callable
        Estimates → name → values (frames).
    long_name, units : callable
        Name → description and unit.
    """

    name: str
    folder: str
    value: Callable[[Estimates], Mapping[str, Array]]
    long_name: Callable[[str], str]
    units: Callable[[str], str] = lambda name: "1"


def _of_terms(done: Estimates, values: Sequence[Array] | Sequence[tuple[float, ...]]) -> dict[str, Array]:
    """Map terms to values of all steps; repeated kinds, which scripts can give, are `kind_2` and so on."""
    from lampest.cost.terms import term_kind  # with CasADi, which reading results does not need

    kinds = [term_kind(term) for term in done.estimator.terms]
    counts = [kinds[:number].count(kind) for number, kind in enumerate(kinds, 1)]
    names = [kind if count == 1 else f"{kind}_{count}" for kind, count in zip(kinds, counts, strict=True)]
    return {name: np.array([step[number] for step in values]) for number, name in enumerate(names)}


def _chosen(done: Estimates) -> dict[str, Array]:
    """Map terms with weights chosen by the data to the standard deviation of ln λ in every frame."""
    size = len(done.estimator.terms)
    by_term = _of_terms(done, [np.array(step.weight_sigma or [np.nan] * size) for step in done.steps])
    return {name: values for name, values in by_term.items() if np.isfinite(values).any()}


def _contacts(done: Estimates) -> dict[str, Array]:
    """Return contact resistances of the lines and their standard deviations, equal in all frames; empty if unknown."""
    if done.contacts is None:
        return {}
    shape, every = done.recording.scene.panel.shape, np.ones(len(done.steps))
    lines = [f"{side}_{line}" for side, count in zip(("row", "column"), shape, strict=True) for line in range(count)]
    ohm, errors = done.contacts.mean(shape), done.contacts.deviation(shape)
    return dict(zip(lines, np.outer(ohm, every), strict=True)) | {
        f"{line}_errors": error * every for line, error in zip(lines, errors, strict=True)
    }


def _of_contact(name: str) -> str:
    line = name.removesuffix("_errors")
    deviation = "" if name == line else "standard deviation of the "
    return f"{deviation}contact resistance of {line.replace('_', ' ')}"


MISFIT = {
    "chi_square": "sum of squared residuals over their noise",
    "degrees_of_freedom": "readings less the trace of the resolution",
    "tail": "probability of a chi square this large from noise alone",
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
    Figures(
        "weight_sigma",
        "weight_sigma",
        _chosen,
        lambda name: f"standard deviation of ln of the chosen weight of the term {name}",
    ),
    Figures("misfit", "model_check", lambda done: done.misfit, lambda name: MISFIT.get(name, name)),
)
