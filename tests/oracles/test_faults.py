"""Broken cells, readings at their limits, and intervals of missing readings."""

from dataclasses import replace

import numpy as np
import pytest

import lampest
from lampest import Array, Estimator, Panel, Recording, Scene, TwoPointReadout, two_point_resistance
from lampest.cost.terms import CellResistance, Misfit
from lampest.estimate.sequence import reconstruct
from lampest.posterior.covariance import DenseErrors
from lampest.posterior.track import profile_end, tangent
from tests.estimates import in_intervals, log_errors, recording_of

SHAPE = (6, 7)
SIGMA = 0.01
LSM = (Misfit(),)
READOUT = lampest.TwoPointReadout(supply_volt=5, reference_ohm=1000, adc_bits=16, noise_lsb=1)
HOLED = lampest.Scene(lampest.Panel(*SHAPE), READOUT, systematic="none")
MIN_COVERAGE = 0.9  # of 95 % intervals: a missing reading moves all cells of a panel together
SHORTED = 10  # σ of a reading, in ohm: a cell below it is a short circuit to the readings
MAX_WIDTH = 0.3  # of an interval over its cell, of cells with readings
MAX_ERROR = 0.005  # median of |log r|; an open baseline moved all cells by 0.01; measured 0.0043
CURVED = 0.1  # of the move of the other cells; the tangent errs by twice that; measured 0.038, 0.44
FALLEN = 0.15  # of the fall of a row; tangents give 0.27 of it; measured 0.08
MAX_DECADES = 1.2  # between weights without and with missing readings; measured 1.07
MAX_RMS = 0.03  # of log r of the cells that are not broken


def cells() -> Array:
    """Three frames of some thousand ohm, the last with a pressed patch."""
    frames = np.repeat(
        3000 * np.exp(0.2 * np.random.default_rng(0).standard_normal((1, *SHAPE))), 3, axis=0
    )
    frames[2, 2:4, 3:5] *= 0.2
    return frames


def recording(truth: Array, readout: TwoPointReadout | None = None) -> Recording:
    """Exact readings with a small σ, one unloaded frame."""
    scene = Scene(Panel(*SHAPE), readout)
    sigma = np.full(truth.shape, SIGMA)
    return recording_of(scene, two_point_resistance(truth), 1, sigma=sigma)


def test_unknown_open_cells_and_shorts_are_flagged() -> None:
    """A cell behind a reading of zero ends at the least that bounds allow."""
    truth = cells()
    truth[:, 1, 2] = np.inf
    estimate = reconstruct(recording(truth), Estimator(LSM, formulation="reduced"))
    flags = np.stack([step.solution.open_cell[-1] for step in estimate.steps])
    assert np.all(flags[:, 1, 2]) and flags.sum() == len(flags)
    truth = cells()
    truth[:, 4, 5] = 1e-3
    estimate = reconstruct(
        recording(truth), Estimator((Misfit(), CellResistance(weight=1e-9)), formulation="reduced")
    )
    for step in estimate.steps:
        assert step.solution.solved
        assert step.solution.cell_resistance[-1][4, 5] < SHORTED * SIGMA


def with_holes(seed: int, missing: int) -> lampest.Recording:
    """Two unloaded frames and one with a pressed patch and so many readings less."""
    rng = np.random.default_rng(seed)
    resting = 1000 * np.exp(0.3 * rng.standard_normal(SHAPE))
    pressed = resting.copy()
    pressed[2:5, 2:4] *= 0.3
    exact = READOUT.exact_reading(np.stack([resting, resting, pressed]))
    readings = exact + READOUT.sigma(exact) * rng.standard_normal(exact.shape)
    readings[2].flat[rng.choice(42, missing, replace=False)] = np.nan
    truth = np.stack([resting, resting, pressed])
    return recording_of(HOLED, readings, 2, truth_cell_resistance=truth)


@pytest.mark.slow
@pytest.mark.parametrize("terms", [[], [lampest.RelativeChange()], [lampest.Gradient()]])
def test_intervals_contain_read_cells_despite_missing_readings(terms: list[object]) -> None:
    """A missing reading moves all cells along a curve; tangents held 87 % of them."""
    misfit = lampest.Misfit(weighting="noise" if terms else "plain")
    held = []
    widths = []
    for seed in range(12):
        estimate = lampest.reconstruct(
            with_holes(seed, 1 + seed % 2), [misfit, *terms], formulation="reduced"
        )
        read = np.isfinite(estimate.recording.recorded[2:])
        held.append(in_intervals(estimate)[read].mean())
        widths.append(
            np.median((estimate.cell_resistance_upper / estimate.cell_resistance_lower - 1)[read])
        )
    assert np.mean(held) > MIN_COVERAGE and np.median(widths) < MAX_WIDTH


@pytest.mark.long
@pytest.mark.parametrize("term", [lampest.RelativeChange(), lampest.GradientOfRelativeChange()])
def test_penalties_compare_with_a_substitute_for_an_unread_baseline(term: object) -> None:
    """Without a substitute the cell opened, all others moved by 1 %, and bars covered 45 %."""
    rng = np.random.default_rng(8)
    resting = 1000 * np.exp(0.2 * rng.standard_normal(SHAPE))
    pressed = resting.copy()
    pressed[2:5, 2:4] *= 0.4
    truth = np.stack([resting, resting, pressed, 0.9 * pressed])
    readings = READOUT.exact_reading(truth)
    readings = readings + READOUT.sigma(readings) * rng.standard_normal(readings.shape)
    readings[:, 1, 5] = np.nan
    recording = recording_of(HOLED, readings, 2, truth_cell_resistance=truth)
    estimate = lampest.reconstruct(
        recording, [lampest.Misfit(weighting="noise"), term], formulation="reduced"
    )
    read = np.isfinite(readings[2:])
    assert in_intervals(estimate)[read].mean() > MIN_COVERAGE
    assert np.median(np.abs(log_errors(estimate))) < MAX_ERROR


def test_a_row_reaches_as_far_as_its_cells_at_the_rail_let_it() -> None:
    """Behind R, readings V g of a row with readings at the rail, of conductance G, leave V open.

    V is proportional to 1/(1 + R G), and the row's other cells to V.
    """
    readout = lampest.VirtualGroundReadout(
        supply_volt=3.3, adc_bits=16, readings=20, noise_lsb=0.5, feedback_ohm=5e3, drive_ohm=100.0
    )
    scene = lampest.Scene(lampest.Panel(*SHAPE), readout, systematic="none")
    truth = np.repeat(
        3e4 * np.exp(0.6 * np.random.default_rng(0).standard_normal((1, *SHAPE))), 3, axis=0
    )
    truth[2, 2, 2:5] /= 20
    volt = np.clip(readout.exact_reading(truth), *readout.range_volt)
    estimate = lampest.reconstruct(
        recording_of(scene, volt, 2, truth_cell_resistance=truth), formulation="reduced"
    )
    row = 0, 2
    at_rail = estimate.readings.bounds[row]
    cells = estimate.cell_resistance[row]
    lower = estimate.cell_resistance_lower[row]
    loads = [1 + readout.drive_ohm * np.sum(1 / of[at_rail]) for of in (cells, lower)]
    fall = np.log(loads[1] / loads[0])
    assert at_rail.sum() == 3 and in_intervals(estimate)[row][~at_rail].all()
    np.testing.assert_allclose(np.log(cells / lower)[~at_rail], fall, rtol=FALLEN)


@pytest.mark.parametrize("side", [-1, 1])
def test_the_profile_of_a_held_cell_follows_the_valley(side: int) -> None:
    """Solves within bounds that fix the cell confirm it."""
    recording = with_holes(3, 1)
    terms = (lampest.Misfit(weighting="noise"), lampest.Gradient(weight=1e-4))
    readings = recording.readings()
    estimator = lampest.Estimator(terms, formulation="reduced")
    stream = lampest.Stream.begin(estimator, HOLED, 1.0, readings[np.array([0, 1])].mean())
    data, _ = stream.data_and_start(readings[2])
    model = stream.estimator.method.solve(stream, data, None).surroundings()
    cell = int(np.flatnonzero(readings.seen[2].ravel() == 0)[0])
    errors = DenseErrors(model)
    displacement = profile_end(errors, cell, side)
    lower = data.lower.copy()
    upper = data.upper.copy()
    lower.flat[cell] = upper.flat[cell] = np.exp(model.at.position.flat[cell] + displacement[cell])
    start = np.exp(model.at.position + displacement.reshape(1, *SHAPE))
    optimum = stream.estimator.method.solve(stream, replace(data, lower=lower, upper=upper), start)
    exact = (np.log(optimum.cell_resistance) - model.at.position[0]).ravel()
    other_cells = np.arange(displacement.size) != cell
    assert (
        np.abs(displacement - exact)[other_cells].max() < CURVED * np.abs(exact[other_cells]).max()
    )
    assert (
        np.abs(tangent(errors, cell) * side - exact)[other_cells].max()
        > 2 * CURVED * np.abs(exact[other_cells]).max()
    )


@pytest.mark.slow
@pytest.mark.parametrize("term", [lampest.Gradient(), lampest.RelativeChange()])
def test_a_missing_reading_does_not_choose_the_weight(term: object) -> None:
    """The penalty decides an unread cell whatever its weight."""
    terms = [lampest.Misfit(weighting="noise"), term]
    estimates = [
        lampest.reconstruct(with_holes(3, missing), terms, formulation="reduced")
        for missing in (0, 2)
    ]
    weights = [estimate.steps[0].weights[1] for estimate in estimates]
    assert abs(np.log10(weights[1] / weights[0])) < MAX_DECADES  # it was 15


@pytest.mark.slow
@pytest.mark.parametrize(
    "readout",
    [
        TwoPointReadout(noise_lsb=0.5, readings=20),
        lampest.VirtualGroundReadout(
            noise_lsb=0.5, feedback_ohm=300.0, drive_ohm=50.0, sense_ohm=50.0
        ),
        lampest.LoadedColumnsReadout(noise_lsb=0.5),
    ],
)
def test_a_simulation_breaks_the_cells_that_its_scene_calls_broken(
    readout: lampest.Readout,
) -> None:
    """No circuit is doubted, and no load lies on the unloaded panel."""
    faults = lampest.Faults(open=((0, 0),), shorted=((3, 4),), dead_columns=(5,))
    rod = lampest.Rod(centre_mm=(25.0, 25.0), diameter_mm=30.0, mass_g=400.0)
    simulation = lampest.Simulation(
        1, 3, Scene(Panel(*SHAPE), readout, faults=faults), frames=3, loads=(rod,)
    )
    estimate = lampest.reconstruct(lampest.simulate(simulation), LSM, formulation="reduced")
    truth = estimate.recording.truth_cell_resistance[estimate.frame]
    errors = np.log(estimate.cell_resistance / truth)[:, ~estimate.recording.scene.broken]
    assert np.sqrt(np.mean(errors**2)) < MAX_RMS and not estimate.checks
