"""A factor of second derivatives that is kept from step to step and from frame to frame spares work, not digits."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import cho_factor, cho_solve

import lampest
from lampest.cost.problem import Evaluation
from lampest.cost.terms import Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.stream import Stream
from lampest.recording.readings import Readings
from lampest.solvers.newton.directions import Factor
from lampest.solvers.newton.newton import Newton
from lampest.solvers.solution import Settings, Status, check

MISFIT = lampest.Misfit(weighting="noise")
METHODS: dict[str, tuple[Term, ...]] = {
    "LSM": (MISFIT,),
    "LSR-CR": (MISFIT, lampest.CellResistance(weight=1e-7)),
    "LSR-gdCR": (MISFIT, lampest.GradientOfRelativeChange(weight=1e-2)),
}


def pressed() -> lampest.Recording:
    readout = lampest.TwoPointReadout(adc_bits=12, reference_ohm=400.0, readings=4, noise_lsb=1.0)
    rod = lampest.Rod(centre_mm=(30.0, 35.0), diameter_mm=30.0, mass_g=400.0)
    scene = lampest.Scene(lampest.Panel(7, 8), readout)
    return lampest.simulate(lampest.Simulation(1, 5, scene, frames=4, loads=(rod,), baseline_frames=2))


def after_frames(method: str, frames: int) -> tuple[Stream, Readings]:
    """A stream that has seen some frames, and the next one."""
    recording, estimator = pressed(), Estimator(METHODS[method], "reduced", error_bars=False)
    scene, measured = recording.scene, recording.recorded[recording.role == 1]
    resting = Readings.of(scene, recording.recorded[recording.role == 0]).mean()
    stream = Stream.begin(estimator, scene, 0.2, resting)
    for frame in measured[:frames]:
        stream, _ = stream.push(Readings.of(scene, frame))
    return stream, Readings.of(scene, measured[frames])


@pytest.mark.parametrize("method", ["LSR-CR", "LSR-gdCR"])
def test_the_frame_before_leaves_its_factor(method: str) -> None:
    """It is that of second derivatives near the estimate, and the next frame needs no more of its own."""
    stream, readings = after_frames(method, 3)
    assert isinstance(stream.prepared, Factor)
    _, warm = stream.push(readings)
    _, cold = replace(stream, prepared=None).push(readings)
    assert warm.solution.status is cold.solution.status is Status.OPTIMUM
    assert warm.solution.iterations <= cold.solution.iterations
    assert warm.solution.objective <= cold.solution.objective * (1 + 1e-9)
    assert_allclose(warm.cell_resistance, cold.cell_resistance, rtol=1e-6)


@pytest.mark.parametrize("method", list(METHODS))
@pytest.mark.parametrize("spoilt", [1e-3, 1e3, -1.0, np.nan])
def test_a_wrong_factor_spoils_nothing(method: str, spoilt: float) -> None:
    """One that makes far too long or short steps, uphill ones or none costs steps, no digit and no verdict."""
    stream, readings = after_frames(method, 3)
    data, previous = stream.given(readings)
    assert previous is not None
    solver = stream.estimator.problem(stream.scene, 1, 0.2)
    assert isinstance(solver, Newton)
    start = Evaluation.at(solver.cost, data, np.clip(previous, data.lower, data.upper))
    right = check(start, solver.solve(data, start))
    everything = np.arange(previous.size)
    wrong = Factor(everything, start.cell_resistance, lambda slope: spoilt * slope)
    found = check(start, solver.following(wrong).solve(data, start))
    assert right.status is found.status is Status.OPTIMUM
    assert_allclose(found.cell_resistance, right.cell_resistance, rtol=1e-5)
    assert found.objective == pytest.approx(right.objective, rel=1e-8)


def test_what_is_handed_out_is_the_point_after_the_step_that_certified_it() -> None:
    """With so loose a tolerance a solve ends far out; one exact Newton step from its end moves nothing to speak of."""
    stream, readings = after_frames("LSR-CR", 2)
    data, previous = stream.given(readings)
    assert previous is not None
    cost = stream.estimator.problem(stream.scene, 1, 0.2).cost
    start = Evaluation.at(cost, data, np.clip(previous, data.lower, data.upper))
    found = Newton(cost, Settings(tolerance=1e-6)).solve(data, start)
    assert found.certificate is not None and found.certificate.settled
    before = found.certificate.curvature
    assert before is not None
    factor = cho_factor(before.matrix)
    left = before.at.cell_resistance * np.exp(-cho_solve(factor, before.gradient)).reshape(previous.shape)
    moved = np.abs(np.log(before.at.cell_resistance / left)).max()
    assert np.abs(np.log(found.cell_resistance / left)).max() < 0.1 * moved
