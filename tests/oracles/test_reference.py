"""The reference estimate, the errors of readings that it shows, and all that relies on them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from promises import promise

import lampest
from lampest import (
    Array,
    Data,
    LogGradient,
    Panel,
    Readings,
    Recording,
    Scene,
    two_point_resistance,
)
from lampest.cost.cost import Cost
from lampest.cost.given import Background
from lampest.cost.losses import Absolute, Huber, Loss, Squared, Student
from lampest.cost.terms import CellResistance, Gradient, Misfit
from lampest.estimate.estimator import Estimator
from lampest.estimate.weights import AutoWeight
from lampest.files.levels import TWO_SIDED
from lampest.inference.readings.outliers import impossible_readings
from lampest.posterior import reference
from lampest.posterior.reference import references
from lampest.solvers.posed import Bounds
from tests.estimates import in_intervals, log_errors, recording_of, rms

NOISE = 0.003  # of the readings
STATIC = 0.07  # error of each reading in all frames
# around 13 and 23, in steps of two; measured 16
MIN_SCALE = 8
MAX_SCALE = 32
CLEAR_GAIN = 6  # log probability: e^6 to one; measured at least 29
TAIL_ERROR = 0.6  # of the tail's 95 % over that of the errors; measured 0.3 to 0.47 less
RMS_ERROR = 0.3  # of the scores of 64 cells; three standard errors, 3/√(2n), are 0.27
MAX_ERROR = 0.3  # rms of log r; measured at most 0.26, and of plain least squares at least 4
MAX_CLEAN_ERROR = 0.07  # the same without a static error; limit: twice the value measured
MAX_FACTOR = 60  # of the noise; STATIC/NOISE is 23, measured 26
MIN_RATIO = 10  # of a reading's σ over its noise; measured 30
MAX_OPEN_NOISE = 3.0  # of the noise; measured 1.2, and 10 as an error of the reading
MIN_COVERAGE = 0.9  # of 95 % intervals, over frames whose readings share their errors
# readings, and the share that may lie within; measured 0.93
MIN_WITHHELD = 300
MAX_INSIDE = 0.98
MIN_OF_TWELVE = 0.8  # of two readings in six frames: 95 % less 2.4 standard deviations
CONVERGED = 1e-5  # relative, of cells at the end of a solve
NO_SMALLER = 0.999  # than the σ of a given weight, but for rounding in solves
MIN_ADDED = 0.05  # of a cell's σ, where the weight matters most; measured 0.13
STEP = 0.05  # of log λ
LINEAR_ERROR = 0.15  # relative, over such a step; measured 0.063
NO_WORSE = 1.02  # of the error by another weight; measured 0.95
NEARLY_AS_GOOD = 1.5  # of the error with specified noise; measured 1.1
WEIGHTED = Misfit(weighting="noise")
MODEL_ERROR_NOTE = "their noise: an error of the model"
PENALTIES = {
    "two": (LogGradient(), CellResistance()),
    "huber": (LogGradient(loss=Huber(corner=0.3)),),
    "student": (Gradient(loss=Student(corner=300.0)),),
    "absolute": (LogGradient(loss=Absolute()),),
}


def smooth(side: int = 8) -> Array:
    row, column = np.indices((side, side))
    return np.asarray(3000 * np.exp(0.3 * np.sin(column / 3) * np.cos(row / 4)))


def loaded(side: int = 8, factor: float = 0.15) -> Array:
    cells = smooth(side)
    cells[2:5, 3:6] *= factor
    return cells


def with_errors(cells: Array, seed: int, static: float = 0.0) -> tuple[Array, Array]:
    """Readings (frames, rows, columns) with a relative static error, and σ of their noise."""
    rng = np.random.default_rng(seed)
    exact = two_point_resistance(cells)
    wrong = exact * (1 + static * rng.standard_normal(exact.shape[-2:]))
    return wrong + NOISE * exact * rng.standard_normal(exact.shape), NOISE * exact


def problem_of(cells: Array, seed: int, static: float = 0.0) -> tuple[Data, Cost]:
    estimator = Estimator((WEIGHTED, LogGradient(weight=1.0)), "reduced")
    scene = Scene(Panel(*cells.shape))
    readings, sigma = with_errors(cells, seed, static)
    data = estimator.data(Readings.of(scene, readings[None], sigma[None]), Background(scene))
    return data, estimator.cost(scene, 1, partial=data.partial)


def log_error(cells: Array, truth: Array) -> float:
    return rms(np.log(cells / truth))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_cells_and_the_error_scale_are_recovered_from_readings_with_7_percent_error(
    seed: int,
) -> None:
    """σ says 0.3 %, so that s is 23, of Student's t between 13 and 23."""
    truth = loaded()
    data, cost = problem_of(truth, seed, static=STATIC)
    scale, (estimate,) = references([data], cost)
    assert MIN_SCALE <= scale.best <= MAX_SCALE and scale.gain(1.0) > CLEAR_GAIN
    of_errors = scale.tail / TWO_SIDED / (STATIC / NOISE)
    assert abs(of_errors - 1) < TAIL_ERROR, "95 % of the errors"
    plain = lampest.reconstruct(recording_of(Scene(Panel(8, 8)), data.measured), [Misfit()])
    assert (
        log_error(estimate.cells[0], truth)
        < MAX_ERROR
        < 5 * MAX_ERROR
        < log_error(plain.cell_resistance[0], truth)
    )
    z = np.log(estimate.cells[0] / truth).ravel() / np.sqrt(np.diag(estimate.covariance))
    assert abs(rms(z) - 1) < RMS_ERROR


@pytest.mark.parametrize("factor", [8.0, 15.0])
def test_a_single_open_cell_is_no_error_of_its_reading(factor: float) -> None:
    """Its weight was chosen for a reading that is ten times as noisy, ten times too large."""
    truth = smooth(6)
    truth[2, 3] *= factor
    data, cost = problem_of(truth, 1)
    _, (estimate,) = references([data], cost, believed=True)
    assert np.max(estimate.deviation / data.deviation) < MAX_OPEN_NOISE


@pytest.mark.parametrize("factor", [0.15, 0.5, 5.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_errors_are_the_noise_where_the_circuit_is_right_and_loads_have_edges(
    factor: float, seed: int
) -> None:
    data, cost = problem_of(loaded(factor=factor), seed)
    scale, (estimate,) = references([data], cost)
    assert scale.best == 1
    assert log_error(estimate.cells[0], loaded(factor=factor)) < MAX_CLEAN_ERROR


@pytest.mark.parametrize("seed", [1, 2])
def test_normal_tails_mistake_edges_for_errors_of_the_readings(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = np.full((10, 10), 3000.0) * np.exp(
        0.02 * np.random.default_rng(seed).standard_normal((10, 10))
    )
    truth[4:6, 3:5] *= 5
    data, cost = problem_of(truth, seed)
    assert references([data], cost)[0].best == 1
    monkeypatch.setattr(reference, "DEGREES_OF_FREEDOM", 1e6)  # nearly Gaussian
    squared = references([data], cost)[0]
    assert squared.best >= 2 and squared.gain(1.0) > CLEAR_GAIN


def frames_under_load(static: float, seed: int, unloaded: int = 0) -> Recording:
    """Six frames, a load that stays, on readings with a static error."""
    cells = np.repeat(loaded(factor=0.3)[None], unloaded + 6, axis=0)
    cells[:unloaded] = smooth()
    readings, sigma = with_errors(cells, seed, static)
    scene = Scene(Panel(8, 8), systematic="none")
    return recording_of(scene, readings, unloaded, sigma=sigma, truth_cell_resistance=cells)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_model_error_is_in_the_error_bars_and_in_one_sentence(seed: int) -> None:
    recording = frames_under_load(STATIC, seed)
    estimate = lampest.reconstruct(recording, [WEIGHTED, LogGradient()])
    assert sum(MODEL_ERROR_NOTE in line for line in estimate.checks) == 1
    assert 10 < estimate.noise.model_factor < MAX_FACTOR
    assert in_intervals(estimate).mean() > MIN_COVERAGE
    sigma = estimate.reading_sigma
    noise = recording.sigma
    assert sigma is not None and noise is not None and np.median(sigma / noise) > MIN_RATIO


@pytest.mark.parametrize("unloaded", [0, 3])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_clean_readings_show_no_error_of_the_model(seed: int, unloaded: int) -> None:
    recording = frames_under_load(0.0, seed, unloaded)
    estimate = lampest.reconstruct(recording, [WEIGHTED, LogGradient()])
    assert estimate.noise.model_factor == 1
    assert not any(MODEL_ERROR_NOTE in line for line in estimate.checks)
    assert in_intervals(estimate).mean() > MIN_COVERAGE


@pytest.mark.slow
@pytest.mark.parametrize("name", ["insole_walking", "insole_standing"])
@pytest.mark.parametrize(("loss", "least"), [(Squared(), 0.88), (Student(corner=4.0), 0.9)])
def test_withheld_readings_of_a_real_sensor_lie_within_their_intervals(
    name: str, loss: Loss, least: float
) -> None:
    """A tenth of the usable readings is withheld."""
    complete = Recording.load(Path(__file__).parents[2] / "data" / f"{name}.h5")
    readings = complete.readings()
    rng = np.random.default_rng(3)
    usable = (
        readings.plain
        & complete.scene.panel.present
        & ~impossible_readings(complete.scene.circuit, readings)
    )
    withheld = usable & (rng.random(usable.shape) < 0.1)
    recording = replace(complete, recorded=np.where(withheld, np.nan, complete.recorded))
    estimate = lampest.reconstruct(recording, [Misfit(weighting="noise", loss=loss), LogGradient()])
    sigma = estimate.reading_sigma
    model = np.stack([step.solution.reading[-1] for step in estimate.steps])
    # Of missing ones, too.
    assert np.all(sigma[estimate.solved] > 0) and np.all(np.isfinite(sigma[estimate.solved]))
    judged = withheld & estimate.solved[:, None, None]
    inside = np.abs(complete.readings().value - model)[judged] < TWO_SIDED * sigma[judged]
    assert judged.sum() > MIN_WITHHELD and least <= inside.mean() <= MAX_INSIDE


def test_a_missing_reading_has_a_wider_interval_that_holds_it() -> None:
    recording = frames_under_load(0.0, 1)
    recorded = recording.recorded.copy()
    recorded[:, 5, 5] = recorded[:, 1, 6] = np.nan
    estimate = lampest.reconstruct(replace(recording, recorded=recorded), [WEIGHTED, LogGradient()])
    sigma = estimate.reading_sigma
    model = np.stack([step.solution.reading[-1] for step in estimate.steps])
    missing = np.isnan(recorded)
    exact = two_point_resistance(recording.truth_cell_resistance)
    assert np.all(np.isfinite(sigma))
    assert np.median((sigma / exact)[missing]) > 2 * np.median((sigma / exact)[~missing])
    assert (
        np.mean(np.abs(recording.recorded - model)[missing] < TWO_SIDED * sigma[missing])
        >= MIN_OF_TWELVE
    )


@pytest.mark.slow
@promise("howto/weights: Error bars include this uncertainty.")
def test_bars_allow_for_the_uncertainty_of_a_chosen_weight() -> None:
    """Bars of a weight given as a number are smaller, most where the weight matters most."""
    recording = frames_under_load(STATIC, 2)
    chosen = lampest.reconstruct(recording, [WEIGHTED, LogGradient()])
    weight = chosen.steps[0].weights[1]
    sigma = chosen.steps[0].weight_sigma[1]
    given = lampest.reconstruct(recording, [WEIGHTED, LogGradient(weight=weight)])
    assert_allclose(given.cell_resistance, chosen.cell_resistance, rtol=CONVERGED)
    chosen_sigma, given_sigma = (estimate.sigma_own for estimate in (chosen, given))
    added_sigma = np.sqrt(np.maximum(chosen_sigma**2 - given_sigma**2, 0))
    assert (
        np.all(chosen_sigma > NO_SMALLER * given_sigma)
        and added_sigma.max() > MIN_ADDED * given_sigma.max()
    )
    moved = lampest.reconstruct(recording, [WEIGHTED, LogGradient(weight=weight * np.exp(STEP))])
    slope = np.abs(np.log(moved.cell_resistance / given.cell_resistance)) / STEP
    assert_allclose(
        added_sigma.max(axis=(1, 2)), (sigma * slope).max(axis=(1, 2)), rtol=LINEAR_ERROR
    )


@pytest.mark.long
@pytest.mark.parametrize("per", ["recording", "frame"])
@pytest.mark.parametrize("penalties", PENALTIES.values(), ids=PENALTIES)
def test_weights_of_any_penalties_beat_the_hundredth_and_the_hundredfold(
    penalties: tuple[lampest.Term, ...], per: str
) -> None:
    recording = frames_under_load(0.0, 3)
    every = (WEIGHTED, *penalties)
    estimate = lampest.reconstruct(
        recording, every, auto_weight=AutoWeight(per=per), error_bars=False
    )
    assert estimate.solved.all()
    chosen = np.array(estimate.steps[-1].weights)
    sigma = np.array(estimate.steps[-1].weight_sigma)
    assert np.isnan(sigma[0]) and np.all(np.isfinite(sigma[1:]) | (chosen[1:] > 0))
    error = rms(log_errors(estimate)[-1])
    for factor in (0.01, 100.0):
        terms = [
            replace(term, weight=factor * weight)
            for term, weight in zip(penalties, chosen[1:], strict=True)
        ]
        alternative = lampest.reconstruct(recording, (WEIGHTED, *terms), error_bars=False)
        assert error < NO_WORSE * rms(log_errors(alternative)[-1])


@pytest.mark.slow
@pytest.mark.parametrize("static", [0.0, STATIC])
def test_readings_without_noise_are_judged_by_the_reference_too(static: float) -> None:
    """A table in ohm: neither σ nor a converter."""
    recording = frames_under_load(static, 1)
    estimate = lampest.reconstruct(
        replace(recording, sigma=None), [Misfit(), Gradient()], bounds=Bounds(upper="none")
    )
    specified = lampest.reconstruct(recording, [Misfit(), Gradient()], bounds=Bounds(upper="none"))
    assert rms(log_errors(estimate)) < NEARLY_AS_GOOD * rms(log_errors(specified))
