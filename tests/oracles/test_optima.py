"""Estimates against optima that a second statement of the equations and another solver find."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from promises import promise

from lampest import (
    Array,
    Estimator,
    GroundedReadout,
    Panel,
    Recording,
    Scene,
    Status,
    two_point_resistance,
)
from lampest.cost.losses import Absolute, Huber, Squared
from lampest.cost.terms import Gradient, LogRatio, Misfit
from lampest.estimate.sequence import reconstruct
from lampest.recording.simulation.measure import Unmodelled, measured
from tests.estimates import recording_of
from tests.least_cost import Circuit

SPOILT = 0.5  # of a cell, relative; measured 0.70, and 0.023 and 0.077 by the other losses
AT_BOUND = 0.99


def truth(shape: tuple[int, int], frames: int, seed: int, spread: float = 0.3) -> Array:
    """Cells of 3 kilohm, scattered, of which a patch falls from frame to frame."""
    rng = np.random.default_rng(seed)
    resting = 3000 * np.exp(spread * rng.standard_normal(shape))
    pressed = rng.random(shape) < 0.25
    steps = [resting * np.where(pressed, 0.8**frame, 1.02**frame) for frame in range(frames)]
    return np.stack(steps)


def recording(cells: Array, noise: float, seed: int = 0, unloaded: int = 0) -> Recording:
    """Two-point resistances with that relative noise, of which σ tells."""
    exact = two_point_resistance(cells)
    rng = np.random.default_rng(seed)
    resistance = exact * (1 + noise * rng.standard_normal(exact.shape))
    return recording_of(
        Scene(Panel(*cells.shape[1:])), resistance, unloaded, sigma=exact * max(noise, 1e-4)
    )


def test_an_outlier_spoils_squares_but_not_absolute_values() -> None:
    """One reading of thirty is 20 % off on an even panel."""
    cells = truth((5, 6), 1, 11, spread=0.02)
    readings = recording(cells, 1e-4)
    wild = readings.recorded.copy()
    wild[0, 2, 3] *= 1.2
    readings = replace(readings, recorded=wild)
    errors = {}
    for loss in (Huber(corner=5.0), Absolute(), Squared()):
        estimate = reconstruct(
            readings, Estimator((Misfit(loss=loss), Gradient(weight=1e-3)))
        ).cell_resistance
        errors[loss.kind] = np.max(np.abs(estimate / cells - 1))
    assert errors["squared"] > SPOILT
    assert errors["absolute"] < SPOILT / 10, "an absolute loss ignores the size of an outlier"
    assert errors["huber"] < 3 * SPOILT / 10, "beyond its corner of 5 the outlier still pulls"


@promise("theory/inverse_problem: A cell at that bound carries the flag `open_cell`")
@pytest.mark.parametrize("formulation", ["per_pixel", "nodal", "reduced", "auto"])
def test_a_cell_without_a_finite_optimum_ends_at_the_resolution(formulation: Any) -> None:
    """Plain least squares with 3 % noise, whose misfit falls all the way."""
    recorded = recording(truth((5, 7), 1, 14, spread=0.8), 3e-2, seed=14)
    solution = reconstruct(recorded, Estimator((Misfit(),), formulation)).steps[0].solution
    assert solution.solved
    upper = recorded.resistance**2 / recorded.sigma
    assert np.sum(solution.open_cell) == 3
    assert np.array_equal(solution.open_cell, solution.cell_resistance >= AT_BOUND * upper)
    assert_allclose(
        solution.cell_resistance[solution.open_cell], upper[solution.open_cell], rtol=1e-6
    )
    reading, response = Circuit("two_point").reading(solution.cell_resistance[0])
    slope = (reading - recorded.resistance[0]).ravel() @ response
    assert np.all(slope[solution.open_cell.ravel()] < 0)


@pytest.mark.parametrize("weight", [35.0, 200.0])
@pytest.mark.parametrize("formulation", ["nodal", "reduced"])
def test_the_optimum_is_verified_from_an_unchanged_start(formulation: str, weight: float) -> None:
    """The baseline is the first start, at which every residual of the absolute loss is zero."""
    rng = np.random.default_rng(0)
    time = np.arange(8.0)
    scene = Scene(Panel(3, 3), readout=GroundedReadout(load_ohm=1000.0, adc_bits=12, noise_lsb=2.5))
    cells = np.repeat(5000 * np.exp(0.2 * rng.standard_normal((1, 3, 3))), 8, axis=0)
    cells[6:, 1, 1] /= 2
    recording = Recording(
        scene, measured(scene, cells, Unmodelled(), 0)[0], time, (time > 4).astype(np.uint8)
    )
    terms = (Misfit(weighting="noise"), LogRatio(weight=weight))
    estimates = reconstruct(recording, Estimator(terms, formulation, error_bars=False))
    assert [step.solution.status for step in estimates.steps] == 3 * [Status.OPTIMUM]
