"""Frames of a board that prints text, line after line, as the import understands a file of them."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lampest.apps.foreign.arrays import Shape
from lampest.apps.foreign.clocks import clock_of
from lampest.apps.foreign.division import learned_ends, line_keys, refuse_several_boards
from lampest.apps.foreign.form import later_lines, readings_table
from lampest.apps.foreign.layouts import TableLayout, arranged
from lampest.apps.foreign.lines import WRITTEN, field_lines_in, notation_of
from lampest.apps.foreign.notation import Notation
from lampest.apps.foreign.segments import FrameEnds, Placed, Segment, Segmenter, placed
from lampest.apps.foreign.table import ReadingsTable, Stamps
from lampest.files.errors import InputError
from lampest.panel.panel import Array, Modules

MIN_FRAMES = 3  # whole ones, from which the layout is understood
MIN_COUNTED = 8  # frames, where nothing but the number of lines says where they end
MAX_LINES = 5000  # that are kept until the layout is understood
FIRST_TRY = 8  # lines; each later try has a quarter more
MAX_WORDS = 0.5  # of the first readings of a cell; later a damaged one is missing
MAX_BETWEEN = 100  # titles that are kept before a line of readings


class TextFrame(NamedTuple):
    """Frame that a board printed.

    Attributes
    ----------
    values : array, shape (rows, columns)
        Numbers as printed; NaN where a reading is missing.
    seconds : float or None
        Time since the first frame in s by the board's own stamps, or by a terminal's; None where
        the lines carry none, and where the board's clock began again.
    number : int or None
        The board's own number of the frame, as printed; None without one.
    remarks : tuple of str
        Sentences on lines of this frame that are missing or left out; usually empty.
    """

    values: Array
    seconds: float | None
    number: int | None
    remarks: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Understanding:
    """Layout of lines, settled on the first ones.

    Attributes
    ----------
    notation : Notation
    table : ReadingsTable
        The first lines.
    arrangement : TableLayout
    ends : FrameEnds
    name : str
        Name of the times, which may contain their unit.
    unit : str or None
        Unit of times that are numbers.
    """

    notation: Notation
    table: ReadingsTable
    arrangement: TableLayout
    ends: FrameEnds
    name: str = ""
    unit: str | None = None

    def stamp(self, table: ReadingsTable, row: int = 0) -> Stamps | None:
        """Return the time of a line of a table; None without one."""
        return table.times(self.arrangement.times, [row], self.ends.title)

    def with_times(self) -> "Understanding":
        """Return the understanding with the unit of the times."""
        lines = range(1, len(self.table.lines))
        read = [*filter(None, (self.stamp(self.table.only([line])) for line in lines))]
        if not read:
            return self
        texts = list(dict.fromkeys(stamps.texts[0] for stamps in read))
        name = read[0].name
        with suppress(InputError):
            clock = clock_of(texts, name, str, comma=self.table.comma, unit=None)
            return replace(self, name=name, unit=clock.unit)
        return self

    def step(self, last: str, stamp: str) -> float | None:
        """Return the time in s from a stamp to a later one; None if it is none, or falls."""
        try:
            clock = clock_of([last, stamp], self.name, str, comma=self.table.comma, unit=self.unit)
        except InputError:
            return None
        return float(clock.seconds[1] - clock.seconds[0])


class LineReader:
    """Frames from lines of text that come one after the other.

    A live reader makes one for a panel, feeds it every line of the port or socket without its end,
    and takes the frames that come back. The first lines are kept until they show the layout: then
    `sentences` says how they were understood, and their frames are returned together. From then on
    a frame is returned with the line that completes it, or with the first line of the next frame
    where only that one shows that it ended.

        reader = LineReader((16, 16), source="/dev/ttyUSB0")
        for line in lines_of_the_port:
            for frame in reader.feed(line):
                ...  # frame.values, frame.seconds, frame.number, frame.remarks
        for frame in reader.close():  # at the end of a file or of the connection
            ...

    `words` are the names of columns, which may contain the unit of the numbers:
    `understood_unit(values, None, reader.words, scene, source)` decides it.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the panel.
    source : str
        Name of the port for messages.
    modules : Modules or None
        Panels that may stand one after the other in a line that has as many parts.

    Attributes
    ----------
    sentences : tuple of str
        How the lines were understood; empty until they are.
    words : tuple of str
        Names of columns and titles that may contain the unit.
    refusal : str
        Why the lines up to now are not understood; empty once they are, and before the first line.
    """

    def __init__(
        self, shape: Shape, *, source: str = "port", modules: Modules | None = None
    ) -> None:
        self._shape = shape
        self._modules = modules  # None once a line is known to have other parts
        self._source = source
        self._count = 0  # of lines
        self._kept: list[str] = []  # before the layout is understood, then titles between readings
        self._next_try = FIRST_TRY
        self._understanding: Understanding | None = None
        self._segmenter = Segmenter(FrameEnds(1))  # of the ends that are understood
        # Lines since the last frame: their table, and their row in it.
        self._tables: dict[int, tuple[ReadingsTable, int]] = {}
        self._last: list[str] = []
        self._first = True
        self._stamp = ""
        self._seconds = 0.0
        self._shortest = 0  # least length of the number at the end of a line
        self.sentences: tuple[str, ...] = ()
        self.words: tuple[str, ...] = ()
        self.refusal = ""

    def feed(self, *lines: str) -> tuple[TextFrame, ...]:
        """Take lines without their ends, and return the frames that they complete.

        Lines that arrive together take less time together.

        Raises InputError if the layout is not understood after MAX_LINES lines.
        """
        self._count += len(lines)
        self._kept += lines
        if self._understanding is None:
            return self._frames_at_last() if len(self._kept) >= self._next_try else ()
        return tuple(self._frames_of_lines(self._understanding))

    def close(self) -> tuple[TextFrame, ...]:
        """Return the frames that were waiting for a line that shows their end."""
        early = () if self._understanding else self._frames_at_last(ended=True)
        known = self._understanding
        segment = self._segmenter.close()
        if known is None or len(segment) < known.ends.lines:
            return early
        return (*early, *self._frames_of(known, segment))

    def _frames_at_last(self, *, ended: bool = False) -> tuple[TextFrame, ...]:
        """Return the frames of the first lines once they show the layout."""
        self._next_try = len(self._kept) + max(1, len(self._kept) // 4)
        try:
            notation = notation_of(self._kept)
            lines = field_lines_in(notation, self._kept, self._source)
            table, arrangement = arranged(readings_table(lines), self._shape)
            table.refuse_words(arrangement.cells, MAX_WORDS)
            ends = learned_ends(table, arrangement)
            refuse_several_boards(table, arrangement, ends)
        except InputError as error:
            self.refusal = str(error)
            if len(self._kept) > MAX_LINES:
                raise
            return ()
        # A lost line among few may hide that a pause, a time or a title ends frames.
        least = MIN_COUNTED if ends.counted and ends.lines > 1 else MIN_FRAMES
        # Of a frame's first lines more than one field may name rows or cells.
        frame = max(ends.lines, arrangement.lines // 2)
        if len(table.lines) < (1 if ended else least) * frame + frame:
            return ()
        self.refusal = ""
        parts = notation.parts if arrangement.lines == 1 else 1
        modules: tuple[str, ...] = ()
        if self._modules is not None and parts == self._modules.count:
            modules = (f"{parts} parts of a line are the modules",)
        else:
            self._modules = None
        self.sentences = (*table.notes, arrangement.note, *modules)
        self.words = tuple(table.names)
        known = Understanding(notation, table, arrangement, ends).with_times()
        self._understanding = known
        self._segmenter = Segmenter(ends)
        last = (lines.lines[at].texts[-1] for at in table.lines.tolist())
        self._shortest = min((len(text) for text in last if WRITTEN.fullmatch(text)), default=0)
        return tuple(self._frames_of_lines(known))

    def _frames_of_lines(self, known: Understanding) -> Iterator[TextFrame]:
        """Yield the frames that the kept lines complete; a line without readings is a title."""
        before = self._count - len(self._kept)
        lines = field_lines_in(known.notation, self._kept, self._source, before, header=False)
        table = later_lines(known.table, lines)
        if not len(table.lines):
            self._kept = self._kept[-MAX_BETWEEN:]
            return
        read = [lines.lines[at] for at in table.lines]
        self._kept = self._kept[read[-1].number - before :]
        keyed = known.arrangement.used > set(known.arrangement.cells)
        all_keys = line_keys(table, known.arrangement, known.ends)
        for row, ((number, texts, *_), keys) in enumerate(zip(read, all_keys, strict=True)):
            fields = table.fields[row].tolist()
            if keyed and fields == self._last:
                continue  # a line that came twice, its keys included
            self._last = fields
            # A line may be broken within it, and its rest comes after the frame.
            length = len(texts[-1])
            if WRITTEN.fullmatch(texts[-1]) and length < self._shortest:
                self._shortest = length
                table.values[row, table.columns == len(texts) - 1] = np.nan
            yield from self._frames_of(known, self._segmenter.feed(number, keys))
            self._tables[number] = (table, row)
            if self._segmenter.complete:
                yield from self._frames_of(known, self._segmenter.close())

    def _frames_of(self, known: Understanding, segment: Segment) -> Iterator[TextFrame]:
        """Yield the frames of lines; the first ones may be cut, and are left out then."""
        for group in placed(segment, known.ends) if segment else ():
            values = self._values(known.arrangement, group)
            title = self._first and np.all(np.isnan(values))  # a greeting with separators
            cut = self._first and group.remark
            self._first = bool(title)
            if not title and not cut:
                yield self._frame(known, group, values)
        for line, _ in segment:
            del self._tables[line]

    def _values(self, arrangement: TableLayout, group: Placed) -> Array:
        """Return the readings of lines at their places."""
        values = np.full(arrangement.shape[0] * arrangement.shape[1], np.nan)
        fields, places = arrangement.places
        share = values.size // arrangement.lines
        for line, position in zip(group.lines, group.positions, strict=True):
            table, row = self._tables[line]
            values[position * share + places] = table.values[row, fields]
        frame = values.reshape(arrangement.shape)
        return frame if self._modules is None else self._modules.of_parts(frame)

    def _frame(self, known: Understanding, group: Placed, values: Array) -> TextFrame:
        """Return the readings of lines as a frame, with the time of the first one."""
        roles = known.arrangement.roles
        table, row = self._tables[group.begin]
        printed = table.values[row, roles["frame"]] if "frame" in roles else np.nan
        number = int(printed) if np.isfinite(printed) else None
        remarks = (f"the frame {group.remark}",) if group.remark else ()
        stamps = known.stamp(table, row)
        if stamps is None:
            return TextFrame(values, None, number, remarks)
        last = self._stamp
        [self._stamp] = stamps.texts
        step = known.step(last, self._stamp) if last else 0.0
        self._seconds += step or 0.0
        return TextFrame(values, None if step is None else self._seconds, number, remarks)
