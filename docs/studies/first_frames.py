"""Minima of first frames from each of their starts, and the work of each.

Run it as OMP_NUM_THREADS=1 python -m docs.studies.first_frames [--frames 12] [--seed 0] [--sides 20
32 48 64] [--methods LSR-gCR]. Each frame has a random load of its own: a mouth, rods, or both, of
random size, mass and place. For each frame it prints the objective and the work in inverses of
M + N - 1 lines of all solves, the baseline's first, then those of the frame's starts; `negative`
where a start met negative curvature. The last line has the mean and the median work.
"""

import argparse
from pathlib import Path
from time import process_time

import numpy as np

from lampest.apps.studies import common
from lampest.apps.studies.bench import BenchFile
from lampest.apps.studies.study import read_settings
from lampest.cost.problem import Evaluation
from lampest.estimate.sequence import first_stream
from lampest.panel.panel import Panel
from lampest.recording.recording import Recording
from lampest.recording.shapes import AnyShape, Rod
from lampest.recording.simulation.simulation import Course, Simulation, simulate
from lampest.solvers import multistart
from lampest.solvers.solution import Solution, Solver


def main() -> None:
    """Solve each frame, and print the minima of its starts."""
    bench = read_settings(BenchFile)(Path("configs/bench.yaml"))
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sides", type=int, nargs="+", default=[20, 32, 48, 64])
    parser.add_argument("--methods", choices=bench.estimators, nargs="+", default=["LSR-gCR"])
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    stated = parser.parse_args()
    starts = log_starts()
    work = []
    for number in range(stated.frames):
        side = stated.sides[number % len(stated.sides)]
        lines = 2 * side - 1
        unit = common.inverse_time(
            np.random.default_rng(0).random((lines, lines)) + side * np.eye(lines)
        )
        recording = random_recording(bench, side, stated.seed + number)
        readings = recording.readings()
        for method in stated.methods:
            starts.clear()
            stream = first_stream(recording, readings, bench.estimator(method, "reduced", (1, 1)))
            begin = process_time()
            _, step = stream.push(readings[recording.measured_frames()[0]])
            spent = (process_time() - begin) / unit
            work.append(spent)
            texts = [
                f"{solution.objective:.8g}{'' if solution.convex else ' negative'} "
                f"{seconds / unit:.0f}"
                for solution, seconds in starts
            ]
            print(
                f"{side} × {side}, {method}, {number}: {step.solution.objective:.10g}, "
                f"{spent:.0f} inverses, {step.status} | {' | '.join(texts)}",
                flush=True,
            )
    print(f"mean {np.mean(work):.0f}, median {np.median(work):.0f} inverses")


def random_recording(bench: BenchFile, side: int, seed: int) -> Recording:
    """Return a recording of unloaded frames and one frame under a random load."""
    generator = np.random.default_rng(seed)
    shape = (side, side)
    extent = Panel(*shape).pitch_mm * (side - 1)
    loads = list[AnyShape]()
    kind = generator.integers(3)
    if kind != 1:
        centre = tuple(float(share) * extent for share in generator.uniform(0.35, 0.65, 2))
        diameter = float(generator.uniform(0.2, 0.4)) * extent
        loads.append(common.lamprey_mouth((centre[0], centre[1]), diameter))
    if kind != 0:
        for _ in range(int(generator.integers(1, 4))):
            right, down = (float(share) * extent for share in generator.uniform(0.2, 0.8, 2))
            diameter = float(generator.uniform(0.1, 0.25)) * extent
            mass = float(np.exp(generator.uniform(np.log(200.0), np.log(2000.0))))
            loads.append(
                Rod(kind="rod", centre_mm=(right, down), diameter_mm=diameter, mass_g=mass)
            )
    course = common.shipped_lamprey().course if kind == 0 else Course()
    scene = common.simple_scene(shape, bench.readout, bench.lines)
    simulation = Simulation(
        1,
        seed,
        scene,
        frames=1,
        loads=tuple(loads),
        course=course,
        unmodelled=bench.unmodelled,
    )
    return simulate(simulation, str(seed))


def log_starts() -> list[tuple[Solution, float]]:
    """Return the list to which every further solve adds its solution and processor time."""
    starts = list[tuple[Solution, float]]()
    solve = multistart.solved_from

    def logged(solver: Solver, start: Evaluation) -> Solution:
        begin = process_time()
        solution = solve(solver, start)
        starts.append((solution, process_time() - begin))
        return solution

    multistart.solved_from = logged
    return starts


if __name__ == "__main__":
    main()
