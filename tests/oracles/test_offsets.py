"""Offsets of amplifiers that the scene does not know: the truth has others than the scene."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import lampest
from lampest.inference.prepared import Prepared
from lampest.panel.effects.offsets import AmplifierOffsets
from tests.estimates import share_in_bars

SHAPE = (5, 6)
SPREAD_VOLT = 0.002  # the prior of an estimated one
NOISE_VOLT = 1e-4
MIN_WITHIN, MAX_UNNAMED = 0.9, 0.4
CIRCUITS = {
    "virtual grounds": lampest.VirtualGroundReadout(sense_ohm=20.0, feedback_ohm=1000.0),
    "followers": lampest.DrivenReadout(
        drive_ohm=50.0, idle_ohm=50.0, load_ohm=1000.0, driven="columns"
    ),
}


def recording(circuit: lampest.Readout, seed: int, size: float | str | None) -> lampest.Recording:
    """Return a recording with drawn offsets, whose scene names this size of theirs."""
    random = np.random.default_rng(seed)
    sensed = SHAPE[1] if circuit.driven == "rows" else SHAPE[0]
    # all quantiles of a normal distribution, so that few draws tell the coverage
    quantiles = norm.ppf((np.arange(sensed) + 0.5) / sensed)
    offsets = SPREAD_VOLT * random.permutation(quantiles)
    true = replace(circuit, offset_volt=tuple(offsets.tolist()))
    cells = 3000.0 * np.exp(0.1 * random.standard_normal(SHAPE))
    loaded = cells.copy()
    loaded[1:3, 2:4] *= 0.5
    scene = lampest.Scene(lampest.Panel(*SHAPE), true)
    frames = np.stack([cells] * 5 + [loaded] * 2)
    volts = true.to_recorded(true.exact_reading(frames), scene)
    volts = volts + NOISE_VOLT * random.standard_normal(volts.shape)
    named = None if size is None else lampest.Systematic(own=(("offset_spread_volt", size),))
    scene = replace(scene, readout=circuit, systematic=named)
    made = lampest.Recording.from_array(volts, unit="volt", baseline=5, scene=scene)
    truth = np.where((made.role == 1)[:, None, None], loaded, cells)
    return replace(made, sigma=np.full(SHAPE, NOISE_VOLT), truth_cell_resistance=truth)


def share(name: str, size: float | str | None) -> float:
    """Return the share of cells within their bars over four recordings."""
    return share_in_bars(recording(CIRCUITS[name], seed, size) for seed in range(4))


@pytest.mark.long
@pytest.mark.parametrize("name", CIRCUITS)
def test_bars_hold_offsets_where_the_scene_says_so(name: str) -> None:
    assert share(name, SPREAD_VOLT) > MIN_WITHIN
    assert share(name, None) < MAX_UNNAMED


def test_offsets_that_readings_do_not_show_have_a_sentence_and_their_prior() -> None:
    noise = Prepared(recording(CIRCUITS["virtual grounds"], 1, "estimated")).noise
    assert "systematic.offset_spread_volt" not in noise.estimated
    assert any("short the inputs and read the codes" in each for each in noise.warnings)
    assert share("virtual grounds", "estimated") > MIN_WITHIN


def test_other_circuits_have_no_amplifiers() -> None:
    size = lampest.Systematic(own=(("offset_spread_volt", SPREAD_VOLT),))
    plain = lampest.TwoPointReadout()
    scene = lampest.Scene(lampest.Panel(*SHAPE), plain, systematic=size)
    network = plain.network(np.full(SHAPE, 1e3), plain.ties(np.full(SHAPE, 1e3)))
    assert not len(AmplifierOffsets().columns(network, network.reading(), scene, SPREAD_VOLT))
