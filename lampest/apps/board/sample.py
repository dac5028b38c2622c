"""Frames of a board, of lampest's own or of one that prints, with their place in a recording."""

from collections.abc import Callable, Generator
from dataclasses import dataclass

from lampest.apps.board.protocol import Frame, Hello
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.acquisition import recorded_of_sums

UNFIT_SECONDS = 30.0  # s without a valid frame on a line that is not silent
# labels of events
CLOCK_STOPPED = "clock stopped"
CLOCK_JUMPED = "clock jump"
HOST_CLOCK_SET = "host clock set"
OTHER_BOARD = "another board"
LINES_LOST = "lines lost"
TOO_FAST = "too fast"
RESTARTED = "restart"
DAMAGED = "damaged reading"


@dataclass(frozen=True)
class Printing:
    """Settings of a board that prints, as far as they show.

    Attributes
    ----------
    period : float
        Usual time between frames in s.
    understood : str
        How its lines are read, in words.
    readings : None
        It sends no sums of codes.
    estimates : bool
        It estimates nothing.
    """

    period: float
    understood: str
    readings: None = None
    estimates: bool = False


@dataclass(frozen=True, eq=False)
class PrintedFrame:
    """Frame that a board printed; fields as those of `lampest.apps.board.protocol.Frame`.

    Attributes
    ----------
    recorded : array, shape (rows, columns)
        Recorded values in ohm or volt.
    sequence : int
        Number of the frame, by the board or counted.
    device_ms : int
        Board's clock in ms; without one, that of the arrival.
    """

    recorded: Array
    sequence: int
    device_ms: int
    missed: int = 0
    sums: None = None
    log_change: None = None
    unestimated: str = ""


AnyFrame = Frame | PrintedFrame
AnySettings = Hello | Printing


@dataclass(frozen=True)
class Listening:
    """Boards that are listened to, and how.

    Attributes
    ----------
    ports : tuple of str
        Ports, as `lampest.apps.board.source.source_at` opens them; for a panel of modules those of
        all boards in the order of the modules. By default the only port that looks like an Arduino.
    scene : Scene or None
        Scene that the board must fit, and by which it is configured; None: the board's own.
    baseline : int
        Number of unloaded frames at the beginning, for a board that estimates as well.
    period : float or None
        Time between frames in s; by default 1 s, or the shortest possible if that is longer.
    lines : bool
        Whether the board is known to print, so that it is not asked whether it is lampest's own.
    baud : int or None
        Rate of a serial port; None: that of lampest's own boards, then usual ones of others.
    unit : str or None
        Unit of printed numbers, as of an import; None: by the lines, or by the numbers.
    on_state : callable
        Called with a sentence when a board disappears.
    ending : callable
        Called repeatedly; once it returns True, the messages that the port has received follow as a
        last batch.
    """

    ports: tuple[str, ...] = ()
    scene: Scene | None = None
    baseline: int = 0
    period: float | None = None
    lines: bool = False
    baud: int | None = None
    unit: str | None = None
    on_state: Callable[[str], None] = lambda sentence: None
    ending: Callable[[], bool] = lambda: False


@dataclass(frozen=True, eq=False)
class Sample:
    """Frame with its position in the recording.

    Attributes
    ----------
    frame : Frame
    hello : Hello or Printing
        Settings of the board.
    scene : Scene
        Scene of `scene_of`.
    time : float
        Time since the first frame in s, by the board's clock; across a restart of the board by the
        host's steady clock.
    host_time : float
        Arrival in s since 1970-01-01 UTC. This clock may be set: it is a label, and no duration
        depends on it.
    lost : int
        Frames missing before this one.
    session : int
        Number of restarts, reconnections and new starts of the board's numbers before the frame.
    events : tuple of str
        Labels marked at this time, such as CLOCK_JUMPED.
    missing : int
        Number of modules that are read but absent from the image.
    arrived : float
        Arrival in s on the host's steady clock, which is never set.
    """

    frame: AnyFrame
    hello: AnySettings
    scene: Scene
    time: float
    host_time: float
    lost: int
    session: int
    events: tuple[str, ...] = ()
    missing: int = 0
    arrived: float = 0.0

    @property
    def recorded(self) -> Array:
        """Recorded values, (rows, columns) ohm or volt."""
        if isinstance(self.frame, PrintedFrame):
            return self.frame.recorded
        return recorded_of_sums(self.scene, self.frame.sums, self.frame.readings)


Batch = tuple[Sample, ...]  # that arrived together, in order of time
Samples = Generator[Batch, None, None]
