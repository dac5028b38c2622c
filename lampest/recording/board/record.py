"""Recording of a board.

Frames are appended to a journal, which is rewritten as a recording at the end. `record` reads from
a port. A `Recorder` records the samples of a watched port on request. A journal has the layout of a
recording. Other processes can read it meanwhile (single writer, multiple readers, SWMR), and
flushed frames remain readable after a crash.
"""

import contextlib
import dataclasses
import math
import re
import secrets
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any

import h5py
import numpy as np

from lampest.files import hdf5
from lampest.files.document import to_yaml
from lampest.files.errors import InputError
from lampest.files.process import deaf, ending_signals
from lampest.files.whole import check_output, folder_beside, is_locked, locked, own, sync_folder
from lampest.panel.readouts.converter import MIN_REPEATS
from lampest.panel.scene import Scene
from lampest.recording.acquisition import EVENTS, FORMAT, SALT, Rows, blocks, group_of
from lampest.recording.board.protocol import MAX_CODE
from lampest.recording.board.several import samples_of
from lampest.recording.board.stream import (
    CLOCK_JUMPED,
    CLOCK_STOPPED,
    UNFIT_SECONDS,
    Sample,
    Samples,
)
from lampest.recording.file import recording_file
from lampest.recording.recording import MEASURED, UNLOADED, Recording
from lampest.recording.stored import StoredRecording, save_parts

# No dot or separator: a visible file within the folder.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


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
    restarts, clock_jumps : int
        Restarts of the board, and jumps of its clock.
    clock_stopped : bool
        Whether the board's clock stood still at any time.
    parted : int
        Frames without the readings of a module.
    behind : int
        Frames that the port still contained at the end.
    ended_by : str
        Signal that ended the recording, such as SIGINT (Ctrl-C), or ''.
    noise_lsb : float, or None
        Noise of one reading from the baseline's repeats, if these suffice.
    silent : float
        Time without frames at the end of the requested duration, in s.
    unestimated : tuple of (str, int)
        Reasons why a board that estimates did not estimate frames, and their numbers.
    """

    path: Path
    scene: Scene
    frames: int
    lost: int
    restarts: int
    clock_jumps: int
    clock_stopped: bool
    parted: int
    behind: int
    ended_by: str
    noise_lsb: float | None
    silent: float
    unestimated: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class Progress:
    """Progress of a recording.

    Attributes
    ----------
    sample : Sample or None
        Newest sample; None while waiting for the board.
    frames, lost : int
        Numbers of frames, and of lost frames, so far.
    state : str
        Sentence on the state of the board, or ''.
    """

    sample: Sample | None
    frames: int
    lost: int
    state: str


@dataclass(frozen=True)
class Journal:
    """Open, growing recording file.

    Attributes
    ----------
    file : h5py.File
    scene : Scene
    """

    file: h5py.File
    scene: Scene

    @classmethod
    @contextlib.contextmanager
    def create(
        cls, path: Path, scene: Scene, readings: int, *, estimates: bool = False
    ) -> Iterator["Journal"]:
        """Create and yield a journal, also of a board's `estimates`.

        Raises InputError if the file cannot be created, or exists.
        """
        check_output(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = h5py.File(path, "x", libver=("v110", "v110"))
        except OSError as error:
            raise InputError(f"{path}: cannot be made ({error.strerror or error})") from error
        with file:
            _lay_out(file, scene, readings, Rows.of_frames(scene.circuit, estimates=estimates))
            file.flush()
            sync_folder(path.parent)
            file.swmr_mode = True
            with locked(path):  # HDF5's own lock ended where SWMR began
                yield cls(file, scene)

    def append(
        self, samples: Sequence[Sample], unloaded: int, keys: Callable[[], str] = lambda: ""
    ) -> None:
        """Append and flush samples with their events, and the pressed keys as events.

        Raises InputError if it fails. The first `unloaded` samples are unloaded.
        """
        rows = Rows.of_file(self.file, self.scene.circuit)
        unknown = np.full(self.scene.panel.shape, np.nan)
        fields = [
            vars(sample.frame)
            | vars(sample)
            | {
                "recorded": sample.recorded,
                "role": UNLOADED if number < unloaded else MEASURED,
                "log_change": unknown
                if sample.frame.log_change is None
                else sample.frame.log_change,
            }
            for number, sample in enumerate(samples)
        ]
        names = ["recorded", *(path.split("/")[-1] for path, *_ in rows.datasets[1:])]
        rows.append(self.file, [[field[name] for field in fields] for name in names])
        for sample in samples:
            for event in (*sample.events, *keys()):
                self.mark(sample.time, event)

    def mark(self, time: float, label: str) -> None:
        """Append an event; its label is cut to 16 characters."""
        EVENTS.append(self.file, ([time], [hdf5.ascii_array(label)]))

    def keep(self, source: h5py.File) -> None:
        """Append the undamaged frames and events of another journal.

        Damaged frames count as lost before the next.
        """
        for rows in (Rows.of_file(self.file, self.scene.circuit), EVENTS):
            intact = np.flatnonzero(rows.undamaged(source))
            dropped = np.diff(intact, prepend=-1) - 1
            for part in blocks(len(intact), self.scene.panel.crossings):
                first, last = intact[part][[0, -1]].tolist()
                values = [
                    column[intact[part] - first]
                    for column in rows.stored(source, slice(first, last + 1))
                ]
                for number, (path, *_) in enumerate(rows.datasets):
                    if path == "acquisition/lost":
                        values[number] = values[number] + dropped[part]
                rows.append(self.file, values)


def _lay_out(file: h5py.File, scene: Scene, readings: int, frame_rows: Rows) -> None:
    """Create the groups, datasets and attributes of a journal."""
    circuit = scene.circuit
    frames = group_of(scene.circuit)
    entry = file.create_group("entry")
    hdf5.write_text(entry, "scene", to_yaml(scene))
    series = (frame_rows, EVENTS)
    salt = secrets.token_hex(16)
    for path, kind, units, long_name in (
        dataset for rows in series for dataset in (*rows.datasets, rows.checksum)
    ):
        cells = (
            scene.panel.shape
            if path.endswith((f"/{circuit.signal}", "/sums", "/log_change"))
            else ()
        )
        chunk = (16 if cells else 1024, *cells)  # a chunk is written anew with every frame
        dataset = entry.create_dataset(
            path, (0, *cells), kind, maxshape=(None, *cells), chunks=chunk
        )
        hdf5.set_attributes(dataset, units=units, long_name=long_name)
    for rows in series:
        hdf5.set_attributes(entry[rows.checksum[0]], **{SALT: salt})
    hdf5.set_attributes(
        file,
        NX_class="NXroot",
        default="entry",
        lampest_format=FORMAT,
        lampest_unfinished=np.uint8(1),
    )
    hdf5.set_attributes(entry, NX_class="NXentry", default=frames)
    hdf5.set_attributes(
        entry[frames], NX_class="NXdata", signal=circuit.signal, axes=["time", "row", "column"]
    )
    hdf5.set_attributes(
        entry["raw"], NX_class="NXdata", signal="sums", readings=np.uint16(readings)
    )
    hdf5.set_attributes(entry["acquisition"], NX_class="NXcollection")


def _journal_for(sample: Sample, path: Path) -> contextlib.AbstractContextManager[Journal]:
    """Return a journal for the frames of a board, from its first sample.

    Raises InputError if the file exists.
    """
    return Journal.create(
        path, sample.scene, sample.hello.readings, estimates=sample.hello.estimates
    )


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

    count: Counter[str] = dataclasses.field(default_factory=Counter)
    unestimated: Counter[str] = dataclasses.field(default_factory=Counter)
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

    def progress(self, sample: Sample | None, state: str = "") -> Progress:
        """Return the progress with the newest sample, or with the state of the board."""
        return Progress(sample, self.frames, self.count["lost"], state)

    def results(self) -> dict[str, Any]:
        """Return the counts by the names of `Recorded`."""
        return {
            **{name: self.count[name] for name in ("frames", "lost", "parted", "behind")},
            "clock_jumps": self.count[CLOCK_JUMPED],
            "clock_stopped": self.count[CLOCK_STOPPED] > 0,
            "unestimated": tuple(self.unestimated.items()),
        }


def record(  # noqa: PLR0913 # the options of a command
    ports: str | Sequence[str] | None,
    out: Path,
    *,
    frames: int | None = None,
    seconds: float | None = None,
    scene: Scene | None = None,
    baseline: int = 0,
    period: float | None = None,
    on_progress: Callable[[Progress], None] = lambda progress: None,
    keys: Callable[[], str] = lambda: "",
) -> Recorded:
    """Record frames from a board into the file `out`, in ohm or volt as the readout gives them.

    Ctrl-C, SIGTERM, SIGHUP and SIGQUIT end the recording; frames that the port has received by then
    are included.

    Parameters
    ----------
    ports : str, sequence of str, or None
        Port name or pyserial URL; for a panel of modules those of all boards in the order of the
        modules. None: the only port that looks like an Arduino.
    out : Path
        File that must not exist yet.
    frames : int, or None
        Number of frames after which to end.
    seconds : float, or None
        Time after which to end.
    scene : Scene, or None
        Scene that the board must fit, and by which it is configured; by default the board's own.
    baseline : int
        Number of unloaded frames at the beginning.
    period : float, or None
        Time between frames in s; by default 1 s, or the shortest possible if that is longer.
    on_progress : callable
        Called after every frame, and when the board appears or disappears.
    keys : callable
        Returns the keys pressed since its last call; each marks an event.

    Raises
    ------
    InputError
        If the board does not answer or fit, `out` exists, or no frame arrives. Earlier frames are
        in the file.
    """
    check_output(out)
    if out.exists():
        raise InputError(f"{out}: exists already; a recording is never written over")
    urls: Sequence[str] = (ports,) if isinstance(ports, str) else ports or ()
    tally = Tally()
    states = [""]
    with ending_signals(lambda: tally.frames > 0 and not states[-1]) as ended_by:
        try:
            with contextlib.ExitStack() as stack:
                batches = samples_of(
                    urls, scene, period, states.append, lambda: bool(ended_by()), baseline
                )
                stack.enter_context(contextlib.closing(batches))
                journal: Journal | None = None
                for batch in _wanted(batches, frames, seconds, period or 1.0):
                    if batch:
                        states[:] = [""]
                        journal = journal or stack.enter_context(_journal_for(batch[0], out))
                        journal.append(batch, baseline - tally.frames, keys)
                    for sample in batch:
                        tally.add(sample, behind=bool(ended_by()))
                        on_progress(tally.progress(sample))
                    if not batch and states[-1]:
                        on_progress(tally.progress(None, states[-1]))
        except KeyboardInterrupt:
            if not tally.last:
                raise
        except InputError as error:
            before = f"; the {tally.frames} frames that came before are in {out}"
            raise InputError(f"{error}{before if tally.last else ''}") from error
        finally:
            made = finished(out) if tally.last else None
        if made is None or tally.last is None:
            raise InputError(f"{out}: ended before the first frame; nothing is written")
        complete = bool(ended_by()) or tally.frames == frames
        silent = (
            0.0
            if seconds is None or complete
            else max(seconds - tally.last.time - tally.last.hello.period, 0.0)
        )
        scene, _, noise = made
        return Recorded(
            path=out,
            scene=scene,
            restarts=tally.last.session,
            **tally.results(),
            ended_by=ended_by(),
            noise_lsb=noise,
            silent=round(silent, 3),
        )


class Recorder:
    """Recorder on request.

    One thread passes all samples, and any thread may start or end a recording. Every file begins
    with the unloaded frames of the watch, or with those after the last request of `zero`.

    Parameters
    ----------
    folder : Path
        Folder of the files.
    baseline : int
        Number of unloaded frames.
    say : callable
        Called with a sentence, and with whether a recording is running.
    """

    def __init__(self, folder: Path, baseline: int, say: Callable[[str, bool], None]) -> None:
        self._folder = folder.absolute()
        self._say = say
        self._baseline = baseline
        self._unloaded = deque[Sample](maxlen=baseline)
        self._asked: deque[str] = deque(maxlen=1)
        self._zeroed = Event()
        self._journal: Journal | None = None  # that grows
        self._open = contextlib.ExitStack()
        self._path: Path  # of the journal, with its frames
        self._frames: int
        self._finishing: list[Thread] = []

    def ask(self, name: str) -> None:
        """Start a recording by its name ('': the time), or end a running one.

        It is for any thread. Raises InputError.
        """
        if name and not NAME.fullmatch(name):
            raise InputError("a recording's name has up to 64 letters, digits, - and _")
        self._asked.append(name)

    def zero(self) -> None:
        """Declare the next frames as unloaded ones of later recordings.

        A running recording has an event instead.
        """
        self._zeroed.set()

    def take(self, sample: Sample) -> None:
        """Process a sample; a requested recording starts once all unloaded frames are known."""
        try:
            if self._zeroed.is_set():
                self._zeroed.clear()
                self._unloaded.clear()
                if self._journal is not None:
                    self._journal.mark(sample.time, "zero")
            if len(self._unloaded) < self._baseline:
                self._unloaded.append(sample)
            if self._journal is not None and self._asked:
                self._asked.clear()
                self._end()
            elif self._journal is not None:
                self._grow(self._journal, (sample,), 0)
            elif self._asked and len(self._unloaded) == self._baseline:
                self._begin(self._asked.popleft(), sample)
        except InputError as error:
            self._end(str(error))

    def close(self) -> None:
        """End a running recording, and wait until all files are closed.

        It waits without regard to signals.
        """
        if self._journal is not None:
            self._end()
        with deaf():
            for thread in self._finishing:
                thread.join()

    def _begin(self, name: str, sample: Sample) -> None:
        """Start a recording with the unloaded frames and a sample.

        Raises InputError if the file exists.
        """
        self._path = self._folder / f"{name or time.strftime('live_%Y-%m-%d_%H-%M-%S')}.h5"
        self._frames = 0
        if self._path.exists():
            raise InputError(f"{self._path}: exists already; a recording is never written over")
        self._journal = self._open.enter_context(_journal_for(sample, self._path))
        self._grow(self._journal, tuple(self._unloaded), self._baseline)
        if sample is not self._unloaded[-1]:
            self._grow(self._journal, (sample,), 0)

    def _grow(self, journal: Journal, samples: tuple[Sample, ...], unloaded: int) -> None:
        """Append samples, and report the progress.

        Of the samples, the first `unloaded` ones are unloaded.
        """
        journal.append(samples, unloaded)
        self._frames += len(samples)
        self._say(f"recording {self._path}: {self._frames} frames", self._journal is not None)

    def _end(self, trouble: str = "") -> None:
        """Close the journal, and rewrite it as a recording in another thread.

        Another thread does it because frames continue to arrive.
        """
        if self._journal is None:
            self._say(f"not recorded: {trouble}", self._journal is not None)
            return
        path = self._path
        frames = self._frames
        self._journal = None
        self._open.close()
        self._say(f"closing {path}", self._journal is not None)

        def finish() -> None:
            try:
                finished(path)
                done = f"recorded {frames} frames: {path}" + (f"; {trouble}" if trouble else "")
            except InputError as error:
                done = f"{error}; lampest check --repair makes a clean file of it"
            self._say(done, self._journal is not None)

        thread = Thread(target=finish, name="lampest-recorder")
        thread.start()
        self._finishing = [*(running for running in self._finishing if running.is_alive()), thread]


def _wanted(batches: Samples, frames: int | None, seconds: float | None, period: float) -> Samples:
    """Yield batches up to a number of frames, or up to a time in s on the board's clock.

    The host's clock ends a timed recording 5 %, a period and 1 s later. Raises InputError if frames
    are counted and none has arrived for UNFIT_SECONDS and three periods.
    """
    most = math.inf if frames is None else frames
    until = math.inf if seconds is None else seconds
    count = 0
    began = 0.0
    heard = time.monotonic()
    for batch in batches:
        time_now = time.monotonic()
        began = began or time_now
        heard = time_now if batch else heard
        if frames is not None and time_now - heard > UNFIT_SECONDS + 3 * period:
            raise InputError(f"no frame came for {time_now - heard:.0f} s")
        last = [
            number >= most or item.time + item.hello.period > until - 1e-3
            for number, item in enumerate(batch, count + 1)
        ]
        batch = batch[: last.index(True) + 1] if any(last) else batch
        count += len(batch)
        yield batch
        if any(last) or time_now - began > 1.05 * until + period + 1:
            return


def repair(path: Path) -> tuple[int, int]:
    """Rewrite an unfinished recording as a finished one, with σ of every reading.

    Finished ones remain unchanged. Returns the numbers of frames and of damaged frames, which are
    removed and count as lost. Raises InputError if nothing can be read, or if the file is still
    being recorded.
    """
    own(path)
    with hdf5.existing_file(path) as file:
        closed = "lampest_unfinished" not in file.attrs
    if closed:
        return StoredRecording.of(path).frames, 0
    if is_locked(path):
        raise InputError(f"{path}: still being recorded")
    with folder_beside(path) as folder:
        with recording_file(path) as (file, scene, _, _):
            rows = Rows.of_file(file, scene.circuit)
            intact = rows.undamaged(file)
            if len(intact) and not intact.any():
                raise InputError(f"{path}: every frame is damaged")
            readings = int(hdf5.read_number(file, "/entry/raw", "readings"))
            estimates = rows != Rows.of_frames(scene.circuit)
            with Journal.create(
                folder / path.name, scene, readings, estimates=estimates
            ) as journal:
                journal.keep(file)
        return finished(path, folder / path.name)[1], int(np.sum(~intact))


def finished(path: Path, journal: Path | None = None) -> tuple[Scene, int, float | None]:
    """Rewrite the journal at `path`, or another one, as a recording at `path`.

    Return scene, frames and noise.
    """
    own(path)
    with deaf():
        recording = StoredRecording.of(journal or path)
        overlapping = (range(max(part.start - 1, 0), part.stop) for part in recording.blocks)
        noise = noise_from_repeats(recording.part(part) for part in overlapping)
        save_parts(path, (_with_sigma(recording.part(part), noise) for part in recording.blocks))
        return recording.scene, recording.frames, noise


def _with_sigma(recording: Recording, noise: float | None) -> Recording:
    """Return the recording with σ of every reading.

    It is by the noise of its repeats in LSB if it is known.
    """
    readout = recording.scene.readout
    if readout is None or recording.scene.panel.modules is not None:  # whose modules have their own
        return recording
    readout = readout if noise is None else dataclasses.replace(readout, noise_lsb=noise)
    return dataclasses.replace(recording, sigma=readout.sigma(recording.recorded))


def noise_from_repeats(parts: Iterable[Recording]) -> float | None:
    """Return the noise of a reading in LSB from differences of successive unloaded codes.

    None below MIN_REPEATS.
    """
    total = 0.0
    count = 0
    readout = None
    for part in parts:
        readout = part.scene.readout
        sums = part.raw_sums
        if readout is None or sums is None or part.raw_readings is None:
            return None
        mean_code = sums / part.raw_readings
        pairs = (part.role[1:] == UNLOADED) & (part.role[:-1] == UNLOADED)
        if part.acquisition is not None:
            pairs &= np.diff(part.acquisition.session.astype(int)) == 0
        # Codes near the rails are excluded: their noise is clipped.
        inside = (mean_code > 2) & (mean_code < MAX_CODE - 2)
        difference = np.diff(mean_code, axis=0)[(inside[1:] & inside[:-1]) & pairs[:, None, None]]
        total = total + float(np.sum(difference**2))
        count = count + len(difference)
    if readout is None or count < MIN_REPEATS:
        return None
    # The variance of a difference of two readings is twice that of one.
    return readout.noise_of_variance(total / count / 2)
