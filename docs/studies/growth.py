"""Growth of time and memory with the panel.

First and later frames of each method come from one of the bench's recordings.

Run it as OMP_NUM_THREADS=1 python -m docs.studies.growth --sides 32 64 100 200 --methods LSR-CR
LSR-gCR: seconds of the processor, the same in inverses of M + N - 1 lines, iterations, how it
ended, the largest memory of the process until then, and the exponent p of time ∝ side^p by a
straight line through the logarithms. Relative methods begin with a first pair.
"""

import argparse
import resource
from pathlib import Path
from time import process_time

import numpy as np

from lampest.apps.studies.bench import BenchFile
from lampest.apps.studies.common import inverse_time
from lampest.apps.studies.study import read_settings
from lampest.estimate.sequence import first_stream
from lampest.solvers.solution import Solution

FRAMES = 3  # the first, and later ones, of which the median counts


def main() -> None:
    """Solve and print a line for each, then the exponents."""
    bench = read_settings(BenchFile)(Path("configs/bench.yaml"))
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sides", type=int, nargs="+", default=[32, 64, 100])
    parser.add_argument(
        "--methods", choices=bench.estimators, nargs="+", default=list(bench.estimators)
    )
    parser.add_argument("--recording", type=int, default=2)
    stated = parser.parse_args()
    for method in stated.methods:
        spent = np.array(
            [_spent(bench, method, side, stated.recording - 1) for side in stated.sides]
        )
        for name, seconds in zip(("first", "later"), spent.T, strict=True):
            power = (
                np.polyfit(np.log(stated.sides), np.log(seconds), 1)[0]
                if len(stated.sides) > 1
                else np.nan
            )
            print(f"{method}, {name}: side^{power:.2f}", flush=True)


def _spent(bench: BenchFile, method: str, side: int, number: int) -> tuple[float, float]:
    """Seconds of the first frame and the median of later ones."""
    recording = bench.recording((side, side), number)
    readings = recording.readings()
    times = []
    lines = 2 * side - 1
    unit = inverse_time(np.random.default_rng(0).random((lines, lines)) + side * np.eye(lines))
    # a pair on any panel
    stream = first_stream(recording, readings, bench.estimator(method, "reduced", (1, 1)))
    for place, frame in enumerate(recording.measured_frames()[:FRAMES]):
        start = process_time()
        stream, step = stream.push(readings[frame])
        times.append(process_time() - start)
        name = f"{side} × {side}, {method}, frame {place}: {times[-1] / unit:.0f} inverses"
        _print(name, times[-1], step.solution)
        if not step.solution.solved:
            raise SystemExit(step.status)
    return times[0], float(np.median(times[1:]))


def _print(name: str, seconds: float, results: Solution) -> None:
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{name}, {seconds:.2f} s, iterations {results.iterations}, {results.status.value}, "
        f"{memory:.0f} MB",
        flush=True,
    )


if __name__ == "__main__":
    main()
