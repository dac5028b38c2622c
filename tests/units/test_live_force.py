"""What the live page is told: forces, the word for the panel's state, the history."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from lampest import two_point_resistance
from lampest.loads.pressure import Force, PressureTrack, water_pressure
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.response import PublishedResponse, ratio_from_pressure
from lampest.panel.scene import Faults, Scene, Water
from lampest.recording.readings import Readings
from lampest.report.live.engine import with_picture
from lampest.report.live.message import HISTORY_FRAMES, Picture, View, view_text
from lampest.report.live.state import read_load, verdict_of


def test_total_pressure_is_a_force() -> None:
    """10 kPa on 100 cells of 10 mm × 10 mm are 100 N; where as much sucks on half of them, 50 N press."""
    scene = Scene(Panel(10, 10), response=PublishedResponse())
    assert force_of(scene, np.full((10, 10), 10.0)).newton == pytest.approx(100.0)
    half = np.repeat([[10.0], [-10.0]], 5, axis=0) * np.ones((10, 10))
    assert force_of(scene, half).newton == pytest.approx(50.0)


def test_a_force_with_saturated_cells_is_a_lower_bound() -> None:
    """A cell beyond what the response determines, 40 kPa, counts with that and is counted."""
    kpa = np.zeros((10, 10))
    kpa[2, 2:6], kpa[3, 3] = 10.0, 95.0
    force = force_of(Scene(Panel(10, 10), response=PublishedResponse()), kpa)
    assert force.newton == pytest.approx(4.0 + 4.0) and force.saturated == 1


def test_a_scene_without_a_response_has_no_force() -> None:
    pressed, force = read_load(PressureTrack.begin(Scene(Panel(2, 2))), np.full((2, 2), 0.5), None, 0.0)
    assert pressed is None and np.isnan(force.newton)


def force_of(scene: Scene, kpa: Array) -> Force:
    """Of cells under such pressures, without error bars."""
    water = water_pressure(scene.panel, scene.water)
    ratio = ratio_from_pressure(water + kpa) / ratio_from_pressure(water)
    return read_load(PressureTrack.begin(scene), ratio, None, 0.0)[1]


def test_a_force_is_that_of_the_scene() -> None:
    """Water that stood there before counts as nothing, nor does what a broken cell seems to say."""
    response, ten = PublishedResponse(), np.full((10, 10), 10.0)
    assert force_of(Scene(Panel(10, 10), water=Water(500.0), response=response), ten).newton == pytest.approx(100.0)
    broken = Scene(Panel(10, 10), faults=Faults(dead_rows=(3,), shorted=((0, 0),)), response=response)
    assert force_of(broken, ten).newton == pytest.approx(89.0)


def test_the_page_is_told_where_something_presses_and_what_its_force_leaves_out() -> None:
    pressure = np.zeros((2, 3))
    pressure[0, 1], pressure[0, 2], pressure[1, 0] = 10.0, 30.0, -5.0
    nothing, saturated = np.zeros((2, 3)), (pressure == 30.0).astype(np.uint8)
    picture = Picture(
        1, 0.0, 0.0, nothing, nothing, nothing > 0, Force(1.0, 0.1), "fine", 0.0, 0, nothing, pressure, saturated
    )

    def told(verdict: str) -> dict[str, Any]:
        view = View("here", "LSM", "receiving", Panel(2, 3), picture=dataclasses.replace(picture, verdict=verdict))
        content: dict[str, Any] = json.loads(view_text(view, 0.0))["picture"]
        return content

    assert told("pressing")["centre"] == [17.5, 0.0] and told("pressing")["health"]["saturated"] == [2]
    assert told("nothing")["centre"] is None and told("sucking")["centre"] is None


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({}, "nothing"),
        ({(1, 1): 0.4}, "pressing"),
        ({(1, 1): 0.4, (1, 2): 1.1}, "pressing"),
        ({(1, 1): 3.0}, "sucking"),
        ({(1, 1): 0.1, (2, 2): 6.0}, "pressing and sucking"),
    ],
)
@pytest.mark.parametrize("noise_told", [True, False])
def test_what_is_on_the_panel_in_a_word(change: dict[tuple[int, int], float], verdict: str, noise_told: bool) -> None:
    """Cells times so much; as much beside a load as a penalty leaves there is no suction, nor is an open cell."""
    scene, ratio = Scene(Panel(4, 5), TwoPointReadout() if noise_told else None), np.ones((4, 5))
    for cell, factor in change.items():
        ratio[cell] = factor
    cells = np.full((4, 5), 3000.0)
    resting, now = (Readings.of(scene, two_point_resistance(each)) for each in (cells, cells * ratio))
    open_cell = np.zeros((4, 5), dtype=bool)
    assert verdict_of(now, resting, ratio, open_cell) == verdict
    open_cell[3, 4], ratio[3, 4] = True, 1e6
    assert verdict_of(now, resting, ratio, open_cell) == verdict


def test_the_history_keeps_its_newest_points() -> None:
    nothing = np.full((1, 1), np.nan)
    view = View("here", "LSM", "receiving", Panel(1, 1))
    for number in range(1, HISTORY_FRAMES + 50):
        view = with_picture(
            view, Picture(number, float(number), 0.0, nothing, nothing, nothing > 0, Force(1.0, 0.1), "fine", 0.0, 0)
        )
    assert len(view.history) == HISTORY_FRAMES and view.history[-1].number == HISTORY_FRAMES + 49
    content = json.loads(view_text(view, 0.0, known=HISTORY_FRAMES + 46))
    assert content["history"] == [
        [HISTORY_FRAMES + 47.0, 1.0],
        [HISTORY_FRAMES + 48.0, 1.0],
        [HISTORY_FRAMES + 49.0, 1.0],
    ]
    assert json.loads(view_text(view, 0.0, known=HISTORY_FRAMES + 49))["picture"] is None
