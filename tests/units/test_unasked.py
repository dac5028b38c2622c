"""Parts that a scene does not request, or a recording cannot show, change nothing."""

from dataclasses import replace

import numpy as np
import pytest

import lampest
from lampest.cost.given import Background
from lampest.inference.effects.converter_ends import with_saturated_stage
from lampest.inference.effects.converter_memory import memory_gain
from lampest.inference.prepared import Prepared
from lampest.solvers.multistart import evaluated

ROWS = 3
COLUMNS = 4


def recording_of(scene: lampest.Scene, recorded: lampest.Array) -> lampest.Recording:
    """Two unloaded and three measured frames of the same readings."""
    role = np.array([0, 0, 1, 1, 1], dtype=np.uint8)
    return lampest.Recording(scene, np.stack([recorded] * len(role)), np.arange(5.0), role)


@pytest.fixture
def grounded() -> lampest.Recording:
    """Grounded lines whose amplifier passes all volts."""
    readout = lampest.GroundedReadout(load_ohm=1000.0, noise_lsb=0.7)
    scene = lampest.Scene(lampest.Panel(ROWS, COLUMNS), readout)
    cells = np.random.default_rng(3).uniform(900, 2000, (ROWS, COLUMNS))
    return recording_of(scene, readout.to_recorded(readout.exact_reading(cells), scene))


def test_a_stage_that_is_not_estimated_leaves_the_recording_as_it_is(
    grounded: lampest.Recording,
) -> None:
    """Only `passes_volt: estimated` is replaced, by a number or by None."""
    assert with_saturated_stage(grounded) is grounded
    scene = grounded.scene
    readout = replace(scene.circuit, passes_volt="estimated")
    requested = replace(grounded, scene=replace(scene, readout=readout))
    assert with_saturated_stage(requested).scene.circuit.passes_volt is None


def test_readings_without_a_converter_show_no_memory() -> None:
    """Ohm of a meter have no order of codes in which a share could stay."""
    scene = lampest.Scene(lampest.Panel(ROWS, COLUMNS), None)
    cells = np.random.default_rng(4).uniform(900, 2000, (ROWS, COLUMNS))
    recording = recording_of(scene, lampest.two_point_resistance(cells))
    question = Prepared(replace(recording, sigma=np.ones(recording.recorded.shape))).question
    assert memory_gain(question, question.explanation) == 0.0


def test_a_cost_of_squared_losses_has_no_rounding_of_corners() -> None:
    """Only residuals with an absolute loss have a corner that rounding blurs."""
    scene = lampest.Scene(lampest.Panel(ROWS, COLUMNS), lampest.TwoPointReadout())
    cells = np.random.default_rng(5).uniform(900, 2000, (ROWS, COLUMNS))
    readings = lampest.Readings.of(scene, lampest.two_point_resistance(cells)).alone()
    for term, has_corners in (
        (lampest.LogGradient(weight=1.0), False),
        (lampest.TotalVariation(weight=1.0), True),
    ):
        estimator = lampest.Estimator((lampest.Misfit(), term), "reduced")
        data = estimator.data(readings, Background(scene))
        point = evaluated(estimator.cost(scene, 1), data, cells[None])
        assert (point.rounding > 0) == has_corners
