"""Record a board into a file: frame by frame while it runs, rewritten as a clean recording at the end."""

import contextlib
import dataclasses
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lampest.files.errors import InputError
from lampest.files.whole import check_output
from lampest.panel.readouts import Readout
from lampest.panel.scene import Scene
from lampest.recording.board.journal import Journal, is_being_written, is_finished
from lampest.recording.board.port import only_port
from lampest.recording.board.protocol import MOST_CODE
from lampest.recording.board.stream import Sample, agreed_and_recorded, board_samples
from lampest.recording.recording import MEASURED, UNLOADED, Recording

FEWEST_REPEATS = 50


@dataclass(frozen=True)
class Recorded:
    """What `record` did: frames in the file, frames known to be missing, restarts of the board, ended by Ctrl-C or not.

    noise_lsb : noise of one reading as the baseline's repeats show it, or None where they do not suffice. scene : what
    board and user agreed on.
    """

    path: Path
    frames: int
    lost: int
    restarts: int
    interrupted: bool
    noise_lsb: float | None
    scene: Scene


@dataclass(frozen=True)
class Progress:
    """Where a recording stands: newest sample (None while waiting), frames and lost ones so far, a sentence or ''."""

    sample: Sample | None
    frames: int
    lost: int
    state: str


def record(
    port_url: str | None,
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
    """Frames from a board into the recording `out`: what the readout makes of sum/readings, ohm or volt.

    Parameters
    ----------
    port_url : port name or pyserial URL; None for the only port that looks like an Arduino.
    out : the file; must not exist.
    frames, seconds : when to end; by default at Ctrl-C.
    scene : what the board must fit, and is set to; by default what the board says.
    baseline : the first so many frames are unloaded.
    period : s between frames; by default 1 s, or the shortest possible where that is longer.
    on_progress : called after every frame, and when the board comes or goes.
    keys : gives the keys pressed since it was last called; each marks an event.

    Raises InputError where the board does not answer or does not fit, `out` exists, or no frame came.
    """
    check_output(out)
    if out.exists():
        raise InputError(f"{out}: exists already; a recording is never written over")
    port_url = port_url or only_port()
    state = ""

    def on_state(sentence: str) -> None:
        nonlocal state
        state = sentence

    count = lost = restarts = 0
    finished: tuple[Recording, float | None] | None = None
    began = time.monotonic()
    try:
        with _interruptible(lambda: count > 0) as interrupted, contextlib.ExitStack() as stack:
            samples = stack.enter_context(contextlib.closing(board_samples(port_url, scene, period, on_state)))
            journal: Journal | None = None
            for sample in samples:
                if sample is not None:
                    agreed, recorded = agreed_and_recorded(sample, scene)
                    if journal is None:
                        journal = stack.enter_context(Journal.create(out, agreed, sample.hello.readings))
                    journal.append(sample, recorded, UNLOADED if count < baseline else MEASURED)
                    count, lost, restarts, state = count + 1, lost + sample.lost, sample.session, ""
                    for key in keys():
                        journal.mark(sample.time, key)
                if sample is not None or state:
                    on_progress(Progress(sample, count, lost, state))
                if interrupted() or _enough(sample, count, began, frames, seconds):
                    break
    finally:
        # However it ended: what was recorded is left as a clean file.
        if count:
            finished = _finish(out)
    if finished is None:
        raise InputError(f"{out}: ended before the first frame; nothing is written")
    recording, noise = finished
    return Recorded(out, count, lost, restarts, interrupted(), noise, recording.scene)


def repair(path: Path) -> int:
    """Rewrite an unfinished recording as a clean one, with σ of every reading; a finished one stays as it is.

    Returns the number of frames. Raises InputError where nothing can be read, or someone is still recording into it.
    """
    if is_finished(path):
        return len(Recording.load(path).time)
    if is_being_written(path):
        raise InputError(f"{path}: still being recorded")
    return len(_finish(path)[0].time)


def _finish(path: Path) -> tuple[Recording, float | None]:
    """Rewrite a journal as a clean recording; that, and the noise that its baseline shows."""
    recording = Recording.load(path)
    noise = noise_from_repeats(recording)
    readout = recording.scene.readout
    if readout is not None:
        seen = readout if noise is None else dataclasses.replace(readout, noise_lsb=noise)
        recording = dataclasses.replace(recording, sigma=seen.sigma(recording.recorded))
    recording.save(path)
    return recording, noise


def noise_from_repeats(recording: Recording) -> float | None:
    """noise with readings·Var(mean code) = noise² + 1/12 − b²(noise), from differences of successive unloaded frames.

    Slow drift and readings at either end of the converter do not count. None below 50 differences.
    """
    readout, sums = recording.scene.readout, recording.raw_sums
    if readout is None or sums is None or recording.raw_readings is None:
        return None
    mean_code = sums / recording.raw_readings
    pairs = (recording.role[1:] == UNLOADED) & (recording.role[:-1] == UNLOADED)
    if recording.acquisition is not None:
        pairs &= np.diff(recording.acquisition.session.astype(int)) == 0
    inside = (mean_code > 2) & (mean_code < MOST_CODE - 2)
    difference = np.diff(mean_code, axis=0)[(inside[1:] & inside[:-1]) & pairs[:, None, None]]
    if difference.size < FEWEST_REPEATS:
        return None
    return _noise_of_variance(readout, float(np.mean(difference**2)) / 2)


def _noise_of_variance(readout: Readout, variance: float) -> float:
    """The noise with that variance = σ²(readings) − b², where b² = σ²(endlessly many readings); by bisection."""
    low, high = 0.0, 2.0**readout.adc_bits
    while high - low > 1e-6:
        middle = (low + high) / 2
        noisy = dataclasses.replace(readout, noise_lsb=middle)
        bias = dataclasses.replace(noisy, readings=65535).sigma_code() ** 2
        low, high = (middle, high) if noisy.sigma_code() ** 2 - bias < variance else (low, middle)
    return low


def _enough(sample: Sample | None, count: int, began: float, frames: int | None, seconds: float | None) -> bool:
    if frames is not None and count >= frames:
        return True
    if seconds is None:
        return False
    if sample is not None:
        return sample.time + sample.hello.period_us * 1e-6 > seconds - 1e-3
    # While nothing comes only the host's clock goes on.
    return time.monotonic() - began > seconds + 10


@contextlib.contextmanager
def _interruptible(worth_finishing: Callable[[], bool]) -> Iterator[Callable[[], bool]]:
    """Ctrl-C and SIGTERM set a flag, so that no frame is torn; a second one, or one before any frame, acts at once."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set
        return

    def ask(number: int, stack: object) -> None:
        # Set first: an exception raised inside a destructor is lost, the flag is not.
        again = asked.is_set()
        asked.set()
        if again or not worth_finishing():
            raise KeyboardInterrupt

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
