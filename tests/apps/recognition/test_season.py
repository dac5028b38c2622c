"""Rows of visits beside each other and after each other."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from laws.recognised import PANEL

from docs.studies.season import IN_TIME_S, drawn, matched, rows_of
from lampest import Scene, TwoPointReadout
from lampest.apps.recognition.detector import Detector
from lampest.apps.recognition.model_errors import ModelErrors
from lampest.apps.recognition.watch import Watch
from lampest.apps.recognition.watch_parts import Look, WatchSetup
from lampest.recording.simulation.simulation import Simulation, simulate

# of this season two mouths at once are the first visits: the weaker one leaves first
SEED = 7101
FRAMES = 275


@pytest.mark.slow
def test_a_weak_mouth_that_leaves_beside_a_strong_one_has_its_own_end() -> None:
    """Its departure is a step of less than half of the stronger load."""
    season, water = drawn(SEED, rate=1.0)
    answer = rows_of(season.recording(water[:FRAMES]))
    pair = season.visits[:2]
    rows = [matched(visit, answer.attachments, FRAMES) for visit in pair]
    assert [len(numbers) for numbers in rows] == [1, 1]
    for visit, (number,) in zip(pair, rows, strict=True):
        end = answer.attachments[number].until_s
        assert end is not None and abs(end - visit.end) < IN_TIME_S


@pytest.mark.slow
def test_the_residue_of_loads_that_left_is_no_contact() -> None:
    """Two mouths leave, and 40 s later a rod arrives: their cells still recover."""
    season, water = drawn(7111, rate=1.0)
    answer = rows_of(season.recording(water[:450]))
    begins = [load.since_s for load in answer.attachments]
    assert len(begins) == 3
    for visit, begin in zip(season.visits, sorted(begins), strict=False):
        assert abs(begin - visit.begin) < IN_TIME_S


def test_a_load_that_has_left_hides_no_later_step() -> None:
    """A change that is no contact has a threshold of its own, not of the load before."""
    scene = Scene(PANEL, TwoPointReadout(noise_lsb=0.7), 140.0)
    readings = simulate(Simulation(1, 5, scene, frames=6)).readings()
    setup = WatchSetup(scene, Detector(6.0), np.zeros(PANEL.shape), ModelErrors())
    resting = readings[[0, 1, 2]].mean()
    watch = Watch.begin(setup, resting.value, readings.sigma[0], readings.value[:3], 0.0)
    verdict: Any = None
    strong = Look(verdict, 1e3 * watch.test.least(), 5.0, np.zeros(PANEL.shape), over=True)
    changed = replace(watch, present=True, known=True)
    after = replace(changed, look=strong)
    assert np.array_equal(after._least_step(9.0), changed._least_step(9.0))
