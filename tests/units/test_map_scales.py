"""Colour bars and titles of maps: numbers that do not collide, lines that break between words."""

from itertools import pairwise

import numpy as np
import pytest

from lampest import Panel
from lampest.report.plots.maps import MapPainter, Tile, change_scale, limited, log_scale
from lampest.report.plots.style import new_figure, wrapped


@pytest.mark.parametrize("shape", [(10, 10), (24, 6), (6, 24)])
def test_numbers_of_a_horizontal_bar_do_not_collide(shape: tuple[int, int]) -> None:
    change = np.random.default_rng(0).uniform(-90, 900, shape)
    figure = new_figure(3.4)
    right = figure.subfigures(1, 2, width_ratios=(1.45, 1))[1]  # as in a timeline of detections
    axes = right.subplots()
    painter = MapPainter(Panel(*shape, 10.0), change_scale([change], "relative change of resistance [%]"))
    painter.draw(axes, Tile("map", change))
    painter.bar(axes.figure, axes, "bottom")
    figure.canvas.draw()
    (bar,) = (other for other in right.axes if other is not axes)
    boxes = [label.get_window_extent() for label in bar.get_xticklabels() if label.get_text()]
    assert len(boxes) > 3
    assert all(first.x1 < second.x0 for first, second in pairwise(boxes))


def test_texts_break_between_words_or_after_a_sign() -> None:
    assert wrapped("LSR-gCR, gradient.weight 0.001", 12) == "LSR-gCR,\ngradient.\nweight 0.001"
    assert wrapped("unbreakable", 4) == "unbreakable"
    assert wrapped("", 4) == ""


def test_a_limited_scale_has_the_given_ends_and_a_white_middle() -> None:
    scale = limited(change_scale([np.array([500.0])], "change [%] (ends at ±20 %)"), -50.0, 50.0)
    assert (scale.norm.vmin, scale.norm.vmax, scale.label) == (-50.0, 50.0, "change [%]")
    assert scale.norm(4.9) == scale.norm(-4.9)
    logarithmic = log_scale([np.array([10.0, 1000.0])], "resistance [ohm]")
    assert limited(logarithmic, None, 300.0).norm.vmax == 300.0
    assert limited(logarithmic, None, None) is logarithmic
