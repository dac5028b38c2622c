"""First pairs of the bench's recordings: a baseline and a loaded frame that only a relative penalty ties together.

Run it as OMP_NUM_THREADS=1 python -m tests.studies.pairs --side 64: seconds of the processor, starts, iterations of the
start that ended lowest, and how it ended. `--every-start` begins at each start by itself.
"""

import argparse
from pathlib import Path
from time import process_time

from lampest.solvers.search import best_solution, solved_from
from lampest.solvers.solution import Solution
from lampest.solvers.starts import convex, evaluated
from lampest.studies.bench.problems import frame_data, solver_of
from lampest.studies.bench.settings import BenchFile
from lampest.studies.study import read_settings

METHODS = ("LSR-dCR", "LSR-gdCR")


def main() -> None:
    """Solve them and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=64)
    parser.add_argument("--every-start", action="store_true")
    told = parser.parse_args()
    bench = read_settings(BenchFile)(Path("configs/bench.yaml"))
    for number in range(bench.recordings):
        recording = bench.recording((told.side, told.side), number)
        for method in METHODS:
            fresh = frame_data(bench, recording, method, 0, None)
            data = fresh()
            solver = solver_of(bench, method, "reduced", data)
            name = f"{told.side} × {told.side}, recording {number + 1}, {method}"
            begun = process_time()
            if not told.every_start:
                _print(name, best_solution(solver, data, None), begun)
                continue
            near = convex(data, None)
            for start, cells in {"uniform": data.uniform_start, "convex": near, "unchanged": near[[0, 0]]}.items():
                begun = process_time()
                _print(f"{name}, {start}", solved_from(solver, evaluated(solver.cost, fresh(), cells)), begun)


def _print(name: str, found: Solution, begun: float) -> None:
    spent, end = process_time() - begun, f"cost {found.objective:.8g}, {found.status.value}"
    print(f"{name}: {spent:.2f} s, starts {found.starts}, iterations {found.iterations}, {end}", flush=True)


if __name__ == "__main__":
    main()
