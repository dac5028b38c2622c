"""Memory and open files of a stream and of the live page.

Run it with: python -m docs.studies.long_lives --frames 1000000.
"""

import argparse
import gc
import time
import tracemalloc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import psutil

import lampest
from lampest.apps.live.engine import Engine, FrameSource
from lampest.apps.live.watcher import Scan
from lampest.estimate.estimator import Estimator
from lampest.panel.panel import Array

SCENE = lampest.Scene(lampest.Panel(3, 4), lampest.TwoPointReadout(noise_lsb=0.7))
METHOD = Estimator(
    (lampest.Misfit(weighting="noise"), lampest.Gradient(weight=1e-5)), "reduced", error_bars=False
)
DISTINCT = 50  # frames that come again and again


@dataclass(frozen=True)
class Figures:
    """After so many frames: bytes that Python holds, those of the process, files, threads.

    The bytes that Python holds are 0 if not traced.
    """

    frames: int
    allocated: int
    resident: int
    open_files: int
    threads: int

    @classmethod
    def now(cls, frames: int) -> "Figures":
        """Return the figures of this process."""
        gc.collect()
        process = psutil.Process()
        allocated = tracemalloc.get_traced_memory()[0] if tracemalloc.is_tracing() else 0
        return cls(
            frames, allocated, process.memory_info().rss, process.num_fds(), process.num_threads()
        )


def recorded() -> Array:
    """Ohm as the divider gives it (frames, rows, columns), with noise."""
    rng = np.random.default_rng(1)
    readout = SCENE.readout
    assert readout is not None
    cells = 1000 * np.exp(
        0.2 * rng.standard_normal((3, 4)) + 0.05 * rng.standard_normal((DISTINCT, 3, 4))
    )
    exact = np.asarray(readout.to_recorded(readout.exact_reading(cells), SCENE))
    return exact + np.asarray(readout.sigma(exact)) * rng.standard_normal(exact.shape)


@contextmanager
def traced(wanted: bool) -> Iterator[None]:
    """Python's allocations counted meanwhile, which takes time."""
    if wanted:
        tracemalloc.start()
    try:
        yield
    finally:
        tracemalloc.stop()


def stream_figures(marks: Sequence[int], trace: bool = True) -> list[Figures]:
    """Figures of a stream after so many frames."""
    frames = recorded()
    figures = []
    stream = lampest.Stream.begin(METHOD, SCENE, 0.1, lampest.Readings.of(SCENE, frames[:3]).mean())
    with traced(trace):
        for number in range(1, max(marks) + 1):
            stream, _ = stream.push(lampest.Readings.of(SCENE, frames[number % DISTINCT]))
            if number in marks:
                figures.append(Figures.now(number))
    return figures


def live_figures(marks: Sequence[int], trace: bool = True) -> list[Figures]:
    """Return figures of the live page's engine after each count of frames in `marks`.

    The engine solves as many frames as it can.
    """
    frames = recorded()
    figures = []
    source = FrameSource(SCENE, 0.1, "receiving")
    with traced(trace), Engine("a fast line", "gradient", METHOD, 3) as engine:
        for number in range(1, max(marks) + 1):
            engine.take(source, Scan(frames[number % DISTINCT], None, 0.1 * number, time.time()))
            if number > 3:
                _wait_for(engine, number - 8)
            if number in marks:
                _wait_for(engine, number)
                figures.append(Figures.now(number))
    return figures


def _wait_for(engine: Any, number: int) -> None:
    """Until the page shows that frame or a later one."""
    while engine.shown.item.picture is None or engine.shown.item.picture.number < number:
        time.sleep(1e-4)


def main() -> None:
    """Print the figures at twentieths of the way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    count = parser.parse_args().frames
    marks = [round(count * share) for share in (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)]
    for name, figures in (("stream", stream_figures), ("live", live_figures)):
        for row in figures(marks, trace=False):
            print(
                f"{name}  {row.frames:>9} frames  {row.resident / 1e6:8.2f} MB  {row.open_files} "
                "files open",
                flush=True,
            )


if __name__ == "__main__":
    main()
