"""The picture of a recording's readings has the state of each one, as file and cleaning say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lampest import InputError, Recording
from lampest.inference.readings.judge import Cleaned
from lampest.report.plots.readings import STATES, plot_readings, readings_picture, states_of
from tests.panels import Plan

TAP = 1.6


def wrong_recording() -> tuple[Recording, dict[str, tuple[int, int, int]]]:
    """Return a recording with wrong readings, and the place of one of each state."""
    plan = replace(Plan.drawn(4, "two_point"), load="none", unloaded=6, measured=18)
    recording = plan.recording()
    recorded = recording.recorded.copy()
    recorded[8, 3, 4] = np.nan
    recorded[12, 2, 2] *= TAP
    recorded[:, 1, 1] = recorded[0, 1, 1]
    recorded[15, 4] = np.random.default_rng(0).uniform(1, 1e4, recorded.shape[2])
    places = {
        "missing in the file": (8, 3, 4),
        "outlier, left out": (12, 2, 2),
        "frozen, left out": (3, 1, 1),
        "garbled, left out": (15, 4, 0),
        "measured": (5, 2, 3),
    }
    return replace(recording, recorded=recorded), places


def test_each_reading_has_the_state_that_cleaning_gives_it() -> None:
    recording, places = wrong_recording()
    states = states_of(Cleaned.of(recording), recording.recorded)
    assert {words: STATES[states[place]] for words, place in places.items()} == {
        words: words for words in places
    }


def test_the_legend_counts_each_state_that_occurs() -> None:
    recording, places = wrong_recording()
    figure = readings_picture(recording)
    texts = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    named = {text.partition(":")[0] for text in texts}
    assert set(places) <= named <= set(STATES)
    assert any(text.startswith("garbled") and text.endswith("in 1 frame") for text in texts)
    (axes,) = figure.axes
    assert "frame" in axes.get_xlabel() and "row" in axes.get_ylabel()


def test_the_command_writes_the_picture_beside_the_recording(tmp_path: Path) -> None:
    recording, _ = wrong_recording()
    recording.save(tmp_path / "mine.h5")
    picture = plot_readings(tmp_path / "mine.h5", None)
    assert picture == tmp_path / "readings_mine.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match=r"\.png, \.svg or \.pdf"):
        plot_readings(tmp_path / "mine.h5", tmp_path / "x.jpg")
