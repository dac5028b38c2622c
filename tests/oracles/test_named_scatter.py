"""The verdict on scatter at rest that a scene names: noise, gain or ripple."""

from dataclasses import replace

import pytest
from promises import promise

import lampest
from lampest.inference.prepared import Prepared

SCATTER = "the unloaded frames scatter"
READOUT = lampest.TwoPointReadout(adc_bits=12, readings=1, noise_lsb=1.0)
RECORDED = {
    name: lampest.simulate(
        lampest.Simulation(
            1,
            3,
            lampest.Scene(lampest.Panel(5, 6), READOUT),
            frames=1,
            baseline_frames=8,
            unmodelled=lampest.Unmodelled(**effect),
        )
    )
    for name, effect in {
        "ripple": {"supply_ripple_lsb": 10.0},
        "gain": {"gain_spread": 0.01},
    }.items()
}


def doubted_scatter(name: str, noise_lsb: float | str, **named: str) -> bool:
    """Return whether scatter is a doubt where a scene specifies this noise and these effects."""
    recording = RECORDED[name]
    readout = replace(READOUT, noise_lsb=noise_lsb)
    scene = replace(recording.scene, readout=readout, **named)
    return SCATTER in Prepared(replace(recording, scene=scene)).check.sentence


@promise(
    "theory/model_check: noise, a gain or a ripple that the scene calls `estimated` is no doubt"
)
@pytest.mark.parametrize("name", ["ripple", "gain"])
def test_scatter_is_a_doubt_only_where_the_scene_does_not_name_it(name: str) -> None:
    assert doubted_scatter(name, 1.0)
    assert not doubted_scatter(name, 1.0, **{name: "estimated"})
    assert not doubted_scatter(name, "estimated")


@pytest.mark.parametrize("name", ["ripple", "gain"])
def test_noise_that_contradicts_the_scene_is_a_doubt_beside_named_effects(name: str) -> None:
    assert doubted_scatter(name, 0.1, **{name: "estimated"})
