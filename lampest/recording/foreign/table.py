"""A file as lines of fields, and the table of those lines that hold readings."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lampest.files.errors import InputError
from lampest.panel.panel import Array
from lampest.recording.foreign.numerals import Numerals


@dataclass(frozen=True, eq=False)
class Rows:
    """Lines of a file, cut into fields.

    fields : (lines, fields) texts, '' where a line ends earlier. counts : (lines) how many fields each has.
    comment : (lines) whether the line is marked as one. blank : (lines) whether an empty line stands before.
    stamps : (lines) when each came, as a terminal wrote it before the line, or ''.
    place : line, field or None → where in the file. called : line → 'line 3'.
    """

    source: str
    fields: NDArray[Any]
    counts: NDArray[np.intp]
    comment: NDArray[np.bool_]
    blank: NDArray[np.bool_]
    stamps: tuple[str, ...]
    place: Callable[[int, int | None], str]
    called: Callable[[int], str]
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ForeignTable:
    """The lines of a file that hold readings.

    fields, numbers, missing, words : (lines, width) texts, their numbers (NaN for none), whether a reading is said to
    be missing, and whether a text is none of both. counts : (lines) fields that each has. names : (width) of the
    columns, or None. apart : (lines) whether something else stands before the line, and titles : what. stamps, place,
    called, notes : see `Rows`.
    """

    source: str
    fields: NDArray[Any]
    numbers: Array
    missing: NDArray[np.bool_]
    words: NDArray[np.bool_]
    counts: NDArray[np.intp]
    names: tuple[str, ...] | None
    apart: NDArray[np.bool_]
    titles: tuple[str, ...]
    stamps: tuple[str, ...]
    numerals: Numerals
    place: Callable[[int, int | None], str]
    called: Callable[[int], str]
    notes: tuple[str, ...]

    @property
    def width(self) -> int:
        """How many fields a line has."""
        return int(self.fields.shape[1])

    def only(self, lines: NDArray[np.bool_], names: tuple[str, ...] | None = None) -> "ForeignTable":
        """The table with some of its lines; the others are what stands before the next one."""
        kept = [int(line) for line in np.flatnonzero(lines)]
        titles = []
        for before, line in zip([-1, *kept], kept, strict=False):
            between = [" ".join(self.fields[other]).strip() for other in range(before + 1, line)]
            titles.append(" ".join(filter(None, (*between, self.titles[line]))))
        passed = np.diff([-1, *kept]) > 1
        return replace(
            self,
            fields=self.fields[kept],
            numbers=self.numbers[kept],
            missing=self.missing[kept],
            words=self.words[kept],
            counts=self.counts[kept],
            names=names or self.names,
            apart=self.apart[kept] | passed,
            titles=tuple(titles),
            stamps=tuple(self.stamps[line] for line in kept),
            place=lambda line, field: self.place(kept[line], field),
            called=lambda line: self.called(kept[line]),
        )

    def without_empty(self) -> "ForeignTable":
        """The table without columns that have a name and nothing in any line, such as LabVIEW's comments."""
        filled = np.any(self.fields != "", axis=0)
        kept = [int(field) for field in np.flatnonzero(filled)]
        if self.names is None or len(kept) == self.width:
            return self
        empty = ", ".join(self.names[field] or "a column without a name" for field in np.flatnonzero(~filled))
        return replace(
            self,
            fields=self.fields[:, kept],
            numbers=self.numbers[:, kept],
            missing=self.missing[:, kept],
            words=self.words[:, kept],
            counts=np.minimum(self.counts, len(kept)),
            names=tuple(self.names[field] for field in kept),
            place=lambda line, field: self.place(line, None if field is None else kept[field]),
            notes=(*self.notes, f"empty columns left out: {empty}"),
        )

    def checked(self, columns: Sequence[int]) -> None:
        """Raise InputError with its place where a field of these columns is neither a number nor a missing reading."""
        chosen = self.words[:, columns]
        if np.any(chosen):
            line, number = (int(part) for part in np.argwhere(chosen)[0])
            shown, field = self.fields[line, columns[number]][:40], columns[number]
            raise InputError(f"{self.place(line, field)}: {shown!r} is no number (field {field + 1} of the line)")
