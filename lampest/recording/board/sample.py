"""A frame with its place in the recording, and which frame can come after which; no I/O."""

import time
from dataclasses import dataclass, field, replace

from lampest.recording.board.protocol import Frame, Hello

ROUND = 2**32  # numbers and the board's clock begin anew after so many
# A board's clock is not further ahead of the host's than this; a simulated board runs 300 times as fast as a real one.
FASTEST, AHEAD_SECONDS = 1000.0, 10.0


@dataclass(frozen=True, eq=False)
class Sample:
    """A frame with its place in the recording.

    time : s since the first frame, by the board's clock; across a restart of the board by the host's.
    host_time : s since 1970-01-01 UTC.
    lost : frames missing before this one.
    session : number of restarts and reconnections before it, and of times the board's numbers began anew.
    """

    frame: Frame
    hello: Hello
    time: float
    host_time: float
    lost: int
    session: int


@dataclass(frozen=True, eq=False)
class Scanning:
    """A board that was started, and how far it came: numbers grow and the clock at least as they do, modulo 2³².

    What came before is sent again by some lines; that is no frame. Where two frames in a row do not follow the newest
    one, but each other, and the clock went on, the numbers have begun anew.

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
        if self.before is None or self._follows(frame, self.before.frame, self.before.host_time):
            return self._with(self._placed(frame))
        stray = self.stray
        if (
            stray is not None
            and (frame.sequence - stray.sequence) % ROUND == 1
            and self._follows(frame, stray, time.time())
        ):
            elapsed_ms = (stray.device_ms - self.before.frame.device_ms) % ROUND
            if 0 < elapsed_ms < ROUND // 2:
                run, samples = self._with(self._renumbered(stray, elapsed_ms))
                run, more = run.taking(frame)
                return run, samples + more
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
        most_ms = 1e3 * (FASTEST * max(time.time() - host_time, 0.0) + AHEAD_SECONDS + 3e-6 * self.hello.period_us)
        return 0 < steps < ROUND // 2 and 0.99e-3 * steps * self.hello.period_us - 2 <= elapsed_ms <= most_ms

    def _placed(self, frame: Frame) -> Sample:
        now, period, last = time.time(), self.hello.period_us * 1e-6, self.last
        if last is None:
            return Sample(frame, self.hello, 0.0, now, self._lost_at_first(frame), self.session)
        moved = max(now - last.host_time, period)
        if self.before is None:
            return Sample(frame, self.hello, last.time + moved, now, max(round(moved / period) - 1, 0), self.session)
        at = self.before.time + (frame.device_ms - self.before.frame.device_ms) % ROUND / 1000
        lost = (frame.sequence - self.before.frame.sequence) % ROUND - 1
        return Sample(frame, self.hello, at if at > last.time else last.time + moved, now, lost, self.session)

    def _lost_at_first(self, frame: Frame) -> int:
        """Numbers begin with 0, unless the clock says that there was no time for so many frames."""
        least = 0.99e-6 * frame.sequence * self.hello.period_us
        most = FASTEST * max(time.time() - self.since, 0.0) + AHEAD_SECONDS
        return frame.sequence if least <= min(1e-3 * frame.device_ms + 2e-3, most) else 0

    def _renumbered(self, frame: Frame, elapsed_ms: int) -> Sample:
        """The first frame whose number began anew; the clock that went less far says how many are missing."""
        assert self.before is not None and self.last is not None
        now, period = time.time(), self.hello.period_us * 1e-6
        moved = min(elapsed_ms / 1000, AHEAD_SECONDS + max(now - self.last.host_time, period))
        at = max(self.before.time, self.last.time) + moved
        return Sample(frame, self.hello, at, now, max(round(moved / period) - 1, 0), self.session + 1)
