"""Frames with missing readings: intervals hold as often as they say, and say no more than they must."""

from dataclasses import replace

import numpy as np
import pytest

import lampest
from lampest.posterior.dense import DenseErrors
from lampest.posterior.profile_interval import ProfileInterval
from lampest.recording.readings import stand_in, stand_in_spread

SHAPE = (6, 7)
READOUT = lampest.TwoPointReadout(supply_volt=5, reference_ohm=1000, adc_bits=16, noise_lsb=1)
SCENE = lampest.Scene(lampest.Panel(*SHAPE), READOUT, systematic="none")


def with_holes(seed: int, missing: int) -> tuple[lampest.Recording, np.ndarray]:
    """Two unloaded frames and one with a pressed patch and so many readings less; and the cells of the latter."""
    rng = np.random.default_rng(seed)
    resting = 1000 * np.exp(0.3 * rng.standard_normal(SHAPE))
    pressed = resting.copy()
    pressed[2:5, 2:4] *= 0.3
    exact = READOUT.exact_reading(np.stack([resting, resting, pressed]))
    readings = exact + READOUT.sigma(exact) * rng.standard_normal(exact.shape)
    readings[2].flat[rng.choice(42, missing, replace=False)] = np.nan
    return lampest.Recording(SCENE, readings, np.arange(3.0), np.array([0, 0, 1], np.uint8)), pressed


def held(recording: lampest.Recording, cells: np.ndarray, terms: list[object]) -> tuple[float, float]:
    """(share of read cells within their interval, median width of it as a fraction)."""
    found = lampest.reconstruct(recording, terms, formulation="reduced")
    lower, upper = (bound[0] for bound in (found.cell_resistance_lower, found.cell_resistance_upper))
    read = np.isfinite(recording.recorded[2])
    return float(((lower <= cells) & (cells <= upper))[read].mean()), float(np.median((upper / lower - 1)[read]))


@pytest.mark.slow
@pytest.mark.parametrize("terms", [[], [lampest.RelativeChange()], [lampest.Gradient()]])
def test_cells_beside_one_that_was_not_read_are_held(terms: list[object]) -> None:
    """A missing reading moves all cells together, along a curve: tangents held 87 % of them over 28 such panels."""
    found = [
        held(*with_holes(seed, 1 + seed % 2), [lampest.Misfit(weighting="noise" if terms else "plain"), *terms])
        for seed in range(12)
    ]
    assert np.mean([share for share, _ in found]) > 0.9
    assert np.median([width for _, width in found]) < 0.3


@pytest.mark.parametrize("term", [lampest.RelativeChange(), lampest.GradientOfRelativeChange()])
def test_what_was_never_read_is_stood_in_for_where_penalties_compare(term: object) -> None:
    """Nothing told the baseline of that cell: it went open, and took all others along by 1 %; bars held 45 %."""
    rng = np.random.default_rng(8)
    resting = 1000 * np.exp(0.2 * rng.standard_normal(SHAPE))
    pressed = resting.copy()
    pressed[2:5, 2:4] *= 0.4
    truth = np.stack([resting, resting, pressed, 0.9 * pressed])
    readings = READOUT.exact_reading(truth)
    readings = readings + READOUT.sigma(readings) * rng.standard_normal(readings.shape)
    readings[:, 1, 5] = np.nan
    recording = lampest.Recording(SCENE, readings, np.arange(4.0), np.array([0, 0, 1, 1], np.uint8))
    found = lampest.reconstruct(recording, [lampest.Misfit(weighting="noise"), term], formulation="reduced")
    read = np.isfinite(readings[2:])
    held = (found.cell_resistance_lower <= truth[2:]) & (truth[2:] <= found.cell_resistance_upper)
    assert held[read].mean() > 0.9
    assert np.median(np.abs(np.log(found.cell_resistance / truth[2:]))) < 0.005


@pytest.mark.parametrize("side", [-1, 1])
def test_the_valley_is_followed_to_where_a_held_cell_leads(side: int) -> None:
    """Ends of the way are optima with that cell held: found again by a solve within bounds that leave it no choice."""
    recording, _ = with_holes(3, 1)
    terms = (lampest.Misfit(weighting="noise"), lampest.Gradient(weight=1e-4))
    readings = recording.readings()
    stream = lampest.Stream.begin(
        lampest.Estimator(terms, formulation="reduced"), SCENE, 1.0, readings[np.array([0, 1])].mean()
    )
    data, _ = stream.given(readings[2])
    model = stream.solve(data, None).surroundings()
    cell = int(np.flatnonzero(readings.seen[2].ravel() == 0)[0])
    errors = DenseErrors(model)
    way = ProfileInterval(errors, cell)
    gone = way.end(side)
    lower, upper = data.lower.copy(), data.upper.copy()
    lower.flat[cell] = upper.flat[cell] = np.exp(model.at.position.flat[cell] + gone[cell])
    there = stream.solve(replace(data, lower=lower, upper=upper), np.exp(model.at.position + gone.reshape(1, *SHAPE)))
    exact = (np.log(there.cell_resistance) - model.at.position[0]).ravel()
    beside = np.arange(gone.size) != cell
    assert np.abs(gone - exact)[beside].max() < 0.1 * np.abs(exact[beside]).max()
    assert np.abs(way.tangent * side - exact)[beside].max() > 0.2 * np.abs(exact[beside]).max()


@pytest.mark.parametrize("term", [lampest.Gradient(), lampest.RelativeChange()])
def test_a_missing_reading_does_not_choose_the_weight(term: object) -> None:
    """The penalty decides an unread cell whatever its weight; that it does was taken for a fault of the weight."""
    weights = []
    for missing in (0, 2):
        found = lampest.reconstruct(
            with_holes(3, missing)[0], [lampest.Misfit(weighting="noise"), term], formulation="reduced"
        )
        weights.append(found.steps[0].weights[1])
    assert abs(np.log10(weights[1] / weights[0])) < 1.2  # it was 1e-15


def test_a_stand_in_says_how_far_readings_stray_that_it_has_not_seen() -> None:
    """A pressed patch has lines that follow it: 13 % of readings lay beyond 1.96 spreads of what was fitted to them."""
    beyond = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        cells = 1000 * np.exp(0.3 * rng.standard_normal((6, 9)))
        cells[2:5, 3:6] *= 0.3
        reading = lampest.two_point_resistance(cells)
        for place in np.ndindex(reading.shape):
            known = np.ones(reading.shape, dtype=bool)
            known[place] = False
            expected, spread = stand_in(reading, known), stand_in_spread(reading, known)
            beyond.append(abs(np.log(reading[place] / expected[place])) > 1.96 * spread[place])
    assert np.mean(beyond) < 0.09
