"""Whether suction moves, or something else: windows whose every reading is known."""

import numpy as np
import pytest

from lampest.loads.recognition.breathing import Breath, Patterns, breath, settled

TIMES = np.arange(0, 8, 0.25)
READINGS = 40


def window(
    own: float = 0.0,
    rim: float = 0.0,
    place: float = 0.0,
    edges: float = 0.0,
    seed: int = 0,
    uneven: float = 0.1,
    slower: float = 1.0,
    waves: float = 0.0,
    wild: bool = False,
    strong: float = 1.0,
) -> Breath:
    """8 s at four frames a second in which parts swing by so much at 1.1 Hz, on a film that answers unevenly.

    Each reading is that of a cell; half of them lie under the rim. edges : six cells swing, as no fit knows. slower :
    by so much does the place swing more slowly. waves : what all readings share swings. wild : outliers of fifty
    standard deviations. strong : so many times the readings change with suction.
    """
    rng = np.random.default_rng(seed)
    rise = np.repeat([-2.0, 1.0], READINGS // 2)
    slopes, moves = strong * np.where(rise < 0, -300.0, 90.0), 8 * rng.standard_normal((1, READINGS))
    film = 0.9 + uneven * rng.standard_normal(READINGS)  # it has a hysteresis of a tenth
    swinging = [np.sin(2 * np.pi * 1.1 * TIMES / by) for by in (1.0, slower)]
    swings = film * slopes * (own + rim * (rise < 0)), film * place * moves[0]
    swings[0][rng.permutation(READINGS)[:6]] += edges * 60 * rng.choice([-1, 1], 6)
    changes = sum(np.outer(wave, swing) for wave, swing in zip(swinging, swings, strict=True)) + rng.standard_normal(
        (len(TIMES), READINGS)
    )
    supply = rng.standard_normal((READINGS, 1)) + 3
    changes = changes + waves * np.outer(swinging[0], film * supply[:, 0])
    changes += wild * 50 * (rng.random(changes.shape) < 0.003)
    spread = 0.2 * np.abs(slopes)
    known = Patterns.of(np.eye(READINGS), rise, slopes[None], spread, moves, supply)
    found = breath(TIMES, settled(changes), known)
    assert found is not None
    return found


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("uneven", [0.0, 0.1, 0.25])
def test_suction_that_swings_with_its_rim_is_breath_on_any_film(seed: int, uneven: float) -> None:
    found = window(own=0.08, seed=seed, uneven=uneven)
    assert found.odds > 3 and found.suction > 0.95
    assert found.hertz[0] == pytest.approx(1.1, abs=0.05)
    assert abs(found.depth[0] - 0.08) < 2.5 * found.depth[1] < 0.05


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
def test_a_rim_or_a_place_that_swings_is_none(seed: int, moving: dict[str, float]) -> None:
    found = window(**moving, seed=seed)  # the last one as the square of a movement that is half as fast
    assert found.odds < 0 or found.suction < 0.1


@pytest.mark.parametrize("uneven", [0.1, 0.25])
def test_the_depth_is_as_sure_as_it_is_said_to_be(uneven: float) -> None:
    """Also where the rim swings by less than its pattern, as on a film that it saturates."""
    found = [window(own=0.08, rim=rim, seed=seed, uneven=uneven).depth for rim in (0.0, -0.04) for seed in range(8)]
    away = np.array([(value - 0.08) / error for value, error in found])
    assert np.abs(away).max() < 3 and np.mean(np.abs(away) < 1.96) >= 0.85
    assert np.median([error for _, error in found]) < 0.03


@pytest.mark.parametrize("seed", range(3))
def test_waves_are_none_and_hide_none(seed: int) -> None:
    assert window(waves=3.0, seed=seed).odds < 0
    found = window(own=0.08, waves=3.0, seed=seed)
    assert found.odds > 3 and found.suction > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_no_breathing(seed: int) -> None:
    found = window(seed=seed)
    assert found.odds < 0


def test_too_few_frames_say_nothing() -> None:
    ones = np.ones(4)
    patterns = Patterns.of(np.eye(4), ones, ones[None], ones, ones[None], np.eye(4)[:, 1:2])
    for times in (TIMES[:10], np.arange(0, 8, 0.5)):
        assert breath(times, np.zeros((len(times), 4)), patterns) is None


@pytest.mark.parametrize("seed", range(3))
def test_outliers_hide_no_breath(seed: int) -> None:
    found = window(own=0.04, seed=seed, wild=True, strong=0.05)
    assert found.odds > 3 and found.suction > 0.9
