"""Whether suction is pumped up again: courses of suction whose cause is known."""

import numpy as np
import pytest

from lampest.loads.recognition.pumping import BLOCK_S, MIN_LOG_ODDS, Pumping
from lampest.panel.panel import Array

TIMES = np.arange(0, 480, BLOCK_S)


def followed(suction: Array, noise: float = 0.02, seed: int = 0) -> Array:
    """ln odds after each sample of a relative change of suction, from a panel of one reading."""
    rng = np.random.default_rng([seed, 7])
    track, odds = Pumping.begin(np.ones(1), np.zeros(1), -BLOCK_S, 0), list[float]()
    for time, value in zip(TIMES, suction + noise * rng.standard_normal(len(suction)), strict=True):
        track = track.after(np.full((3, 1), value), float(time))
        odds.append(track.odds)
    return np.array(odds)


def pumped(period_s: float, loss: float) -> Array:
    return np.asarray((1 - loss) ** (np.mod(TIMES, period_s) / period_s) - 1)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("period_s", "loss"), [(25.0, 0.2), (60.0, 0.15), (60.0, 0.4), (90.0, 0.3)])
def test_suction_that_decays_and_is_pumped_up_is_alive(period_s: float, loss: float, seed: int) -> None:
    """Within five pumps, the published intervals: 20 to 200 s."""
    odds = followed(pumped(period_s, loss), seed=seed)
    assert np.max(odds) > np.log(9), "nine in ten is the answer's level"
    assert TIMES[np.argmax(odds > np.log(9))] < 5.5 * period_s


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "course",
    [
        np.zeros(len(TIMES)),
        np.exp(-TIMES / 120) - 1,
        0.05 * np.log10(1 + TIMES),
        0.1 * np.sin(2 * np.pi * TIMES / 47),
        np.where(TIMES > 300, 0.3, 0.0),
        np.where(TIMES > 300, -0.3, 0.0),
        0.3 * (TIMES > 200) * (TIMES < 330),
    ],
    ids=["still", "leaks", "creeps", "aliased breath", "pressed once", "bumped once", "pressed and let go"],
)
def test_a_cup_that_leaks_creeps_or_is_touched_is_not(course: Array, seed: int) -> None:
    odds = followed(course, seed=seed)
    assert np.max(odds) < np.log(9) and odds[-1] < 0.5


@pytest.mark.slow
def test_rare_and_frequent_bumps_of_either_sign_are_none() -> None:
    """At one in a minute and one in twenty seconds; two of twenty courses may pass the level by chance."""
    passed = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        for count in (10, 30):
            at, size = rng.uniform(0, TIMES[-1], count), rng.normal(0, 0.2, count)
            passed.append(followed(size @ (at[:, None] <= TIMES), seed=seed)[-1] > np.log(9))
    assert np.mean(passed) <= 0.1


def test_a_mouth_that_rested_is_known_again_within_minutes() -> None:
    long = Pumping.begin(np.ones(1), np.zeros(1), -BLOCK_S, 0)
    for number in range(400):  # twenty minutes
        long = long.after(np.full((3, 1), 0.001 * (-1) ** number), number * BLOCK_S)
    assert long.odds < -1 and long.logarithm.size < 10_000, "absence is no more evidence than some minutes of it"
    began = long.since_s
    for number in range(1, 100):
        value = float(pumped(45.0, 0.3)[number])
        long = long.after(np.full((3, 1), value), began + number * BLOCK_S)
    assert long.odds > np.log(9) > MIN_LOG_ODDS


def test_what_was_learned_stays_when_a_mouth_has_moved() -> None:
    track = Pumping.begin(np.ones(1), np.zeros(1), -BLOCK_S, 0)
    for time, value in zip(TIMES[:100], pumped(45.0, 0.3), strict=False):
        track = track.after(np.full((3, 1), value), float(time))
    again = Pumping.begin(np.ones(2), np.zeros(2), 300.0, 1, track)
    assert again.odds == pytest.approx(track.odds) and again.odds > np.log(9)
