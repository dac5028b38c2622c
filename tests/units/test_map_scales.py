"""Colour bars and titles of maps: numbers that do not collide, lines that break between words."""

from itertools import combinations, pairwise
from typing import Literal

import numpy as np
import pytest

from lampest import LoadedColumnsReadout, Panel, Scene
from lampest.report.plots.maps import (
    MapPainter,
    Tile,
    change_scale,
    limited,
    log_scale,
    maps_figure,
)
from lampest.report.plots.style import new_figure, wrapped
from lampest.report.strongest import apparent_change, percent_change


@pytest.mark.parametrize("polarity", ["up", "down"])
def test_a_measured_map_in_volt_shows_the_change_of_resistance_of_lone_cells(
    polarity: Literal["up", "down"],
) -> None:
    """Half the resistance in one cell of 1 × 1 is −50 %, whatever the voltage does."""
    scene = Scene(Panel(1, 1), LoadedColumnsReadout(load_ohm=1000.0, polarity=polarity))
    readings = [
        scene.circuit.network(cells, scene.circuit.ties(cells)).reading()
        for cells in (np.array([[1500.0]]), np.array([[3000.0]]))
    ]
    assert abs(percent_change(*readings).item()) < 49 or percent_change(*readings).item() > 0
    assert apparent_change(*readings, scene).item() == pytest.approx(-50, rel=1e-6)


@pytest.mark.parametrize("shape", [(10, 10), (24, 6), (6, 24)])
def test_numbers_of_a_horizontal_bar_do_not_collide(shape: tuple[int, int]) -> None:
    change = np.random.default_rng(0).uniform(-90, 900, shape)
    figure = new_figure(3.4)
    right = figure.subfigures(1, 2, width_ratios=(1.45, 1))[1]  # as in a timeline of detections
    axes = right.subplots()
    painter = MapPainter(
        Panel(*shape, 10.0), change_scale([change], "relative change of resistance [%]")
    )
    painter.draw(axes, Tile("map", change))
    painter.bar(axes.figure, axes, "bottom")
    figure.canvas.draw()
    (bar,) = (candidate for candidate in right.axes if candidate is not axes)
    boxes = [label.get_window_extent() for label in bar.get_xticklabels() if label.get_text()]
    assert len(boxes) > 3
    assert all(first.x1 < second.x0 for first, second in pairwise(boxes))


@pytest.mark.long
@pytest.mark.parametrize("count", [3, 11])
@pytest.mark.parametrize("shape", [(24, 4), (30, 3), (16, 6)])
def test_titles_and_numbers_of_narrow_panels_do_not_collide(
    shape: tuple[int, int], count: int
) -> None:
    change = np.random.default_rng(0).uniform(-50, 50, shape)
    tiles = [Tile(f"few_changes {n}", change, note="error 100 %") for n in range(count)]
    figure = maps_figure(
        tiles, Panel(*shape, 10.0), change_scale([change], "change of resistance [%]")
    )
    figure.canvas.draw()
    maps = [axes for axes in figure.axes if axes.get_title()]
    assert len(maps) == count
    titles = [axes.title.get_window_extent() for axes in maps]
    assert all(not first.overlaps(second) for first, second in combinations(titles, 2))
    for axes in maps:
        boxes = [
            label.get_window_extent() for label in axes.get_xticklabels() if label.get_visible()
        ]
        assert all(
            first.x1 < second.x0 for first, second in pairwise(box for box in boxes if box.width)
        )


def test_texts_break_between_words_or_after_a_sign() -> None:
    assert wrapped("LSR-gCR, gradient.weight 0.001", 12) == "LSR-gCR,\ngradient.\nweight 0.001"
    assert wrapped("log_gradient.weight=0.001", 11) == "log_\ngradient.\nweight=0.001"
    assert wrapped("weight=1e-3", 4) == "weight=1e-3"
    assert wrapped("unbreakable", 4) == "unbreakable"
    assert wrapped("LSR-CR, paper's λ", 16) == "LSR-CR,\npaper's λ"
    assert wrapped("a mat of 10 × 10 cells", 13) == "a mat of\n10 × 10 cells"
    assert wrapped("gradient λ = 0.001, at 1.5 s", 12) == "gradient\nλ = 0.001,\nat 1.5 s"
    assert wrapped("change 3 ± 2 %", 12) == "change\n3 ± 2 %"
    assert wrapped("", 4) == ""


def test_a_limited_scale_has_the_given_ends_and_a_white_middle() -> None:
    scale = limited(change_scale([np.array([500.0])], "change [%] (ends at ±20 %)"), -50.0, 50.0)
    assert (scale.norm.vmin, scale.norm.vmax, scale.label) == (-50.0, 50.0, "change [%]")
    assert scale.norm(4.9) == scale.norm(-4.9)
    logarithmic = log_scale([np.array([10.0, 1000.0])], "resistance [ohm]")
    assert limited(logarithmic, None, 300.0).norm.vmax == 300.0
    assert limited(logarithmic, None, None) is logarithmic
