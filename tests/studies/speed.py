"""Where the time of a frame goes: each part of a reduced solve alone, the least of many turns.

Run it with: OMP_NUM_THREADS=1 python -m tests.studies.speed --side 10
The least, because whatever else a machine does only adds.
"""

import argparse
from collections.abc import Callable
from time import perf_counter, process_time

import numpy as np

import lampest
from lampest.cost.cost import Cost
from lampest.cost.problem import Data, Evaluation
from lampest.panel.conjugate import DENSE_UNKNOWNS
from lampest.panel.panel import Array
from lampest.recording.readings import Readings
from lampest.solvers.newton.curvature import Curvature
from lampest.solvers.newton.directions import direction
from lampest.solvers.newton.newton import Newton
from lampest.solvers.newton.smoothing import Smoothing
from lampest.solvers.solution import Status, check

TURNS, FRAMES = 300, 9
METHODS = {
    "LSM": (),
    "LSR-CR": (lampest.CellResistance(weight=1e-7),),
    "LSR-dCR": (lampest.RelativeChange(weight=1e-2),),
    "LSR-gCR": (lampest.Gradient(weight=1e-6),),
    "LSR-gdCR": (lampest.GradientOfRelativeChange(weight=1e-2),),
}


def simulated(side: int) -> lampest.Recording:
    """A rod on a square panel, read with 12 bits: every frame has its own noise."""
    readout = lampest.TwoPointReadout(adc_bits=12, reference_ohm=400.0, readings=4, noise_lsb=1.0)
    rod = lampest.Rod(centre_mm=(5.0 * side, 5.0 * side), diameter_mm=40.0, mass_g=500.0)
    scene = lampest.Scene(lampest.Panel(side, side), readout)
    return lampest.simulate(
        lampest.Simulation(1, 5, scene, frames=FRAMES, loads=(rod,), baseline_frames=2, frame_period_s=0.2)
    )


def least(turn: Callable[[], object]) -> float:
    """Milliseconds of the shortest of many turns."""
    times = []
    for _ in range(TURNS):
        begin = perf_counter()
        turn()
        times.append(perf_counter() - begin)
    return 1e3 * min(times)


def whole_frames(recording: lampest.Recording, name: str) -> tuple[float, float]:
    """(milliseconds of the processor, iterations) of the median frame; of each frame the least of several sequences."""
    estimator = lampest.Estimator(
        (lampest.Misfit(weighting="noise"), *METHODS[name]), formulation="reduced", error_bars=False
    )
    times, iterations = [], []
    for _ in range(6):
        stream = begun(recording, estimator)
        spent = []
        for frame in recording.recorded[recording.role == 1]:
            begin = process_time()
            stream, step = stream.push(Readings.of(recording.scene, frame))
            spent.append(process_time() - begin)
            iterations.append(step.solution.iterations)
            assert step.solution.status is Status.OPTIMUM, step.status
        times.append(spent[1:])
    return 1e3 * float(np.median(np.min(times, axis=0))), float(np.median(iterations))


def begun(recording: lampest.Recording, estimator: lampest.Estimator) -> lampest.Stream:
    """Before the first frame."""
    resting = Readings.of(recording.scene, recording.recorded[recording.role == 0]).mean()
    return lampest.Stream.begin(estimator, recording.scene, 0.2, resting)


def parts(recording: lampest.Recording) -> dict[str, float]:
    """Milliseconds of each part of a frame of LSR-CR, at the solution of the last one."""
    terms = (lampest.Misfit(weighting="noise"), *METHODS["LSR-CR"])
    estimator = lampest.Estimator(terms, formulation="reduced", error_bars=False)
    stream, scene = begun(recording, estimator), recording.scene
    frames = recording.recorded[recording.role == 1]
    for frame in frames:
        stream, step = stream.push(Readings.of(scene, frame))
    readings = Readings.of(scene, frames[-1])
    data, _ = stream.given(readings)
    cost, cells = estimator.problem(scene, 1, 0.2).cost, step.cell_resistance[None]
    there = solved(cost, data, cells)
    everything, nothing = np.ones(cells.size, dtype=bool), np.zeros(cells.size)
    found = Newton(cost, estimator.solver).solve(data, there.at)
    at_point = least(lambda: solved(cost, data, cells))
    return {
        "recorded values to readings": least(lambda: Readings.of(scene, frames[-1])),
        "what a solve is given, with its bounds": least(lambda: stream.given(readings)),
        "a point: network, cost, gradient": at_point,
        "second derivatives there, as a matrix": least(lambda: solved(cost, data, cells).matrix) - at_point,
        "their factor, and a step": least(lambda: direction(there, everything, nothing, 0.0, 0.1)),
        "the check outside the solver": least(lambda: check(there.at, found)),
    }


def solved(cost: Cost, data: Data, cells: Array) -> Curvature:
    """A point with its first derivatives."""
    at = Evaluation.at(cost, data, cells)
    curvature = Curvature(at, Smoothing.start(at))
    _ = at.objective, at.cost_scale, curvature.gradient
    return curvature


def main(side: int) -> None:
    """Print the parts of one frame, and whole frames of five methods."""
    recording = simulated(side)
    print(f"{side} x {side}, milliseconds")
    for name, milliseconds in (parts(recording) if side**2 <= DENSE_UNKNOWNS else {}).items():
        print(f"{name:56s} {milliseconds:8.3f}", flush=True)
    for name in METHODS:
        milliseconds, iterations = whole_frames(recording, name)
        print(f"{'a frame of ' + name:56s} {milliseconds:8.3f}   iterations {iterations:.1f}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=10)
    main(parser.parse_args().side)
