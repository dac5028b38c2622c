"""Changed cells, known resistors, locks and levels, against their plain statements."""

from functools import cached_property
from itertools import product
from threading import RLock
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal, norm

from lampest.files import levels
from lampest.inference.evidence import (
    FIELD_CELLS,
    FIELD_DEVIATIONS,
    MOVED_COST,
    OUTLINE_COST,
    OWN_SHARES,
    Changes,
    scores_with_errors,
    select_changed,
    usual_starts,
)
from lampest.panel import compiled
from lampest.panel.panel import Array

ROUNDING = 1e-9  # float64 times the condition of covariances, below 1e6


def random_change(cells: int, seed: int) -> tuple[Array, Array]:
    """A change of still cells, and its covariance."""
    rng = np.random.default_rng(seed)
    root = 0.01 * rng.standard_normal((cells, cells)) + 0.02 * np.eye(cells)
    return root @ rng.standard_normal(cells), root @ root.T


@pytest.mark.parametrize("seed", range(3))
def test_an_additional_error_is_scored_by_the_density_of_the_change(seed: int) -> None:
    change, covariance = random_change(9, seed)
    columns = 0.05 * np.random.default_rng(seed + 10).standard_normal((9, 4))
    scores = scores_with_errors(change, np.linalg.inv(covariance), columns)
    for score, column in zip(scores, columns.T, strict=True):
        with_it = covariance + np.outer(column, column)
        volume = np.linalg.slogdet(with_it)[1] - np.linalg.slogdet(covariance)[1]
        assert score == pytest.approx(
            change @ np.linalg.solve(with_it, change) + volume, rel=ROUNDING
        )


def test_cells_are_added_until_none_gains_however_many_these_are() -> None:
    """Independent changes: each cell that gains is added, of 40 most."""
    change = np.where(np.arange(40) < 30, 1.0, 0.0)
    variance = 0.01
    score = scores_with_errors(change, np.eye(40) / variance, np.zeros((40, 1)))[0]
    of_moved = change[0] ** 2 / (1 + variance) + np.log((1 + variance) / variance) + MOVED_COST
    assert score == pytest.approx(30 * of_moved, rel=ROUNDING)


def evidence(change: Array, covariance: Array, moved: NDArray[np.bool_]) -> float:
    """Return −2 ln of N(d; 0, C + 1 of moved cells) over that of none, with the prior odds."""
    with_moved = covariance + np.diag(moved.astype(float))
    volume = np.linalg.slogdet(with_moved)[1] - np.linalg.slogdet(covariance)[1]
    return float(change @ np.linalg.solve(with_moved, change) + volume + MOVED_COST * moved.sum())


@pytest.mark.parametrize("seed", range(6))
def test_the_selected_cells_have_the_most_evidence_of_all_subsets(seed: int) -> None:
    change, covariance = random_change(8, seed)
    change[[2, 5]] += -0.8, 0.1 * seed
    precision = np.linalg.inv(covariance)
    lost, moved = select_changed(precision @ change, precision, usual_starts(change))
    assert change @ precision @ change + lost == pytest.approx(
        evidence(change, covariance, moved), rel=ROUNDING
    )
    subsets = (np.array(chosen) for chosen in product((False, True), repeat=8))
    assert evidence(change, covariance, moved) == pytest.approx(
        min(evidence(change, covariance, m) for m in subsets)
    )
    # Adds cells only, and may end above.
    score = scores_with_errors(change, precision, np.zeros((8, 1)))
    assert score[0] > evidence(change, covariance, moved) - ROUNDING


def test_a_field_costs_its_outline_and_the_density_of_its_covariance() -> None:
    """A bar costs six edges; all sizes of its field are equally probable."""
    change, covariance = random_change(20, 3)
    place = np.argwhere(np.ones((4, 5), dtype=bool))
    moved = (place[:, 0] >= 2) & (place[:, 1] < 4)
    change[moved] -= 0.8
    inside = np.outer(moved, moved)
    distance = np.hypot(*(place[:, None] - place).T)
    densities = []
    for size, cells, own in product(FIELD_DEVIATIONS, FIELD_CELLS, OWN_SHARES):
        smooth = np.exp(-(distance**2) / (2 * cells**2))
        field = size**2 * inside * ((1 - own) * smooth + own * np.eye(20))
        densities.append(multivariate_normal(None, covariance + field).pdf(change))
    expected = -2 * np.log(np.mean(densities)) - 20 * np.log(2 * np.pi)
    changes = Changes(change, covariance, np.zeros((20, 1)))
    assert changes.cost_of_field(place, moved) == pytest.approx(
        expected + 6 * OUTLINE_COST, rel=1e-6
    )
    assert changes.cost_of_field(place, moved) < changes.cost_of_field(place, moved | ~moved)


def test_a_forked_child_renews_only_the_locks_of_cached_properties(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A property's lock would be held there for ever by a thread of the parent."""
    held = RLock()
    waiting: Any = cached_property(len)
    waiting.lock = held
    bare: Any = cached_property(len)
    vars(bare).pop("lock", None)
    own = SimpleNamespace(lock=held)
    module = SimpleNamespace(
        Owner=type("Owner", (), {"waiting": waiting, "bare": bare, "own": own}), number=1
    )
    modules = {
        "lampest.mine": module,
        "others.mine": SimpleNamespace(Other=type("Other", (), {"waiting": "no lock"})),
    }
    monkeypatch.setattr(compiled.sys, "modules", modules)
    lock = RLock()
    monkeypatch.setattr(compiled, "_LOCK", lock)
    lock.acquire()
    compiled._unlock_child()
    assert waiting.lock is not held and own.lock is held and not hasattr(bare, "lock")
    with pytest.raises(RuntimeError, match="cannot release un-acquired lock"):
        lock.release()


def test_levels_have_their_stated_false_alarm_rate() -> None:
    """Both tails of a normal distribution exceed a level once in the stated count of numbers."""
    half_a_digit = 0.5e-4  # the table states four decimals

    def once_in(sigmas: float) -> float:
        return float(1 / (2 * norm.sf(sigmas)))

    # The table rounds counts to one or two digits; each limit is just above what that takes off.
    assert once_in(levels.NOISE_REACH) == pytest.approx(370, rel=0.005)
    assert once_in(levels.UNUSUAL) == pytest.approx(15_000, rel=0.06)
    assert once_in(levels.SIGNIFICANT) == pytest.approx(1.7e6, rel=0.03)
    assert once_in(levels.OUTLIER_THRESHOLD) == pytest.approx(5e8, rel=0.02)
    assert once_in(levels.OUTLIER_THRESHOLD) / 2400 == pytest.approx(200_000, rel=0.06)
    assert pytest.approx(1 + 3 * np.sqrt(2 / 100), abs=0.03) == levels.MAX_MEAN_SQUARE
    assert (levels.SIGNIFICANCE, levels.FALSE_ALARM_RATE) == (1e-4, 0.01)
    assert norm.ppf(0.975) == levels.TWO_SIDED
    assert 1 / norm.ppf(0.75) == pytest.approx(levels.MAD_TO_SIGMA, abs=half_a_digit)
