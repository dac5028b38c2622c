"""Which solver `formulation: auto` takes."""

from math import inf

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.estimate.methods import named_method
from lampest.estimate.sequence import reconstruct
from lampest.solvers.solution import Settings


def solver_with_load(load_ohm: float) -> str:
    """Return the solver's name for sensed lines with a resistor each; infinite: without."""
    readout = lampest.DrivenReadout(drive_ohm=45.0, idle_ohm=45.0, load_ohm=load_ohm)
    scene = lampest.Scene(lampest.Panel(4, 4), readout)
    estimator = lampest.Estimator((lampest.Misfit(weighting="noise"), lampest.LogGradient(1.0)))
    cost = estimator.cost(scene, 1, partial=False)
    return named_method("auto").solver(cost, scene, Settings(), 1.0).name


def test_auto_takes_newton_where_no_reading_shows_the_scale_of_a_column() -> None:
    assert solver_with_load(inf) == "Newton"
    assert solver_with_load(1000.0) == "IPOPT nodal"


@pytest.mark.parametrize(
    ("shape", "period", "loss", "name"),
    [
        ((12, 12), 1.0, lampest.Squared(), "IPOPT nodal"),
        ((12, 13), 1.0, lampest.Squared(), "Newton"),
        ((4, 4), 0.25, lampest.Squared(), "Newton"),
        ((4, 4), 1.0, lampest.Absolute(), "Newton"),
        ((4, 4), 1.0, lampest.Huber(0.1), "Newton"),
        ((4, 4), 1.0, lampest.Student(3.0), "Newton"),
    ],
)
def test_auto_takes_ipopt_for_few_cells_with_squared_losses(
    shape: tuple[int, int], period: float, loss: lampest.Loss, name: str
) -> None:
    scene = lampest.Scene(lampest.Panel(*shape), lampest.TwoPointReadout())
    terms = (lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=1.0, loss=loss))
    cost = lampest.Estimator(terms).cost(scene, 1, partial=False)
    assert named_method("auto").solver(cost, scene, Settings(), period).name == name


def test_newton_ends_nearer_the_optimum_of_absolute_losses_than_ipopt() -> None:
    """Costs of IPOPT are up to 1e-7 of the cost above; of Newton at most 1e-9 (lowest of both)."""
    readout = lampest.TwoPointReadout(noise_lsb=0.7, readings=20)
    scene = lampest.Scene(lampest.Panel(6, 6), readout, 140.0)
    rod = lampest.Rod(centre_mm=(12, 12), diameter_mm=12, mass_g=150)
    simulation = lampest.Simulation(1, 3, scene, baseline_frames=3, frames=2, loads=(rod,))
    recording = lampest.simulate(simulation, "rod")
    terms = (lampest.Misfit(weighting="noise"), lampest.LogRatio(weight=1.0))
    newton, ipopt = (
        np.array([step.solution.objective for step in ended.steps])
        for ended in (
            reconstruct(recording, lampest.Estimator(terms, formulation=kind))
            for kind in ("reduced", "nodal")
        )
    )
    least = np.minimum(newton, ipopt)
    assert np.all(newton <= least * (1 + 1e-9))
    assert np.all(ipopt <= least * (1 + 1e-7)) and ipopt.max() > newton.max() * (1 + 1e-9)


@pytest.mark.slow
def test_newton_ends_at_the_minimum_of_ipopt_where_no_reading_shows_the_scale() -> None:
    rng = np.random.default_rng(7)
    readout = lampest.DrivenReadout(
        drive_ohm=45.0, idle_ohm=45.0, load_ohm=inf, adc_bits=10, readings=1, noise_lsb=1.0
    )
    scene = lampest.Scene(lampest.Panel(4, 5), readout)
    cells = 3000 * np.exp(0.05 * rng.normal(size=(4, 5))) * np.ones((4, 1, 1))
    cells[2:, 1:3, 1:3] /= 5
    volt = readout.to_recorded(np.stack([readout.exact_reading(frame) for frame in cells]), scene)
    codes = readout.code_from_volt(volt + readout.lsb_volt * rng.normal(size=volt.shape))
    recording = lampest.Recording.from_array(
        codes.astype(float), unit="code", scene=scene, baseline=2
    )
    terms = (lampest.Misfit(weighting="noise"), lampest.LogRatio(weight=1.0))
    ended = [
        reconstruct(recording, lampest.Estimator(terms, formulation=kind))
        for kind in ("reduced", "nodal")
    ]
    newton, ipopt = ([each.baseline, *each.steps] for each in ended)
    for ours, theirs in zip(newton, ipopt, strict=True):
        assert ours.solution.optimum
        assert ours.solution.objective <= theirs.solution.objective * (1 + 1e-6)
        assert_allclose(ours.solution.cell_resistance, theirs.solution.cell_resistance, rtol=1e-3)
