"""Which solver `formulation: auto` takes."""

from math import inf

import numpy as np
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
