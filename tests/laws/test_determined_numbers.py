"""Every number that a scene may call `estimated`, at both ends of its range."""

from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
import pytest

import lampest
from lampest.audit.advice import searched_effects
from lampest.files.document import parse_document, validated
from lampest.inference.effects.effect import SceneEffect
from lampest.inference.noise import NoiseEstimate
from lampest.inference.resolve import ENTRIES, MODEL_ERROR, OF_NOISE, resolved_scene
from lampest.panel.scene import scene_text, specified
from lampest.panel.sizes import ESTIMATED, Systematic

SHAPE = (4, 5)
KEYS = sorted({*chain.from_iterable(entry.keys for entry in ENTRIES), OF_NOISE, MODEL_ERROR})
BEYOND_EVERY_RANGE = (1e-40, 1e40, -1e-40, -1e40, 1.0 + 1e-15)
PASSES = "readout.passes_volt"  # its pair is a range
OF_LINES = ("contacts", "leaks")  # a number for each line, and none in the scene's key


def scene_that_asks_for(key: str) -> lampest.Scene:
    section, _, name = key.rpartition(".")
    readout = lampest.TwoPointReadout(noise_lsb=0.7)
    scene = lampest.Scene(lampest.Panel(*SHAPE), readout)
    entry: dict[str, Any] = {name: ESTIMATED}
    if section == "readout.converter":
        return replace(scene, readout=replace(readout, converter=lampest.Characteristic(**entry)))
    if section == "readout":
        return replace(scene, readout=replace(readout, **entry))
    if section == "systematic":
        return replace(scene, systematic=Systematic(**entry))
    return replace(scene, **entry)


def noise_that_determined(key: str, pair: tuple[float, float]) -> NoiseEstimate:
    readings = lampest.Recording.from_array(np.full((2, *SHAPE), 1e3), unit="ohm").readings()
    return NoiseEstimate(None, (), readings).determined(key, pair)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("number", BEYOND_EVERY_RANGE)
def test_a_scene_accepts_every_number_that_its_recording_determines(
    key: str, number: float
) -> None:
    pair = (0.0, abs(number)) if key == PASSES else (number, abs(number))
    determined = f"{key} of row 1" if key in OF_LINES else key
    scene = resolved_scene(scene_that_asks_for(key), noise_that_determined(determined, pair))
    assert specified(scene, key) != ESTIMATED
    read_again = validated(parse_document(scene_text(scene), "scene"), lampest.Scene)
    assert read_again == scene
    assert read_again.estimated == scene.estimated


def test_every_effect_is_searched_for_once() -> None:
    effects = searched_effects()
    assert {type(effect) for effect in effects} == {type(entry.load()) for entry in ENTRIES}
    assert len(effects) == len(ENTRIES)
    assert all(isinstance(effect, SceneEffect) for effect in effects)
