"""Formulas of changed cells, motion, smoothed losses and series resistances, against their plain statements."""

from dataclasses import replace
from functools import cached_property
from itertools import product
from pathlib import Path
from threading import RLock
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
    TwoPointReadout,
    two_point_resistance,
)
from lampest.cost.given import Background, Given
from lampest.cost.problem import Evaluation
from lampest.estimate.calibration.loads import _answers
from lampest.estimate.calibration.trials import known_resistors
from lampest.estimate.changed_cells import MOVED_COST, scores_with_errors, select_changed, usual_starts
from lampest.estimate.model_check import Question, most_in_series
from lampest.estimate.rivals import Rival
from lampest.files import levels
from lampest.panel import compiled
from lampest.panel.panel import Array
from lampest.posterior import track
from lampest.posterior.covariance import SampledErrors, swept
from lampest.recording.recording import MEASURED, UNLOADED
from lampest.solvers.bounds import bounds_matter, lower_along

ROLE = np.array([UNLOADED, UNLOADED, MEASURED, MEASURED], dtype=np.uint8)


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
    question = Question(rival, ROLE, np.array([0, 1]), np.array([2, 3]), 1.0, np.arange(4))
    assert 0.9 * min(levels) < most_in_series(rival, question) < min(levels)
    assert question.loaded == "frames 2 to 3"
    assert replace(question, standing=np.array([3]), named=np.arange(10, 14)).loaded == "frame 13"


def test_a_circuit_explains_means_of_widened_readings_that_noise_leaves_nearly_gaussian() -> None:
    recorded, sigma = np.repeat([900.0, 800.0], 2)[:, None, None] * np.ones((3, 3)), np.full((3, 3), 2.0)
    sigma[1, 2] = 600.0
    rival = Rival(Scene(Panel(3, 3), TwoPointReadout(), 100.0), recorded, sigma)
    resting, loaded = Question(rival, ROLE, np.array([0, 1]), np.array([2, 3]), 3.0, np.arange(4)).readings(rival)
    usable = np.ones((3, 3))
    usable[1, 2] = 0.0
    for readings, value in ((resting, 800.0), (loaded, 700.0)):
        np.testing.assert_array_equal(readings.seen, usable)
        np.testing.assert_allclose(readings.value[usable > 0], value)
        np.testing.assert_allclose(readings.sigma[usable > 0], 3.0 * 2.0 / np.sqrt(2))
    assert len(Question(rival, ROLE, np.arange(4), np.arange(0), 3.0, np.arange(4)).readings(rival)) == 1


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


def test_a_lower_cost_is_looked_for_forth_and_back_along_a_direction_from_far_to_near(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, cells = Scene(Panel(3, 3), TwoPointReadout()), np.full((1, 3, 3), 1000.0)
    estimator = Estimator((Misfit(),), "reduced")
    data = estimator.data(Readings.of(scene, two_point_resistance(1.1 * cells)), Background(scene))
    at = Evaluation.at(estimator.cost(scene, 1, partial=data.partial), data, cells)
    steps, along = list[Array](), np.linspace(-4.0, 2.0, 9)
    with monkeypatch.context() as patch:
        patch.setattr("lampest.solvers.bounds.moved_by", lambda _, step: steps.append(step))
        assert lower_along(at, along) is None
    lengths = [1.0, -1.0, 0.3, -0.3, 0.1, -0.1, 0.03, -0.03, 0.01, -0.01]
    np.testing.assert_allclose(steps, np.multiply.outer(lengths, along / 4))
    steps.clear()
    lower = lower_along(at, -np.ones(9))
    assert lower is not None and lower.objective < at.objective
    np.testing.assert_allclose(lower.cell_resistance, 1000.0 * np.exp(0.1))


def test_profiles_are_of_three_missing_cells_that_are_free_where_matrices_are_at_hand(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Cells 1, 2, 4 and 5 of a pair were not read; 1 stands at a bound, and 5 is one too many. Tangents move by 1."""
    readings: Any = SimpleNamespace(value=np.zeros((2, 3)))
    model: Any = SimpleNamespace(free=np.array([6, 8, 10, 11]), at=SimpleNamespace(cell_resistance=np.zeros((2, 2, 3))))
    errors: Any = SimpleNamespace(model=model)
    missing = np.array([[False, True, True], [False, True, True]])
    monkeypatch.setattr(track, "errors_of", lambda model, memory: errors)
    monkeypatch.setattr(track, "tangent", lambda errors, cell: np.eye(12)[cell])
    ends = {-1: -3.0, 1: 2.0}
    monkeypatch.setattr(track, "profile_end", lambda errors, cell, side: ends[side] * np.eye(12)[cell])
    below, above = track.beyond_tangents(model, readings, missing, None)
    np.testing.assert_allclose(below, 8.0 * np.array([[0, 0, 1], [0, 1, 0]]))
    np.testing.assert_allclose(above, 3.0 * np.array([[0, 0, 1], [0, 1, 0]]))
    errors = object.__new__(SampledErrors)
    assert not np.any(track.beyond_tangents(model, readings, missing, None))


def test_readings_that_are_all_values_are_told_to_a_cost_without_sides() -> None:
    declared = {name: (one.absent, one.per_frame, one.partial) for name, one in Given.sources().items()}
    assert declared == {
        "measured": (1.0, True, False),
        "sigma": (1.0, True, False),
        "side": (0.0, True, True),
        "seen": (1.0, True, True),
        "previous": (1.0, False, False),
        "baseline": (1.0, False, False),
        "previous_deviation": (0.0, False, False),
    }
    whole, partial = (dict(Given.symbols(4, 2, partial=partial).named()) for partial in (False, True))
    assert partial.keys() - whole.keys() == {"side", "seen"}
    assert {name: symbol.shape for name, symbol in partial.items()} == {
        name: (4, 2 if per_frame else 1) for name, (_, per_frame, _) in declared.items()
    }


def test_known_resistors_are_a_number_or_a_table_with_gaps(tmp_path: Path) -> None:
    panel, table = Panel(2, 3), tmp_path / "known.csv"
    np.testing.assert_array_equal(known_resistors("120.5", panel), np.full((2, 3), 120.5))
    table.write_text("1,2.5,inf\n,nan,6\n", encoding="utf-8-sig")
    expected = [[1, 2.5, np.inf], [np.nan, np.nan, 6]]
    np.testing.assert_array_equal(known_resistors(str(table), panel), expected)
    np.save(tmp_path / "known.npy", expected)
    np.testing.assert_array_equal(known_resistors(str(tmp_path / "known.npy"), panel), expected)
    table.write_text("1,2,3\n")
    with pytest.raises(InputError, match="the panel has 2 × 3 cells, but the table holds 1 × 3 numbers"):
        known_resistors(str(table), panel)
    np.save(tmp_path / "known.npy", np.full((2, 3), "ten"))
    with pytest.raises(InputError, match="but the table holds 2 × 3 numbers"):
        known_resistors(str(tmp_path / "known.npy"), panel)


def test_locks_of_cached_properties_are_new_in_a_forked_child_and_others_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """A property's lock would be held there for ever by a thread of the parent; the module's own is free again."""
    held = RLock()
    waiting: Any = cached_property(len)
    waiting.lock = held
    bare: Any = cached_property(len)
    vars(bare).pop("lock", None)
    own = SimpleNamespace(lock=held)
    module = SimpleNamespace(Owner=type("Owner", (), {"waiting": waiting, "bare": bare, "own": own}), number=1)
    modules = {"lampest.mine": module, "others.mine": SimpleNamespace(Other=type("Other", (), {"waiting": "no lock"}))}
    monkeypatch.setattr(compiled.sys, "modules", modules)
    lock = RLock()
    monkeypatch.setattr(compiled, "_LOCK", lock)
    lock.acquire()
    compiled._unlock_child()
    assert waiting.lock is not held and own.lock is held and not hasattr(bare, "lock")
    with pytest.raises(RuntimeError, match="cannot release un-acquired lock"):
        lock.release()


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


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_table_swept_by_all_its_places_is_the_inverse_and_the_solution(order: str) -> None:
    rng = np.random.default_rng(4)
    root, right = rng.standard_normal((5, 5)), rng.standard_normal(5)
    matrix = root @ root.T + np.eye(5)
    table = np.array(np.column_stack([matrix, right]), order=order)
    for place in range(5):
        table = swept(table, place)
    np.testing.assert_allclose(table[:, :5], -np.linalg.inv(matrix), rtol=1e-9)
    np.testing.assert_allclose(table[:, 5], np.linalg.solve(matrix, right), rtol=1e-9)
