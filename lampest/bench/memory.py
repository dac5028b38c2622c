"""The peak memory of a fresh process that solves a few frames."""

import resource
from pathlib import Path

from lampest.bench.settings import BenchFile
from lampest.executors import Processes
from lampest.sequence import reconstruct

STATUS = Path("/proc/self/status")


def peak_memory(bench: BenchFile, shape: tuple[int, int]) -> float:
    """Megabytes (10⁶ bytes) that a process needs at most which solves all methods on a panel, reduced formulation."""
    ((_, megabytes),) = Processes(1).results(solving, [(bench, shape)])
    return float("nan") if isinstance(megabytes, Exception) else float(megabytes)


def solving(task: tuple[BenchFile, tuple[int, int]]) -> float:
    """Solve all methods' frames here; the peak of this process in megabytes."""
    bench, shape = task
    recording = bench.recording(shape)
    for method in bench.estimators:
        reconstruct(recording, bench.estimator(method, "reduced"))
    return peak_mb()


def peak_mb() -> float:
    """The largest resident size of this process so far; where Linux tells it, without what a parent had before."""
    if STATUS.is_file():
        line = next(line for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return float(line.split()[1]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
