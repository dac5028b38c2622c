"""Frames in lines of readings, by what the lines themselves say.

Each line has keys: the frame's number, the time, a position (row, or cell) and a mark such as a
title before it. A frame is the longest run of lines in which no key begins again:

- the frame's number and a time that all lines of a frame share do not change,
- no title or blank line of those that stand between frames precedes a line,
- no position occurs again, or falls in the order in which positions are scanned,
- times of single lines do not jump by more than half a frame.

Keys are compared with the previous line only, and never sorted, so that they may wrap. Only lines
without any of these keys are counted.
"""

from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from math import inf, nan
from typing import NamedTuple

import numpy as np

from lampest.files.errors import first_and_more
from lampest.panel.panel import Mask

ANY = "any"  # title, in place of titles of one kind
MAX_VALUES = 8  # of a field that tells boards or trials apart

# Falls that orders of the scan may have less than the true one, which a frame that is cut at the
# beginning costs one: ascending, descending, another from the lowest position, or from the first.
UNUSUAL = (0.0, 0.0, 0.5, 2.0)
MIN_SHARE = 0.75  # of the runs of a key that must be whole frames; the others lost lines


class LineKeys(NamedTuple):
    """Keys of a line of readings, which tell its frame.

    Attributes
    ----------
    shared : hashable
        Number and time that all lines of a frame share; None where they are missing.
    position : int
        Row, or cell, of the line; -1 without one.
    marked : bool
        Whether a title or a blank line between frames precedes the line.
    seconds : float
        Time of the line alone in any unit; NaN without one.
    """

    shared: Hashable = None
    position: int = -1
    marked: bool = False
    seconds: float = nan


@dataclass(frozen=True)
class FrameEnds:
    """Rules by which a frame ends in a file or on a line.

    Attributes
    ----------
    lines : int
        Lines of a whole frame, usually.
    ranks : mapping
        Position → its place in the order of the scan; empty for lines without positions.
    shared : tuple of str
        Those of 'frame' and 'time' that all lines of a frame share.
    titles : frozenset of str
        Kinds of the titles between frames; ANY for titles and blank lines of any kind.
    max_step : float
        Largest step of the time within a frame; infinite where the time shows no end of a frame.
    gapless : bool
        Whether frames have lines of all positions, so that a gap shows lost lines.
    """

    lines: int
    ranks: Mapping[int, int] = field(default_factory=dict)
    shared: tuple[str, ...] = ()
    titles: frozenset[str] = frozenset()
    max_step: float = inf
    gapless: bool = False

    @property
    def counted(self) -> bool:
        """Whether nothing but the count of lines says where frames begin."""
        return not (self.ranks or self.shared or self.titles or self.max_step < inf)

    @property
    def title(self) -> str | None:
        """Kind of a title between frames; None for any kind."""
        kind = next(iter(self.titles), ANY)
        return None if kind == ANY else kind


# Lines of one frame: their numbers, as they were fed, and their keys.
Segment = Sequence[tuple[int, LineKeys]]


class Segmenter:
    """Division of lines that come one after the other into frames."""

    def __init__(self, ends: FrameEnds) -> None:
        self.ends = ends
        self._lines: list[tuple[int, LineKeys]] = []
        self._positions: set[int] = set()
        self._rank = -1  # of the last position
        self._shared: Hashable = None  # last known

    def feed(self, line: int, keys: LineKeys) -> Segment:
        """Take a line, and return the lines of the frame that ended before it, if one did."""
        ended = self.close() if self._lines and self._begins(keys) else ()
        self._lines.append((line, keys))
        self._shared = self._shared if keys.shared is None else keys.shared
        if keys.position in self.ends.ranks:
            self._positions.add(keys.position)
            self._rank = self.ends.ranks[keys.position]
        return ended

    @property
    def complete(self) -> bool:
        """Whether the lines since the last frame are a whole one that no line can continue."""
        if self.ends.ranks:
            return self.ends.gapless and len(self._positions) == self.ends.lines
        return self.ends.counted and len(self._lines) == self.ends.lines

    def close(self) -> Segment:
        """Return the lines since the last frame."""
        lines = self._lines
        self._lines = []
        self._positions = set()
        self._rank = -1
        return lines

    def _begins(self, keys: LineKeys) -> bool:
        """Return whether a line does not continue the frame of the previous ones."""
        ends = self.ends
        _, last = self._lines[-1]
        changed = keys.shared is not None and keys.shared != self._shared
        if changed or keys.marked or keys.seconds - last.seconds > ends.max_step:
            return True
        if not ends.ranks:
            return ends.counted and len(self._lines) == ends.lines
        rank = ends.ranks.get(keys.position, inf)  # a damaged name says nothing
        return keys.position in self._positions or (rank < self._rank and not ends.shared)


class Placed(NamedTuple):
    """Lines of one frame with their places in it.

    Attributes
    ----------
    begin : int
        First line of the segment.
    lines, positions : tuple of int
        Lines that hold the frame, and their positions; none if the frame is missing.
    remark : str
        What is missing; '' for a whole frame.
    """

    begin: int
    lines: tuple[int, ...]
    positions: tuple[int, ...]
    remark: str = ""


def placed(segment: Segment, ends: FrameEnds) -> Iterator[Placed]:
    """Yield the frames of a segment: usually one, several where marks between them are lost.

    Lines without a position take it from their number, if none is lost. Of lines with positions
    that share nothing else, one side of a gap may be of another frame: the longest side is kept.
    """
    lines = tuple(line for line, _ in segment)
    count = len(lines)
    whole = ends.lines
    if not ends.ranks:
        if count % whole:
            yield Placed(lines[0], (), (), f"has {count} of {whole} lines and is missing")
            return
        for first in range(0, count, whole):
            yield Placed(lines[first], lines[first : first + whole], tuple(range(whole)))
        return
    ranks = {
        at: ends.ranks[keys.position]
        for at, (_, keys) in enumerate(segment)
        if keys.position in ends.ranks
    }
    chosen = [*ranks]
    if not ends.shared and ends.gapless:
        # A line with a damaged name between two successive positions is of another frame: on a
        # side of it, lines and ranks rise by one.
        runs = groupby(
            enumerate(chosen), lambda item: (item[1] - item[0], ranks[item[1]] - item[0])
        )
        sides = [[at for _, at in run] for _, run in runs]
        chosen = max(sides, key=len, default=[])
        # Of two single lines one may have a damaged name.
        if len(sides) > 1 and len(chosen) == 1:
            chosen = []
    remark = f"has {len(chosen)} of {whole} lines" if len(chosen) < whole else ""
    positions = tuple(segment[at][1].position for at in chosen)
    yield Placed(lines[0], tuple(lines[at] for at in chosen), positions, remark)


def scan_order(positions: Sequence[int], parts: Mask) -> Mapping[int, int]:
    """Return positions with their ranks in the order in which they are scanned.

    The order is ascending or descending, or another one that parts between marks, or the lines
    until a position occurs again, show most often. Such an order begins with the lowest position,
    or with that of the first line.

    Parameters
    ----------
    positions : sequence of int
        Position of each line; -1 for none.
    parts : boolean array, shape (lines,)
        Lines at which a frame begins for certain.
    """
    read = [
        (position, bool(new))
        for position, new in zip(positions, parts, strict=True)
        if position >= 0
    ]
    ascending = sorted({position for position, _ in read})
    orders: list[Sequence[int]] = [ascending, ascending[::-1]]
    # Positions of lines up to one that occurs again, or before which a part begins.
    sequences: list[list[int]] = [[]]
    for position, new in read:
        if new or position in sequences[-1]:
            sequences.append([])
        sequences[-1].append(position)
    cycles = Counter(
        _beginning_with(ascending[0], tuple(order))
        for order in sequences
        if len(order) == len(ascending)
    )
    for order, _ in cycles.most_common(1):
        orders += [order, _beginning_with(read[0][0], order)]
    ranks = [{position: rank for rank, position in enumerate(order)} for order in orders]
    costs = [
        sum(
            rank[position] <= rank[last] and not new
            for (last, _), (position, new) in pairwise(read)
        )
        + unusual
        for rank, unusual in zip(ranks, UNUSUAL, strict=False)
    ]
    return ranks[int(np.argmin(costs))]


def _beginning_with(position: int, order: tuple[int, ...]) -> tuple[int, ...]:
    """Return a cyclic order from a position on."""
    at = order.index(position)
    return order[at:] + order[:at]


def are_whole(changes: Mask, lines: int) -> bool:
    """Return whether most runs between changes of a key, (lines,), are whole frames."""
    begins = np.flatnonzero(changes[1:]) + 1
    runs = np.diff([0, *begins, len(changes)])
    inner = runs[1:-1] if len(runs) > 2 else runs
    return len(runs) > 1 and bool(np.mean(inner == lines) >= MIN_SHARE) and lines > 1


def changes_of(texts: Sequence[str]) -> Mask:
    """Return whether a text differs from that of the previous line, boolean (lines,)."""
    return np.array([False, *(text != last for last, text in pairwise(texts))])


def few_values(texts: Sequence[str]) -> list[str]:
    """Return the values of a field that takes a few, as of boards or trials; none of another."""
    values = sorted(set(texts) - {""})
    return values if 1 < len(values) <= min(MAX_VALUES, len(texts) // 2) else []


def alternate(texts: Sequence[str]) -> bool:
    """Return whether lines or frames of several values stand among each other."""
    return 2 * int(changes_of(texts).sum()) >= len(texts)


def unused_note(name: str, values: Sequence[str]) -> str:
    """Return the sentence on a field that nothing uses and that takes a few values."""
    return (
        f"{name!r} is not used and takes {len(values)} values ({first_and_more(values, 3)}): "
        "are these several boards or trials?"
    )


def several_sources(name: str, values: Sequence[str]) -> str:
    """Return the sentence on a field that tells lines or frames of several boards apart."""
    return (
        f"{name or 'this field'!r} takes the values {first_and_more(values, 3)} in turn, as of "
        "several boards in one file; import those of one board alone"
    )
