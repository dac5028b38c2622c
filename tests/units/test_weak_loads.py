"""Weak loads under strong noise: what a chosen weight smooths is said, with its share."""

import re

import numpy as np
import pytest

import lampest
from docs.studies.weak_loads import weak_load

SEED, DEPTH = 4, 0.3  # a load of 25 %


def doubt_of(estimates: lampest.Estimates) -> str:
    """The doubt that weak loads are smoothed; '' without."""
    doubts = (line for line in estimates.checks_without_circuit if "smoothed" in line)
    return next(doubts, "")


@pytest.mark.parametrize("noise_lsb", [0.5, 8.0])
def test_a_chosen_weight_says_where_it_smooths_weak_loads(noise_lsb: float) -> None:
    """Strong noise has the sentence, and noise that leaves loads alone has none."""
    estimates = lampest.reconstruct(
        weak_load(SEED, DEPTH, noise_lsb), [lampest.Misfit(), lampest.LogGradient()]
    )
    assert bool(doubt_of(estimates)) is (noise_lsb == 8.0)


def test_an_absolute_loss_says_no_share() -> None:
    """It holds the cells that no load moves, and shows the load itself."""
    terms = [lampest.Misfit(), lampest.LogRatio()]
    estimates = lampest.reconstruct(weak_load(SEED, DEPTH, 3.0), terms)
    assert estimates.resolution is not None
    assert np.nanmedian(estimates.resolution) < 0.5
    assert not doubt_of(estimates)


def test_the_share_that_is_said_is_that_of_a_cell_s_change() -> None:
    """Cells that change by a further 2 % show the share of it, and a weight of one's own is no
    doubt."""
    recording = weak_load(SEED, DEPTH, 8.0)
    estimates = lampest.reconstruct(recording, [lampest.Misfit(), lampest.LogGradient()])
    share = re.search(r"(\d+)%", doubt_of(estimates))
    assert share is not None
    weight = float(estimates.steps[-1].weights[1])
    terms = [lampest.Misfit(), lampest.LogGradient(weight=weight)]
    before = lampest.reconstruct(recording, terms)
    assert not doubt_of(before)
    shown = []
    for cell in [(1, 1), (1, 4), (3, 3), (4, 1), (5, 5)]:
        after = lampest.reconstruct(weak_load(SEED, DEPTH, 8.0, cell), terms, error_bars=False)
        ratio = after.cell_resistance[-1][cell] / before.cell_resistance[-1][cell]
        shown.append(np.log(ratio) / np.log(1.02))
    assert float(share[1]) / 100 == pytest.approx(np.median(shown), rel=0.25)
