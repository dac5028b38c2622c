"""Laws of every shape, by its own example, and of discs over patches.

The tests walk the union; a new shape is under them with the example in its docstring.
"""

import dataclasses
import inspect
import json
import re

import numpy as np
import pytest
from laws.recognised import PATCH_MM, frame_under

from lampest import Array, Panel, Scene, Simulation
from lampest.apps.recognition.sucking_disc import CANDIDATE, SuckingDisc
from lampest.apps.recognition.suction import suctions
from lampest.files.document import adapter, parse_document, to_yaml, validated
from lampest.files.levels import SIGNIFICANT
from lampest.panel.response import PUBLISHED
from lampest.recording.shapes import OralDisc, Shape, shape_types
from lampest.recording.shapes.disc import Disc, Unevenness, pressure_at_places
from lampest.recording.shapes.kinds import RoundCandidate
from lampest.recording.shapes.shape import POINTS, Template

PANEL = Panel(10, 10)
FINE_PANEL = Panel(180, 180, 0.5)
SCENE = "schema: 1\nseed: 1\nscene: {panel: {rows: 10, columns: 10}}\nframes: 1\nloads:\n  - "
SHAPES = [pytest.param(kind, id=kind.__name__) for kind in shape_types()]
OBLONG = Panel(7, 5, 10.0)
POINTS_ALONG = 200  # points along a patch of the sampling that it is held against
ROUNDING = 1e-12  # of sums over the fine panel, relative, and of pressures in kPa
TILTED_RATIO = 1.2  # of the forces on the two halves under a tilt of 0.6; measured at least 1.44
# Parts of the largest pressure, or of the step at the rim.
MAX_TEMPLATE_ERROR = 0.01  # limit: three times the value measured
MAX_SAMPLING_ERROR = 1e-3  # of forces on patches of 0.5 mm; limit: four times the value measured
MAX_EDGE_ERROR = 0.04  # of a patch that a hard edge crosses; measured 2.8 %


def example(kind: type[Shape]) -> str:
    """The load in the docstring of a shape, as YAML."""
    (text,) = re.findall(
        r"Example: (\{kind: .*?\})", " ".join((inspect.getdoc(kind) or "").split())
    )
    return str(text)


def load_of(kind: type[Shape]) -> Shape:
    """The example, read as a simulation's file would be."""
    (load,) = validated(parse_document(SCENE + example(kind), "example"), Simulation).loads
    assert type(load) is kind
    return load


def sums(load: Shape) -> tuple[float, float]:
    """Forces of contact and suction in mN, on a panel without gaps."""
    contact, suction = load.mean_pressure(FINE_PANEL, FINE_PANEL.pitch_mm)
    return float(contact.sum() * FINE_PANEL.pitch_mm**2), float(
        suction.sum() * FINE_PANEL.pitch_mm**2
    )


@pytest.mark.parametrize("kind", SHAPES)
def test_a_shape_is_in_the_schema_and_survives_yaml(kind: type[Shape]) -> None:
    load = load_of(kind)
    simulation = Simulation(1, 1, Scene(PANEL), loads=(load,))
    assert validated(parse_document(to_yaml(simulation), "again"), Simulation) == simulation
    schema = adapter(Simulation).json_schema()
    assert f'"{load.kind}": "#/$defs/{kind.__name__}"' in json.dumps(schema)
    assert set(schema["$defs"][kind.__name__]["properties"]) == {
        field.name for field in dataclasses.fields(kind)
    }


@pytest.mark.parametrize("kind", SHAPES)
def test_a_shape_presses_or_sucks_only_within_its_reach(kind: type[Shape]) -> None:
    load = dataclasses.replace(
        load_of(kind), centre_mm=(45.0, 45.0), tilt=1.0, tilt_direction_deg=200.0
    )
    contact, suction = load.mean_pressure(FINE_PANEL, FINE_PANEL.pitch_mm)
    x, y = FINE_PANEL.centres_mm()
    distance = np.hypot(x[None, :] - 45, y[:, None] - 45)
    assert np.all(contact >= 0) and np.all(suction <= 0)
    assert not np.any((contact - suction)[distance > load.reach_mm + FINE_PANEL.pitch_mm])
    assert np.any((contact - suction)[distance > load.reach_mm - 2 * FINE_PANEL.pitch_mm])


@pytest.mark.parametrize("kind", SHAPES)
def test_the_pressure_of_a_shape_moves_with_its_centre(kind: type[Shape]) -> None:
    load = dataclasses.replace(load_of(kind), centre_mm=(33.0, 44.0))
    moved = dataclasses.replace(load, centre_mm=(53.0, 34.0))
    for original, shifted in zip(
        load.mean_pressure(PANEL, 6), moved.mean_pressure(PANEL, 6), strict=True
    ):
        np.testing.assert_allclose(shifted[:-1, 2:], original[1:, :-2], atol=ROUNDING)


@pytest.mark.parametrize("kind", SHAPES)
def test_tilt_moves_and_preserves_the_force(kind: type[Shape]) -> None:
    level = dataclasses.replace(load_of(kind), centre_mm=(45.0, 45.0), tilt=0.0)
    tilted = dataclasses.replace(level, tilt=0.6, tilt_direction_deg=90.0)
    assert sums(tilted) == pytest.approx(sums(level), rel=ROUNDING)
    lower, upper = np.split(tilted.mean_pressure(FINE_PANEL, FINE_PANEL.pitch_mm)[0], 2)
    assert upper.sum() > TILTED_RATIO * lower.sum()


def test_any_parameters_of_a_disc_give_finite_readings() -> None:
    """Tilts and lobes beyond one turn a strong rim into suction of many atmospheres.

    No network has such cells.
    """
    rng = np.random.default_rng(4)
    frame = frame_under(load_of(OralDisc), PANEL)
    (place,) = suctions(frame)
    disc = SuckingDisc(frame, place, PATCH_MM, PUBLISHED)
    mean = CANDIDATE.mean(PANEL)
    sd = CANDIDATE.sd(PANEL)
    for _ in range(60):
        point = disc.at(mean + SIGNIFICANT * sd * rng.choice([-1, 0, 1], len(mean)), disc.errors)
        assert np.isfinite(point.cost)
        assert np.isfinite(point.gradient).all() and np.isfinite(point.normal).all()


@pytest.mark.parametrize(
    "kind", [kind for kind in shape_types() if isinstance(kind.candidate, RoundCandidate)]
)
def test_recognition_and_simulation_share_one_pressure(kind: type[Shape]) -> None:
    load = dataclasses.replace(
        load_of(kind), centre_mm=(43.0, 47.5), tilt=0.3, tilt_direction_deg=70.0
    )
    disc = load.disc()
    sampled = np.sum(load.mean_pressure(PANEL, 6.0), axis=0)
    smooth = pressure_at_places(PANEL.places_mm, 6.0, disc)[0]
    assert np.abs(sampled - smooth).max() < max(disc.rim_kpa, -disc.suction_kpa) / (2 * POINTS)
    fitted, _ = kind.candidate.pressure(PANEL, 6.0, kind.candidate.start(disc))
    assert np.abs(fitted - smooth).max() < MAX_TEMPLATE_ERROR * max(disc.rim_kpa, -disc.suction_kpa)


def test_labels_and_kinds_are_unique() -> None:
    every = [kind.candidate.label for kind in shape_types() if kind.candidate is not None]
    assert len(set(every)) == len(every)
    kinds = [example(kind).split(",")[0] for kind in shape_types()]
    assert len(set(kinds)) == len(kinds)
    assert tuple(Template(30.0)) == (30.0, 0.0, 0.0, False), (
        "a full disc with nothing else unless it says so"
    )


@pytest.mark.slow
def test_the_rim_of_any_mouth_balances_its_suction() -> None:
    """The rim's force is the suction's, however long or uneven it is.

    Extra pressure comes on top of it.
    """
    level = OralDisc(centre_mm=(45.0, 45.0), diameter_mm=36.0, rim_width_mm=6.0, pressure_kpa=-9.0)
    uneven = {
        "elongation": 1.3,
        "elongation_deg": 25.0,
        "unevenness": 0.4,
        "lobes": 3,
        "unevenness_deg": 70.0,
    }
    for load in (
        level,
        dataclasses.replace(level, **uneven),
        dataclasses.replace(level, **uneven, tilt=0.3),
    ):
        contact, suction = sums(load)
        assert suction == pytest.approx(-9 * np.pi * 24**2 / 4, rel=MAX_SAMPLING_ERROR)
        assert contact == pytest.approx(-suction, rel=MAX_SAMPLING_ERROR)
    pressed = dataclasses.replace(level, extra_rim_kpa=20.0)
    assert sums(pressed)[0] - sums(level)[0] == pytest.approx(
        20 * np.pi * (36**2 - 24**2) / 4, rel=MAX_SAMPLING_ERROR
    )


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
    pressure, _ = pressure_at_places(OBLONG.places_mm, 6.0, disc, form)
    expected = sampled(disc, form, 6.0)
    assert np.abs(pressure - expected).max() < MAX_EDGE_ERROR * (disc.rim_kpa - disc.suction_kpa)
