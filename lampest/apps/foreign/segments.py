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

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

MIN_SHARE = 0.75  # of the runs of a key that must be whole frames; the others lost lines


class LineKeys(NamedTuple):
    """What a line of readings says about its frame.

    Attributes
    ----------
    shared : hashable
        Number and time that all lines of a frame share; None without them.
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
    seconds: float = float("nan")


@dataclass(frozen=True)
class FrameEnds:
    """What ends a frame in a file or on a line.

    Attributes
    ----------
    lines : int
        Lines of a whole frame.
    ranks : mapping
        Position → its place in the order of the scan; empty for lines without positions.
    shared : bool
        Whether all lines of a frame share a number or a time.
    marked : bool
        Whether titles or blank lines stand between frames.
    max_step : float
        Largest step of the time within a frame.
    """

    lines: int
    ranks: Mapping[int, int] = field(default_factory=dict)
    shared: bool = False
    marked: bool = False
    max_step: float = float("inf")

    @property
    def counted(self) -> bool:
        """Whether nothing but the count of lines says where frames begin."""
        return not (self.ranks or self.shared or self.marked)


class Segment(NamedTuple):
    """Lines of one frame.

    Attributes
    ----------
    lines : tuple of int
        Numbers of the lines, as they were fed.
    keys : tuple of LineKeys
    """

    lines: tuple[int, ...]
    keys: tuple[LineKeys, ...]


class Segmenter:
    """Division of lines that come one after the other into frames."""

    def __init__(self, ends: FrameEnds) -> None:
        self.ends = ends
        self._lines: list[int] = []
        self._keys: list[LineKeys] = []
        self._positions: set[int] = set()

    def feed(self, line: int, keys: LineKeys) -> Segment | None:
        """Take a line, and return the lines of the frame that ended before it, if one did."""
        ended = self.close() if self._lines and self._begins(keys) else None
        self._lines.append(line)
        self._keys.append(keys)
        self._positions.add(keys.position)
        return ended

    @property
    def complete(self) -> bool:
        """Whether the lines since the last frame are a whole one that no line can continue."""
        if self.ends.ranks:
            return len(self._positions) == len(self.ends.ranks)
        return self.ends.counted and len(self._lines) == self.ends.lines

    def close(self) -> Segment | None:
        """Return the lines since the last frame; None without any."""
        segment = Segment(tuple(self._lines), tuple(self._keys)) if self._lines else None
        self._lines = []
        self._keys = []
        self._positions = set()
        return segment

    def _begins(self, keys: LineKeys) -> bool:
        """Return whether a line does not continue the frame of the previous ones."""
        ends = self.ends
        last = self._keys[-1]
        if keys.marked or keys.shared != last.shared:
            return True
        if keys.seconds - last.seconds > ends.max_step:
            return True
        if not ends.ranks:
            return ends.counted and len(self._lines) == ends.lines
        falls = ends.ranks.get(keys.position, -1) < ends.ranks.get(last.position, -1)
        return keys.position in self._positions or (falls and not ends.shared)
