"""Weak loads under strong noise: what a chosen weight smooths is said, with its share."""

import re
from dataclasses import replace

import numpy as np
import pytest

import lampest

SIDE = 7
FRAMES = 9
UNLOADED = 5


def weak_load(noise_lsb: float, further: tuple[int, int] | None = None) -> lampest.Recording:
    """A load of 25 % on a panel; one cell of the last frame changes by a further 2 %."""
    rng = np.random.default_rng(4)
    readout = lampest.TwoPointReadout(adc_bits=10, readings=1, noise_lsb=noise_lsb)
    film = 3000 * np.exp(0.1 * rng.standard_normal((1, SIDE, SIDE)))
    cells = np.repeat(film, FRAMES, axis=0)
    row, column = np.indices((SIDE, SIDE))
    cells[UNLOADED:] *= np.exp(-0.3 * np.exp(-((row - 3) ** 2 + (column - 2.6) ** 2) / 2.5))
    if further:
        cells[-1, *further] *= 1.02
    volt = readout.volt_from_recorded(lampest.two_point_resistance(cells) + 140)
    volt = volt + noise_lsb * readout.lsb_volt * rng.standard_normal(volt.shape)
    return lampest.Recording(
        lampest.Scene(lampest.Panel(SIDE, SIDE), readout, 140.0),
        readout.recorded_from_volt(volt),
        np.arange(FRAMES) / 4,
        (np.arange(FRAMES) >= UNLOADED).astype(np.uint8),
    )


def doubt_of(estimates: lampest.Estimates) -> str:
    """The doubt that weak loads are smoothed or held; '' without."""
    doubts = (line for line in estimates.checks_without_circuit if "weak loads" in line)
    return next(doubts, "")


@pytest.mark.parametrize("penalty", [lampest.LogGradient(), lampest.LogRatio()])
@pytest.mark.parametrize("noise_lsb", [0.5, 8.0])
def test_a_chosen_weight_says_where_it_smooths_weak_loads(
    noise_lsb: float, penalty: lampest.Term
) -> None:
    """Strong noise has the sentence, and noise that leaves loads alone has none."""
    estimates = lampest.reconstruct(weak_load(noise_lsb), [lampest.Misfit(), penalty])
    assert bool(doubt_of(estimates)) is (noise_lsb == 8.0)


@pytest.mark.parametrize("penalty", [lampest.LogRatio(), lampest.TotalVariationOfChange()])
def test_a_change_of_a_cell_below_the_said_threshold_does_not_show(penalty: lampest.Term) -> None:
    """A single cell of a panel at rest changes by 0.7 and by 1.4 times the threshold."""
    noisy = lampest.reconstruct(weak_load(8.0), [lampest.Misfit(), penalty])
    said = re.search(r"below ([\d.]+)", doubt_of(noisy))
    assert said is not None
    terms = [lampest.Misfit(), replace(penalty, weight=float(noisy.steps[-1].weights[1]))]
    resting = np.full((1, SIDE, SIDE), 3000.0)
    for share in (0.7, 1.4):
        cells = np.repeat(resting, FRAMES, axis=0)
        cells[-1, 3, 3] *= np.exp(-share * float(said[1]))
        exact = lampest.two_point_resistance(cells) + 140
        still = replace(weak_load(8.0), recorded=exact)
        relative = lampest.reconstruct(still, terms, error_bars=False).relative_change
        assert relative is not None
        stands_out = np.abs(relative[-1, 3, 3] - relative[-1, 0, 0]) > 0.1
        assert stands_out == (share > 1)


def test_the_share_that_is_said_is_that_of_a_cell_s_change() -> None:
    """Cells that change by a further 2 % show the share of it, and a weight of one's own is no
    doubt."""
    estimates = lampest.reconstruct(weak_load(8.0), [lampest.Misfit(), lampest.LogGradient()])
    share = re.search(r"(\d+)%", doubt_of(estimates))
    assert share is not None
    weight = float(estimates.steps[-1].weights[1])
    terms = [lampest.Misfit(), lampest.LogGradient(weight=weight)]
    before = lampest.reconstruct(weak_load(8.0), terms)
    assert not doubt_of(before)
    shown = []
    for cell in [(1, 1), (1, 4), (3, 3), (4, 1), (5, 5)]:
        after = lampest.reconstruct(weak_load(8.0, cell), terms, error_bars=False)
        ratio = after.cell_resistance[-1][cell] / before.cell_resistance[-1][cell]
        shown.append(np.log(ratio) / np.log(1.02))
    assert float(share[1]) / 100 == pytest.approx(np.median(shown), rel=0.25)
