"""Every effect that no scene names."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.files.applications import loaded
from lampest.inference.estimated import estimated_lines
from lampest.panel.effects import (
    SharedEffect,
    error_columns,
    shared_effects,
)
from lampest.panel.effects.line_effect import LineEffect, effect_on_readings, line_effects
from lampest.panel.effects.loose_contact import LooseContact
from lampest.panel.sizes import EFFECTS, SIZED, limits_of

OF_FRAMES = [(each.of_frames, each.path) for each in EFFECTS if each.of_frames]
AT_CONVERTER = [(each.at_converter, each.path) for each in EFFECTS if each.at_converter]
SHAPE = (3, 4)
SCENE = lampest.Scene(lampest.Panel(*SHAPE), lampest.TwoPointReadout(), series_resistance_ohm=140.0)
CELLS = np.random.default_rng(1).uniform(500.0, 5000.0, SHAPE)
LINES = sum(SHAPE)
MAX_BEND = 1e-3  # of effects of a thousandth of their prior size; limit: three times that measured
LINEAR = 1e-7  # relative: columns are central differences; measured 3e-9


# A ground that idle lines share needs idle lines that end.
GROUNDED = replace(SCENE, readout=lampest.GroundedReadout(), series_resistance_ohm=0.0)
NETWORK = SCENE.circuit.network(CELLS, SCENE.circuit.ties(CELLS), SCENE.wiring)


@pytest.mark.parametrize("kind", line_effects())
def test_an_effect_is_smooth_in_its_size_and_vanishes_at_zero(kind: type[LineEffect]) -> None:
    scene = SCENE if kind.may_begin else GROUNDED
    network = scene.circuit.network(CELLS, scene.circuit.ties(CELLS))
    places = list(kind.places(*SHAPE))
    assert len(set(places)) == len(places) > 0
    for lines in places:
        assert all(0 <= line < LINES for line in lines)
        effect = kind(lines)
        sized = [replace(effect, size=n * 1e-3 * kind.prior) for n in (0, 1, 2)]
        zero, single, double = (effect_on_readings([each], scene, network) for each in sized)
        assert_allclose(zero, 0.0, atol=1e-9 * network.reading().max())
        assert np.abs(single).max() > 0
        assert_allclose(double, 2 * single, rtol=MAX_BEND, atol=MAX_BEND * np.abs(single).max())


@pytest.mark.parametrize("kind", line_effects())
def test_an_effect_has_a_sentence_with_its_line_and_its_time(kind: type[LineEffect]) -> None:
    for lines in kind.places(*SHAPE):
        sentence = kind(lines, since=True, size=kind.prior).sentence(3)
        assert ("since the unloaded frames" in sentence) is kind.may_begin
        assert (
            len(lines) != 1
            or (f"row {lines[0]}" if lines[0] < SHAPE[0] else f"column {lines[0] - SHAPE[0]}")
            in sentence
        )
    assert (
        LooseContact((4,), size=-12.345)
        .sentence(3)
        .startswith("12 ohm less at the contact of column 1")
    )


@pytest.mark.parametrize("error", shared_effects(), ids=lambda error: error.setting)
def test_columns_of_a_shared_error_are_proportional_to_its_setting(error: SharedEffect) -> None:
    sizes = [lampest.Systematic(**{error.setting: size}) for size in (1e-3, 2e-3)]
    single, double = (
        error_columns([error], NETWORK, NETWORK.reading(), SCENE, size) for size in sizes
    )
    assert single.shape[1:] == SHAPE and np.all(np.abs(single).max(axis=(1, 2)) > 0)
    assert_allclose(double, 2 * single, rtol=LINEAR)


def test_exact_electronics_have_no_columns_and_leave_error_bars_finite() -> None:
    exact = lampest.Systematic(0.0, 0.0, response_sd=0.0)
    columns = error_columns(shared_effects(), NETWORK, NETWORK.reading(), SCENE, exact)
    assert columns.shape == (0, 3, 4)
    channels = replace(exact, channel_spread_ohm=2.0)
    assert error_columns(shared_effects(), NETWORK, NETWORK.reading(), SCENE, channels).shape == (
        7,
        3,
        4,
    )
    readings = np.stack([NETWORK.reading()] * 3) + 140
    recording = lampest.Recording.from_array(
        readings, baseline=1, scene=replace(SCENE, systematic=exact)
    )
    assert np.isfinite(lampest.reconstruct(recording).cell_resistance_errors).all()


@pytest.mark.parametrize("key", SIZED)
def test_limits_and_unit_of_a_key_are_those_of_its_effect(key: str) -> None:
    effect = loaded(SIZED[key])()
    assert limits_of(key) == effect.limits
    (line,) = estimated_lines({key: (0.5, 0.1)})
    assert line.endswith(f" {effect.unit or '(relative)'}")


@pytest.mark.parametrize(("names", "path"), OF_FRAMES)
def test_errors_of_a_frame_are_proportional_to_their_sizes(
    names: tuple[str, ...], path: str
) -> None:
    effect = loaded(path)()
    roots = np.random.default_rng(2).uniform(0.1, 1.0, (3, 1))
    sizes = {
        "motion": roots[:, 0],
        "common_ripple": np.ones((4, 1)),
        "line_ripple": np.ones((4, 1)),
    }
    given = [sizes.get(name, 0.1 if name != "resting" else np.ones(SHAPE)) for name in names]
    values = np.random.default_rng(3).uniform(1.0, 2.0, SHAPE)
    single = effect.columns(SCENE.circuit, values, *given)
    doubled = [
        2 * size if name != "resting" else size for name, size in zip(names, given, strict=True)
    ]
    assert single.shape[1:] == SHAPE and np.all(np.abs(single).max(axis=(1, 2)) > 0)
    assert_allclose(effect.columns(SCENE.circuit, values, *doubled), 2 * single, rtol=1e-12)


@pytest.mark.parametrize(("names", "path"), AT_CONVERTER)
def test_an_effect_at_the_converter_changes_voltages(names: tuple[str, ...], path: str) -> None:
    assert SCENE.readout is not None
    volt = np.random.default_rng(3).uniform(1.0, 4.0, (2, *SHAPE))
    sizes = [0.5, *[None] * (len(names) - 1)]
    disturbed = loaded(path)().disturbed(SCENE.readout, volt, np.random.default_rng(1), 1.0, *sizes)
    assert disturbed.shape == volt.shape and np.abs(disturbed - volt).max() > 0
