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
from scipy import sparse
from scipy.stats import norm

from lampest import (
    Bounds,
    Estimator,
    InputError,
    Misfit,
    Panel,
    Readings,
    Scene,
    TableResponse,
    TwoPointReadout,
    Water,
    two_point_resistance,
)
from lampest.cost.given import Background, Given
from lampest.cost.losses import AnyLoss
from lampest.cost.problem import Evaluation
from lampest.estimate.calibration.loads import _answers
from lampest.estimate.calibration.trials import known_resistors
from lampest.estimate.changed_cells import MOVED_COST, scores_with_errors, select_changed, usual_starts
from lampest.estimate.estimates import barred_maps
from lampest.estimate.model_check import Question, most_in_series
from lampest.estimate.noise import NoiseEstimate, steps_within_scan
from lampest.estimate.outliers import _by_line, _by_median
from lampest.estimate.rivals import Rival
from lampest.files import levels
from lampest.files.typed import members_of
from lampest.loads.pressure import determined, total_force
from lampest.panel import compiled
from lampest.panel.panel import Array
from lampest.posterior import track
from lampest.posterior.covariance import DenseErrors, SampledErrors, swept
from lampest.posterior.linear import LinearModel
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


def test_motion_widens_the_noise_of_swept_readings_and_counts_frames_that_it_exceeds() -> None:
    scene = Scene(Panel(2, 2), TwoPointReadout())
    value = np.full((4, 2, 2), 600.0)
    value[2] += 40.0  # a load that comes in the third frame and presses a little more in the last
    value[3] += 44.0
    nothing = np.zeros(value.shape)
    readings = Readings(value, nothing + 4.0, nothing, nothing + 1)
    seen = NoiseEstimate(nothing.astype(bool), (), readings)
    measured = np.arange(1, 4)
    moved = np.abs(steps_within_scan(scene, readings, measured)).max(axis=0)
    widened = seen.with_motion(scene, measured)
    np.testing.assert_allclose(widened.readings.sigma, np.hypot(4.0, moved))
    exceeded = int(np.sum(np.sqrt(np.mean(moved**2, axis=(1, 2))) > 4.0))
    assert exceeded == 2 and "in 2 frames" in widened.sentence
    assert moved[3].any() and widened.in_motion


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


def test_maps_of_error_bars_reach_as_far_as_those_of_each_frame_and_nowhere_where_it_has_none() -> None:
    cells, baseline = np.array([[[2.0, 6.0]], [[4.0, 8.0]]]), np.array([[4.0, 4.0]])
    own = {
        "deviation": 0.1,
        "below": 0.2,
        "above": 0.3,
        "resolution": 0.4,
        "data_share": 0.5,
        "own": 0.6,
        "common": 0.7,
    }
    change = {name: 2 * number for name, number in own.items()}
    frame, changed = (
        SimpleNamespace(**{name: np.full((1, 2), number) for name, number in one.items()}) for one in (own, change)
    )
    steps: Any = (SimpleNamespace(bars=SimpleNamespace(frame=frame, change=changed)), SimpleNamespace(bars=None))
    maps, ratio = barred_maps(cells, baseline, steps), np.array([[0.5, 1.5]])
    first = {
        "cell_resistance_errors": 0.1 * cells[0],
        "cell_resistance_lower": np.exp(-0.2) * cells[0],
        "cell_resistance_upper": np.exp(0.3) * cells[0],
        "relative_change_errors": 20.0 * ratio,
        "relative_change_lower": 100 * (np.exp(-0.4) * ratio - 1),
        "relative_change_upper": 100 * (np.exp(0.6) * ratio - 1),
        "ratio_lower": np.exp(-0.4) * ratio,
        "ratio_upper": np.exp(0.6) * ratio,
        "resolution": 0.4,
        "data_share": 0.5,
        "sigma_own": 0.6,
        "sigma_common": 0.7,
        "change_own": 1.2,
    }
    assert maps.keys() == first.keys()
    ends = {name: 0.0 for name in first if name.endswith("_lower") or name in ("resolution", "data_share")}
    for name, values in maps.items():
        np.testing.assert_allclose(values[0], np.broadcast_to(first[name], (1, 2)), err_msg=name)
        np.testing.assert_allclose(
            values[1], {"relative_change_lower": -100.0}.get(name, ends.get(name, np.inf)), err_msg=name
        )
    cells[0, 0, 1] = np.nan
    assert all(
        np.isnan(values[0, 0]).tolist() == [False, True] for values in barred_maps(cells, baseline, steps).values()
    )


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


@pytest.mark.parametrize("offsets", [(-2, -1, 1, 2), (1, 2, 3, 4), (-3, -2, -1, 1)])
def test_neighbours_in_time_predict_a_reading_by_their_median_and_by_their_line(offsets: tuple[int, ...]) -> None:
    """By least squares, with twice the deviation of the line's prediction; and by the efficiency of a median."""
    beside, offset = np.random.default_rng(4).normal(5.0, 1.0, (4, 1, 2, 2)), np.array(offsets)[:, None]
    predicted, spread, noise = _by_line(beside, offset)
    median, scatter, of_median = _by_median(beside, offset)
    design = np.stack([np.ones(4), offset[:, 0]], axis=1)
    for place in np.ndindex(2, 2):
        values = beside[:, 0, *place]
        (height, _), left, *_ = np.linalg.lstsq(design, values, rcond=None)
        error = np.sqrt(1 + np.linalg.inv(design.T @ design)[0, 0])
        assert predicted[0][place] == pytest.approx(height) and noise[0][place] == pytest.approx(error)
        assert spread[0][place] == pytest.approx(2 * np.sqrt(left[0] / 2) * error)
        assert median[0][place] == np.median(values)
        assert scatter[0][place] == pytest.approx(1.4826 * np.median(np.abs(values - np.median(values))), rel=1e-4)
        assert of_median[0][place] == pytest.approx(np.sqrt(1 + np.pi / 8))


def test_pressures_end_with_the_response_that_is_known_and_have_no_errors_there() -> None:
    panel, film = Panel(2, 2), TableResponse(pressure_kpa=(0.0, 5.0), resistance_ohm=(3000.0, 900.0))
    pressure, own = np.array([[1.0, 4.9], [5.0, 7.0]]), np.array([[0.1, 0.2], [0.3, 0.4]])
    scene = Scene(panel, TwoPointReadout(), response=film)
    known = [[1.0, 4.9], [5.0, 5.0]], [[0.1, 0.2], [0.0, 0.0]], [[0.2, 0.4], [0.0, 0.0]]
    np.testing.assert_allclose(determined(scene, pressure, own, 2 * own), known)
    np.testing.assert_array_equal(determined(Scene(panel), pressure, own), [pressure, own])
    under = replace(scene, water=Water(200.0))
    depth = 1e-6 * 1000 * 9.81 * np.array([[200.0, 200.0], [210.0, 210.0]])
    ((last,), (below,)) = (part[1:, 1] for part in determined(under, pressure, own))
    assert last == pytest.approx(5 - depth[1, 1], rel=1e-3) and below == 0


def test_a_force_adds_pressures_up_whose_common_errors_move_together() -> None:
    scene = Scene(Panel(2, 2, pitch_mm=20.0), TwoPointReadout())
    pressure, own, common = np.array([[1.0, 2.0], [3.0, -4.0]]), np.full((2, 2), 0.3), np.full((2, 2), 0.1)
    load: Any = SimpleNamespace(
        pressure=pressure, own=own, common=common, pressing=pressure > 0, saturated=pressure > 2
    )
    force = total_force(scene, load)
    assert force.newton == pytest.approx(0.4 * 6.0) and force.saturated == 1
    assert force.deviation == pytest.approx(0.4 * np.hypot(np.sqrt(3) * 0.3, 3 * 0.1))


def test_penalties_are_as_wide_as_their_residuals_say_without_the_share_of_the_frame_before() -> None:
    """Residuals beside a cell that was not read are as wide as the largest other one of their term, and no evidence."""
    term, squares = np.array([0, 0, 0, 1, 1]), np.array([4.0, 1.0, 9.0, 0.5, 2.0])
    jacobian = sparse.csc_array([[1.0, 0.0], [0.0, 2.0], [1.0, 0.0], [0.5, 0.0], [0.0, 2.0]])
    terms = [SimpleNamespace(weighs_previous=weighs) for weighs in (False, True)]
    at = SimpleNamespace(cost=SimpleNamespace(terms=terms))
    unread = np.zeros(5, dtype=bool)
    model: Any = SimpleNamespace(
        penalty_term=term, penalty_squares=squares, known_jacobians=[jacobian], at=at, unread_rows=unread
    )
    model.known_share = lambda variance: LinearModel.known_share(model, variance)
    determined = {0: 7.0, 1: 0.2}
    for variance, shares in ((None, [0, 0, 0, 0, 0]), (np.array([0.4, 0.9]), [0, 0, 0, 0.1, 1.0])):
        before = None if variance is None else SimpleNamespace(variance=lambda variance=variance: variance)
        errors = SimpleNamespace(model=model, before=before, determined=determined.get)
        widening = DenseErrors.__dict__["widening"].func(errors)
        np.testing.assert_allclose(widening, np.subtract([4.0, 2.0, 9.0, 2.5, 2.5], shares))
    unread[1], errors.before, squares[2] = True, None, 90.0
    widening = DenseErrors.__dict__["widening"].func(errors)
    np.testing.assert_allclose(widening, [95 / 7, 90 / 1.959964**2, 90.0, 2.5, 2.5], rtol=1e-6)


def test_squares_alone_are_called_squares() -> None:
    assert {kind.__name__: kind.squared for kind in members_of(AnyLoss)} == {
        "Squared": True,
        "Huber": False,
        "Absolute": False,
        "Student": False,
    }


def test_sizes_of_what_a_frame_shares_are_those_of_a_usual_reading() -> None:
    """The gain in percent; ripples as the root of the mean square over all readings, in steps of the converter."""
    sizes: Any = NoiseEstimate.__dict__["shared_sizes"].fget
    assert sizes(SimpleNamespace(frame=None)) == (0.0, 0.0, 0.0)
    circuit = SimpleNamespace(lsb_volt=0.5)
    roots = {"common_ripple": np.array([[3.0], [4.0]]), "line_ripple": np.array([[1.0, 0.0], [2.0, 2.0]])}
    frame = SimpleNamespace(gain=0.02, scene=SimpleNamespace(circuit=circuit), **roots)
    assert sizes(SimpleNamespace(frame=frame)) == pytest.approx((2.0, np.sqrt(12.5) / 0.5, np.sqrt(4.5) / 0.5))


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
