"""Every effect that no scene names."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lampest
from lampest.panel.effects import EFFECTS, Effect, LooseContact, effect_on_readings

SCENE = lampest.Scene(lampest.Panel(3, 4), lampest.TwoPointReadout(), series_resistance_ohm=140.0)
CELLS = np.random.default_rng(1).uniform(500.0, 5000.0, (3, 4))


@pytest.mark.parametrize("kind", EFFECTS)
def test_an_effect_is_smooth_in_its_size_and_nothing_at_zero(kind: type[Effect]) -> None:
    network = SCENE.circuit.network(CELLS, SCENE.circuit.ties(CELLS), SCENE.wiring)
    places = list(kind.places(3, 4))
    assert len(set(places)) == len(places) > 0
    for lines in places:
        assert all(0 <= line < 7 for line in lines)
        effect = kind(lines)
        once, twice = (
            effect_on_readings([replace(effect, size=n * 1e-3 * kind.prior)], SCENE, network) for n in (1, 2)
        )
        assert_allclose(effect_on_readings([effect], SCENE, network), 0.0, atol=1e-9 * CELLS.max())
        assert np.abs(once).max() > 0
        assert_allclose(twice, 2 * once, rtol=1e-2, atol=1e-2 * np.abs(once).max())


@pytest.mark.parametrize("kind", EFFECTS)
def test_an_effect_has_a_sentence_with_its_line_and_its_time(kind: type[Effect]) -> None:
    effect = kind((4,), since=True, size=kind.prior)
    assert "column 1" in effect.sentence(3) and "since the unloaded frames" in effect.sentence(3)
    assert "row" in kind((2,), size=kind.prior).sentence(3)


def test_a_loose_contact_is_expected_to_add_a_hundred_ohm_to_its_line() -> None:
    network, loose = SCENE.circuit.network(CELLS, SCENE.circuit.ties(CELLS), SCENE.wiring), LooseContact((4,))
    assert LooseContact.prior == 100.0
    for size, words in ((-12.345, "12 ohm less"), (123.0, "120 ohm more")):
        effect = replace(loose, size=size)
        assert effect.sentence(3).startswith(f"{words} at the contact of column 1")
        added = np.zeros((3, 4))
        added[:, 1] = size
        assert_allclose(effect_on_readings([effect], SCENE, network), added, atol=1e-9)
