"""Several boards as one: each scans a module, and what they measured at one moment is a frame of the whole image.

A board's time on the host's clock is its own plus the least delay of its newest frames, s = min(arrival − time). The
first module's board leads, or while it is gone the next one: its frames are the moments, and of every other board that
frame counts which began nearest. A board that drops out is missing from the image until it is back.
"""

from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from threading import Event, Thread
from time import time

import numpy as np

from lampest.files.errors import InputError
from lampest.panel.scene import Scene
from lampest.recording.acquisition import NO_SUM
from lampest.recording.board.port import only_port
from lampest.recording.board.stream import Sample, Samples, board_samples

CLOCKED = 50  # newest frames of which the least delayed one sets a board's clock
NEAR = 0.75  # periods by which a board's frame may be off a moment: half of one, and what clocks jitter
LATE_SECONDS = 0.3  # and 1.5 periods after a moment, a board that has sent nothing is missing
POLL_SECONDS = 0.02
Stamped = tuple[float, Sample]  # s on the host's clock, when the scan began
Arrived = SimpleQueue[tuple[int, Sample | str | InputError | None]]  # by board


def samples_of(
    ports: Sequence[str],
    scene: Scene | None = None,
    period: float | None = None,
    on_state: Callable[[str], None] = lambda sentence: None,
    ending: Callable[[], bool] = lambda: False,
) -> Samples:
    """As `board_samples`, of one board or of one for each module that is read, in the order of the modules.

    ports : names or URLs; none: the only port that looks like an Arduino. Raises InputError as `board_samples`, and
    where there is not one port for each module.
    """
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
    return _together(ports, scene, numbers, period, on_state, ending)


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where boards stand: of each the frames that wait, oldest first, the one that was shown last, and recent delays.

    moment : of the image's newest frame, s on the host's clock; None before the first. missing : boards not in it.
    """

    waiting: tuple[tuple[Stamped, ...], ...]
    shown: tuple[Stamped | None, ...]
    delays: tuple[tuple[float, ...], ...]
    moment: float | None = None
    missing: frozenset[int] = frozenset()

    @classmethod
    def of(cls, boards: int) -> "Alignment":
        """Before the first frame."""
        return cls(((),) * boards, (None,) * boards, ((),) * boards)

    def taking(self, board: int, sample: Sample) -> "Alignment":
        """With one frame more of a board; after a restart its clock is compared anew."""
        known = [*filter(None, [self.shown[board]]), *self.waiting[board]]
        before = self.delays[board] if known and known[-1][1].session == sample.session else ()
        delays, waiting = list(self.delays), list(self.waiting)
        delays[board] = (*before, sample.host_time - sample.time)[-CLOCKED:]
        waiting[board] = (*waiting[board], (sample.time + min(delays[board]), sample))
        return replace(self, waiting=tuple(waiting), delays=tuple(delays))

    def frame(self, now: float) -> "tuple[Alignment, dict[int, Sample]] | None":
        """What comes after the next frame of the image, and that, board → sample; None before it can be made.

        The first one waits for all boards, later ones for no board that is late. now : s since 1970-01-01 UTC.
        """
        led = self._led(now)
        if led is None:
            return None
        at, period = led[0], _period(led[1])
        late, found = now > at + 1.5 * period + LATE_SECONDS, dict[int, Stamped]()
        for board, waiting in enumerate(self.waiting):
            known = [*filter(None, [self.shown[board]]), *waiting]
            if not (late or board in self.missing) and (not known or known[-1][0] < at - period / 2):
                return None
            nearest = min(known, key=lambda one: abs(one[0] - at), default=None)
            if nearest is not None and abs(nearest[0] - at) <= NEAR * period:
                found[board] = nearest
        left = [
            tuple(one for one in waiting if one[0] > (found[board][0] if board in found else at - period))
            for board, waiting in enumerate(self.waiting)
        ]
        shown = tuple(found.get(board, last) for board, last in enumerate(self.shown))
        missing = frozenset(range(len(shown))) - found.keys()
        after = replace(self, waiting=tuple(left), shown=shown, moment=at, missing=missing)
        return after, {board: sample for board, (_, sample) in found.items()}

    def _led(self, now: float) -> Stamped | None:
        """The frame that is the next moment: of the first board that is there; None where it has not come yet."""
        if self.moment is None:
            if not all(self.waiting):
                return None
            begin = max(waiting[0][0] for waiting in self.waiting)
            return next((one for one in self.waiting[0] if one[0] > begin - _period(one[1]) / 2), None)
        for board, waiting in enumerate(self.waiting):
            for one in waiting:
                if one[0] > self.moment + _period(one[1]) / 2:
                    return one
            last = self.shown[board]
            if board not in self.missing and last and now < self.moment + 2.5 * _period(last[1]) + LATE_SECONDS:
                return None
        return None


def _period(sample: Sample) -> float:
    return sample.hello.period_us * 1e-6


def _together(
    ports: Sequence[str],
    scene: Scene,
    numbers: Sequence[int],
    period: float | None,
    on_state: Callable[[str], None],
    ending: Callable[[], bool],
) -> Samples:
    """Frames of the whole image; numbers : of the modules that are read, one for each port."""
    layout = scene.panel.modules
    assert layout is not None
    here, count, began, ended, arrived = Alignment.of(len(ports)), 0, 0.0, Event(), Arrived()
    names = [f"module {list(layout.place(number))} at {port}" for number, port in zip(numbers, ports, strict=True)]
    states, listening = [""] * len(ports), set(range(len(ports)))
    threads = [
        Thread(
            target=_listen, args=(board, port, scene.of_modules[numbers[board]], period, arrived, ended), daemon=True
        )
        for board, port in enumerate(ports)
    ]
    for thread in threads:
        thread.start()
    try:
        while listening or not arrived.empty():
            if ending():
                ended.set()
            with suppress(Empty):
                board, item = arrived.get(timeout=POLL_SECONDS)
                if isinstance(item, Sample):
                    here, states[board] = here.taking(board, item), ""
                elif isinstance(item, InputError) and (here.moment is None or len(listening) == 1):
                    raise item
                elif item is None:
                    listening.discard(board)
                else:
                    states[board] = str(item)
            made = list[Sample]()
            while (found := here.frame(time() if listening else np.inf)) is not None:
                after, parts = found
                began = began if count else after.moment or 0.0
                made.append(_image(scene, numbers, parts, here, after, count, began))
                here, count = after, count + 1
            yield tuple(made)
            said = "; ".join(f"{names[board]}: {states[board] or 'no frame came'}" for board in sorted(here.missing))
            if made and said:
                on_state(said)
                yield ()
    finally:
        ended.set()
        for thread in threads:
            thread.join()


def _listen(board: int, port: str, own: Scene, period: float | None, arrived: Arrived, ended: Event) -> None:
    """Hand on what a board sends: samples, what is said of it, the error that ended it, and None at the end."""

    def said(sentence: str) -> None:
        arrived.put((board, sentence))

    try:
        with closing(board_samples(port, own, period, said, ended.is_set)) as batches:
            for sample in (sample for batch in batches for sample in batch):
                arrived.put((board, sample))
    except InputError as error:
        arrived.put((board, error))
    arrived.put((board, None))


def _image(
    scene: Scene,
    numbers: Sequence[int],
    parts: dict[int, Sample],
    before: Alignment,
    after: Alignment,
    count: int,
    began: float,
) -> Sample:
    """The boards' frames as one: it has the first board's clock, and the restarts of all."""
    layout = scene.panel.modules
    assert layout is not None and after.moment is not None
    every, first = list(parts.values()), next(iter(parts.values()))
    sums = np.full((layout.count, layout.each.rows, layout.each.columns), NO_SUM, dtype=np.uint16)
    for board, sample in parts.items():
        sums[numbers[board]] = sample.frame.sums
    fresh = [sample for board, sample in parts.items() if before.shown[board] != after.shown[board]]
    changed = {"gone": after.missing - before.missing, "back": before.missing - after.missing}
    rows, columns = layout.shape
    return Sample(
        replace(first.frame, sequence=count, missed=max(one.frame.missed for one in every), sums=layout.joined(sums)),
        replace(first.hello, rows=rows, columns=columns),
        after.moment - began,
        max(sample.host_time for sample in every),
        min((sample.lost for sample in fresh), default=0) if count else 0,
        sum(last[1].session for last in after.shown if last is not None),
        any(sample.clock_jump for sample in fresh),
        len(after.missing),
        tuple(
            f"{word}: {','.join(map(str, layout.place(numbers[board])))}"
            for word, boards in changed.items()
            for board in sorted(boards)
        ),
    )
