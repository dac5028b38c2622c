"""How many frames the machine code solves, and whether Newton's method, which takes the others, finds the same.

Run it with: OMP_NUM_THREADS=1 python -m tests.studies.kernel data/*.h5 (recordings; without any, invented scenes),
with --parts 10 for the microseconds of each part of a frame on a square panel, or with --side 32 for whole frames of
the bench's three recordings both ways.
Of every method: frames after the first, the share solved in one call, the largest relative difference of the objective
(negative: the machine code's is lower; of costs below a millionth a reading, of that) and of log r, how many statuses
differ, and how many are no settled minimum by second derivatives taken at the very place. Every frame is solved both
ways from the same estimate of the frame before.
"""

import sys
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np

import lampest
from lampest.cost.problem import Evaluation
from lampest.estimate.sequence import frame_period
from lampest.estimate.stream import Stream
from lampest.panel.conjugate import DENSE_UNKNOWNS
from lampest.panel.panel import Array
from lampest.recording.readings import Readings
from lampest.solvers import search
from lampest.solvers.certificate import certificate
from lampest.solvers.kernel import following
from lampest.solvers.kernel.following import Workbench, descended, from_previous, load_machine_code, serves
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.smoothing import Smoothing
from lampest.solvers.search import best_solution
from lampest.solvers.solution import check
from lampest.studies.bench.problems import first_estimate, frame_data, solver_of
from lampest.studies.bench.settings import BenchFile
from lampest.studies.study import read_settings
from tests.studies.speed import least, simulated

MOST_FRAMES = 60
METHODS = {
    "LSM": (),
    "LSR-CR": (lampest.CellResistance(weight=1e-7),),
    "LSR-dCR": (lampest.RelativeChange(weight=1e-2),),
    "LSR-gCR": (lampest.Gradient(weight=1e-6),),
    "LSR-gdCR": (lampest.GradientOfRelativeChange(weight=1e-2),),
    "huber": (lampest.Gradient(weight=1e-6),),  # of readings beyond three σ
}


def scenes() -> dict[str, lampest.Recording]:
    """Invented ones: a rod, and the same seen by loaded columns and by a virtual ground."""
    found = {"rod 10": simulated(10), "rod 16": simulated(16)}
    rod = lampest.Rod(centre_mm=(50.0, 50.0), diameter_mm=40.0, mass_g=500.0)
    kinds = {
        "loaded": lampest.LoadedColumnsReadout(adc_bits=12, load_ohm=300.0, drive_ohm=20.0),
        "ground": lampest.VirtualGroundReadout(adc_bits=12),
    }
    for name, readout in kinds.items():
        scene = lampest.Scene(lampest.Panel(10, 9), readout)
        found[name] = lampest.simulate(
            lampest.Simulation(1, 5, scene, frames=12, loads=(rod,), baseline_frames=2, frame_period_s=0.2)
        )
    return found


def compared(recording: lampest.Recording, name: str) -> str:
    """One method on one recording, as a line."""
    loss = lampest.Huber(corner=3.0) if name == "huber" else lampest.Squared()
    data_term = lampest.Misfit(weighting="noise", loss=loss)
    estimator = lampest.Estimator((data_term, *METHODS[name]), formulation="reduced", error_bars=False)
    resting = Readings.of(recording.scene, recording.recorded[recording.role == 0]).mean()
    stream = Stream.begin(estimator, recording.scene, frame_period(recording), resting)
    frames = recording.recorded[recording.role == 1][:MOST_FRAMES]
    stream, _ = stream.push(Readings.of(recording.scene, frames[0]))
    lower, apart, answers, other, open_ends = [], [], [], 0, 0
    least = 1e-6 * frames[0].size

    def noted(*given: Any) -> Any:
        answers.append(from_previous(*given))
        return answers[-1]

    with np.errstate(all="ignore"):
        for frame in frames[1:]:
            readings = Readings.of(recording.scene, frame)
            with patch.object(following, "serves", lambda *given: False):
                _, newton = stream.push(readings)
            stream_before = stream
            with patch.object(search, "from_previous", noted):
                stream, step = stream.push(readings)
            other += step.status != newton.status
            if step.solution.solved and newton.solution.solved:
                known = newton.solution.objective
                lower.append((step.solution.objective - known) / max(known, least))
                open_ends += not settled(estimator, stream_before, readings, step.cell_resistance[None])
                apart.append(np.abs(np.log(step.cell_resistance / newton.cell_resistance)).max())
    return (
        f"{len(frames) - 1:4d} frames, {answers.count(None):3d} fell back, objective {min(lower, default=0):9.1e} to "
        f"{max(lower, default=0):9.1e}, log r {max(apart, default=0):8.1e}, {other} statuses differ, "
        f"{open_ends} not settled"
    )


def settled(estimator: lampest.Estimator, stream: Stream, readings: Readings, cells: Array) -> bool:
    """Whether cells (1, rows, columns) are a settled minimum of a frame, by a certificate of its own."""
    data, _ = stream.given(readings)
    at = Evaluation.at(estimator.problem(stream.scene, 1, stream.period, data.partial).cost, data, cells)
    curvature = Curvature(at, Smoothing.start(at))
    return certificate(curvature, curvature.gradient).settled


def parts(side: int) -> None:
    """Print microseconds of each part of a frame of LSR-CR, the least of many turns."""
    recording = simulated(side)
    terms = (lampest.Misfit(weighting="noise"), *METHODS["LSR-CR"])
    estimator = lampest.Estimator(terms, formulation="reduced", error_bars=False)
    frames, scene = recording.recorded[recording.role == 1], recording.scene
    stream = Stream.begin(estimator, scene, 0.2, Readings.of(scene, recording.recorded[recording.role == 0]).mean())
    for frame in frames[:5]:
        stream, _ = stream.push(Readings.of(scene, frame))
    readings = Readings.of(scene, frames[5])
    data, previous = stream.given(readings)
    assert previous is not None
    solver = estimator.problem(scene, 1, 0.2).following(stream.prepared)
    start = Workbench(solver.cost, data).point(np.clip(previous, data.lower, data.upper))
    found = descended(solver, start.bench, start.position)
    new = descended(replace(solver, factor=None), start.bench, start.position)
    assert found is not None and new is not None
    turns = {
        "recorded values to readings": lambda: Readings.of(scene, frames[5]),
        "what a solve is given, with its bounds": lambda: stream.given(readings),
        "a point: network, cost, gradient": lambda: start.elsewhere(previous),
        "the same by Newton's classes": lambda: Evaluation.at(solver.cost, data, previous).log_gradient(np.zeros(0)),
        "all steps, factor of the frame before": lambda: descended(solver, start.bench, start.position),
        "all steps, a factor of its own": lambda: descended(replace(solver, factor=None), start.bench, start.position),
        "the check outside the solver": lambda: check(start, found),
        "the frame, readings to step": lambda: stream.push(readings),
    }
    for name, turn in turns.items():
        print(f"{name:40s} {1e3 * least(turn):8.1f}")
    print("factors of its own:", found.iterations, "with the frame before's,", new.iterations, "without")


def both_ways(side: int) -> None:
    """Print how long frames of the bench's recordings take by Newton's classes and by machine code, in turn."""
    bench = replace(read_settings(BenchFile)(Path("configs/bench.yaml")), frames=6)
    load_machine_code(side**2 > DENSE_UNKNOWNS)
    for recording, name in ((recording, name) for recording in range(3) for name in bench.estimators):
        spent, ends = by_turns(bench, bench.recording((side, side), recording), name)
        middle, most = 1e3 * np.median(spent, axis=0), 1e3 * np.max(spent, axis=0)
        print(
            f"{side} x {side} recording {recording} {name:9s} ms by classes {middle[0]:7.2f} (at most {most[0]:7.2f}), "
            f"by machine code {middle[1]:6.2f} ({most[1]:7.2f}); {', '.join(ends)}",
            flush=True,
        )


def by_turns(bench: BenchFile, recording: lampest.Recording, name: str) -> tuple[list[list[float]], list[str]]:
    """(s of the processor by classes and with machine code, how far the latter's objective is above) of every frame."""
    best, kept, spent, ends = first_estimate(bench, recording, name), None, [], []
    for frame in range(bench.frames + 1):
        given = frame_data(bench, recording, name, frame, best)
        solver, previous = solver_of(bench, name, "reduced", given()), None if best is None else best[None]
        found, times = [], []
        for machine in (False, True):
            with patch.object(following, "serves", serves if machine else lambda *given: False):
                data, begin = given(), process_time()
                found.append(best_solution(solver, data, previous, kept if machine else None))
                times.append(process_time() - begin)
        if frame:
            spent.append(times)
            ends.append(f"{found[1].objective / found[0].objective - 1:.0e} ({found[1].starts})")
        if found[1].solved:
            best, kept = found[1].cell_resistance[-1], found[1].factor
    return spent, ends


def main(paths: list[str]) -> None:
    """Print all methods of all recordings."""
    if paths[:1] == ["--parts"]:
        return parts(int(paths[1]))
    if paths[:1] == ["--side"]:
        return both_ways(int(paths[1]))
    recordings = {path: lampest.Recording.load(path) for path in paths} or scenes()
    for title, recording in recordings.items():
        for name in METHODS:
            print(f"{title:28s} {name:10s} {compared(recording, name)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
