"""Which solver `formulation: auto` takes."""

from math import inf

import lampest
from lampest.estimate.methods import named_method
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
