"""Weak loads under strong noise: what a chosen weight smooths is said, with its share."""

import re
from dataclasses import replace

import numpy as np
import pytest
from promises import promise

import lampest
from docs.studies.weak_loads import FRAMES, SIDE, weak_load

SEED, DEPTH = 4, 0.3  # a load of 25 %


def doubt_of(estimates: lampest.Estimates) -> str:
    """The doubt that weak loads are smoothed or held; '' without."""
    doubts = (line for line in estimates.checks_without_circuit if "weak loads" in line)
    return next(doubts, "")


@promise(
    "howto/weights: Under strong noise a chosen weight smooths weak loads. "
    "`checks` then have a line"
)
@pytest.mark.parametrize("penalty", [lampest.LogGradient(), lampest.LogRatio()])
@pytest.mark.parametrize("noise_lsb", [0.5, 8.0])
def test_a_chosen_weight_says_where_it_smooths_weak_loads(
    noise_lsb: float, penalty: lampest.Term
) -> None:
    estimates = lampest.reconstruct(weak_load(SEED, DEPTH, noise_lsb), [lampest.Misfit(), penalty])
    assert bool(doubt_of(estimates)) is (noise_lsb == 8.0)


@promise("howto/weights: An absolute loss holds changes instead")
@pytest.mark.parametrize("penalty", [lampest.LogRatio(), lampest.TotalVariationOfChange()])
def test_a_change_of_a_cell_below_the_said_threshold_does_not_show(penalty: lampest.Term) -> None:
    noisy = lampest.reconstruct(weak_load(SEED, DEPTH, 8.0), [lampest.Misfit(), penalty])
    said = re.search(r"below ([\d.]+)", doubt_of(noisy))
    assert said is not None
    terms = [lampest.Misfit(), replace(penalty, weight=float(noisy.steps[-1].weights[1]))]
    resting = np.full((1, SIDE, SIDE), 3000.0)
    for share in (0.7, 1.4):
        cells = np.repeat(resting, FRAMES, axis=0)
        cells[-1, 3, 3] *= np.exp(-share * float(said[1]))
        exact = lampest.two_point_resistance(cells) + 140
        still = replace(weak_load(SEED, DEPTH, 8.0), recorded=exact)
        relative = lampest.reconstruct(still, terms, error_bars=False).relative_change
        assert relative is not None
        stands_out = np.abs(relative[-1, 3, 3] - relative[-1, 0, 0]) > 0.1
        assert stands_out == (share > 1)


def test_the_share_that_is_said_is_that_of_a_cell_s_change() -> None:
    """Cells change by a further 2 %, and a weight of one's own is no doubt."""
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
