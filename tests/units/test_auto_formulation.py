"""Which solver `formulation: auto` takes."""

from math import inf

import pytest

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
