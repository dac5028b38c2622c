"""Frames for the engine: from a board as they come, or from a recording at any speed."""

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np

from lampest.estimate.sequence import frame_period
from lampest.panel.scene import Scene
from lampest.recording.board.record import Progress, Recorded, record
from lampest.recording.board.sample import Sample
from lampest.recording.board.stream import agreed_and_recorded, board_samples
from lampest.recording.recording import UNLOADED, Recording
from lampest.report.live.engine import Engine, FrameSource, Scan


def from_board(
    engine: Engine,
    url: str,
    scene: Scene | None,
    period: float | None,
    frames: int | None,
    on_sample: Callable[[Sample], None] = lambda sample: None,
) -> None:
    """Every frame of a board, until `frames` have come or for ever; on_sample : given each of them, too.

    Raises InputError as `lampest.recording.board.stream.stream`.
    """
    engine.say(f"waiting for the board at {url}")
    with closing(board_samples(url, scene, period, engine.say)) as samples:
        came = 0
        for batch in samples:
            for sample in batch:
                take_sample(engine, sample, scene)
                on_sample(sample)
                came += 1
                if came == frames:
                    return


def recorded_from_board(
    engine: Engine,
    url: str,
    out: Path,
    scene: Scene | None,
    baseline: int,
    period: float | None,
    frames: int | None,
) -> Recorded:
    """The same while every frame goes into the recording `out` first. Raises InputError as `record`."""
    engine.say(f"waiting for the board at {url}")

    def on_progress(progress: Progress) -> None:
        if progress.sample is not None:
            take_sample(engine, progress.sample, scene)
        elif progress.state:
            engine.say(progress.state)

    return record(url, out, frames=frames, scene=scene, baseline=baseline, period=period, on_progress=on_progress)


def take_sample(engine: Engine, sample: Sample, scene: Scene | None) -> None:
    """Hand a board's frame on, as a recording would hold it."""
    agreed, recorded = agreed_and_recorded(sample, scene)
    engine.take(
        FrameSource(agreed, sample.hello.period_us * 1e-6, "receiving"),
        Scan(recorded, None, sample.time, sample.host_time, sample.lost),
    )


def from_recording(
    engine: Engine, recording: Recording, speed: float, frames: int | None, wait: Callable[[float], None] = time.sleep
) -> None:
    """A recording's measured frames, `speed` times as fast as they were taken; its unloaded frames are the baseline."""
    source = FrameSource(recording.scene, frame_period(recording), f"replaying at {speed:g} times its speed")
    unloaded = [scan_of(recording, int(frame)) for frame in np.flatnonzero(recording.role == UNLOADED)]
    if unloaded:
        engine.begin(source, unloaded)
    measured = recording.measured_frames()[:frames]
    began = time.monotonic() - recording.time[measured[0]] / speed
    for frame in measured:
        wait(max(0.0, began + recording.time[frame] / speed - time.monotonic()))
        engine.take(source, scan_of(recording, int(frame)))


def scan_of(recording: Recording, frame: int) -> Scan:
    """One frame of a recording, as if it arrived now."""
    sigma, origin = recording.sigma, recording.acquisition
    return Scan(
        recording.recorded[frame],
        None if sigma is None else np.broadcast_to(sigma, recording.recorded.shape)[frame],
        float(recording.time[frame]),
        time.time(),
        0 if origin is None else int(origin.lost[frame]),
    )
