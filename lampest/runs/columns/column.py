"""A column of results: where it stands in the file, what it means, how it is filled and when it is wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lampest.files.errors import InputError
from lampest.files.hdf5 import ALL, ascii_array, read_array, read_texts, read_whole
from lampest.files.typed import Validated
from lampest.panel.panel import Array
from lampest.panel.readouts.readout import Readout

if TYPE_CHECKING:  # what reads results need not load what solves
    from lampest.estimate.estimates import Estimates
    from lampest.estimate.state import Step

MAPS = ("time", "row", "column")
FRAMES, CELLS = MAPS[:1], MAPS[1:]
# What the groups of a results file hold besides columns.
RESERVED = (*CELLS, "x", "y", "scene", "start_time", "cost", "weight", "disc", "model_check")

Solved = NDArray[np.bool_]  # (frames)
Check = Callable[[Any, Solved], str | None]


def _everywhere(right: Callable[[Array], Any], said: str) -> Check:
    """A check of each value."""
    return lambda values, solved: None if np.all(right(np.asarray(values))) else said


def _framewise(right: Callable[[Array, Solved], Any], said: str) -> Check:
    """A check of the values (frames, all others) and whether each frame was solved."""
    return lambda values, solved: None if np.all(right(np.reshape(values, (len(solved), -1)), solved)) else said


finite = _everywhere(np.isfinite, "must be finite")
positive = _everywhere(lambda values: np.isfinite(values) & (values > 0), "must be positive and finite everywhere")
positive_or_missing = _everywhere(
    lambda values: np.isnan(values) | (np.isfinite(values) & (values > 0)), "must be positive and finite, or NaN"
)
positive_or_infinite = _everywhere(lambda values: values > 0, "must be positive everywhere")
not_negative = _everywhere(lambda values: ~(values < 0), "must not be negative")
not_zero_or_less = _everywhere(lambda values: ~(values <= 0), "must be positive")
numbers_if_solved = _framewise(
    lambda values, solved: np.where(solved, np.isfinite(values).all(axis=1), np.isnan(values).all(axis=1)),
    "must be numbers where solved is 1, and NaN elsewhere",
)
known_if_solved = _framewise(  # numbers, or infinite
    lambda values, solved: np.where(solved, ~np.isnan(values).any(axis=1), np.isnan(values).all(axis=1)),
    "must be NaN where solved is 0, only",
)
whole_frames_if_solved = _framewise(
    lambda values, solved: np.isnan(values).all(axis=1) | (solved & np.isfinite(values).all(axis=1)),
    "must be numbers or NaN throughout where solved is 1, and NaN elsewhere",
)


@dataclass(frozen=True)
class Column(Validated):
    """One dataset of a results file.

    Parameters
    ----------
    name : what a case calls it, and the file too unless `dataset` says otherwise.
    axes : MAPS (frames, rows, columns), CELLS (rows, columns) or FRAMES. units, long_name : as the file gives them.
    value : estimates → values over the axes, or None where there are none; by default their attribute of the same name.
    checks : each says what is wrong with values: the end of a sentence that begins with their path, or None.
    dtype : float, bool, an integer kind, or str.
    shared : True for what was measured: every estimate of a recording was given the same.
    as_volt : (dataset, long name) where the readout gives volt; none for what does not follow the readout's unit.
    flags : what each value means where values are no amounts: (value, a word of ASCII letters and _).

    Raises InputError where the name, the axes or a flag's word are unfit.

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
    as_volt: tuple[str, str] = ("", "")
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
        """The name of the dataset."""
        return self.dataset or self.name

    @property
    def label(self) -> str:
        """The name in labelled arrays, tables and exports: the dataset's, but for what was measured."""
        return self.name if self.shared else self.path

    @property
    def attributes(self) -> dict[str, Any]:
        """What files and labelled arrays say of the values; flags as the CF conventions have them."""
        return {"units": self.units, "long_name": self.long_name} | flag_attributes(self.flags, self.dtype)

    def of(self, readout: Readout) -> Column:
        """The same column as a readout's unit, 'ohm' or 'volt', asks for it."""
        dataset, long_name = self.as_volt
        if readout.unit == "ohm" or not dataset:
            return self
        return replace(self, dataset=dataset, units=readout.unit, long_name=long_name)

    def filled(self, estimates: Estimates) -> Any:
        """The values as a case holds them: an array, a tuple of texts, or None where there are none."""
        values = getattr(estimates, self.name) if self.value is None else self.value(estimates)
        if values is None:
            return None
        return tuple(np.asarray(values).tolist()) if self._kind == "U" else np.asarray(values, self.dtype)

    def stored(self, values: Any) -> Any:
        """The values as HDF5 holds them: texts in ASCII, truth values as 0 and 1."""
        if self._kind == "U":
            return ascii_array(values)
        return np.asarray(values).astype(np.uint8 if self._kind == "b" else self.dtype)

    def read(self, file: Any, group: str, sizes: Mapping[str, int], part: slice = ALL) -> Any:
        """The values in a group of a file, as a case holds them; sizes : axis → length. part : of the frames.

        Raises InputError where they are missing, damaged, of another shape or no such values.
        """
        path, shape = f"{group}/{self.path}", tuple(sizes[axis] for axis in self.axes)
        part = part if self.axes[:1] == FRAMES else ALL
        if self._kind == "U":
            return read_texts(file, path, shape[0], part)
        if self._kind == "f":
            return read_array(file, path, len(shape), shape, part).astype(self.dtype)
        stored = np.uint8 if self._kind == "b" else self.dtype
        return read_whole(file, path, stored, len(shape), shape, part).astype(self.dtype)

    @property
    def _kind(self) -> str:
        """numpy's letter: f, i or u, b, U for texts."""
        return np.dtype(self.dtype).kind


@dataclass(frozen=True)
class Figures:
    """Columns over the frames whose names only a case knows, in a folder of their own.

    name : what a case calls them. folder : the file. value : estimates → name → (frames).
    long_name, units : of the figure of a name.
    """

    name: str
    folder: str
    value: Callable[[Estimates], Mapping[str, Array]]
    long_name: Callable[[str], str]
    units: Callable[[str], str] = lambda name: "1"


def flag_attributes(flags: Sequence[tuple[int, str]], dtype: type[Any]) -> dict[str, Any]:
    """flag_values and flag_meanings of the CF conventions (section 3.5); none where there are no flags."""
    if not flags:
        return {}
    values = np.array([value for value, _ in flags], dtype=np.uint8 if dtype is bool else dtype)
    return {"flag_values": values, "flag_meanings": " ".join(word for _, word in flags)}


def of_steps(value: Callable[[Step], ArrayLike]) -> Callable[[Estimates], Array]:
    """(frames, ...) of what every step says."""
    return lambda estimates: np.stack([np.asarray(value(step)) for step in estimates.steps])
