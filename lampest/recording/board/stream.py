"""Frames from a board in the order of time, through lost frames, resets and unplugging."""

import time
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lampest.files.errors import InputError
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import LoadedColumnsReadout, Readout, TwoPointReadout
from lampest.panel.readouts.lines import as_tuple
from lampest.panel.scene import Scene
from lampest.recording.board.port import Board, NoBoardError
from lampest.recording.board.protocol import Frame, Garbage, Hello, Message

# What a board and a scene must say alike, by the board's wiring.
SHARED = {
    "two_point": ("supply_volt", "reference_ohm", "measured_across", "adc_bits"),
    "loaded_columns": ("driven", "polarity", "supply_volt", "adc_bits"),
}
# A calibrated load differs from the one that is printed on it: 5 % of ordinary resistors, twice.
LOAD_TOLERANCE = 0.1
ROUND = 2**32  # numbers and the board's clock begin anew after so many
# A board's clock is not further ahead of the host's than this; a simulated board runs 300 times as fast as a real one.
FASTEST, AHEAD_SECONDS = 1000.0, 10.0
UNFIT_SECONDS = 30.0
RETRY_SECONDS = 0.2
SILENCE_SECONDS = 2.5


def scene_of(hello: Hello, scene: Scene | None) -> Scene:
    """The scene that the board's HELLO and the user's scene agree on; without a scene, what the board says.

    Raises InputError where they contradict each other.
    """
    declared = declared_readout(hello)
    if scene is None:
        return Scene(Panel(hello.rows, hello.columns), declared)
    if scene.readout is None:
        return replace(scene, readout=declared)
    if scene.readout.kind != hello.wiring:
        raise InputError(
            f"the scene's readout.kind is {scene.readout.kind}, but the board says that it is wired as {hello.wiring} "
            f"(firmware pins.h)"
        )
    for name in SHARED[hello.wiring]:
        ours, theirs = getattr(scene.readout, name), getattr(declared, name)
        if ours != theirs:
            raise InputError(f"the scene's readout.{name} is {ours}, but the board says {theirs} (firmware pins.h)")
    _check_loads(scene.readout, declared)
    panel = scene.panel
    most = (hello.most_rows, hello.most_columns, hello.most_readings)
    asked = (panel.rows, panel.columns, scene.readout.readings)
    for name, ours, theirs in zip(("panel.rows", "panel.columns", "readout.readings"), asked, most, strict=True):
        if ours > theirs:
            raise InputError(f"the scene's {name} is {ours}, but the board can do at most {theirs}")
    return scene


def declared_readout(hello: Hello) -> TwoPointReadout | LoadedColumnsReadout:
    """The circuit and the converter as the board declares them."""
    reference, drive = hello.reference_milliohm / 1000, hello.drive_milliohm / 1000
    declared: dict[str, Any] = {"supply_volt": hello.supply_millivolt / 1000, "adc_bits": hello.adc_bits}
    declared["readings"] = hello.readings
    if hello.wiring == "loaded_columns":
        return LoadedColumnsReadout(load_ohm=reference, drive_ohm=drive, **declared)
    return TwoPointReadout(reference_ohm=reference, measured_across=hello.measured_across, **declared)


def _check_loads(ours: Readout, declared: Readout) -> None:
    """Raise InputError where a load is not what the board says, give or take what resistors differ by."""
    if not (isinstance(ours, LoadedColumnsReadout) and isinstance(declared, LoadedColumnsReadout)):
        return
    (nominal,) = as_tuple(declared.load_ohm)
    for load in as_tuple(ours.load_ohm):
        if abs(load / nominal - 1) > LOAD_TOLERANCE:
            raise InputError(
                f"the scene's readout.load_ohm is {load:g}, but the board says {nominal:g} (firmware pins.h)"
            )


@dataclass(frozen=True, eq=False)
class Sample:
    """A frame with its place in the recording.

    time : s since the first frame, by the board's clock; across a restart of the board by the host's.
    host_time : s since 1970-01-01 UTC.
    lost : frames missing before this one.
    session : number of restarts and reconnections before it, and of times the board's numbers began anew.
    clock_jump : whether the board's clock jumped before it; time goes on by the period then.
    """

    frame: Frame
    hello: Hello
    time: float
    host_time: float
    lost: int
    session: int
    clock_jump: bool = False


@dataclass(frozen=True, eq=False)
class Scanning:
    """A board that was started, and how far it came: numbers grow and the clock at least as they do, modulo 2³².

    What came before is sent again by some lines; that is no frame. Where two frames in a row do not follow the newest
    one, but each other, the clock has jumped if the numbers went on, and the numbers began anew if the clock did.

    hello : how the board is set. session : of its next frame. last : the recording's newest sample.
    before, earlier : the two newest samples of this run. stray : a frame that followed none. since : s since 1970-01-01
    UTC, when the board was started.
    """

    hello: Hello
    session: int
    last: Sample | None
    before: Sample | None = None
    earlier: Sample | None = None
    stray: Frame | None = None
    since: float = field(default_factory=time.time)

    def taking(self, frame: Frame) -> tuple["Scanning", tuple[Sample, ...]]:
        """The run with that frame, and the samples that it makes: one, none where it does not follow, or two."""
        stray = self.stray
        if (
            stray is not None
            and (frame.sequence - stray.sequence) % ROUND == 1
            and self._follows(frame, stray, time.time())
            and (sample := self._resumed(stray)) is not None
        ):
            run, samples = self._with(sample)
            run, more = run.taking(frame)
            return run, samples + more
        if self.before is None:
            return self._with(self._placed(frame))
        for before in (self.last, self.before):  # which differ where the last one is in doubt
            if before is not None and self._follows(frame, before.frame, before.host_time):
                return replace(self, before=before)._with(self._placed(frame, before))
        return replace(self, stray=frame), ()

    def doubted(self) -> "Scanning":
        """After a silence: should a wrong frame have been believed, nothing else would ever follow it."""
        return replace(self, before=self.earlier, stray=None)

    def _with(self, sample: Sample) -> tuple["Scanning", tuple[Sample, ...]]:
        run = replace(self, session=sample.session, last=sample, before=sample, earlier=self.before, stray=None)
        return run, (sample,)

    def _follows(self, frame: Frame, before: Frame, host_time: float) -> bool:
        steps = (frame.sequence - before.sequence) % ROUND
        elapsed_ms = (frame.device_ms - before.device_ms) % ROUND
        period_ms, most_ms = self.hello.period_us / 1000, self._most_ms(host_time)
        if steps == 1:  # the board counts what it missed since; a scan may begin up to a period late
            most_ms = min(most_ms, 1.01 * (2 + frame.missed) * period_ms + 2)
        return 0 < steps < ROUND // 2 and 0.99 * steps * period_ms - 2 <= elapsed_ms <= most_ms

    def _most_ms(self, host_time: float) -> float:
        """By how much the board's clock can have advanced since a time of the host's."""
        return 1e3 * (FASTEST * max(time.time() - host_time, 0.0) + AHEAD_SECONDS) + 3e-3 * self.hello.period_us

    def _placed(self, frame: Frame, before: Sample | None = None) -> Sample:
        now, period, last = time.time(), self.hello.period_us * 1e-6, self.last
        if last is None:
            return Sample(frame, self.hello, 0.0, now, self._lost_at_first(frame), self.session)
        moved = max(now - last.host_time, period)
        if before is None:
            return Sample(frame, self.hello, last.time + moved, now, max(round(moved / period) - 1, 0), self.session)
        at = before.time + (frame.device_ms - before.frame.device_ms) % ROUND / 1000
        lost = (frame.sequence - before.frame.sequence) % ROUND - 1
        return Sample(frame, self.hello, at if at > last.time else last.time + moved, now, lost, self.session)

    def _lost_at_first(self, frame: Frame) -> int:
        """Numbers begin with 0, unless the clock says that there was no time for so many frames."""
        least = 0.99e-6 * frame.sequence * self.hello.period_us
        most = FASTEST * max(time.time() - self.since, 0.0) + AHEAD_SECONDS
        return frame.sequence if least <= min(1e-3 * frame.device_ms + 2e-3, most) else 0

    def _resumed(self, frame: Frame) -> Sample | None:
        """The first frame after a jump of the clock or of the numbers; None where it was sent before."""
        assert self.before is not None and self.last is not None
        now, period, before = time.time(), self.hello.period_us * 1e-6, self.before
        steps = (frame.sequence - before.frame.sequence) % ROUND
        elapsed_ms = (frame.device_ms - before.frame.device_ms) % ROUND
        forward = 0 < elapsed_ms < ROUND // 2
        if steps == 1 or (not forward and 0 < 1e3 * steps * period <= self._most_ms(before.host_time)):
            at = max(before.time, self.last.time) + (steps + frame.missed) * period
            return Sample(frame, self.hello, at, now, steps - 1, self.session, clock_jump=True)
        if not forward:
            return None
        moved = min(elapsed_ms / 1000, AHEAD_SECONDS + max(now - self.last.host_time, period))
        at = max(before.time, self.last.time) + moved
        return Sample(frame, self.hello, at, now, max(round(moved / period) - 1, 0), self.session + 1)


class UnfitError(InputError):
    """The line talks and talks, but no frame that fits comes."""


class Patience:
    """Since when nothing has fitted, and what came instead; that is its only state.

    A line that is silent, or a port that is gone, may be waited for; one that talks may not without end.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._since = time.monotonic()
        self._heard = Counter[str]()

    def renew(self) -> None:
        """A frame fitted, or nobody is there."""
        self._since = time.monotonic()
        self._heard.clear()

    def hear(self, item: Message, out_of_order: bool) -> None:
        """Something came that is no frame that fits."""
        if isinstance(item, Frame):
            kind = "frames out of order" if out_of_order else "frames of another size"
        else:
            kind = "pieces that are no message" if isinstance(item, Garbage) else "answers"
        self._heard[kind] += 1

    def check(self, period_us: int = 0) -> None:
        """Raise UnfitError where the line has talked for 30 s and three periods, and nothing fitted."""
        waited = time.monotonic() - self._since
        if self._heard and waited > UNFIT_SECONDS + 3e-6 * period_us:
            came = ", ".join(f"{number} {kind}" for kind, number in self._heard.most_common())
            raise UnfitError(f"{self._url}: nothing fit for {waited:.0f} s, though the line is not silent ({came})")


Samples = Generator[tuple[Sample, ...], None, None]


def agreed_and_recorded(sample: Sample, scene: Scene | None) -> tuple[Scene, Array]:
    """The agreed scene, and (rows, columns) what its readout makes of the mean code: ohm or volt.

    Raises InputError as `scene_of`.
    """
    agreed = scene_of(sample.hello, scene)
    assert agreed.readout is not None
    return agreed, agreed.readout.recorded_from_sums(sample.frame.sums, sample.frame.readings)


def board_samples(
    url: str,
    scene: Scene | None = None,
    period: float | None = None,
    on_state: Callable[[str], None] = lambda sentence: None,
    ending: Callable[[], bool] = lambda: False,
) -> Samples:
    """Samples as they come, several at once where they wait, and none now and then. Close it to stop the board.

    Parameters
    ----------
    url : port name or pyserial URL.
    scene : what the board must fit, and is set to.
    period : s between frames; None for 1 s, or the shortest where that is longer.
    on_state : called with a sentence when the board is gone.
    ending : asked again and again; once it says so, what the port has delivered comes as one last batch.

    Raises InputError where no board answers at first, where it does not fit the scene, cannot be that fast, or the line
    talks without a frame that fits.
    """
    last: Sample | None = None
    session = 0
    patience = Patience(url)
    while not ending():
        heard = 0
        try:
            with Board.open(url) as board:
                try:
                    for samples in _one_connection(board, scene, period, last, session, patience, ending):
                        if samples:
                            last = samples[-1]
                            scene = scene_of(last.hello, scene)
                        yield samples
                finally:
                    heard = board.heard
        except OSError as error:
            if last is None:
                raise NoBoardError(f"{url}: the board went away ({' '.join(str(error).split())})") from error
            reason = "the board is gone; waiting for it"
        except NoBoardError:
            if last is None:
                raise
            reason = "the board does not answer; waiting for it"
        else:
            return
        if not heard:
            patience.renew()
        patience.check()
        session = last.session + 1 if last else 0
        on_state(reason)
        yield ()
        time.sleep(RETRY_SECONDS)


def _one_connection(
    board: Board,
    scene: Scene | None,
    period: float | None,
    last: Sample | None,
    session: int,
    patience: Patience,
    ending: Callable[[], bool],
) -> Samples:
    """Samples until the board is gone or the end is asked for; a board that restarts is set and started again."""
    hello = board.hello()
    try:
        while True:
            agreed = scene_of(hello, scene)
            readings = agreed.readout.readings if agreed.readout else hello.readings
            wanted = None if period is None else round(period * 1e6)
            settings = board.start(agreed.panel.rows, agreed.panel.columns, readings, wanted)
            for samples in _one_run(board, Scanning(settings, session, last), patience, ending):
                last = samples[-1] if samples else last
                yield samples
            if ending():
                return
            yield ()
            patience.check(settings.period_us)
            hello = board.hello()
            session = last.session + 1 if last else session + 1
    finally:
        board.stop()


def _one_run(board: Board, run: Scanning, patience: Patience, ending: Callable[[], bool]) -> Samples:
    """Samples until the board says that it no longer scans, or the end is asked for."""
    hello = run.hello
    silent_after = max(SILENCE_SECONDS, 3e-6 * hello.period_us)
    heard = time.monotonic()
    while True:
        asked = ending()
        found = board.last_messages() if asked else board.messages()
        run, samples, over = _taken(run, found, patience)
        if samples:
            heard = time.monotonic()
        yield samples
        if over or asked:
            return
        patience.check(hello.period_us)
        if time.monotonic() - heard > silent_after:
            came = board.heard
            try:
                now = board.identify()
            except NoBoardError:
                if board.heard == came:
                    raise
                heard = time.monotonic()  # the line is noisy, which is no reason to reset the board
                continue
            patience.hear(now, False)
            if not now.running or (now.rows, now.columns, now.readings) != (hello.rows, hello.columns, hello.readings):
                return
            run, heard = run.doubted(), time.monotonic()


def _taken(run: Scanning, found: Sequence[Message], patience: Patience) -> tuple[Scanning, tuple[Sample, ...], bool]:
    """The run with all messages, the samples they make, and whether the board said that it no longer scans."""
    samples: list[Sample] = []
    for item in found:
        if isinstance(item, Hello) and not item.running:
            patience.hear(item, False)
            return run, tuple(samples), True
        fits = isinstance(item, Frame) and _fits(item, run.hello)
        more: tuple[Sample, ...] = ()
        if isinstance(item, Frame) and fits:
            run, more = run.taking(item)
        if more:
            samples.extend(more)
            patience.renew()
        else:
            patience.hear(item, fits)
    return run, tuple(samples), False


def _fits(frame: Frame, hello: Hello) -> bool:
    return frame.sums.shape == (hello.rows, hello.columns) and frame.readings == hello.readings
