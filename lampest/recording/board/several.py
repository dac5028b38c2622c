"""Several boards as one: each scans a module, and their simultaneous frames form a frame of the whole image.

A board's time on the host's clock is its own time plus the least delay of its newest frames, s = min(arrival − time).
The board of the first module leads, or the next one while it is absent: its frames define the times of the image. Every
other board contributes its frame nearest in time. An absent board is missing from the image until it returns.
"""

from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from threading import Event, Thread
from time import time

import numpy as np

from lampest.files.errors import InputError
from lampest.panel.panel import Modules
from lampest.panel.scene import Scene
from lampest.recording.acquisition import NO_SUM
from lampest.recording.board.port import only_port
from lampest.recording.board.stream import RETRY_SECONDS, Sample, Samples, board_samples

LATE_SECONDS = 0.3  # s, and 1.5 periods, after which a silent board counts as missing
Stamped = tuple[float, Sample]  # start of the scan in s on the host's clock, and the sample
Arrived = SimpleQueue[tuple[int, Sample | str | InputError | None]]  # board, and its sample, state, error or end


def samples_of(
    ports: Sequence[str],
    scene: Scene | None = None,
    period: float | None = None,
    on_state: Callable[[str], None] = lambda sentence: None,
    ending: Callable[[], bool] = lambda: False,
) -> Samples:
    """Return samples as `board_samples`: of one board (by default the only one), or of one for each module in order."""
    if scene is None or scene.panel.modules is None:
        if len(ports) > 1:
            raise InputError("--port: several boards need a scene with panel: {modules: ...}, a board for each module")
        return board_samples(ports[0] if ports else only_port(), scene, period, on_state, ending)
    layout = scene.panel.modules
    numbers = [number for number in range(layout.count) if number not in scene.dead_modules]
    if len(ports) != len(numbers):
        named = ", ".join(str(list(layout.place(number))) for number in numbers[:4])
        raise InputError(
            f"the scene reads {len(numbers)} modules: name as many ports, --port once for each, in the order {named}"
            f"{', …' if len(numbers) > 4 else ''}; not {len(ports)}"
        )
    readings = {own.readout.readings for own in map(scene.of_modules.__getitem__, numbers) if own.readout}
    if len(readings) != 1:
        raise InputError("modules that are recorded together need a readout with one number of readings for all")
    return _Boards(scene, layout, numbers, ports).samples(period, on_state, ending)


@dataclass(frozen=True, eq=False)
class Alignment:
    """State of the alignment of several boards.

    Attributes
    ----------
    waiting : tuple of tuple of Stamped
        Waiting frames of each board, oldest first.
    shown : tuple of Stamped or None
        Last frame of each board in the image.
    delays : tuple of tuple of float
        Recent delays of each board in s.
    moment, began : float or None
        Times of the newest and of the first frame of the image in s on the host's clock.
    missing : tuple of int
        Boards that are missing from the newest frame.
    frames : int
        Number of frames of the image so far.
    """

    waiting: tuple[tuple[Stamped, ...], ...]
    shown: tuple[Stamped | None, ...]
    delays: tuple[tuple[float, ...], ...]
    moment: float | None = None
    missing: tuple[int, ...] = ()
    frames: int = 0
    began: float | None = None

    @classmethod
    def of(cls, boards: int) -> "Alignment":
        """Return the state before the first frame."""
        return cls(((),) * boards, (None,) * boards, ((),) * boards)

    def taking(self, board: int, sample: Sample) -> "Alignment":
        """Return the state after a frame of a board; the delays begin anew after a restart."""
        known = [*filter(None, [self.shown[board]]), *self.waiting[board]]
        before = self.delays[board] if known and known[-1][1].session == sample.session else ()
        delays, waiting = list(self.delays), list(self.waiting)
        delays[board] = (*before, sample.host_time - sample.time)[-50:]  # the least of these relates the two clocks
        waiting[board] = (*waiting[board], (sample.time + min(delays[board]), sample))
        return replace(self, waiting=tuple(waiting), delays=tuple(delays))

    def frame(self, now: float) -> "tuple[Alignment, dict[int, Sample]] | None":
        """Return the next state and its samples by board; None while a present board may still send its frame."""
        led = self._led(now)
        if led is None:
            return None
        at, period = led[0], led[1].hello.period
        late, parts = now > at + 1.5 * period + LATE_SECONDS, dict[int, Stamped]()
        for board, waiting in enumerate(self.waiting):
            known = [*filter(None, [self.shown[board]]), *waiting]
            if not (late or board in self.missing) and (not known or known[-1][0] < at - period / 2):
                return None
            nearest = min(known, key=lambda stamped: abs(stamped[0] - at), default=None)
            # Half a period, plus the jitter of clocks.
            if nearest is not None and abs(nearest[0] - at) <= 0.75 * period:
                parts[board] = nearest
        remaining = [
            tuple(part for part in waiting if part[0] > (parts[board][0] if board in parts else at - period))
            for board, waiting in enumerate(self.waiting)
        ]
        shown = tuple(parts.get(board, last) for board, last in enumerate(self.shown))
        missing = tuple(board for board in range(len(shown)) if board not in parts)
        began, frames = at if self.began is None else self.began, self.frames + 1
        after = Alignment(tuple(remaining), shown, self.delays, at, missing, frames, began)
        return after, {board: sample for board, (_, sample) in parts.items()}

    def _led(self, now: float) -> Stamped | None:
        """Return the frame that defines the next time, from the first present board; None before it has arrived."""
        if self.moment is None:
            if not all(self.waiting):
                return None
            begin = max(waiting[0][0] for waiting in self.waiting)
            return next((led for led in self.waiting[0] if led[0] > begin - led[1].hello.period / 2), None)
        for board, waiting in enumerate(self.waiting):
            for led in waiting:
                if led[0] > self.moment + led[1].hello.period / 2:
                    return led
            last = self.shown[board]
            if board not in self.missing and last and now < self.moment + 2.5 * last[1].hello.period + LATE_SECONDS:
                return None
        return None


@dataclass(frozen=True, eq=False)
class _Boards:
    """Boards of the modules `numbers`, one at each port."""

    scene: Scene
    layout: Modules
    numbers: Sequence[int]
    ports: Sequence[str]

    def samples(self, period: float | None, on_state: Callable[[str], None], ending: Callable[[], bool]) -> Samples:
        """Yield samples of the whole image in batches; see `board_samples`."""
        current, ended, arrived = Alignment.of(len(self.ports)), Event(), Arrived()
        states, listening = [""] * len(self.ports), set(range(len(self.ports)))
        modules = [self.scene.of_modules[number] for number in self.numbers]
        threads = [
            Thread(target=_listen, args=(*listener, period, arrived, ended), daemon=True)
            for listener in zip(range(len(modules)), self.ports, modules, strict=True)
        ]
        for thread in threads:
            thread.start()
        try:
            while listening or not arrived.empty():
                if ending():
                    ended.set()
                with suppress(Empty):
                    board, item = arrived.get(timeout=0.02)
                    if isinstance(item, Sample):
                        current, states[board] = current.taking(board, item), ""
                    elif isinstance(item, InputError):  # no frame of this board came, so there is no image yet
                        raise item
                    elif item is None:
                        listening.discard(board)
                    else:
                        states[board] = str(item)
                made = list[Sample]()
                while (step := current.frame(time() if listening else np.inf)) is not None:
                    made.append(self._image(step[1], current, step[0]))
                    current = step[0]
                yield tuple(made)
                gone = [
                    f"{self._place(board)} at {self.ports[board]}: {states[board] or 'no frame came'}"
                    for board in current.missing
                ]
                if made and gone:
                    on_state("module " + "; module ".join(gone))
                    yield ()
        finally:
            ended.set()
            for thread in threads:
                thread.join()

    def _image(self, parts: dict[int, Sample], before: Alignment, after: Alignment) -> Sample:
        """Return the boards' frames as one sample, with the clock of the first board and the restarts of all."""
        every, first = list(parts.values()), next(iter(parts.values()))
        each, (rows, columns) = self.layout.each, self.layout.shape
        sums = np.full((self.layout.count, each.rows, each.columns), NO_SUM, dtype=np.uint16)
        for board, sample in parts.items():
            sums[self.numbers[board]] = sample.frame.sums
        fresh = [sample for board, sample in parts.items() if before.shown[board] != after.shown[board]]
        missed, whole = max(sample.frame.missed for sample in every), self.layout.joined(sums)
        events = [f"gone: {self._place(board)}" for board in after.missing if board not in before.missing]
        events += [f"back: {self._place(board)}" for board in before.missing if board not in after.missing]
        return Sample(
            replace(first.frame, sequence=before.frames, missed=missed, sums=whole),
            replace(first.hello, rows=rows, columns=columns),
            (after.moment or 0.0) - (after.began or 0.0),
            max(sample.host_time for sample in every),
            min(sample.lost for sample in fresh) if before.frames else 0,
            sum(last[1].session for last in after.shown if last is not None),
            any(sample.clock_jump for sample in fresh),
            len(after.missing),
            tuple(events),
        )

    def _place(self, board: int) -> str:
        return ",".join(map(str, self.layout.place(self.numbers[board])))


def _listen(board: int, port: str, own: Scene, period: float | None, arrived: Arrived, ended: Event) -> None:
    """Queue a board's samples and states until the end, then None.

    An error before the first sample ends the queue. After a later error the port is opened again, any number of times:
    hubs that hang are unplugged and plugged in again.
    """
    sessions = 0
    while not ended.is_set():
        before = sessions
        try:
            samples = board_samples(port, own, period, lambda sentence: arrived.put((board, sentence)), ended.is_set)
            with closing(samples) as batches:
                for sample in (sample for batch in batches for sample in batch):
                    sessions = before + sample.session + 1
                    arrived.put((board, replace(sample, session=sessions - 1)))
        except InputError as error:
            arrived.put((board, str(error) if sessions else error))
            if not sessions:
                break
            ended.wait(RETRY_SECONDS)
    arrived.put((board, None))
