"""Laws of every shape, by the example in its docstring."""

import dataclasses
import inspect
import json
import re

import numpy as np
import pytest

from lampest import Panel, Scene, Simulation
from lampest.files.document import adapter, parse_document, to_yaml, validated
from lampest.files.typed import shipped
from lampest.recording.shapes import AnyShape, OralDisc, Shape
from lampest.recording.shapes.kinds import RoundShape

PANEL = Panel(10, 10)
FINE_PANEL = Panel(180, 180, 0.5)
SCENE = "schema: 1\nseed: 1\nscene: {panel: {rows: 10, columns: 10}}\nframes: 1\nloads:\n  - "
SHAPES = [pytest.param(kind, id=kind.__name__) for kind in shipped(AnyShape)]
ROUND_SHAPES = [kind for kind in shipped(AnyShape) if issubclass(kind, RoundShape)]
ROUNDING = 1e-12  # of sums over the fine panel, relative, and of pressures in kPa
TILTED_RATIO = 1.2  # of the forces on the two halves under a tilt of 0.6; measured at least 1.44
MAX_SAMPLING_ERROR = 1e-3  # of forces on patches of 0.5 mm; limit: four times the value measured


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


def test_kinds_are_unique() -> None:
    kinds = [example(kind).split(",")[0] for kind in shipped(AnyShape)]
    assert len(set(kinds)) == len(kinds)


@pytest.mark.slow
def test_the_rim_of_any_mouth_balances_its_suction() -> None:
    """The rim's force is the suction's, to which extra pressure adds."""
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
