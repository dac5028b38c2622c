"""What somebody gets who names nothing: weights from the data, and a formulation that fits the size and the rate."""

from dataclasses import replace

import numpy as np
import pytest

import lampest
from lampest import CellResistance, Gradient, Misfit, Recording, Scene, TotalVariation


@pytest.fixture(scope="module")
def few() -> Recording:
    """The lamprey's unloaded frames and two later ones."""
    whole, chosen = lampest.datasets.load("lamprey_35mm"), [0, 1, 2, 14, 15]
    parts = ("recorded", "time", "role", "truth_cell_resistance", "truth_pressure")
    return replace(whole, raw_sums=None, **{part: getattr(whole, part)[chosen] for part in parts})


def test_it_serves_better_than_the_papers_weight(few: Recording) -> None:
    errors = {}
    for name, penalty in (("default", Gradient()), ("paper", Gradient(weight=1e-3))):
        found = lampest.reconstruct(few, [Misfit(), penalty])
        errors[name] = np.median(np.abs(found.cell_resistance / few.truth_cell_resistance[3:] - 1))
    assert errors["default"] < 0.3 * errors["paper"]


def test_unknown_noise_takes_the_same_rule(few: Recording) -> None:
    silent = replace(few, scene=Scene(few.scene.panel, None, few.scene.series_resistance_ohm))
    found = lampest.reconstruct(silent, [Misfit(), Gradient()])
    told = lampest.reconstruct(silent, [Misfit(), Gradient()], auto_weight=lampest.AutoWeight(rule="risk"))
    assert found.solved.all() and np.array_equal(found.cell_resistance, told.cell_resistance)
    open_ended = lampest.reconstruct(silent, [Misfit(), Gradient()], bounds=lampest.Bounds(upper="none"))
    assert np.array_equal(found.cell_resistance, open_ended.cell_resistance)
    assert lampest.reconstruct(silent, [Misfit(), CellResistance(), TotalVariation()]).solved.all()
