"""The report's statistics against closed forms, brute force and constructed batches of which the answer is known."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from support import invented_case

from lampest.report.page.compared import (
    PREDICTION,
    Batch,
    Comparison,
    Interval,
    Standing,
    advise,
    block_length,
    comparison_of,
    mean_interval,
    picks,
    predicted,
)
from lampest.report.page.page import disagreements
from lampest.runs.results import CaseResult

SHAPE = (4, 3, 3)


def batch(*cases: CaseResult) -> Batch:
    return Batch.of(["results.h5"], cases)


def case_with(estimator: str, recording: str, error: float, milliseconds: float, **changes: Any) -> CaseResult:
    """A case whose cells all err by the factor exp(error)."""
    case = invented_case(estimator, recording, SHAPE)
    cells = case.truth * np.exp(error)
    times = np.full(SHAPE[0], milliseconds / 1e3)
    return dataclasses.replace(case, cell_resistance=cells, solve_time=times, **changes)


def cohort(recordings: int, **methods: tuple[Sequence[float], float]) -> Batch:
    """method → (error in every recording, ms)."""
    return batch(
        *(
            case_with(name, chr(ord("A") + number), errors[number], milliseconds)  # no two have the same readings
            for number in range(recordings)
            for name, (errors, milliseconds) in methods.items()
        )
    )


def test_bootstrap_intervals_of_a_mean_hold_it() -> None:
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(400):
        values = rng.standard_normal(30)
        interval = mean_interval(values, picks(30, 1, rng))
        assert interval.value == pytest.approx(values.mean()) and interval.lower < interval.value < interval.upper
        held += interval.lower <= 0 <= interval.upper
    assert 0.90 <= held / 400 <= 0.97
    drawn = picks(10, 3, rng)  # blocks are neighbours, and every frame is drawn alike
    assert drawn.shape == (2000, 10) and np.all((drawn[:, 1:3] - drawn[:, :2]) % 10 == 1)
    assert np.all(np.abs(np.bincount(drawn.ravel(), minlength=10) / drawn.size - 0.1) < 0.01)


def test_blocks_widen_the_interval_of_frames_that_remember() -> None:
    """For x_t = 0.8 x_{t−1} + e the mean varies 1.8/0.2 = 9 times as much as that of independent frames."""
    rng = np.random.default_rng(3)
    alone, together, lengths = [], [], []
    for _ in range(40):
        noise = rng.standard_normal(400)
        series = np.zeros(400)
        for frame in range(1, 400):
            series[frame] = 0.8 * series[frame - 1] + noise[frame]
        lengths.append(block_length(np.stack([series, -series], axis=1)))
        blocks, single = (mean_interval(series, picks(400, length, rng)) for length in (30, 1))
        together.append(blocks.upper - blocks.lower)
        alone.append(single.upper - single.lower)
    assert 2.0 < np.mean(together) / np.mean(alone) < 3.2
    assert min(lengths) == 8  # 400^(1/3): the memory of 0.8 ends after five
    assert block_length(np.ones((30, 2))) == 4 and block_length(np.ones((1, 2))) == 1
    slow = np.sin(np.arange(300) / 40)
    assert 30 < block_length(np.stack([slow, -slow], axis=1)) <= 100


def compared(results: Batch) -> Comparison | None:
    return comparison_of(results, np.random.default_rng(0))


def with_change(estimator: str, change: float, below: float, above: float) -> CaseResult:
    case = invented_case(estimator, shape=SHAPE)
    values = np.full(SHAPE, change)
    ends = {"relative_change_lower": values - below, "relative_change_upper": values + above}
    return dataclasses.replace(case, relative_change=values, **ends)


def test_estimates_differ_where_their_joint_interval_excludes_zero() -> None:
    """Two normal errors of 3 and 4: the difference has 5. Unequal arms: those that face each other count."""
    for change, told in ((1.96 * 5 + 0.01, True), (1.96 * 5 - 0.01, False)):
        pair = disagreements([with_change("A", change, 1.96 * 3, 1.96 * 3), with_change("B", 0.0, 1.96 * 4, 1.96 * 4)])
        assert np.all(np.isfinite(pair[0].significant) == told) and pair[0].share == 100 * told
    facing = [with_change("A", 6.0, 3.0, 1e6), with_change("B", 0.0, 1e6, 4.0)]
    assert disagreements(facing)[0].share == 100 and disagreements(facing[::-1])[0].share == 100
    assert np.all(disagreements(facing[::-1])[0].significant == -6)
    assert disagreements([with_change("A", 6.0, 3.0, np.inf), with_change("B", 0.0, 1.0, np.inf)])[0].share == 0
    assert disagreements([invented_case("A"), with_change("B", 0.0, 1.0, 1.0)]) == ()


def test_prediction_error_is_what_fresh_readings_deviate_by() -> None:
    """Shrunk readings, model = s·y: E|fresh − model|² = 1 + s² + (1 − s)²·signal, in units of the noise."""
    rng = np.random.default_rng(5)
    shape = (400, 5, 5)
    signal = 0.7 * rng.standard_normal(shape) + 50
    readings, fresh = (signal + rng.standard_normal(shape) for _ in range(2))
    case = invented_case(shape=shape, truth=False)
    for share in (0.2, 0.5, 1.0):
        model = 50 + share * (readings - 50)
        known = dataclasses.replace(
            case, measured=readings, sigma=np.ones(shape), reading_model=model, resolution=np.full(shape, share)
        )
        expected = 1 + share**2 + (1 - share) ** 2 * 0.49
        assert np.mean(predicted(known)) == pytest.approx(expected, rel=0.03)
        assert np.mean((fresh - model) ** 2) == pytest.approx(expected, rel=0.03)


def test_the_fastest_of_those_without_a_practical_difference_is_recommended() -> None:
    rng = np.random.default_rng(6)
    hard = 0.02 + 0.01 * rng.random(30)
    near = hard + 0.002 * rng.standard_normal(30)
    near += 0.0002 - np.mean(near - hard)
    given = {"best": (hard, 8.0), "near": (near, 2.0), "far": (hard + 0.01, 0.5)}
    comparison = compared(cohort(30, **given))
    assert [row.estimator for row in comparison.standings] == ["best", "near", "far"]
    assert [row.told_apart for row in comparison.standings] == [False, False, True]
    assert comparison.standings[2].difference.value == pytest.approx(1.0)
    assert comparison.standings[2].wins == 0
    assert sum(row.wins for row in comparison.standings) == 30
    advice = advise(cohort(30, **given), comparison)
    alike = "No practical difference between best and near; near (gradient λ = 0.5) is the fastest of them."
    assert advice.headline == alike
    assert "near takes 2.0 ms a frame, best 8.0 ms." in advice.reasons and not advice.warnings
    given["near"] = (near, 7.5)
    slow = cohort(30, **given)
    assert advise(slow, compared(slow)).estimator == "best"


def test_speed_makes_up_for_no_error_and_a_sure_trifle_decides_nothing() -> None:
    """Twice the error for half the time, not sure in five recordings; and a thousandth that is sure in all."""
    twice = cohort(5, slow=([0.01, 0.02, 0.01, 0.02, 0.01], 8.0), fast=([0.09, 0.01, 0.01, 0.02, 0.01], 4.0))
    comparison = compared(twice)
    assert not comparison.standings[1].told_apart
    advice, sentence = (
        advise(twice, comparison),
        "The difference between fast and slow is not significant (95 % interval ",
    )
    assert advice.estimator == "slow" and sentence in " ".join(advice.reasons)
    hard = 0.02 + 0.001 * np.arange(30)
    trifle = cohort(30, one=(hard, 4.0), other=(hard * 1.001, 4.0))
    comparison = compared(trifle)
    assert comparison.standings[1].told_apart
    assert Standing("wide", Interval(2.0, 1.0, 3.0), Interval(1.5, 0.5, 2.5), 0, 1.0).told_apart
    assert advise(trifle, comparison).headline.startswith("No practical difference between one and other")


def test_without_truth_the_prediction_decides_and_without_noise_nothing_does() -> None:
    def case(name: str, recording: str, misfit: float, resolution: float) -> CaseResult:
        plain = invented_case(name, recording, SHAPE, truth=False)
        sigma = 0.01 * plain.measured
        model = plain.measured + misfit * sigma
        return dataclasses.replace(plain, sigma=sigma, reading_model=model, resolution=np.full(SHAPE, resolution))

    given = (("follows all", 0.0, 1.0), ("right", 0.8, 0.3), ("too stiff", 3.0, 0.05))
    known = batch(*(case(*method[:1], f"r{number}", *method[1:]) for number in range(6) for method in given))
    comparison = compared(known)
    assert comparison.criterion is PREDICTION
    assert [row.estimator for row in comparison.standings] == ["right", "follows all", "too stiff"]
    assert advise(known, comparison).estimator == "right"
    bare = batch(*(invented_case(name, "r", SHAPE, truth=False) for name in ("A", "B")))
    untold = advise(bare, compared(bare))
    assert untold.estimator is None and "cannot rank" in untold.headline
