"""Discs over patches: forces add up, fine sampling agrees, slopes are those of the values."""

import numpy as np
import pytest

from lampest.loads.shapes.disc import Disc, Unevenness, pressure_at_places
from lampest.panel.panel import Array, Panel

PANEL = Panel(7, 5, 10.0)
FINE = 200  # points along a patch of the sampling that it is held against


def drawn(seed: int) -> tuple[Disc, Unevenness]:
    rng = np.random.default_rng(seed)
    outer = float(rng.uniform(15, 50))
    numbers = (rng.uniform(-5, 45), rng.uniform(-5, 65), outer, outer * rng.uniform(0.2, 0.8), -rng.uniform(2, 20))
    disc = Disc(*map(float, (*numbers, rng.uniform(5, 80), *rng.uniform(-0.3, 0.3, 2))))
    return disc, Unevenness(*map(float, rng.uniform(-0.1, 0.1, 2)), *map(float, rng.uniform(-0.3, 0.3, 2)))


def sampled(disc: Disc, form: Unevenness, patch_mm: float) -> Array:
    """Mean over each patch of a disc with hard edges, written as a user would draw it."""
    offset = ((np.arange(FINE) + 0.5) / FINE - 0.5) * patch_mm
    across, down = PANEL.centres_mm()
    found = np.empty(PANEL.shape)
    for row, column in np.ndindex(PANEL.shape):
        x, y = np.meshgrid(across[column] + offset - disc.x_mm, down[row] + offset - disc.y_mm)
        stretch = np.array([[1 - form.along, -form.across], [-form.across, 1 + form.along]])
        u, v = np.tensordot(stretch, np.stack([x, y]), 1)
        radius, angle = np.hypot(u, v), np.arctan2(v, u)
        level = 1 + 2 * (disc.tilt_x * u + disc.tilt_y * v) / disc.diameter_mm
        level = level + form.lobe_along * np.cos(2 * angle) + form.lobe_across * np.sin(2 * angle)
        inside = radius < disc.inner_mm / 2
        rim = (radius < disc.diameter_mm / 2) & ~inside
        found[row, column] = (inside * disc.suction_kpa + rim * disc.rim_kpa * level).mean()
    return found


@pytest.mark.parametrize("seed", range(6))
def test_values_are_those_of_fine_sampling(seed: int) -> None:
    disc, form = drawn(seed)
    pressure, _ = pressure_at_places(PANEL.places_mm, 6.0, disc, form)
    expected = sampled(disc, form, 6.0)
    assert np.abs(pressure - expected).max() < 0.04 * (disc.rim_kpa - disc.suction_kpa)


@pytest.mark.parametrize("seed", range(6))
def test_the_slopes_of_an_oval_are_its_differences(seed: int) -> None:
    disc, form = drawn(100 + seed)
    slopes, step = pressure_at_places(PANEL.places_mm, 6.0, disc, form)[1], 1e-6
    for slope, apart in zip(slopes, np.eye(12) * step, strict=True):
        up, down = (
            pressure_at_places(
                PANEL.places_mm,
                6.0,
                Disc(*(np.array(disc) + sign * apart[:8])),
                Unevenness(*(np.array(form) + sign * apart[8:])),
            )[0]
            for sign in (1, -1)
        )
        np.testing.assert_allclose(slope, (up - down) / (2 * step), atol=1e-6 * disc.rim_kpa)


def test_patches_without_gaps_hold_the_whole_force() -> None:
    for diameter in (20.0, 33.0, 39.9):
        pressure, _ = pressure_at_places(PANEL.places_mm, 10.0, Disc(18.3, 31.7, diameter, 0.0, 0.0, 3.0, 0.0, 0.0))
        assert pressure.sum() * 100 == pytest.approx(3 * np.pi * diameter**2 / 4, rel=0.01)


def test_a_disc_beside_the_panel_presses_on_nothing() -> None:
    pressure, slopes = pressure_at_places(PANEL.places_mm, 6.0, Disc(-40.0, 10.0, 20.0, 10.0, -5.0, 9.0, 0.1, 0.0))
    assert not pressure.any() and not slopes.any()
