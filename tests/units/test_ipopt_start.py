"""What IPOPT makes of a start: from an optimum it goes nowhere, from near by not far, from afar all the way."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lampest
from lampest.cost.cost import Cost
from lampest.cost.problem import Data
from lampest.cost.terms import Term
from lampest.panel.panel import Array
from lampest.panel.readouts import Readout
from lampest.recording.readings import Readings
from lampest.solvers.ipopt.formulations import FORMULATIONS
from lampest.solvers.ipopt.ipopt import Ipopt, Limits
from lampest.solvers.multistart import evaluated
from lampest.solvers.projected_newton import ProjectedNewton
from lampest.solvers.solution import Settings, Status, check

CONVERTER = {"adc_bits": 12, "readings": 4, "noise_lsb": 1.0}
CASES: list[tuple[str, Readout]] = [
    ("nodal", lampest.TwoPointReadout(**CONVERTER)),
    ("per_pixel", lampest.TwoPointReadout(**CONVERTER)),
    ("nodal", lampest.LoadedColumnsReadout(load_ohm=1000, drive_ohm=100, **CONVERTER)),
    ("nodal", lampest.GroundedReadout(load_ohm=1000, drive_ohm=70, **CONVERTER)),
    ("nodal", lampest.VirtualGroundReadout(drive_ohm=70, sense_ohm=70, feedback_ohm=150, **CONVERTER)),
]
METHODS: dict[str, tuple[Term, ...]] = {
    "LSM": (),
    "LSR-CR": (lampest.CellResistance(weight=1e-7),),
    "LSR-gdCR": (lampest.GradientOfRelativeChange(weight=1e-2),),
}


def problem(readout: Readout, method: str) -> tuple[Cost, Data, Array]:
    """Of a frame's cost, its data and the optimum that Newton's method finds, (1, rows, columns) ohm."""
    rod = lampest.Rod(centre_mm=(20.0, 25.0), diameter_mm=25.0, mass_g=400.0)
    scene = lampest.Scene(lampest.Panel(5, 6), readout)
    recording = lampest.simulate(lampest.Simulation(1, 5, scene, frames=3, loads=(rod,), baseline_frames=2))
    terms = (lampest.Misfit(weighting="noise"), *METHODS[method])
    estimator = lampest.Estimator(terms, "reduced", error_bars=False)
    resting = Readings.of(scene, recording.recorded[recording.role == 0]).mean()
    stream = lampest.Stream.begin(estimator, scene, 0.2, resting)
    for frame in recording.recorded[recording.role == 1]:
        before, (stream, step) = stream, stream.push(Readings.of(scene, frame))
    data, _ = before.given(Readings.of(scene, recording.recorded[-1]))
    assert step.solution.status is Status.OPTIMUM
    return estimator.problem(scene, 1, 0.2).cost, data, step.cell_resistance[None]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("kind", "readout"), CASES)
def test_an_optimum_is_left_alone(kind: str, readout: Readout, method: str) -> None:
    """Zero iterations: voltages, currents and bounds satisfy all conditions with the multipliers that were given."""
    cost, data, cells = problem(readout, method)
    optimum = ProjectedNewton(cost, Settings(1e-12)).solve(data, evaluated(cost, data, cells)).cell_resistance
    start = evaluated(cost, data, optimum)
    outcome = Ipopt(cost, readout, FORMULATIONS[kind], Settings()).solve(data, start)
    assert (outcome.status, outcome.iterations) == (Status.OPTIMUM, 0)
    assert_allclose(outcome.cell_resistance, start.cell_resistance, rtol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("kind", "readout"), CASES)
def test_the_same_optimum_from_near_and_far(kind: str, readout: Readout, method: str) -> None:
    cost, data, cells = problem(readout, method)
    solver = Ipopt(cost, readout, FORMULATIONS[kind], Settings())
    near = cells * np.exp(0.01 * np.random.default_rng(2).standard_normal(cells.shape))
    iterations = []
    for place in (near, data.uniform_start):
        start = evaluated(cost, data, place)
        solution = check(start, solver.solve(data, start))
        assert solution.solved
        assert_allclose(solution.cell_resistance, cells, rtol=1e-4)
        iterations.append(solution.iterations)
    assert iterations[0] <= 8 and iterations[0] <= iterations[1]


def test_a_pressed_cell_lies_on_its_bound() -> None:
    limits = Limits(np.full(4, 1e-4), np.full(4, 2.0))
    settled = limits.settled(np.array([1e-4 + 1e-9, 0.5, 2 - 1e-9, 1e-4 + 1e-9]), np.array([-1e-3, -1e-12, 1e-3, 1e-3]))
    assert_array_equal(settled, [1e-4, 0.5, 2.0, 1e-4 + 1e-9])


def test_multipliers_hold_what_presses_and_nothing_else() -> None:
    limits = Limits(np.full(4, 0.5), np.full(4, 2.0))
    multipliers = limits.multipliers(np.array([0.5, 0.5, 2.0, 1.0]), np.array([-3.0, 3.0, 3.0, 7.0]), 0.1)
    assert_allclose(multipliers, [-3.0, 0.0, 3.0, 0.1 / 1.0 - 0.1 / 0.5])
