"""The peak memory of a fresh process that solves a few frames."""

import resource
from pathlib import Path

from lampest.runs.executors import Processes
from lampest.studies.bench.problems import first_estimate, frame_data, solver_of
from lampest.studies.bench.settings import BenchFile
from lampest.studies.bench.timing import timed

STATUS = Path("/proc/self/status")
FRAMES = 2


def peak_memory(bench: BenchFile, shape: tuple[int, int], method: str, solver: str) -> float:
    """The largest resident size, 10⁶ bytes, of a process that solves a first frame and the next; NaN if it died.

    Imports and simulation are part of it. Beyond the limit for it no pair of frames is solved jointly.
    """
    ((_, megabytes),) = Processes(1).results(_solving, [(bench, shape, method, solver)])
    return float("nan") if isinstance(megabytes, Exception) else float(megabytes)


def _solving(task: tuple[BenchFile, tuple[int, int], str, str]) -> float:
    """Solve the frames here; the peak of this process in megabytes."""
    bench, shape, method, name = task
    recording = bench.recording(shape)
    previous = first_estimate(bench, recording, method)
    for frame in range(FRAMES):
        data = frame_data(bench, recording, method, frame, previous)()
        solution = timed(
            solver_of(bench, method, name, data), data, None if previous is None else previous[None]
        ).solution
        previous = solution.cell_resistance[-1] if solution.solved else previous
    return peak_mb()


def peak_mb() -> float:
    """The largest resident size of this process so far; where Linux tells it, without what its parent had before."""
    if STATUS.is_file():
        line = next(line for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return float(line.split()[1]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
