"""The model of a mouth that is fitted, and the mean pressure of discs on patches."""

import dataclasses

import numpy as np
import pytest
from laws.recognised import PATCH_MM, frame_under
from laws.test_shapes import PANEL, ROUND_SHAPES, load_of

from lampest import Array, Panel
from lampest.apps.recognition import mouth_model
from lampest.apps.recognition.disc_search import Template
from lampest.apps.recognition.mouth_model import EVEN, SuckingDisc, Unevenness, pressure_at_places
from lampest.apps.recognition.suction import suctions
from lampest.files.levels import SIGNIFICANT
from lampest.recording.shapes import OralDisc
from lampest.recording.shapes.disc import Disc
from lampest.recording.shapes.kinds import RoundShape
from lampest.recording.shapes.shape import POINTS

OBLONG = Panel(7, 5, 10.0)
POINTS_ALONG = 200  # points along a patch of the sampling that it is held against
# Parts of the largest pressure, or of the step at the rim.
MAX_TEMPLATE_ERROR = 0.01  # limit: three times the value measured
MAX_EDGE_ERROR = 0.04  # of a patch that a hard edge crosses; measured 2.8 %


def test_pressure_slopes_are_differences() -> None:
    rng = np.random.default_rng(5)
    mean, sd = mouth_model.mean_and_sd(PANEL)
    for _ in range(4):
        parameters = mean + 0.5 * sd * rng.standard_normal(len(mean))
        _, slopes = mouth_model.pressure(PANEL, 6.0, parameters)
        for slope, step in zip(slopes, 1e-6 * np.eye(len(parameters)), strict=True):
            up, down = (
                mouth_model.pressure(PANEL, 6.0, parameters + sign * step)[0] for sign in (1, -1)
            )
            size = max(1.0, float(np.abs(slope).max()))
            np.testing.assert_allclose(slope, (up - down) / 2e-6, atol=1e-4 * size)


def test_any_parameters_of_a_disc_give_finite_readings() -> None:
    """Tilts and lobes beyond one turn a strong rim into suction of many atmospheres.

    No network has such cells.
    """
    rng = np.random.default_rng(4)
    frame = frame_under(load_of(OralDisc), PANEL)
    (place,) = suctions(frame)
    disc = SuckingDisc(frame, place, PATCH_MM)
    mean, sd = mouth_model.mean_and_sd(PANEL)
    for _ in range(60):
        point = disc.at(mean + SIGNIFICANT * sd * rng.choice([-1, 0, 1], len(mean)), disc.errors)
        assert np.isfinite(point.cost)
        assert np.isfinite(point.gradient).all() and np.isfinite(point.normal).all()


@pytest.mark.parametrize("kind", ROUND_SHAPES)
def test_recognition_and_simulation_share_one_pressure(kind: type[RoundShape]) -> None:
    load = dataclasses.replace(
        load_of(kind), centre_mm=(43.0, 47.5), tilt=0.3, tilt_direction_deg=70.0
    )
    disc = load.disc()
    sampled = np.sum(load.mean_pressure(PANEL, 6.0), axis=0)
    (smooth,) = pressure_at_places(PANEL.places_mm, 6.0, np.array([*disc, *EVEN]))
    largest = max(disc.rim_kpa, -disc.suction_kpa)
    assert np.abs(sampled - smooth).max() < largest / (2 * POINTS)
    if kind is OralDisc:
        fitted, _ = mouth_model.pressure(PANEL, 6.0, mouth_model.start_of(disc))
        assert np.abs(fitted - smooth).max() < MAX_TEMPLATE_ERROR * largest


def test_a_template_is_a_full_disc_unless_it_says_more() -> None:
    assert tuple(Template(30.0)) == (30.0, 0.0, 0.0, False)


def sampled(disc: Disc, form: Unevenness, patch_mm: float) -> Array:
    """Mean over each patch of a disc with hard edges, written as a user would draw it."""
    offset = ((np.arange(POINTS_ALONG) + 0.5) / POINTS_ALONG - 0.5) * patch_mm
    across, down = OBLONG.centres_mm()
    pressure = np.empty(OBLONG.shape)
    for row, column in np.ndindex(OBLONG.shape):
        x, y = np.meshgrid(across[column] + offset - disc.x_mm, down[row] + offset - disc.y_mm)
        stretch = np.array([[1 - form.along, -form.across], [-form.across, 1 + form.along]])
        u, v = np.tensordot(stretch, np.stack([x, y]), 1)
        radius = np.hypot(u, v)
        angle = np.arctan2(v, u)
        level = 1 + 2 * (disc.tilt_x * u + disc.tilt_y * v) / disc.diameter_mm
        level = level + form.lobe_along * np.cos(2 * angle) + form.lobe_across * np.sin(2 * angle)
        inside = radius < disc.inner_mm / 2
        rim = (radius < disc.diameter_mm / 2) & ~inside
        pressure[row, column] = (inside * disc.suction_kpa + rim * disc.rim_kpa * level).mean()
    return pressure


@pytest.mark.parametrize("seed", range(6))
def test_pressures_equal_those_of_fine_sampling(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outer = float(rng.uniform(15, 50))
    numbers = (
        rng.uniform(-5, 45),
        rng.uniform(-5, 65),
        outer,
        outer * rng.uniform(0.2, 0.8),
        -rng.uniform(2, 20),
    )
    disc = Disc(*map(float, (*numbers, rng.uniform(5, 80), *rng.uniform(-0.3, 0.3, 2))))
    form = Unevenness(
        *map(float, rng.uniform(-0.1, 0.1, 2)), *map(float, rng.uniform(-0.3, 0.3, 2))
    )
    (pressure,) = pressure_at_places(OBLONG.places_mm, 6.0, np.array([*disc, *form]))
    expected = sampled(disc, form, 6.0)
    assert np.abs(pressure - expected).max() < MAX_EDGE_ERROR * (disc.rim_kpa - disc.suction_kpa)
