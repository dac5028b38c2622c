"""What solves take: clocks, frames solved in sequence with what each ended at, the peak memory of a fresh process."""

import resource
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lampest.files import hdf5
from lampest.panel.panel import Array
from lampest.runs.executors import Processes
from lampest.solvers.solution import STRICT, Solution
from lampest.studies.methods import Shape
from lampest.studies.study import write_columns

Result = TypeVar("Result")
Task = TypeVar("Task")
NO_GAP = 1e-12  # less is rounding
STATUS = Path("/proc/self/status")  # where Linux says how much a process holds


@dataclass(frozen=True, eq=False)
class TimedFrames:
    """Frames of a recording, solved in sequence.

    wall, cpu : (frames, repeats) s; NaN where a frame was not repeated. objective, gap, iterations, solved, status :
    (frames), of the first repeat; gap : of the objective to the best that is known for it.
    """

    wall: Array
    cpu: Array
    objective: Array
    gap: Array
    iterations: NDArray[np.int64]
    solved: NDArray[np.bool_]
    status: tuple[str, ...]

    @staticmethod
    def ends(solutions: list[Solution]) -> dict[str, Any]:
        """The last three fields."""
        return {
            "iterations": np.array([solution.iterations for solution in solutions], dtype=np.int64),
            "solved": np.array([solution.solved for solution in solutions]),
            "status": tuple(solution.status.value for solution in solutions),
        }

    def write(self, group: Any, about: dict[str, str], frame: str, **attributes: Any) -> None:
        """All of it as datasets of a group, with their scales; about : meanings by name, frame : that of the scale."""
        hdf5.set_attributes(group, NX_class="NXdata", signal="wall_time", axes=["frame", "repeat"], **attributes)
        frames, repeats = self.wall.shape
        hdf5.write_scale(group, "frame", np.arange(frames), "1", frame)
        hdf5.write_scale(group, "repeat", np.arange(repeats), "1", "turn of the alternation")
        times = (("wall_time", "s", about["wall"], "wall"), ("cpu_time", "s", about["cpu"], "cpu"))
        write_columns(group, self, times, ("frame", "repeat"))
        ends = (
            ("objective", "1", about["objective"]),
            ("gap", "1", about["gap"]),
            ("iterations", "1", "iterations of the solver"),
            ("solved", "1", "1: solved, 0: failed"),
            ("status", "1", "how the solve ended"),
        )
        write_columns(group, self, ends, ("frame",))


@dataclass(frozen=True, eq=False)
class Timing(TimedFrames):
    """One solver with one method on one recording of a panel; the first frame is a cold start and not repeated.

    recording : its number. inverse_s : seconds of a dense inverse of size rows + columns − 1 at that time.
    pair : whether the first frame was solved jointly with the baseline.
    gap : (φ − φ_best)/(φ_best + 1e-9·Σ R²) against the best that any solver found for the same data; NaN where there
    was no other. The last part is the cost of missing every reading by 0.003 %: less is nothing.
    """

    shape: Shape
    method: str
    solver: str
    recording: int
    pair: bool
    inverse_s: float

    def times(self) -> Array:
        """(frames) s: median of a frame's wall times; the processor's where something else disturbed it."""
        return np.asarray(np.nanmedian(np.where(undisturbed(self.wall, self.cpu), self.wall, self.cpu), axis=1))

    def clean(self) -> float:
        """The share of undisturbed solves."""
        return float(np.mean(undisturbed(self.wall, self.cpu)[np.isfinite(self.wall)]))

    def verified(self) -> NDArray[np.bool_]:
        """(frames) whether the optimum was verified."""
        return np.array([status in {strict.value for strict in STRICT} for status in self.status])


def clocked(call: Callable[[], Result]) -> tuple[Result, float, float]:
    """What a call returns, its wall time and the processor's, s."""
    wall, cpu = perf_counter(), process_time()
    result = call()
    return result, perf_counter() - wall, process_time() - cpu


def undisturbed(wall: Array, cpu: Array) -> NDArray[np.bool_]:
    """Where a wall time exceeds the processor's by no more than 5 % and a tenth of a millisecond."""
    return np.asarray(wall <= 1.05 * cpu + 1e-4)


def inverse_time(matrix: Array) -> float:
    """Seconds of one dense inverse, from as many as take 2 ms or more; the least of three tries."""

    def inverses(count: int) -> float:
        return clocked(lambda: [np.linalg.inv(matrix) for _ in range(count)])[1]

    count = 1
    while (spent := inverses(count)) < 2e-3:
        count *= 2
    return min(spent, inverses(count), inverses(count)) / count


def peak_memory(work: Callable[[Task], object], task: Task) -> float:
    """The largest resident size, 10⁶ bytes, of a fresh process that does some work; NaN if it died.

    Not what Python has allocated: compiled costs and IPOPT's factors lie outside what tracemalloc sees.
    """
    ((_, megabytes),) = Processes(1).results(_peak_after, [(work, task)])
    return float("nan") if isinstance(megabytes, Exception) else float(megabytes)


def _peak_after(task: tuple[Callable[[Task], object], Task]) -> float:
    """The largest resident size of this process after some work; on Linux without what its parent had before."""
    work, argument = task
    work(argument)
    if STATUS.is_file():
        line = next(line for line in STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
        return float(line.split()[1]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
