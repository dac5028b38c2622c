"""Formulas of changed cells, motion, smoothed losses and series resistances, against their plain statements."""

from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from lampest import (
    Bounds,
    Estimator,
    InputError,
    Misfit,
    Panel,
    Readings,
    Scene,
    TotalVariation,
    TwoPointReadout,
    two_point_resistance,
)
from lampest.cost.given import Background
from lampest.cost.problem import Evaluation
from lampest.estimate.calibration.loads import _answers
from lampest.estimate.changed_cells import MOVED_COST, scores_with_errors, select_changed, usual_starts
from lampest.estimate.model_check import most_in_series
from lampest.estimate.noise import NoiseEstimate, largest_change_within_scan
from lampest.estimate.rivals import Question, Rival
from lampest.files import levels
from lampest.panel.panel import Array
from lampest.solvers.bounds import bounds_matter
from lampest.solvers.smoothing import Smoothing


def drawn(cells: int, seed: int) -> tuple[Array, Array]:
    """A change of still cells, and its covariance."""
    rng = np.random.default_rng(seed)
    root = 0.01 * rng.standard_normal((cells, cells)) + 0.02 * np.eye(cells)
    return root @ rng.standard_normal(cells), root @ root.T


@pytest.mark.parametrize("seed", range(3))
def test_an_error_more_is_scored_by_the_density_of_the_change_with_it(seed: int) -> None:
    change, covariance = drawn(9, seed)
    columns = 0.05 * np.random.default_rng(seed + 10).standard_normal((9, 4))
    scores = scores_with_errors(change, np.linalg.inv(covariance), columns)
    for score, column in zip(scores, columns.T, strict=True):
        with_it = covariance + np.outer(column, column)
        volume = np.linalg.slogdet(with_it)[1] - np.linalg.slogdet(covariance)[1]
        assert score == pytest.approx(change @ np.linalg.solve(with_it, change) + volume, rel=1e-9)


def evidence(change: Array, covariance: Array, moved: NDArray[np.bool_]) -> float:
    """−2 ln of N(d; 0, C + 1 of moved cells) over that of no moved cells, with the odds of each moved cell."""
    with_moved = covariance + np.diag(moved.astype(float))
    volume = np.linalg.slogdet(with_moved)[1] - np.linalg.slogdet(covariance)[1]
    return float(change @ np.linalg.solve(with_moved, change) + volume + MOVED_COST * moved.sum())


@pytest.mark.parametrize("seed", range(6))
def test_the_selected_cells_have_the_most_evidence_of_all_subsets(seed: int) -> None:
    change, covariance = drawn(8, seed)
    change[[2, 5]] += -0.8, 0.1 * seed
    precision = np.linalg.inv(covariance)
    lost, moved = select_changed(precision @ change, precision, usual_starts(change))
    assert change @ precision @ change + lost == pytest.approx(evidence(change, covariance, moved), rel=1e-9)
    subsets = (np.array(chosen) for chosen in product((False, True), repeat=8))
    assert evidence(change, covariance, moved) == pytest.approx(min(evidence(change, covariance, m) for m in subsets))
    score = scores_with_errors(change, precision, np.zeros((8, 1)))  # adds cells only, and may end above
    assert score[0] > evidence(change, covariance, moved) - 1e-9


def test_loaded_cells_have_moved_in_any_case() -> None:
    change, covariance = drawn(8, 3)
    precision, loaded = np.linalg.inv(covariance), np.arange(8) == 6
    lost, moved = select_changed(precision @ change, precision, [np.zeros(8, dtype=bool)], loaded)
    assert moved[6] and change @ precision @ change + lost == pytest.approx(evidence(change, covariance, moved))


def test_motion_widens_the_noise_of_swept_readings_and_counts_frames_that_it_exceeds() -> None:
    scene = Scene(Panel(2, 2), TwoPointReadout())
    value = np.full((4, 2, 2), 600.0)
    value[2] += 40.0  # a load that comes in the third frame and presses a little more in the last
    value[3] += 44.0
    nothing = np.zeros(value.shape)
    readings = Readings(value, nothing + 4.0, nothing, nothing + 1)
    seen = NoiseEstimate(nothing.astype(bool), 0.0, (), readings)
    measured = np.arange(1, 4)
    moved = 0.5 * largest_change_within_scan(scene, readings, measured)
    widened = seen.with_motion(scene, 0.5, measured)
    np.testing.assert_allclose(widened.readings.sigma, np.hypot(4.0, moved))
    exceeded = int(np.sum(np.sqrt(np.mean(moved**2, axis=(1, 2))) > 4.0))
    assert exceeded == 2 and "in 2 frames" in widened.sentence
    assert moved[3].any() and seen.with_motion(scene, 0.0, measured) is seen


def test_absolute_losses_are_smoothed_by_the_root_of_squares_less_its_width() -> None:
    scene, cells = Scene(Panel(3, 3), TwoPointReadout()), np.linspace(900.0, 1300.0, 9).reshape(1, 3, 3)
    estimator = Estimator((Misfit(), TotalVariation(weight=2.0)), "reduced")
    data = estimator.data(Readings.of(scene, two_point_resistance(1.1 * cells)), Background(scene))
    at = Evaluation.at(estimator.cost(scene, 1, partial=data.partial), data, cells)
    width = 0.01
    smoothed = np.sum(2.0 * (np.sqrt(at.nonsmooth**2 + width**2) - width))
    assert Smoothing(width, np.zeros(len(at.nonsmooth))).objective(at) == pytest.approx(
        at.costs[0] + smoothed, rel=1e-12
    )
    plain = Evaluation.at(Estimator((Misfit(),), "reduced").cost(scene, 1, partial=data.partial), data, cells)
    assert Smoothing(width, np.zeros(0)).objective(plain) == plain.objective


@pytest.mark.parametrize(("deviations", "matters"), [(1.2, True), (0.8, False)])
def test_a_bound_matters_where_a_reading_is_missed_by_more_than_its_noise(deviations: float, matters: bool) -> None:
    """A cell stands at its lower bound, 500 ohm below which the truth lies; σ is the misfit over `deviations`."""
    scene, truth = Scene(Panel(3, 3), TwoPointReadout()), np.full((3, 3), 1000.0)
    held = truth.copy()
    truth[1, 1] = 500.0
    value, nothing = two_point_resistance(truth), np.zeros((1, 3, 3))
    missed = np.abs(two_point_resistance(held) - value)
    readings = Readings(value[None], np.full((1, 3, 3), missed.max() / deviations), nothing, nothing + 1)
    estimator = Estimator((Misfit(),), "reduced", bounds=Bounds(lower=1000.0, upper="none"))
    data = estimator.data(readings, Background(scene))
    at = Evaluation.at(estimator.cost(scene, 1, partial=data.partial), data, held[None])
    assert bounds_matter(at, at.log_gradient(np.zeros(0)), np.zeros(0)) is matters
    assert not bounds_matter(at, -at.log_gradient(np.zeros(0)), np.zeros(0))  # no cell presses against a bound


@pytest.mark.parametrize("levels", [(900.0, 400.0), (400.0, 900.0)])
def test_a_resistance_in_series_is_smaller_than_every_reading_of_both_frames(levels: tuple[float, float]) -> None:
    recorded = np.repeat(levels, 2)[:, None, None] * np.ones((3, 3))
    rival = Rival(Scene(Panel(3, 3), TwoPointReadout(), 100.0), recorded, np.ones(recorded.shape))
    question = Question(rival, np.array([0, 1]), np.array([2, 3]), 1.0, np.arange(4))
    assert 0.9 * min(levels) < most_in_series(rival, question) < min(levels)


def test_a_point_keeps_its_solved_networks_and_solves_them_where_it_has_none() -> None:
    scene, cells = Scene(Panel(3, 3), TwoPointReadout()), np.linspace(900.0, 1300.0, 9).reshape(1, 3, 3)
    estimator = Estimator((Misfit(),), "reduced")
    data = estimator.data(Readings.of(scene, two_point_resistance(1.1 * cells)), Background(scene))
    at = Evaluation.at(estimator.cost(scene, 1, partial=data.partial), data, cells)
    assert at.networks is at.solved
    anew = Evaluation(at.cost, data, cells, at.reading, None)
    np.testing.assert_array_equal(anew.log_gradient(np.zeros(0)), at.log_gradient(np.zeros(0)))


def test_a_load_changes_within_its_frames_where_its_strongest_cell_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four frames, two under each load: of the first the strongest cell moves by a quarter, of the second another."""
    logarithm = np.full((4, 2, 3), 0.1)
    logarithm[:, 1, 2] = [-1.75, -2.25, -2.0, -2.0]
    logarithm[:, 0, 1] = [0.1, 0.1, 0.3, -0.3]
    sd = np.full((4, 2, 3), 0.04)
    sd[1] = 0.03
    estimates = SimpleNamespace(frame=np.arange(2, 6), film=None)
    monkeypatch.setattr("lampest.estimate.calibration.loads.reconstruct", lambda *_: estimates)
    monkeypatch.setattr("lampest.estimate.calibration.loads.log_change", lambda _: (logarithm, sd))
    recording: Any = SimpleNamespace(name="mine", role=np.arange(6))
    loads: list[Any] = [SimpleNamespace(frames=frames) for frames in ((2, 3), (4, 5))]
    mean, deviation, within = _answers(recording, loads)
    np.testing.assert_allclose(mean, (logarithm[::2] + logarithm[1::2]) / 2)
    np.testing.assert_allclose(deviation[:, 0, 0], [np.sqrt((0.04**2 + 0.03**2) / 2), 0.04])
    np.testing.assert_allclose(within, [0.25, 0])
    loads[0].frames = (2, 6)
    with pytest.raises(InputError, match="no frame 6, its frames are 0 to 5"):
        list(_answers(recording, loads))


def test_levels_have_the_false_alarms_that_they_state() -> None:
    """Of a normal distribution, on both sides; once in so many numbers."""

    def once_in(sigmas: float) -> float:
        return float(1 / (2 * norm.sf(sigmas)))

    assert once_in(levels.NOISE_REACH) == pytest.approx(370, rel=0.01)
    assert once_in(levels.UNUSUAL) == pytest.approx(15_000, rel=0.06)
    assert once_in(levels.SIGNIFICANT) == pytest.approx(1.7e6, rel=0.03)
    assert once_in(levels.OUTLIER_THRESHOLD) == pytest.approx(5e8, rel=0.02)
    assert once_in(levels.OUTLIER_THRESHOLD) / 2400 == pytest.approx(200_000, rel=0.06)
    assert pytest.approx(1 + 3 * np.sqrt(2 / 100), abs=0.03) == levels.MAX_MEAN_SQUARE
    assert (levels.SIGNIFICANCE, levels.FALSE_ALARM_RATE) == (1e-4, 0.01)
    assert norm.ppf(0.975) == levels.TWO_SIDED
    assert 1 / norm.ppf(0.75) == pytest.approx(levels.MAD_TO_SIGMA, abs=5e-5)
