"""Recording of a board into a file, frame by frame, until it is complete or a signal ends it.

Frames are appended to a journal (`lampest.apps.board.journal`), which is rewritten as a
recording at the end.
"""

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path

from lampest.apps.board.journal import UnwrittenError, finished, journal_for
from lampest.apps.board.sample import (
    CLOCK_JUMPED,
    CLOCK_STOPPED,
    DAMAGED,
    HOST_CLOCK_SET,
    LINES_LOST,
    OTHER_BOARD,
    TOO_FAST,
    UNFIT_SECONDS,
    Listening,
    Printing,
    Sample,
    Samples,
)
from lampest.apps.board.several import samples_of
from lampest.files.errors import InputError
from lampest.files.process import ending_signals
from lampest.files.whole import check_output
from lampest.panel.scene import Scene

# Count of a recording → its warning: {n} is the count, {s} its plural, {frames} that of all frames.
WARNINGS = {
    DAMAGED: "{n} of the {frames} frames have a reading that the converter cannot give, "
    "as lost bytes make; it is missing, and events mark where",
    LINES_LOST: "{n} of the {frames} frames lack lines; events mark where",
    TOO_FAST: "lines came faster than this computer read them; "
    "the lost frames are counted, and events mark where",
    CLOCK_JUMPED: "{n} jump{s} of the board's clock; "
    "events mark where, and time goes on by the period",
    CLOCK_STOPPED: "the board's clock stood still; "
    "an event marks since when, and time goes on by this computer's clock",
    HOST_CLOCK_SET: "this computer's clock was set {n} time{s}; "
    "events mark where, and no time of a frame depends on it",
    OTHER_BOARD: "another board sends on the same line; "
    "its frames are left out, and events mark where",
    "parted": "{n} of the {frames} frames lack a module; "
    "events mark which was gone, and when it was back",
}


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """Result of `record`.

    Attributes
    ----------
    path : Path
    scene : Scene
    frames : int
        Frames in the file.
    lost : int
        Frames known to be missing.
    restarts : int
        Restarts of the board.
    count : Counter
        Frames without the readings of a module ('parted'), frames that the port still contained at
        the end ('behind'), and events by their labels.
    ended_by : str
        Signal that ended the recording, such as SIGINT (Ctrl-C), or ''.
    noise_lsb : float, or None
        Noise of one reading from the baseline's repeats, if these suffice.
    silent : float
        Time without frames at the end of the requested duration, in s.
    unestimated : Counter
        Reasons why a board that estimates did not estimate frames.
    understood : str
        How the lines of a board that prints were read, in words; '' of another one.
    """

    path: Path
    scene: Scene
    frames: int
    lost: int
    restarts: int
    count: Counter[str]
    ended_by: str
    noise_lsb: float | None
    silent: float
    unestimated: Counter[str]
    understood: str = ""

    def warnings(self) -> Iterator[str]:
        """Yield what went wrong while the recording was made, a sentence each."""
        for name, sentence in WARNINGS.items():
            if n := self.count[name]:
                yield sentence.format(n=n, s="" if n == 1 else "s", frames=self.frames)
        for reason, n in self.unestimated.items():
            yield f"the board did not estimate {n} of the {self.frames} frames: {reason}"
        if self.silent:
            yield f"no frame came in the last {self.silent:.1f} s"
        if self.scene.circuit.unit == "ohm" and not self.scene.series_resistance_ohm:
            yield (
                "no series resistance is assumed, because the scene names none; "
                "two multiplexer channels have some 140 ohm, which lampest calibrate measures"
            )
        if self.ended_by:
            unread = self.count["behind"]
            frames = f"{unread} of the {self.frames} frames were" if unread else "no frame was"
            yield f"{self.ended_by} ended the recording; {frames} still in the port then"


@dataclass(frozen=True)
class Progress:
    """Progress of a recording.

    Attributes
    ----------
    sample : Sample or None
        Newest sample; None while waiting for the board.
    frames, lost : int
        Numbers of frames in the file, and of lost frames, so far.
    state : str
        Sentence on the state of the board or of the disk, or ''.
    """

    sample: Sample | None
    frames: int
    lost: int
    state: str


@dataclass(eq=False)
class Tally:
    """Counts of a recording while it grows.

    Attributes
    ----------
    count : Counter
        Frames, lost frames, frames without the readings of a module, frames that the port still
        contained at the end, and events.
    unestimated : Counter
        Reasons why a board that estimates did not estimate frames.
    last : Sample or None
        Newest sample; None before the first one.
    """

    count: Counter[str] = field(default_factory=Counter)
    unestimated: Counter[str] = field(default_factory=Counter)
    last: Sample | None = None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.count["frames"]

    def add(self, sample: Sample, *, behind: bool) -> None:
        """Count a frame, frames lost before it, missing readings of a module, and its events."""
        self.last = sample
        self.count.update(frames=1, lost=sample.lost, parted=sample.missing > 0, behind=behind)
        self.count.update(sample.events)
        self.unestimated.update(filter(None, [sample.frame.unestimated]))


def record(
    boards: Listening,
    out: Path,
    *,
    frames: int | None = None,
    seconds: float | None = None,
    on_progress: Callable[[Progress], None] = lambda progress: None,
    keys: Callable[[], str] = lambda: "",
) -> Recorded:
    """Record frames from a board into the file `out`, in ohm or volt as the readout gives them.

    Ctrl-C, SIGTERM, SIGHUP and SIGQUIT end the recording; frames that the port has received by then
    are included. Raises InputError if the board does not answer or fit, `out` exists, no frame
    arrives, or the disk takes no more frames. Earlier frames are in the file.

    Parameters
    ----------
    boards : Listening
        Boards; `on_state` and `ending` are those of the recording.
    out : Path
        File that must not exist yet.
    frames, seconds : int and float, or None
        Number of frames, and time in s, after which to end.
    on_progress : callable
        Called after every frame, and when the board appears or disappears.
    keys : callable
        Returns the keys pressed since its last call; each marks an event.
    """
    check_output(out)
    if out.exists():
        raise InputError(f"{out}: exists already; a recording is never written over")
    tally = Tally()
    states = [""]
    with ending_signals(lambda: tally.frames > 0 and not states[-1]) as ended_by:
        listening = replace(boards, on_state=states.append, ending=lambda: bool(ended_by()))
        with (
            _naming_what_is_kept(tally, out),
            contextlib.closing(samples_of(listening)) as batches,
            contextlib.ExitStack() as stack,
        ):
            journal = None
            for batch in _wanted(batches, frames, seconds, boards.period or 1.0):
                if batch:
                    states[:] = [""]
                    journal = journal or stack.enter_context(journal_for(batch[0], out))
                    journal.append(batch, boards.baseline - tally.frames, keys)
                    for sample in batch:
                        tally.add(sample, behind=listening.ending())
                        frames_in_file = tally.frames - journal.pending
                        lost = tally.count["lost"]
                        on_progress(Progress(sample, frames_in_file, lost, journal.trouble))
                elif states[-1]:
                    on_progress(Progress(None, tally.frames, tally.count["lost"], states[-1]))
        complete = bool(ended_by()) or tally.frames == frames
        return _finished(tally, out, ended_by(), None if complete else seconds)


@contextlib.contextmanager
def _naming_what_is_kept(tally: Tally, out: Path) -> Iterator[None]:
    """Let a key end a recording that has frames, and add to a mistake where its frames are."""
    try:
        yield
    except KeyboardInterrupt:
        if not tally.last:
            raise
    except UnwrittenError as error:
        raise InputError(f"{out}: {error}{_end_of(out)}") from error
    except InputError as error:
        if not tally.last:
            raise
        before = f"the {tally.frames} frames that came before are in {out}{_end_of(out)}"
        raise InputError(f"{error}; {before}") from error


def _finished(tally: Tally, out: Path, ended_by: str, seconds: float | None) -> Recorded:
    """Complete the file, and return the recording.

    `seconds` is the requested duration of a recording that nothing ended before.
    """
    last = tally.last
    if last is None:
        raise InputError(f"{out}: ended before the first frame; nothing is written")
    scene, _, noise = finished(out)
    settings = last.hello
    silent = 0.0  # s without frames at the end of the requested duration
    if seconds is not None:
        silent = max(seconds - last.time - settings.period, 0.0)
    return Recorded(
        path=out,
        scene=scene,
        restarts=last.session,
        frames=tally.frames,
        lost=tally.count["lost"],
        count=tally.count,
        unestimated=tally.unestimated,
        ended_by=ended_by,
        noise_lsb=noise,
        silent=round(silent, 3),
        understood=settings.understood if isinstance(settings, Printing) else "",
    )


def _end_of(out: Path) -> str:
    """Finish a recording that ended early, and return a sentence on the remaining steps, or ''."""
    try:
        finished(out)
    except InputError:
        return f"; lampest check --repair {out} completes the file once there is room"
    return ""


def _wanted(batches: Samples, frames: int | None, seconds: float | None, period: float) -> Samples:
    """Yield batches up to a number of frames, or up to a time in s on the board's clock.

    The host's clock ends a timed recording 5 %, a period and 1 s later. Raises InputError if frames
    are counted and none has arrived for UNFIT_SECONDS and three periods.
    """
    most = inf if frames is None else frames
    until = inf if seconds is None else seconds
    count = 0
    began = 0.0
    heard = time.monotonic()
    for batch in batches:
        time_now = time.monotonic()
        began = began or time_now
        heard = time_now if batch else heard
        if frames is not None and time_now - heard > UNFIT_SECONDS + 3 * period:
            raise InputError(f"no frame came for {time_now - heard:.0f} s")
        over = time_now - began > 1.05 * until + period + 1
        for place, item in enumerate(batch, 1):
            if count + place >= most or item.time + item.hello.period > until - 1e-3:
                batch = batch[:place]
                over = True
                break
        count += len(batch)
        yield batch
        if over:
            return
