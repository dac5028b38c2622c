"""The peak memory of a fresh process that solves a few frames."""

import resource
from pathlib import Path

from lampest.runs.executors import Processes
from lampest.solvers.search import best_solution
from lampest.studies.bench.problems import first_estimate, frame_data, solver_of
from lampest.studies.bench.settings import BenchFile

STATUS = Path("/proc/self/status")
FRAMES = 2


def peak_memory(bench: BenchFile, shape: tuple[int, int]) -> float:
    """The largest resident size, 10⁶ bytes, of a process that solves two frames by all methods; NaN if it died.

    Imports and simulation are part of it. Beyond the limit for it no pair of frames is solved jointly.
    """
    ((_, megabytes),) = Processes(1).results(_solving, [(bench, shape)])
    return float("nan") if isinstance(megabytes, Exception) else float(megabytes)


def _solving(task: tuple[BenchFile, tuple[int, int]]) -> float:
    """Solve the frames here; the peak of this process in megabytes."""
    bench, shape = task
    recording = bench.recording(shape)
    for method in bench.estimators:
        previous = first_estimate(bench, recording, method)
        for frame in range(FRAMES):
            data = frame_data(bench, recording, method, frame, previous)()
            solver = solver_of(bench, method, "reduced", data)
            solution = best_solution(solver, data, None if previous is None else previous[None])
            previous = solution.cell_resistance[-1] if solution.solved else previous
    return peak_mb()


def peak_mb() -> float:
    """The largest resident size of this process so far; where Linux tells it, without what its parent had before."""
    if STATUS.is_file():
        line = next(line for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return float(line.split()[1]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
