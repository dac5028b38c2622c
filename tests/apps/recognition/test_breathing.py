"""Breathing: recognition of swings of suction, and of swings with another cause.

Every reading of these windows and courses of suction is known.
"""

from dataclasses import replace

import numpy as np
import pytest

from lampest.apps.recognition.breath import Breath, breath
from lampest.apps.recognition.breathing import Breathing
from lampest.apps.recognition.hypotheses import SILENT_LOG_ODDS
from lampest.apps.recognition.pumping import BLOCK_S, MIN_LOG_ODDS, Pumping
from lampest.apps.recognition.steady_frames import SteadyFrames, settled
from lampest.apps.recognition.swings import Patterns, adjoin
from lampest.panel.panel import Array, Panel

TIMES = np.arange(0, 8, 0.25)
READINGS = 40
BLOCKS = np.arange(0, 480, BLOCK_S)
ANSWER_LOG_ODDS = np.log(9)  # nine in ten is the level of an answer
CLEAR_LOG_ODDS = 3.0  # twenty to one


def window(
    own: float = 0.0,
    rim: float = 0.0,
    place: float = 0.0,
    edges: float = 0.0,
    seed: int = 0,
    uneven: float = 0.1,
    slower: float = 1.0,
    wanders: float = 0.0,
    waves: float = 0.0,
    wild: bool = False,
    strong: float = 1.0,
    body: float | None = None,
) -> Breath:
    """Return the breath in 8 s at four frames a second, whose parts swing at 1.1 Hz.

    Each reading is that of a cell; half of the cells lie under the rim.

    Parameters
    ----------
    own, rim, place : float
        Swings of suction, rim and place.
    edges : float
        Swing of six cells that no fit predicts.
    uneven : float
        Scatter of the film's answer.
    slower : float
        Factor by which the place swings more slowly.
    wanders : float
        Largest relative deviation of the rates, which sway once in the window.
    waves : float
        Swing that all readings share.
    wild : bool
        Whether there are outliers of fifty standard deviations.
    strong : float
        Factor of the readings' change with suction.
    body : float or None
        Swing of a body that adjoins the load; None where there is no body.
    """
    rng = np.random.default_rng(seed)
    rise = np.repeat([-2.0, 1.0], READINGS // 2)
    slopes = strong * np.where(rise < 0, -300.0, 90.0)
    moves = 8 * rng.standard_normal((1, READINGS))
    film = 0.9 + uneven * rng.standard_normal(READINGS)  # it has a hysteresis of a tenth
    sway = 8 / (2 * np.pi) * (1 - np.cos(2 * np.pi * TIMES / 8))
    swinging = [np.sin(2 * np.pi * 1.1 * (TIMES + wanders * sway) / by) for by in (1.0, slower)]
    swings = film * slopes * (own + rim * (rise < 0)), film * place * moves[0]
    swings[0][rng.permutation(READINGS)[:6]] += edges * 60 * rng.choice([-1, 1], 6)
    changes = sum(np.outer(wave, swing) for wave, swing in zip(swinging, swings, strict=True))
    changes = changes + rng.standard_normal((len(TIMES), READINGS))
    supply = rng.standard_normal((READINGS, 1)) + 3
    changes = changes + waves * np.outer(swinging[0], film * supply[:, 0])
    changes += wild * 50 * (rng.random(changes.shape) < 0.003)
    spread = 0.2 * np.abs(slopes)
    bodies = rng.standard_normal((READINGS, int(body is not None)))
    changes += (body or 0.0) * np.outer(swinging[0], bodies.sum(axis=1))
    others = np.hstack([supply, bodies])
    known = Patterns.of(np.eye(READINGS), rise, slopes[None], spread, moves, others)
    known = known._replace(adjoining=bodies)
    return breath(SteadyFrames.of(TIMES, changes), settled(changes), known)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("uneven", [0.0, 0.1, 0.25])
def test_suction_swinging_with_its_rim_is_breath_on_any_film(seed: int, uneven: float) -> None:
    shown = window(own=0.08, seed=seed, uneven=uneven)
    assert shown.odds > CLEAR_LOG_ODDS and shown.suction > 0.95
    assert shown.hertz[0] == pytest.approx(1.1, abs=0.05)
    assert abs(shown.depth[0] - 0.08) < 2.5 * shown.depth[1] < 0.05


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "moving",
    [
        {"rim": 0.08},
        {"place": 2.0},
        {"rim": 0.04, "place": 2.0},
        {"own": 0.04, "place": 4.0, "slower": 2.0},
        {"edges": 1.0},
    ],
    ids=str,
)
def test_a_swinging_rim_or_place_is_not_breath(seed: int, moving: dict[str, float]) -> None:
    # The last one as the square of a movement that is half as fast.
    shown = window(**moving, seed=seed)
    assert shown.odds < 0 or shown.suction < 0.1


@pytest.mark.parametrize("uneven", [0.1, 0.25])
def test_the_depth_of_breath_lies_within_its_error(uneven: float) -> None:
    """The rim may swing by less than its pattern, as on a film that it saturates."""
    depths = [
        window(own=0.08, rim=rim, seed=seed, uneven=uneven).depth
        for rim in (0.0, -0.04)
        for seed in range(8)
    ]
    scores = np.array([(value - 0.08) / error for value, error in depths])
    assert np.abs(scores).max() < 3 and np.mean(np.abs(scores) < 1.96) >= 0.85
    assert np.median([error for _, error in depths]) < 0.03


@pytest.mark.parametrize("seed", range(3))
def test_waves_and_noise_are_not_breath_and_hide_none(seed: int) -> None:
    assert window(seed=seed).odds < 0 > window(waves=3.0, seed=seed).odds
    # Or outliers.
    for hiding in ({"own": 0.08, "waves": 3.0}, {"own": 0.05, "wild": True, "strong": 0.05}):
        shown = window(**hiding, seed=seed)
        assert shown.odds > CLEAR_LOG_ODDS and shown.suction > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_a_stronger_movement_at_another_rate_hides_no_breath(seed: int) -> None:
    """A current moves the load at 0.65 Hz; the suction swings at 1.1 Hz."""
    shown = window(own=0.05, place=2.0, slower=1.7, seed=seed)
    assert shown.odds > CLEAR_LOG_ODDS and shown.suction > 0.9
    assert shown.hertz[0] == pytest.approx(1.1, abs=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_a_breath_may_be_faster_and_slower_within_seconds(seed: int) -> None:
    shown = window(own=0.06, wanders=0.2, seed=seed)
    assert shown.odds > CLEAR_LOG_ODDS and shown.suction > 0.8


@pytest.mark.parametrize("seed", range(3))
def test_cells_that_swing_beside_a_load_are_not_its_breath_and_hide_none(seed: int) -> None:
    """They move readings that the load moves, too; a breath moves no others."""
    rng = np.random.default_rng(seed)
    rise = np.repeat([-2.0, 1.0], READINGS // 2)
    slopes = np.where(rise < 0, -300.0, 90.0)
    moves = 8 * rng.standard_normal((1, READINGS))
    load, beside = np.eye(2 * READINGS)[:, :READINGS], np.eye(2 * READINGS)[:, READINGS:]
    mixed = np.linalg.qr(rng.standard_normal((2 * READINGS, 2 * READINGS)))[0]
    supply = mixed @ np.ones((2 * READINGS, 1))
    known = Patterns.of(
        mixed @ load, rise, slopes[None], 0.2 * np.abs(slopes), moves, supply
    )._replace(beside=600 * mixed @ beside)
    wave = np.sin(2 * np.pi * 1.1 * TIMES)
    breathing = mixed @ load @ (0.05 * slopes)
    swings = 20 * rng.standard_normal(READINGS)
    beating = mixed @ beside @ (swings - swings.mean())
    alone, hidden = (
        breath(SteadyFrames.of(TIMES, changes), changes, known).probability
        for swing in (beating, breathing + beating)
        for changes in [np.outer(wave, swing) + rng.standard_normal((len(TIMES), 2 * READINGS))]
    )
    assert alone < 0.5 and hidden > 0.95


@pytest.mark.parametrize("seed", range(3))
def test_a_neighbouring_body_that_swings_makes_swings_of_the_rim_likelier(seed: int) -> None:
    """A swing of the whole suction remains a breath."""
    still, swinging = (
        shown.suction / (1 - shown.suction)
        for swing in (0.0, 20.0)
        for shown in [window(own=0.01, rim=0.02, body=swing, seed=seed)]
    )
    assert still > 5 * swinging
    assert window(own=0.08, body=20.0, seed=seed).suction > 0.95


def test_a_body_is_distinguished_from_cells_of_the_rim() -> None:
    panel = Panel(6, 6)
    load, rim, body, far = np.zeros((4, 6, 6), dtype=bool)
    load[1:3, 1:3] = rim[3, 1] = body[1, 4] = far[5, 5] = True
    beside = [adjoin(panel, some.ravel(), load.ravel()) for some in (rim, body, far, rim | body)]
    assert beside == [False, True, False, True]
    assert not adjoin(panel, np.zeros(36, dtype=bool), load.ravel())


def test_swings_within_a_pull_are_no_outliers() -> None:
    pull = 1.5 * ((TIMES > 2.5) & (TIMES < 5.5))
    swings = pull + 0.05 * np.sin(2 * np.pi * 1.1 * TIMES)
    inner = (TIMES > 3) & (TIMES < 5)
    np.testing.assert_allclose(settled(swings[:, None])[inner, 0], swings[inner], atol=0.01)


@pytest.mark.parametrize("hertz", [0.7, 1.1, 1.8])
def test_a_pull_that_no_step_shows_hides_no_breath(hertz: float) -> None:
    """It begins and ends within half a second, which is less than half of the load's change."""
    level = 0.8 * np.clip(2 * np.minimum(TIMES - 2.25, 5.25 - TIMES), 0, 1)
    shown = pulled_window(0.05 * (1 + level) * np.sin(2 * np.pi * hertz * TIMES), level)
    assert shown.odds > CLEAR_LOG_ODDS and shown.suction > 0.97
    assert shown.hertz[0] == pytest.approx(hertz, abs=0.1)


def test_a_pull_keeps_the_odds_of_earlier_windows() -> None:
    """A pull ends the window; without one, the longer window replaces the shorter."""
    shown, hidden = (Breath(odds, 1.0, (1.1, 0.1), (0.08, 0.01)) for odds in (8.0, -3.0))
    unpulled = Breathing().after(shown, 9.0, full=False)
    assert unpulled.parted((8.0,)) == unpulled
    assert unpulled.after(hidden, 12.0, full=False).probability < 0.2
    pulled = unpulled.parted((8.0, 10.0))
    assert pulled.full_s == 9.0 and pulled.after(hidden, 15.0, full=False).probability > 0.9


def test_odds_and_cause_of_a_window_count_together() -> None:
    """A load keeps still, and after a step its place swings; a step leaves it at that."""
    still, shaken = (
        Breath(odds, suction, (1.1, 0.1), (0.08, 0.01))
        for odds, suction in ((-3.0, 0.9), (8, 0.005))
    )
    stepped = Breathing().after(still, 6.0, full=False).parted((6.25,))
    swinging = stepped.after(shaken, 13.0, full=False)
    assert swinging.probability < 0.1 > swinging.parted((13.5,)).probability
    assert swinging.after(shaken, 14.0, full=True).probability < 0.1


def test_many_like_windows_are_little_surer_than_a_few() -> None:
    """A weak swing at the edge of the band, for a quarter of an hour, as a quiet cup has it."""
    weak = Breath(0.8, 0.93, (0.53, 0.03), (0.01, 0.003))
    clear = Breath(6.0, 0.97, (1.1, 0.1), (0.08, 0.01))
    few, many, mouth = Breathing(), Breathing(), Breathing()
    for number in range(112):
        many = many.after(weak, 8.0 * number, full=True)
        few = many if number == 3 else few
        mouth = mouth.after(clear, 8.0 * number, full=True)
    assert few.probability - 0.05 < many.probability < 0.85
    assert mouth.probability > 0.98


def test_a_clear_breath_is_lost_to_its_absence_alone() -> None:
    """Not to movements that hide it or to a pause, where it was certain before."""
    clear, moved = (Breath(9.0, suction, (1.1, 0.1), (0.08, 0.01)) for suction in (1 - 1e-6, 1e-6))
    still = Breath(-6.0, 0.9, (1.1, 0.1), (0.01, 0.005))
    certain, likely = Breathing(), Breathing().after(replace(clear, odds=4.0), 8.0, full=True)
    for number in range(3):
        certain = certain.after(clear, 8.0 * number, full=True)
    assert certain.probability > 0.99 > likely.probability > 0.9
    for number in range(3, 8):
        certain, likely = (
            breathing.after(moved, 8.0 * number, full=True) for breathing in (certain, likely)
        )
    assert certain.probability > 0.99 and likely.probability < 0.1
    for number in range(9, 12):
        paused, certain = certain, certain.after(still, 8.0 * number, full=True)
    assert certain.probability < 0.1 < 0.99 < paused.probability, "two windows may be a pause"


def test_a_mouth_that_breathes_again_is_recognised_within_half_a_minute() -> None:
    silent = Breath(-6.0, 0.9, (1.1, 0.1), (0.08, 0.01))
    clear = Breath(8.0, 0.99, (1.1, 0.1), (0.08, 0.01))
    breathing = Breathing()
    for number in range(100):
        breathing = breathing.after(silent, 8.0 * number, full=True)
    assert breathing.probability < 0.1
    for number in range(100, 103):
        breathing = breathing.after(clear, 8.0 * number, full=True)
    assert breathing.probability > 0.9


def test_a_single_incomplete_window_decides_no_cause() -> None:
    shown = Breath(8.0, 0.99, (1.1, 0.1), (0.08, 0.01))
    once = Breathing().after(shown, 5.0, full=False)
    assert 0.5 < once.probability < 0.9 < once.after(shown, 6.0, full=False).probability
    # nor a movement, after a full window with breath
    moved = replace(shown, suction=1e-6)
    breathing = Breathing().after(shown, 8.0, full=True).after(moved, 12.0, full=False)
    assert breathing.probability > 0.9 > 0.1 > breathing.after(moved, 13.0, full=False).probability


def pulled_window(swings: Array, level: Array, *steps: float) -> Breath:
    """8 s with these steps, s, in which suction and its rim change by these shares."""
    rng = np.random.default_rng(2)
    rise = np.repeat([-2.0, 1.0], READINGS // 2)
    slopes = np.where(rise < 0, -300.0, 90.0)
    moves = 8 * rng.standard_normal((1, READINGS))
    changes = np.outer(level + swings, slopes) + rng.standard_normal((len(TIMES), READINGS))
    known = Patterns.of(
        np.eye(READINGS), rise, slopes[None], 0.2 * np.abs(slopes), moves, np.ones((READINGS, 1))
    )
    interval, still = SteadyFrames.of(TIMES, changes).parted(steps)
    return breath(interval, changes[still], known)


def test_the_depth_of_breath_is_relative_to_the_pulled_suction() -> None:
    level = 1.5 * ((TIMES > 2.5) & (TIMES < 5.5))
    shown = pulled_window(0.05 * (1 + level) * np.sin(2 * np.pi * 1.1 * TIMES), level, 2.5, 5.25)
    assert shown.odds > CLEAR_LOG_ODDS and shown.depth[0] == pytest.approx(0.05, rel=0.2)


def test_part_of_a_window_suffices_to_detect_breath() -> None:
    """While a mouth pulls, it does not breathe steadily."""
    pull = TIMES > 3.75
    wild = 0.5 * pull * np.random.default_rng(5).standard_normal(len(TIMES))
    shown = pulled_window(
        np.where(pull, wild, 0.08 * np.sin(2 * np.pi * 1.1 * TIMES)), 0.0 * TIMES, 3.75
    )
    assert shown.odds > CLEAR_LOG_ODDS and shown.hertz[0] == pytest.approx(1.1, abs=0.15)


def followed(suction: Array, noise: float = 0.02, seed: int = 0) -> Array:
    """ln odds after each sample of a relative change of suction, from a panel of one reading."""
    rng = np.random.default_rng([seed, 7])
    track = Pumping.begin(np.ones(1), np.zeros(1), -BLOCK_S, 0)
    odds = list[float]()
    for time, value in zip(
        BLOCKS, suction + noise * rng.standard_normal(len(suction)), strict=True
    ):
        track = track.after(np.full((3, 1), value), float(time))
        odds.append(track.odds)
    return np.array(odds)


def pumped(period_s: float, loss: float) -> Array:
    return np.asarray((1 - loss) ** (np.mod(BLOCKS, period_s) / period_s) - 1)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("period_s", "loss"), [(25.0, 0.2), (60.0, 0.15), (60.0, 0.4), (90.0, 0.3)]
)
def test_decaying_and_pumped_suction_is_alive(period_s: float, loss: float, seed: int) -> None:
    """Within five pumps, the published intervals: 20 to 200 s."""
    odds = followed(pumped(period_s, loss), seed=seed)
    assert np.max(odds) > ANSWER_LOG_ODDS, "nine in ten is the answer's level"
    assert BLOCKS[np.argmax(odds > ANSWER_LOG_ODDS)] < 5.5 * period_s


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "course",
    [
        np.zeros(len(BLOCKS)),
        np.exp(-BLOCKS / 120) - 1,
        0.05 * np.log10(1 + BLOCKS),
        0.1 * np.sin(2 * np.pi * BLOCKS / 47),
        np.where(BLOCKS > 300, 0.3, 0.0),
        np.where(BLOCKS > 300, -0.3, 0.0),
        0.3 * (BLOCKS > 200) * (BLOCKS < 330),
    ],
    ids=[
        "still",
        "leaks",
        "creeps",
        "aliased breath",
        "pressed once",
        "bumped once",
        "pressed and let go",
    ],
)
def test_a_leaking_creeping_or_touched_cup_is_not_alive(course: Array, seed: int) -> None:
    odds = followed(course, seed=seed)
    assert np.max(odds) < ANSWER_LOG_ODDS and odds[-1] < 0.5


def test_pumps_alone_leave_one_cup_in_twenty() -> None:
    """A cup that somebody pushes on again and again decays and rises as a mouth does."""
    pressed = float(np.max(followed(pumped(45.0, 0.4))))
    assert ANSWER_LOG_ODDS < pressed < np.log(0.8 / 0.05)
    assert pressed - SILENT_LOG_ODDS < ANSWER_LOG_ODDS, "without any breath it is no mouth"


@pytest.mark.slow
def test_a_pump_restores_the_suction_of_the_last_one() -> None:
    """Jumps of one size and interval; those of a cup that is pushed lead from level to level."""
    number = np.floor(BLOCKS / 50)
    levels = np.array([0.0, 0.3, -0.2, 0.4, 0.1, 0.5, 0.0, 0.4, -0.1, 0.3, 0.0, 0.2, 0.4, 0.1])
    decayed = np.mod(BLOCKS, 50.0) * -0.005
    restored = followed(decayed)
    pushed = followed(decayed + levels[number.astype(int) % len(levels)])
    within = BLOCKS < 300
    assert np.max(restored[within]) > ANSWER_LOG_ODDS > np.max(pushed[within])


def test_changes_beyond_a_pump_are_no_evidence() -> None:
    """A cup that is pressed harder every 25 s, in the end to eleven times its suction."""
    levels = (0.0, 0.1, 0.2, 0.25, 0.4, 0.6, 0.8, 3.7, 2.1, 8.6, 13.2, 9.5, 11.0, 11.4, 7.9)
    number = np.minimum(BLOCKS / 25, len(levels) - 1).astype(int)
    assert np.max(followed(np.array(levels)[number], noise=0.08)) < ANSWER_LOG_ODDS


@pytest.mark.slow
def test_rare_and_frequent_bumps_are_not_pumping() -> None:
    """At one in a minute and one in twenty seconds.

    Two of twenty courses may pass the level by chance.
    """
    passed = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        for count in (10, 30):
            at = rng.uniform(0, BLOCKS[-1], count)
            size = rng.normal(0, 0.2, count)
            passed.append(followed(size @ (at[:, None] <= BLOCKS), seed=seed)[-1] > ANSWER_LOG_ODDS)
    assert np.mean(passed) <= 0.1


@pytest.mark.slow
def test_a_rested_mouth_is_recognised_within_minutes() -> None:
    long = Pumping.begin(np.ones(1), np.zeros(1), -BLOCK_S, 0)
    for number in range(400):  # twenty minutes
        long = long.after(np.full((3, 1), 0.001 * (-1) ** number), number * BLOCK_S)
    assert long.odds < -1 and long.logarithm.size < 10_000, (
        "absence is no more evidence than some minutes of it"
    )
    began = long.since_s
    for number in range(1, 100):
        value = float(pumped(45.0, 0.3)[number])
        long = long.after(np.full((3, 1), value), began + number * BLOCK_S)
    assert long.odds > ANSWER_LOG_ODDS > MIN_LOG_ODDS


def test_a_moved_mouth_keeps_its_odds() -> None:
    track = Pumping.begin(np.ones(1), np.zeros(1), -BLOCK_S, 0)
    for time, value in zip(BLOCKS[:100], pumped(45.0, 0.3), strict=False):
        track = track.after(np.full((3, 1), value), float(time))
    restarted = Pumping.begin(np.ones(2), np.zeros(2), 300.0, 1, track)
    assert restarted.odds == pytest.approx(track.odds) and restarted.odds > ANSWER_LOG_ODDS


@pytest.mark.parametrize("seed", range(4))
def test_a_breath_is_seen_whose_rim_swings_less_than_the_suction_lets_expect(seed: int) -> None:
    """The rim bears a body, or is pressed: its share cancels that of the suction in a mean."""
    shown = window(own=0.05, rim=-0.07, seed=seed)
    assert shown.odds > CLEAR_LOG_ODDS and shown.hertz[0] == pytest.approx(1.1, abs=0.1)
    assert shown.suction > 0.9


def leaking_window(begin: float, depth: float, seed: int) -> Breath:
    """8 s in which suction with its rim decays with a time constant of 3 s from a time on."""
    rng = np.random.default_rng(seed)
    rise = np.repeat([-2.0, 1.0], READINGS // 2)
    slopes = np.where(rise < 0, -300.0, 90.0)
    fallen = np.exp(-np.maximum(TIMES - begin, 0) / 3)
    film = 1 + 0.1 * rng.standard_normal(READINGS)
    course = fallen * (1 + depth * np.sin(2 * np.pi * 1.1 * TIMES)) - 1
    changes = np.outer(course, film * slopes) + rng.standard_normal((len(TIMES), READINGS))
    moves = 8 * rng.standard_normal((1, READINGS))
    known = Patterns.of(
        np.eye(READINGS), rise, slopes[None], 0.2 * np.abs(slopes), moves, np.ones((READINGS, 1))
    )
    return breath(SteadyFrames.of(TIMES, changes), changes, known)


@pytest.mark.parametrize("begin", [4.1, 5.6, 6.1])
def test_a_leak_that_begins_is_no_breath_and_hides_none(begin: float) -> None:
    """A bend of the suction resembles half a wave at the lower end of the band."""
    for seed in range(3):
        assert leaking_window(begin, 0.0, seed).odds < 1
        breathing = leaking_window(begin, 0.06, seed)
        assert breathing.odds > CLEAR_LOG_ODDS
        assert breathing.hertz[0] == pytest.approx(1.1, abs=0.1)
