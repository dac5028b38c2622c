"""Boards that print: frames from lines of text, as most sketches send them.

The lines are understood as those of a file that is imported (`lampest.apps.foreign.line_reader`).
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import ceil
from time import monotonic
from time import time as wall_clock

import numpy as np

from lampest.apps.board.port import is_text
from lampest.apps.board.sample import (
    DAMAGED,
    LINES_LOST,
    RESTARTED,
    TOO_FAST,
    UNFIT_SECONDS,
    Batch,
    PrintedFrame,
    Printing,
    Sample,
    Samples,
)
from lampest.apps.board.source import PRINTED_BAUDS, ByteSource, Listener, NoBoardError, Piece
from lampest.apps.foreign.line_reader import LineReader, TextFrame
from lampest.apps.foreign.unit import understood_unit
from lampest.files.errors import InputError, counted, printable
from lampest.panel.scene import Scene
from lampest.recording.acquisition import COUNTER
from lampest.recording.unit import check_unit, recorded_values

WORDS_SECONDS = 10.0  # s of lines without numbers, after which they are none
RATE_SECONDS = 2.5  # s in which a board prints something, at each rate that is tried
ENOUGH = 200  # bytes that show whether a rate is right: of wrong ones a few are characters
MIN_STEP = 1e-3  # s between frames of one arrival
USUAL_PERIOD = 1.0  # s between frames that a file held before, as imports assume
MAX_LINE = 1_000_000  # bytes of a line, as of an imported file
MAX_SHOWN = 60  # characters of a line in a message
MAX_IMPOSSIBLE = 0.1  # share of the first readings that may be damaged; more are of another unit
BEHIND_SECONDS = 1.0  # s of lines that wait, from which the computer is too slow
LINE_END = re.compile(rb"\r\n|\n|\r(?!\Z)")


def line_text(line: bytes) -> str:
    """Return the text of a line, with a mark in place of bytes that are none."""
    return line.decode("utf-8", errors="replace").replace("\0", "\ufffd")


@dataclass(frozen=True)
class Stamped:
    """Frame with its arrival in s on the host's steady clock; None: it was in a file before."""

    frame: TextFrame
    arrived: float | None


@dataclass(eq=False)
class Printer:
    """Board that prints, over all connections to it.

    Attributes
    ----------
    url : str
    scene : Scene
    unit : str or None
        Unit of the numbers, as of an import; None: by the lines, or by the numbers.
    period : float or None
        Time between frames in s, in place of stamps and arrivals; None: these.
    last : Sample or None
        Newest sample.
    """

    url: str
    scene: Scene
    unit: str | None
    period: float | None
    last: Sample | None = None
    first_line: str = ""
    _reader: LineReader = field(init=False)
    _pending: bytes = b""  # behind the last end of a line
    _arrivals: list[float | None] = field(default_factory=list)  # of the first lines
    _printing: Printing | None = None
    _count: int = 0  # of lines
    _frames: int = 0
    _previous: TextFrame | None = None
    _lost: int = 0
    _events: tuple[str, ...] = ()
    _began: float | None = None

    def __post_init__(self) -> None:
        check_unit(self.unit, self.scene, self.url)
        panel = self.scene.panel
        self._reader = LineReader(panel.shape, source=self.url, modules=panel.modules)

    def samples(
        self,
        source: ByteSource,
        heard: bytes,
        on_state: Callable[[str], None],
        ending: Callable[[], bool],
    ) -> Samples:
        """Yield samples of a connection, in batches, until the source or the recording ends.

        `heard` are bytes of it that were read before. Raises OSError if the source is gone.
        """
        self._pending = b""
        began = monotonic()
        with Listener(source, heard) as listener:
            while True:
                over = ending()
                pieces = listener.take()
                batch = self._taken(pieces or ())
                if pieces is None or over:
                    # The end of the lines completes samples.
                    last = line_text(self._pending.rstrip(b"\r"))
                    self._pending = b""
                    now = monotonic()
                    frames = self._fed([last], now) if last.strip() else []
                    frames += [Stamped(frame, now) for frame in self._reader.close()]
                    samples = self._samples_of(frames)
                    if self._printing is None and self._count:
                        raise self._refused("ended before")
                    batch += samples
                yield batch
                if pieces is None or over:
                    return
                waits = monotonic() - began
                self._check(waits, may_wait=source.one_way)
                if listener.behind > BEHIND_SECONDS:
                    on_state(f"lines come faster than they are read: {listener.behind:.1f} s wait")
                    yield ()

    def _taken(self, pieces: Sequence[Piece]) -> Batch:
        """Return the samples that pieces complete."""
        samples: Batch = ()
        for piece in pieces:
            if piece.lost:
                lines_per_frame = max(self._count / max(self._frames, 1), 1.0)
                self._lost += ceil(piece.lost / lines_per_frame)
                self._events += (TOO_FAST,)
                self._pending = b""
            # '\r' at the end of a piece may be the first half of '\r\n'.
            *lines, self._pending = LINE_END.split(self._pending + piece.data)
            if len(self._pending) > MAX_LINE:
                lines.append(self._pending)
                self._pending = b""
            if lines:
                samples += self._samples_of(self._fed([*map(line_text, lines)], piece.arrived))
        return samples

    def _fed(self, lines: Sequence[str], arrived: float | None) -> list[Stamped]:
        """Return the frames that lines complete."""
        self.first_line = self.first_line or next(filter(None, map(str.strip, lines)), "")
        self._began = self._began or monotonic()
        self._count += len(lines)
        frames = self._reader.feed(*lines)
        if self._printing is not None:
            return [Stamped(frame, arrived) for frame in frames]
        # Until the layout is understood frames wait: each has its share of the lines.
        self._arrivals += [arrived] * len(lines)
        share = len(self._arrivals) / max(len(frames), 1)
        return [
            Stamped(frame, self._arrivals[round(share * number) - 1])
            for number, frame in enumerate(frames, 1)
        ]

    def _samples_of(self, frames: Sequence[Stamped]) -> Batch:
        """Return frames of one arrival as samples; those without a reading are lost."""
        if not frames:
            return ()
        if self._printing is None:
            # Unit and period follow from the first frames.
            values = np.stack([item.frame.values for item in frames])
            words = self._reader.words
            self.unit, reason = understood_unit(values, self.unit, words, self.scene, self.url)
            recorded = recorded_values(values, self.unit, self.scene, None, self.url)
            impossible = np.isfinite(values) & np.isnan(recorded)
            if np.mean(impossible) > MAX_IMPOSSIBLE:
                recorded_values(values, self.unit, self.scene, self._place, self.url)
            arrivals = [item.arrived for item in frames if item.arrived is not None]
            stamps = [item.frame.seconds for item in frames if item.frame.seconds is not None]
            how = "time: the board's" if stamps else "time: a frame's arrival"
            if self.period is not None:
                how = f"time: a frame every {self.period:g} s, as specified"
            steps = np.diff(np.array(stamps or arrivals, dtype=float))
            steps = steps[steps > 0]
            usual = float(np.median(steps)) if steps.size else USUAL_PERIOD
            understood = "; ".join((*self._reader.sentences, reason, how))
            self._printing = Printing(self.period or usual, printable(understood))
        samples: Batch = ()
        for place, stamped in enumerate(frames):
            if np.isnan(stamped.frame.values[self.scene.panel.present]).all():
                self._lost += 1
            else:
                samples += (self._sample(stamped, len(frames) - place),)
        return samples

    def _place(self, frame: int, row: int, column: int) -> str:
        return f"{self.url}: frame {frame}, row {row}, column {column}"

    def _sample(self, stamped: Stamped, together: int) -> Sample:
        """Return a frame as a sample; it came at once with those that follow, `together`."""
        assert self._printing is not None and self.unit is not None
        frame = stamped.frame
        recorded = recorded_values(frame.values[None], self.unit, self.scene, None, self.url)[0]
        now = monotonic() if stamped.arrived is None else stamped.arrived
        events = self._events
        if np.any(np.isfinite(frame.values) & np.isnan(recorded)):
            events += (DAMAGED,)
        if frame.remarks:
            events += (LINES_LOST,)
        at = 0.0
        session = 0
        lost = self._lost
        previous = self._previous
        if self.last is not None and previous is not None:
            elapsed = self._printing.period
            if stamped.arrived is not None:
                # Frames that arrive together are spread evenly.
                elapsed = max((now - self.last.arrived) / together, MIN_STEP)
                now = self.last.arrived + elapsed
            restarted = frame.seconds is None and previous.seconds is not None
            by_stamp = 0.0
            if frame.seconds is not None and previous.seconds is not None:
                by_stamp = max(frame.seconds - previous.seconds, 0.0)
            at = self.last.time + (self.period or by_stamp or elapsed)
            session = self.last.session + restarted
            if restarted:
                events += (RESTARTED,)
            if frame.number is not None and previous.number is not None and not restarted:
                lost += max(frame.number - previous.number - 1, 0)
        self._previous = frame
        self._lost = 0
        self._events = ()
        device_s = at if frame.seconds is None else frame.seconds
        number = self._frames if frame.number is None else frame.number
        self._frames += 1
        self.last = Sample(
            frame=PrintedFrame(recorded, number % COUNTER, round(1000 * device_s) % COUNTER),
            hello=self._printing,
            scene=self.scene,
            time=at,
            host_time=wall_clock() - max(monotonic() - now, 0.0),
            lost=lost,
            session=session,
            events=tuple(dict.fromkeys(events)),
            arrived=now,
        )
        return self.last

    def _check(self, waited: float, *, may_wait: bool) -> None:
        """Raise InputError if too long no lines are understood, or none come."""
        if self._printing is not None:
            return
        if self._began is None:
            if waited > UNFIT_SECONDS and not may_wait:
                raise NoBoardError(f"{self.url}: no line came within {UNFIT_SECONDS:g} s")
            return
        since = monotonic() - self._began
        words = not re.search(r"\d", self.first_line) and not self._reader.words
        if since > (WORDS_SECONDS if words else UNFIT_SECONDS):
            raise self._refused(f"were read for {since:.0f} s without")

    def _refused(self, what: str) -> InputError:
        """Return an error with the port's first line, and what was expected."""
        rows, columns = self.scene.panel.shape
        return InputError(
            f"{self.url}: prints {printable(self.first_line)[:MAX_SHOWN]!r} first, where lines of "
            f"{columns} numbers (a row) or of {rows * columns} (a frame) were expected; "
            f"its {counted(self._count, 'line')} {what} a whole frame"
            f"{self._reader.refusal and f': {self._reader.refusal}'}"
        )


def text_at_some_rate(source: ByteSource, heard: bytes, url: str, baud: int | None) -> bytes:
    """Return the bytes that were heard, of a board that prints.

    Unless the rate is given, usual ones are tried until what comes is text. Raises NoBoardError if
    none comes.
    """
    heard = heard or _listened(source)
    for rate in PRINTED_BAUDS if baud is None else ():
        if not heard or is_text(heard) or not source.set_baud(rate):
            break
        heard = _listened(source)
    if not heard or is_text(heard):
        return heard
    rates = "at any usual rate; --baud N names another" if baud is None else f"at {baud} baud"
    raise NoBoardError(
        f"{url}: the line is not silent, but no lampest board answered, "
        f"and what comes is no text {rates}"
    )


def _listened(source: ByteSource) -> bytes:
    """Return what comes until it is enough to know whether it is text, or RATE_SECONDS are over."""
    heard = b""
    until = monotonic() + RATE_SECONDS
    while len(heard) < ENOUGH and monotonic() < until:
        heard += source.read()
    return heard
