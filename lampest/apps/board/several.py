"""Several boards as one.

Each board scans a module, and their simultaneous frames form a frame of the whole image. A board's
time on the host's steady clock is its own time plus the least delay of its newest frames, s =
min(arrival − time). The board of the first module leads, or the next one while it is absent: its
frames define the times of the image. Every other board contributes its frame nearest in time. An
absent board is missing from the image until it returns.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from copy import copy
from dataclasses import replace
from itertools import chain
from queue import Empty, SimpleQueue
from threading import Event, Thread
from time import monotonic

import numpy as np

from lampest.apps.board.port import only_port
from lampest.apps.board.protocol import Frame, Hello
from lampest.apps.board.sample import AnyFrame, Listening, Sample, Samples
from lampest.apps.board.stream import RETRY_SECONDS, board_samples
from lampest.files.errors import InputError
from lampest.panel.panel import Modules
from lampest.panel.scene import Scene
from lampest.recording.acquisition import NO_SUM

POLL_SECONDS = 0.02  # s between looks whether a recording ends
LATE_SECONDS = 0.3  # s, and 1.5 periods, after which a silent board counts as missing
Stamped = tuple[float, Sample]  # start of the scan in s on the host's steady clock, and the sample
# board, and its sample, state, error or end
Arrived = SimpleQueue[tuple[int, Sample | str | InputError | None]]


def samples_of(listening: Listening) -> Samples:
    """Return samples as `board_samples`, of one board or of one for each module in order.

    The one board is by default the only one. Of modules the boards' own estimates are left out; one
    board that prints (`lines`) may print all of them.
    """
    scene = listening.scene
    ports = listening.ports
    modules = None if scene is None else scene.panel.modules
    joined = listening.lines and len(ports) == 1
    if scene is None or modules is None or (joined and modules.count > 1):
        if len(ports) > 1:
            raise InputError(
                "--port: several boards need a scene with panel: "
                "{modules: ...}, a board for each module"
            )
        return board_samples(ports[0] if ports else only_port(), listening)
    numbers = sorted({*range(modules.count)} - {*scene.dead_modules})
    if len(ports) != len(numbers):
        named = ", ".join(str(list(modules.place(number))) for number in numbers[:4])
        raise InputError(
            f"the scene reads {len(numbers)} modules: name as many ports, --port once for each, "
            f"in the order {named}{', …' if len(numbers) > 4 else ''}; not {len(ports)}. "
            "--lines reads one board that prints all of them"
        )
    readouts = (scene.of_modules[number].readout for number in numbers)
    if len({readout.readings for readout in readouts if readout}) != 1:
        raise InputError(
            "modules that are recorded together need a readout with one number of readings for all"
        )
    return _images(scene, numbers, listening)


class Alignment:
    """Alignment of several boards in time.

    Attributes
    ----------
    boards : range
        Numbers of the boards.
    waiting : list of list of Stamped
        Waiting frames of each board, oldest first.
    shown : list of Stamped or None
        Last frame of each board in the image.
    delays : list of deque of float
        Recent delays of each board in s; the least of these relates the two clocks.
    moment, began : float or None
        Times of the newest and of the first frame of the image in s on the host's steady clock.
    elapsed : float
        Time between these in s, once there is a frame.
    missing : tuple of int
        Boards that are missing from the newest frame.
    frames : int
        Number of frames of the image so far.
    """

    def __init__(self, boards: int) -> None:
        self.boards = range(boards)
        self.frames = 0
        self.moment: float | None = None
        self.began: float | None = None
        self.elapsed: float
        self.missing: tuple[int, ...] = ()
        self.waiting: list[list[Stamped]] = [[] for _ in self.boards]
        self.shown: list[Stamped | None] = [None] * boards
        self.delays = [deque[float](maxlen=50) for _ in self.boards]

    def _frames_of(self, board: int) -> list[Stamped]:
        """Return the last shown frame of a board, if any, and those that wait."""
        return [*filter(None, [self.shown[board]]), *self.waiting[board]]

    def take(self, board: int, sample: Sample) -> None:
        """Take a frame of a board; its delays begin anew after a restart."""
        frames = self._frames_of(board)
        delays = self.delays[board]
        if not frames or frames[-1][1].session != sample.session:
            delays.clear()
        delays.append(sample.arrived - sample.time)
        self.waiting[board].append((sample.time + min(delays), sample))

    def frame(self, now: float) -> dict[int, Sample] | None:
        """Advance to the next frame and return its samples by board.

        The result is None while a present board may still send.
        """
        led = self._led(now)
        if led is None:
            return None
        at, sample = led
        period = sample.hello.period
        late = now > at + 1.5 * period + LATE_SECONDS
        parts = dict[int, Stamped]()
        for board in self.boards:
            frames = self._frames_of(board)
            newest = frames[-1][0] if frames else -np.inf
            # A missing board is waited for as soon as it sends again: its next frame may be the
            # nearer one.
            silent = board in self.missing and newest < at - 1.5 * period
            if not (late or silent) and newest < at - period / 2:
                return None
            nearest = min(frames, key=lambda stamped: abs(stamped[0] - at), default=None)
            # Half a period, plus the jitter of clocks.
            if nearest is not None and abs(nearest[0] - at) <= 0.75 * period:
                parts[board] = nearest
        for board, waiting in enumerate(self.waiting):
            end = parts[board][0] if board in parts else at - period
            self.waiting[board] = [part for part in waiting if part[0] > end]
        self.shown = [parts.get(board, last) for board, last in enumerate(self.shown)]
        self.missing = tuple(board for board in self.boards if board not in parts)
        self.moment = at
        self.frames += 1
        self.began = at if self.began is None else self.began
        self.elapsed = at - self.began
        return {board: sample for board, (_, sample) in parts.items()}

    def _led(self, now: float) -> Stamped | None:
        """Return the frame that defines the next time, from the first present board.

        The result is None before it has arrived.
        """
        if self.moment is None:
            if not all(self.waiting):
                return None
            begin = max(waiting[0][0] for waiting in self.waiting)
            return next(
                (led for led in self.waiting[0] if led[0] > begin - led[1].hello.period / 2), None
            )
        for board, waiting in enumerate(self.waiting):
            for led in waiting:
                if led[0] > self.moment + led[1].hello.period / 2:
                    return led
            last = self.shown[board]
            if (
                board not in self.missing
                and last
                and now < self.moment + 2.5 * last[1].hello.period + LATE_SECONDS
            ):
                return None
        return None


def _images(scene: Scene, numbers: Sequence[int], listening: Listening) -> Samples:
    """Yield samples of the whole image in batches; see `board_samples`.

    `numbers` are the modules of the boards.
    """
    assert scene.panel.modules is not None
    places = [",".join(map(str, scene.panel.modules.place(number))) for number in numbers]
    current = Alignment(len(numbers))
    ended = Event()
    arrived = Arrived()
    states = [""] * len(numbers)
    present = {*current.boards}
    with _listeners(scene, numbers, listening, arrived, ended):
        while present or not arrived.empty():
            if listening.ending():
                ended.set()
            with suppress(Empty):
                board, item = arrived.get(timeout=POLL_SECONDS)
                if isinstance(item, Sample):
                    current.take(board, item)
                    states[board] = ""
                # No frame of this board came, so there is no image yet.
                elif isinstance(item, InputError):
                    raise item
                elif item is None:
                    present.discard(board)
                else:
                    states[board] = item
            images = list[Sample]()
            before = copy(current)
            while (parts := current.frame(monotonic() if present else np.inf)) is not None:
                images.append(_image(scene, numbers, parts, before, current))
                before = copy(current)
            yield tuple(images)
            if images and current.missing:
                gone = (
                    f"module {places[board]} at {listening.ports[board]}: "
                    f"{states[board] or 'no frame came'}"
                    for board in current.missing
                )
                listening.on_state("; ".join(gone))
                yield ()


@contextmanager
def _listeners(
    scene: Scene,
    numbers: Sequence[int],
    listening: Listening,
    arrived: Arrived,
    ended: Event,
) -> Iterator[None]:
    """Listen to each board in a thread; end and join the threads on exit.

    A thread queues the samples and states of its board until the end, then None. An error before
    the first sample ends all boards. After a later error the port is opened again, any number of
    times: hubs that hang are unplugged and plugged in again.
    """

    def listen(board: int) -> None:
        sessions = 0
        while not ended.is_set():
            before = sessions
            try:
                how = replace(
                    listening,
                    scene=scene.of_modules[numbers[board]],
                    on_state=lambda sentence: arrived.put((board, sentence)),
                    ending=ended.is_set,
                    baseline=0,
                )
                with closing(board_samples(listening.ports[board], how)) as batches:
                    for sample in chain.from_iterable(batches):
                        sessions = before + sample.session + 1
                        arrived.put((board, replace(sample, session=sessions - 1)))
            except InputError as error:
                arrived.put((board, str(error) if sessions else error))
                ended.wait(RETRY_SECONDS)
        arrived.put((board, None))

    threads = [Thread(target=listen, args=(board,), daemon=True) for board in range(len(numbers))]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()


def _image(
    scene: Scene,
    numbers: Sequence[int],
    parts: dict[int, Sample],
    before: Alignment,
    after: Alignment,
) -> Sample:
    """Return the boards' frames as one sample, with the clock of the first board.

    The sample has the restarts of all boards.
    """
    layout = scene.panel.modules
    first = next(iter(parts.values()))
    assert layout is not None
    fresh = [sample for board, sample in parts.items() if before.shown[board] != after.shown[board]]
    events = list(chain.from_iterable(sample.events for sample in fresh))
    for word, inside, outside in (
        ("gone", after.missing, before.missing),
        ("back", before.missing, after.missing),
    ):
        places = (layout.place(numbers[board]) for board in inside if board not in outside)
        events += [f"{word}: {','.join(map(str, place))}" for place in places]
    own = {numbers[board]: sample for board, sample in parts.items()}
    settings = first.hello
    if isinstance(settings, Hello):
        rows, columns = layout.shape
        settings = replace(settings, rows=rows, columns=columns, estimates=False)
    return Sample(
        frame=replace(_joined(layout, own, first), sequence=before.frames, log_change=None),
        hello=settings,
        scene=scene,
        time=after.elapsed,
        host_time=max(sample.host_time for sample in parts.values()),
        lost=min(sample.lost for sample in fresh) if before.frames else 0,
        session=sum(last[1].session for last in after.shown if last is not None),
        events=tuple(dict.fromkeys(events)),
        missing=len(after.missing),
        arrived=max(sample.arrived for sample in parts.values()),
    )


def _joined(layout: Modules, parts: Mapping[int, Sample], first: Sample) -> AnyFrame:
    """Return the frames of modules, by their numbers, as one; a missing module has no readings."""
    shape = (layout.count, layout.each.rows, layout.each.columns)
    missed = max(sample.frame.missed for sample in parts.values())
    if isinstance(first.frame, Frame):
        sums = np.full(shape, NO_SUM, dtype=np.uint16)
        for number, sample in parts.items():
            sums[number] = NO_SUM if sample.frame.sums is None else sample.frame.sums
        return replace(first.frame, missed=missed, sums=layout.joined(sums))
    recorded = np.full(shape, np.nan)
    for number, sample in parts.items():
        recorded[number] = sample.recorded
    return replace(first.frame, missed=missed, recorded=layout.joined(recorded))
