"""Frames of a board that prints text, line after line, as the import understands a file of them."""

import re
from typing import NamedTuple

from lampest.apps.foreign.arrays import Frames, Shape
from lampest.apps.foreign.division import frames_of
from lampest.apps.foreign.lines import field_lines_of
from lampest.apps.foreign.table import readings_table
from lampest.files.errors import InputError
from lampest.panel.panel import Array

MIN_FRAMES = 3  # from which the layout is understood: the first one may be cut
MAX_LINES = 5000  # that are kept until the layout is understood


class TextFrame(NamedTuple):
    """Frame that a board printed.

    Attributes
    ----------
    values : array, shape (rows, columns)
        Numbers as printed; NaN where a reading is missing.
    seconds : float or None
        Time since the first frame in s by the board's own stamps, or by a terminal's; None where
        the lines carry none, and at the first frame after the board began again.
    number : int or None
        The board's own number of the frame, as printed; None without one.
    remarks : tuple of str
        Sentences on lines of this frame that are missing or left out; usually empty.
    """

    values: Array
    seconds: float | None
    number: int | None
    remarks: tuple[str, ...]


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
    `understood_unit(values, named_units(reader, source), scene, source)` decides it.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the panel.
    layout : str or None
        Names of the columns as in a header; see `import_file`.
    skip_lines : int
        Lines at the beginning that are no readings: a greeting.
    source : str
        Name of the port for messages.

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
        self, shape: Shape, *, layout: str | None = None, skip_lines: int = 0, source: str = "port"
    ) -> None:
        self._shape = shape
        self._layout = layout
        self._skip = skip_lines
        self._source = source
        self._lines: list[str] = []
        self._returned = 0
        self.sentences: tuple[str, ...] = ()
        self.words: tuple[str, ...] = ()
        self.refusal = ""

    def feed(self, line: str) -> tuple[TextFrame, ...]:
        """Take a line without its end, and return the frames that it completes.

        Raises InputError if the layout is not understood after MAX_LINES lines.
        """
        self._lines.append(line)
        return self._new_frames(pending=1)

    def close(self) -> tuple[TextFrame, ...]:
        """Return the frames that were waiting for a line that shows their end."""
        return self._new_frames(pending=0)

    def _new_frames(self, pending: int) -> tuple[TextFrame, ...]:
        try:
            frames = self._frames()
        except InputError as error:
            self.refusal = str(error)
            if not self.sentences and len(self._lines) > MAX_LINES:
                raise
            return ()
        count = len(frames.number) - pending
        if not self.sentences and count < MIN_FRAMES:
            return ()
        self.refusal = ""
        self.sentences = self.sentences or frames.notes
        self.words = frames.words
        new = range(self._returned, max(count, self._returned))
        self._returned += len(new)
        seconds = frames.timing(None).seconds if frames.timing is not None and new else None
        return tuple(
            TextFrame(frames.values[at], None if seconds is None else float(seconds[at]), None, ())
            for at in new
        )

    def _frames(self) -> Frames:
        text = "\n".join(self._lines[self._skip :])
        lines = field_lines_of(re.split(r"\r\n|\r|\n", text), self._source)
        return frames_of(readings_table(lines, self._layout), self._shape)
