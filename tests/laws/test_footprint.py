"""Circles over patches: areas add up, sampling agrees, slopes are those of the values."""

import numpy as np
import pytest

from lampest.loads.footprint import cover
from lampest.panel.panel import Array, Panel

PANEL = Panel(7, 5, 10.0)
POINTS = 200


def sampled(panel: Panel, patch_mm: float, centre: tuple[float, float], diameter: float) -> Array:
    """Share and moments from a grid of points in every patch."""
    offset = ((np.arange(POINTS) + 0.5) / POINTS - 0.5) * patch_mm
    across, down = panel.centres_mm()
    found = np.empty((3, *panel.shape))
    for row, column in np.ndindex(panel.shape):
        x, y = np.meshgrid(across[column] + offset - centre[0], down[row] + offset - centre[1])
        inside = x * x + y * y < diameter * diameter / 4
        found[:, row, column] = inside.mean(), (inside * x).mean(), (inside * y).mean()
    return found


@pytest.mark.parametrize("diameter", [2.0, 9.0, 33.0, 39.9])
def test_patches_without_gaps_hold_the_whole_circle(diameter: float) -> None:
    share, *moments = cover(PANEL, PANEL.pitch_mm, (18.3, 31.7), (diameter,)).values[0]
    assert share.sum() * PANEL.pitch_mm**2 == pytest.approx(np.pi * diameter**2 / 4, rel=1e-12)
    for moment in moments:
        assert moment.sum() == pytest.approx(0, abs=1e-10)


@pytest.mark.parametrize("seed", range(6))
def test_values_are_those_of_fine_sampling(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre = (float(rng.uniform(-10, 50)), float(rng.uniform(-10, 70)))
    patch, diameters = float(rng.uniform(2, 10)), tuple(map(float, rng.uniform(2, 60, 2)))
    values = cover(PANEL, patch, centre, diameters).values
    for circle, diameter in zip(values, diameters, strict=True):
        expected = sampled(PANEL, patch, centre, diameter)
        np.testing.assert_allclose(circle[0], expected[0], atol=3e-3)
        np.testing.assert_allclose(circle[1:], expected[1:], atol=3e-3 * diameter)


@pytest.mark.parametrize("seed", range(6))
def test_slopes_are_differences(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    x, y, diameter = float(rng.uniform(0, 40)), float(rng.uniform(0, 60)), float(rng.uniform(5, 60))
    slopes, step = cover(PANEL, 6.0, (x, y), (diameter,)).slopes[:, 0], 1e-5
    for slope, (dx, dy, dd) in zip(slopes, np.eye(3) * step, strict=True):
        up = cover(PANEL, 6.0, (x + dx, y + dy), (diameter + dd,)).values[0]
        down = cover(PANEL, 6.0, (x - dx, y - dy), (diameter - dd,)).values[0]
        np.testing.assert_allclose(slope, (up - down) / (2 * step), atol=1e-6)


def test_a_circle_beside_the_panel_covers_nothing() -> None:
    covered = cover(PANEL, 6.0, (-40.0, 10.0), (20.0, 10.0))
    assert not covered.values.any() and not covered.slopes.any()
