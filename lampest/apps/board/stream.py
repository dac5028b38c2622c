"""Frames from a board in temporal order, despite lost frames, resets and unplugging."""

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lampest.apps.board.port import SILENCE_SECONDS, Board, prints_numbers
from lampest.apps.board.printed import MAX_SHOWN, Printer, line_text, text_at_some_rate
from lampest.apps.board.protocol import BAUD, Estimate, Frame, Garbage, Hello, Message
from lampest.apps.board.sample import (
    CLOCK_JUMPED,
    CLOCK_STOPPED,
    HOST_CLOCK_SET,
    OTHER_BOARD,
    UNFIT_SECONDS,
    AnyFrame,
    Batch,
    Listening,
    Sample,
    Samples,
)
from lampest.apps.board.source import PRINTED_BAUDS, ByteSource, NoBoardError, opened_source
from lampest.files.errors import InputError
from lampest.panel.lines import as_tuple
from lampest.panel.panel import Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.readouts.loaded_columns import LoadedColumnsReadout
from lampest.panel.scene import Scene
from lampest.recording.acquisition import COUNTER

# Keys on which a board and a scene must agree, by the board's wiring.
SHARED = {
    "two_point": ("supply_volt", "reference_ohm", "measured_across", "adc_bits"),
    "loaded_columns": ("driven", "polarity", "supply_volt", "adc_bits", "load_ohm"),
}
RETRY_SECONDS = 0.2  # s between attempts to open a port
# s, and 0.1 % of the time between two frames, by which the host's clocks differ unless one was set:
# adjtime disciplines a clock by 0.05 %, and a busy machine reads the two clocks 0.1 s apart
HOST_CLOCK_STEP = 1.0


def scene_of(hello: Hello, scene: Scene | None) -> Scene:
    """Return the user's scene, completed by the board's HELLO; without one, the board's.

    Raises InputError. An error is raised if the two contradict each other, or if the scene exceeds
    the limits of the board.
    """
    declared = declared_readout(hello)
    if scene is None:
        return Scene(Panel(hello.rows, hello.columns), declared)
    ours: Any = scene.readout  # a kind of readout, with its own fields
    if ours is None:
        return replace(scene, readout=declared)
    if ours.kind != hello.wiring:
        wired = f"but the board says that it is wired as {hello.wiring} (firmware pins.h)"
        raise InputError(f"the scene's readout.kind is {ours.kind}, {wired}")
    for name in SHARED[hello.wiring]:
        theirs = getattr(declared, name)
        for mine in as_tuple(getattr(ours, name)):
            # A calibrated load differs from the one that is printed on it: 5 % of ordinary
            # resistors, twice.
            if mine != theirs and not (name == "load_ohm" and abs(mine - theirs) <= 0.1 * theirs):
                said, known = (
                    f"{value:g}" if isinstance(value, float) else value for value in (mine, theirs)
                )
                raise InputError(
                    f"the scene's readout.{name} is {said}, "
                    f"but the board says {known} (firmware pins.h)"
                )
    for name, needed, possible in (
        ("panel.rows", scene.panel.rows, hello.most_rows),
        ("panel.columns", scene.panel.columns, hello.most_columns),
        ("readout.readings", ours.readings, hello.most_readings),
    ):
        if needed > possible:
            raise InputError(
                f"the scene's {name} is {needed}, but the board can do at most {possible}"
            )
    return scene


def declared_readout(hello: Hello) -> TwoPointReadout | LoadedColumnsReadout:
    """Return the readout that a board declares in its HELLO."""
    reference = hello.reference_milliohm / 1000
    converter: dict[str, Any] = {
        "supply_volt": hello.supply_millivolt / 1000,
        "adc_bits": hello.adc_bits,
        "readings": hello.readings,
    }
    if hello.wiring == "loaded_columns":
        return LoadedColumnsReadout(
            load_ohm=reference, drive_ohm=hello.drive_milliohm / 1000, **converter
        )
    return TwoPointReadout(
        reference_ohm=reference, measured_across=hello.measured_across, **converter
    )


@dataclass(eq=False)
class Scanning:
    """Run of a started board: frame numbers and clock increase together, modulo 2³².

    A scan may begin up to a period late. Some lines repeat old messages, which are no frames. If
    two consecutive frames follow each other but not the newest sample, either the clock has jumped
    (the numbers continue), or the numbers have restarted (the clock continues). If the clock has
    jumped for a single frame, whose number lies between those of its neighbours, the frame has the
    time between theirs that its number says. A clock that stands still costs no frame.

    Attributes
    ----------
    hello : Hello
        Settings of the board.
    scene : Scene
        Scene of `scene_of`.
    session : int
        Session of the next frame.
    last : Sample, or None
        Newest sample of the recording.
    before, earlier : Sample, or None
        The two newest samples of this run.
    estimate : Estimate, or None
        Newest estimate of the board, which precedes its frame.
    stray : Sample, or None
        Newest frame that did not follow another one, whose time is unknown.
    stopped : bool
        Whether the clock stands still.
    others : bool
        Whether frames of another board came, which no event has marked yet.
    since : float
        Start of the board in s on the host's steady clock.
    """

    hello: Hello
    scene: Scene
    session: int
    last: Sample | None
    before: Sample | None = None
    earlier: Sample | None = None
    estimate: Estimate | None = None
    stray: Sample | None = None
    stopped: bool = False
    others: bool = False
    since: float = field(default_factory=time.monotonic)

    def take(self, frame: Frame) -> Batch:
        """Take a further frame, and return the new samples.

        There are one or two samples, or none if the frame does not follow.
        """
        frame = frame.with_estimate(self.estimate)
        if self.before is None:
            # Numbers start with 0: earlier frames are lost, unless the clock shows that there was
            # no time for them.
            time_ms = min(frame.device_ms + 2, self._most_ms(self.since))
            lost = frame.sequence if 990 * frame.sequence * self.hello.period <= time_ms else 0
            return (self._accept(self._sample(frame, 0.0, lost)),)
        for newest in (self.last or self.before, self.before):  # these differ after `doubt`
            if self._follows(frame, newest.frame, newest.arrived):
                steps, elapsed_ms = _since(newest.frame, frame)
                self.before = newest
                at = newest.time + elapsed_ms / 1000
                between = self._between(newest, frame, at)
                steps_between = _since(newest.frame, between[0].frame)[0] if between else 0
                sample = self._sample(frame, at, steps - 1 - steps_between)
                return (*between, self._accept(sample))
        # Two consecutive frames that follow each other: the clock has jumped, or the numbers have
        # restarted.
        if self.stray is not None and _since(self.stray.frame, frame)[0] == 1:
            resumed = self._resumed(self.stray.frame, frame)
            if resumed is not None:
                return (self._accept(resumed), *self.take(frame))
        self.stray = self._placed(frame, 0.0)
        return ()

    def _between(self, newest: Sample, frame: Frame, at: float) -> Batch:
        """Return the stray frame as a sample, if its number is between those of its neighbours.

        The neighbours are a sample and the next frame, which is at the time `at` in s. The clock
        has jumped for the stray frame alone.
        """
        stray = self.stray
        if stray is None or self.last is not newest or not at > newest.time:
            return ()
        steps = _since(newest.frame, stray.frame)[0]
        all_steps = _since(newest.frame, frame)[0]
        if not 0 < steps < all_steps:
            return ()
        moment = newest.time + steps / all_steps * (at - newest.time)
        self.last = replace(stray, time=moment, lost=steps - 1, events=(CLOCK_JUMPED,))
        return (self.last,)

    def _placed(self, frame: AnyFrame, at: float) -> Sample:
        """Return a frame that has just arrived as a sample, at a time in s since the first one."""
        return Sample(
            frame=frame,
            hello=self.hello,
            scene=self.scene,
            time=at,
            host_time=time.time(),
            lost=0,
            session=self.session,
            arrived=time.monotonic(),
        )

    def last_sample(self) -> Batch:
        """Return the last frame of a run as a sample, if its clock alone does not follow."""
        stray = self.stray
        if not stray or not self.before or _since(self.before.frame, stray.frame)[0] != 1:
            return ()
        resumed = self._resumed(stray.frame, stray.frame)
        return () if resumed is None else (self._accept(resumed),)

    def doubt(self) -> None:
        """Forget the newest sample, after a silence.

        If it was a wrong frame, no other frame would follow it.
        """
        self.before = self.earlier
        self.stray = None

    def _accept(self, sample: Sample) -> Sample:
        """Continue from a sample, and return it, with an event if the clock stopped."""
        # A late scan explains two frames with equal times, but not three.
        stopped = (
            self.earlier is not None
            and _since(self.earlier.frame, sample.frame)[1] == 0
            and self.hello.period > 2e-3
        )
        if stopped and not self.stopped:
            sample = replace(sample, events=(*sample.events, CLOCK_STOPPED))
        self.session = sample.session
        self.last = sample
        self.stray = None
        self.stopped = stopped
        self.earlier = self.before
        self.before = sample
        return sample

    def _sample(self, frame: AnyFrame, at: float, lost: int, anew: int = 0, *events: str) -> Sample:
        """Return a sample at a time in s, moved behind the last one if necessary.

        `anew` is 1 after a restart.
        """
        sample = self._placed(frame, at)
        if self.last is not None:
            elapsed = sample.arrived - self.last.arrived
            if at <= self.last.time:
                at = self.last.time + max(elapsed, self.hello.period)
            ahead = sample.host_time - self.last.host_time - elapsed
            if abs(ahead) > HOST_CLOCK_STEP + 1e-3 * elapsed:
                events = (*events, HOST_CLOCK_SET)
        if self.others:
            events = (*events, OTHER_BOARD)
            self.others = False
        return replace(sample, time=at, lost=lost, session=self.session + anew, events=events)

    def _follows(self, frame: AnyFrame, before: AnyFrame, arrived: float) -> bool:
        """Return whether number and clock of a frame can follow those of an earlier one.

        The earlier one arrived at this time of the host's steady clock.
        """
        steps, elapsed_ms = _since(before, frame)
        most_ms = self._most_ms(arrived)
        # The board counts its missed scans; either scan may begin up to a period late.
        most_ms = min(most_ms, 1010 * (1 + steps * (1 + frame.missed)) * self.hello.period + 2)
        return (
            0 < steps < COUNTER // 2
            and 990 * (steps - 1) * self.hello.period - 2 <= elapsed_ms <= most_ms
        )

    def _most_ms(self, moment: float) -> float:
        """Return the largest possible advance of the board's clock in ms since a moment.

        The moment is in seconds of the host's steady clock.
        """
        # The factor 1000 covers simulated boards, which run 300 times as fast as a real one.
        return 1e3 * (1000 * max(time.monotonic() - moment, 0.0) + 10 + 3 * self.hello.period)

    def _resumed(self, frame: AnyFrame, after: AnyFrame) -> Sample | None:
        """Return the first sample after a jump of the clock or a restart of the numbers.

        The result is None for a repetition. `after` is the next frame, whose clock follows that of
        `frame` if the numbers have restarted.
        """
        assert self.before is not None and self.last is not None
        steps, elapsed_ms = _since(self.before.frame, frame)
        if steps == 1 or 0 < 1e3 * steps * self.hello.period <= self._most_ms(self.before.arrived):
            moved = (steps + frame.missed) * self.hello.period
            return self._sample(frame, self.last.time + moved, steps - 1, 0, CLOCK_JUMPED)
        if not (0 < elapsed_ms < COUNTER // 2 and self._follows(after, frame, time.monotonic())):
            return None
        # Longer gaps are impossible here: after SILENCE_SECONDS the board is identified anew.
        period = self.hello.period
        longest = SILENCE_SECONDS + max(time.monotonic() - self.last.arrived, period)
        moved = min(elapsed_ms / 1000, longest)
        lost = max(round(moved / period) - 1, 0)
        return self._sample(frame, self.last.time + moved, lost, anew=1)


def _since(before: AnyFrame, frame: AnyFrame) -> tuple[int, int]:
    """Return the number of frames and the time in ms from one frame to another, modulo 2³²."""
    steps = (frame.sequence - before.sequence) % COUNTER
    return steps, (frame.device_ms - before.device_ms) % COUNTER


def board_samples(url: str, listening: Listening) -> Samples:
    """Yield samples as they arrive, in batches, which may be empty.

    Closing the generator stops the board.

    Raises InputError if no board answers or prints numbers at first, if the board does not fit the
    scene or the period, or if the line delivers no valid frame for UNFIT_SECONDS.

    Parameters
    ----------
    url : str
        Port, as `lampest.apps.board.source.source_at` opens it.
    listening : Listening
    """
    line = _Line(url, listening)
    while not listening.ending():
        line.heard = 0
        try:
            with opened_source(url, line.baud) as source:
                yield from line.connection(source)
                return
        except OSError as error:
            if line.last is None:
                raise NoBoardError(
                    f"{url}: the board went away ({' '.join(str(error).split())})"
                ) from error
            reason = "the board is gone; waiting for it"
        except NoBoardError:
            if line.last is None:
                raise
            reason = "the board does not answer; waiting for it"
        if not line.heard:
            line.renew()
        line.check()
        listening.on_state(reason)
        yield ()
        time.sleep(RETRY_SECONDS)


class _Line:
    """Connection to a board.

    A line holds the board's settings, its newest sample, and the later messages that were no valid
    frames.
    """

    def __init__(self, url: str, listening: Listening) -> None:
        self._url = url
        self._how = listening
        self._scene = listening.scene
        self._printer: Printer | None = None
        self.baud = listening.baud or (PRINTED_BAUDS[0] if listening.lines else BAUD)
        self.heard = 0  # bytes of the current connection
        self.last: Sample | None = None
        self.renew()

    def renew(self) -> None:
        """Restart the time of invalid messages: a frame was valid, or no board is present."""
        self._since = time.monotonic()
        self._unfit = Counter[str]()

    def check(self, period: float = 0.0) -> None:
        """Raise InputError if the line delivered only invalid messages for too long.

        Too long is for UNFIT_SECONDS and three periods.
        """
        waited = time.monotonic() - self._since
        if self._unfit and waited > UNFIT_SECONDS + 3 * period:
            came = ", ".join(f"{number} {kind}" for kind, number in self._unfit.most_common())
            raise InputError(
                f"{self._url}: nothing fit for {waited:.0f} s, "
                f"though the line is not silent ({came})"
            )

    def connection(self, source: ByteSource) -> Samples:
        """Yield samples until the board disappears or the end is requested."""
        if self._printer is not None or self._how.lines or source.one_way:
            yield from self._printed(source, b"")
            return
        board = Board(source, self._url)
        try:
            hello = None
            try:
                hello = board.hello()
            except OSError:  # a board that printed numbers may be gone since
                if not prints_numbers(board.first):
                    raise
            if hello is not None:
                yield from self._started(board, hello)
                return
        finally:
            self.heard = board.heard
        yield from self._printed(source, board.first)

    def _printed(self, source: ByteSource, heard: bytes) -> Samples:
        """Yield samples of a board that prints; `heard` are the bytes that were read before."""
        if self.last is not None and self._printer is None:
            raise NoBoardError(f"{self._url}: no lampest board answers any more")
        how = self._how
        if self._printer is None and not source.one_way:
            heard = text_at_some_rate(source, heard, self._url, how.baud)
        if self._scene is None:
            first = line_text(heard.strip().partition(b"\n")[0].strip())
            prints = f"prints {first[:MAX_SHOWN]!r} first" if first else "printed nothing yet"
            raise InputError(
                f"{self._url}: {prints}, and no lampest board answered; "
                "--scene says the rows, columns and circuit of a board that prints"
            )
        if self._printer is None:
            self._printer = Printer(self._url, self._scene, how.unit, how.period)
        for samples in self._printer.samples(source, heard, how.on_state, how.ending):
            if samples:
                self.heard = 1
                self.last = samples[-1]
            yield samples

    def _started(self, board: Board, hello: Hello) -> Samples:
        """Start a board, and yield its samples; restarted boards are started again."""
        try:
            while True:
                agreed = scene_of(hello, self._scene)
                readings = agreed.readout.readings if agreed.readout else hello.readings
                period = self._how.period
                requested = None if period is None else round(period * 1e6)
                # A board that comes back may be loaded.
                unloaded = self._how.baseline if self.last is None else 0
                settings = board.start(*agreed.panel.shape, readings, requested, unloaded)
                for samples in self._run(board, settings, agreed):
                    if samples:
                        self.last = samples[-1]
                        self._scene = agreed
                    yield samples
                if self._how.ending():
                    return
                yield ()
                self.check(settings.period)
                answer = board.hello()
                if answer is None:
                    raise NoBoardError(f"{self._url}: no lampest board answers any more")
                hello = answer
        finally:
            board.stop()

    def _run(self, board: Board, hello: Hello, scene: Scene) -> Samples:
        """Yield samples of one run until the board restarts or the end is requested."""
        run = Scanning(hello, scene, 0 if self.last is None else self.last.session + 1, self.last)
        silent_after = max(SILENCE_SECONDS, 3 * hello.period)
        heard = time.monotonic()
        while True:
            ending = self._how.ending()
            samples, over = self._taken(run, board.stop() if ending else board.messages())
            if over or ending:
                samples += run.last_sample()
            if samples:
                heard = time.monotonic()
            yield samples
            if over or ending:
                return
            self.check(hello.period)
            # Silence: identify the board, and end the run if it has restarted.
            if time.monotonic() - heard > silent_after:
                came = board.heard
                try:
                    identity = board.identify()
                    self._unfit["answers"] += 1
                    if not identity.running or identity.size != hello.size:
                        return
                    run.doubt()
                except NoBoardError:
                    if board.heard == came:  # a noisy line is no reason to reset the board
                        raise
                heard = time.monotonic()

    def _taken(self, run: Scanning, messages: Sequence[Message]) -> tuple[Batch, bool]:
        """Return the samples by which messages continue a run, and whether the board restarted."""
        samples: Batch = ()
        for item in messages:
            if isinstance(item, Estimate):
                run.estimate = item
                continue
            more: Batch = ()
            instead = "answers"
            if isinstance(item, Frame) and item.identity != run.hello.identity:
                run.others = True
                instead = "frames of another board"
            elif isinstance(item, Frame):
                fits = (*item.sums.shape, item.readings) == run.hello.size
                more = run.take(item) if fits else ()
                instead = "frames out of order" if fits else "frames of another size"
            elif isinstance(item, Garbage):
                instead = "pieces that are no message"
            samples += more
            if more:
                self.renew()
            else:
                self._unfit[instead] += 1
            if isinstance(item, Hello) and not item.running:
                return samples, True
        return samples, False
