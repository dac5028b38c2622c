"""Columns of a results file, with their axes, units, checks and values.

A package adds columns by naming them in the entry point group `lampest.columns`, a script by
handing them to `named_result`, `write_results` and `read_results`. The columns of every case are
declared in `lampest.runs.content`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from lampest.files import hdf5
from lampest.files.errors import InputError
from lampest.files.typed import Validated
from lampest.panel.panel import Array, Mask, beyond_any_panel
from lampest.panel.readouts.readout import Readout

if TYPE_CHECKING:  # readers of results need not load the solvers
    from lampest.estimate.estimates import Estimates

FRAMES = ("time",)
CELLS = ("row", "column")
MAPS = FRAMES + CELLS
# Names in the groups of a results file that are no columns.
RESERVED = (
    *CELLS,
    "x",
    "y",
    "z",
    "scene",
    "start_time",
    "cost",
    "weight",
    "weight_sigma",
    "model_check",
)

# (values, mask of expected estimates) → fault, the end of a sentence that begins with the path;
# None: no fault.
Check = Callable[[Any, Mask], str | None]


def possible(values: Array, solved: Mask) -> str | None:
    """Return a fault if a number exceeds that of any panel."""
    beyond = np.asarray(values)[beyond_any_panel(values)]
    return f"holds {beyond[0]:.6g}, which no panel has" if beyond.size else None


def _check(sentence: str, right: Callable[[Array, Mask], Any], *, physical: bool = True) -> Check:
    """Return a check of values, which must also be possible if they are physical."""

    def fault(values: Any, solved: Mask) -> str | None:
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
    values : the values of a case over the axes, an array or texts; None in a declaration. Files,
        labelled arrays, tables and exports are made of columns with values.

    Raises InputError where the name, the axes or a flag's word are invalid.

    >>> rod = lampest.Rod(centre_mm=(10, 5), diameter_mm=15, mass_g=100)
    >>> scene = lampest.Scene(lampest.Panel(2, 3), lampest.TwoPointReadout(), 140.0)
    >>> of_rod = lampest.Simulation(1, 1, scene, baseline_frames=2, frames=2, loads=(rod,))
    >>> recording = lampest.simulate(of_rod, "mine")
    >>> estimate = lampest.reconstruct(recording, [lampest.Misfit()])
    >>> import operator
    >>> taken = operator.attrgetter("time")
    >>> force = lampest.Column("force", ("time",), "newton", "total force", value=taken)
    >>> estimate.result(columns=[force]).extra["force"].shape
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
    values: Any = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if not (self.path.isidentifier() and self.path.isascii()) or self.path in RESERVED:
            raise InputError(
                f"{self.path!r} cannot name a column: "
                f"a word of ASCII letters is needed, none of {RESERVED}"
            )
        if self.axes not in (MAPS, CELLS, FRAMES):
            raise InputError(
                f"the column {self.name} cannot lie along {self.axes}: "
                f"only {MAPS}, {CELLS} or {FRAMES}"
            )
        for _, word in self.flags:
            if not (word.isidentifier() and word.isascii()):
                raise InputError(
                    f"the column {self.name} says {word!r} of a value; "
                    "a word of ASCII letters is needed"
                )

    @property
    def path(self) -> str:
        """Name of the dataset."""
        return self.dataset or self.name

    @property
    def label(self) -> str:
        """Name in labelled arrays, tables and exports: the dataset's, but `name` if shared.

        Figures in a folder are called `cost_misfit`.
        """
        return self.name if self.shared else self.path.replace("/", "_")

    @property
    def stored_dtype(self) -> type:
        """Type of numbers in a file, where truth values are 0 and 1."""
        return np.uint8 if self.dtype is bool else self.dtype

    @property
    def stored(self) -> Any:
        """Values for a file: texts in ASCII, truth values as 0 and 1."""
        if self.dtype is str:
            return hdf5.ascii_array(self.values)
        return np.asarray(self.values).astype(self.stored_dtype)

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
        return attributes | {
            "flag_values": np.array([value for value, _ in self.flags], dtype=self.stored_dtype),
            "flag_meanings": " ".join(word for _, word in self.flags),
        }

    def of(self, readout: Readout) -> Column:
        """Return the column in the unit of a readout, 'ohm' or 'volt'."""
        follows = self.as_volt and readout.unit == "volt"
        return replace(self, dataset=self.as_volt, units=readout.unit) if follows else self

    def filled(self, estimates: Estimates) -> Any:
        """Return the values for a case: an array, a tuple of texts, or None."""
        values = getattr(estimates, self.name) if self.value is None else self.value(estimates)
        if values is None:
            return None
        if self.dtype is str:
            return tuple(np.asarray(values).tolist())
        return np.asarray(values, self.dtype)

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
        integer = None if np.dtype(self.dtype).kind == "f" else self.stored_dtype
        return hdf5.read_array(file, path, len(shape), shape, part, integer).astype(self.dtype)


Columns = Sequence[Column]


class ReservedColumn(Column):
    """A column under a name that no package may use: a coordinate, or figures in a folder."""

    def __post_init__(self) -> None:
        pass


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

    def column(self, figure: str, values: Array) -> Column:
        """Return the column of a figure, which lies along the frames."""
        dataset = f"{self.folder}/{figure}"
        words = self.long_name(figure)
        return ReservedColumn(figure, FRAMES, self.units, words, dataset=dataset, values=values)
