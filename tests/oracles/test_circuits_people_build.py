"""Circuits with potentials, described as others: the check of the circuit names their line."""

from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest

from lampest import (
    DrivenReadout,
    GroundedReadout,
    LoadedColumnsReadout,
    Panel,
    Recording,
    Scene,
    TwoPointReadout,
    VirtualGroundReadout,
)
from lampest.audit.advice import Audit
from lampest.inference.prepared import Prepared
from tests.netlist import volts

SHAPE = (7, 6)
FRAMES = 4
CONVERTER: dict[str, Any] = {"supply_volt": 5.0, "adc_bits": 12, "readings": 1}
BLOCKS = ((0, 1, 2, 3), (4, 5, 6))
IN_TURN = ((0, 2, 4), (1, 3, 5))
LOADED = LoadedColumnsReadout(load_ohm=6800.0, drive_ohm=40.0, **CONVERTER)
GROUNDED = GroundedReadout(load_ohm=4700.0, drive_ohm=40.0, **CONVERTER)
FEEDBACK = DrivenReadout(
    load_ohm=4700.0,
    drive_ohm=40.0,
    idle_ohm=40.0,
    idle_volt="follows",
    idle_load_ohm=inf,
    **CONVERTER,
)


def audit(built: Any, stated: Any) -> Audit:
    """Audit of five pressed cells that one circuit reads and a scene describes as another."""
    rng = np.random.default_rng(4)
    resting = 8000 * np.exp(0.25 * rng.normal(size=SHAPE))
    loaded = resting.copy()
    loaded[2:4, 1:3] = 1500 * np.exp(0.3 * rng.normal(size=(2, 2)))
    loaded[5, 4] = 1300.0
    exact = np.repeat([volts(resting, built), volts(loaded, built)], FRAMES, axis=0)
    noise = 0.6 * built.lsb_volt * rng.normal(size=exact.shape)
    codes = built.code_from_volt(exact + noise)
    scene = Scene(Panel(*SHAPE), stated)
    recording = Recording.from_array(1.0 * codes, unit="code", scene=scene, baseline=FRAMES)
    return Audit(Prepared(recording))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("built", "stated", "line"),
    [
        (replace(LOADED, load_volt=2.5), LOADED, "readout: {load_volt: 2.5}"),
        (replace(GROUNDED, load_volt=2.5), GROUNDED, "readout: {load_volt: 2.5}"),
        (
            replace(LOADED, driven_groups=BLOCKS),
            LOADED,
            "readout: {driven_groups: [[0, 1, 2, 3], [4, 5, 6]]}",
        ),
        (
            replace(LOADED, groups=IN_TURN),
            LOADED,
            "readout: {groups: [[0, 2, 4], [1, 3, 5]]}",
        ),
        (replace(LOADED, adc_bits=10), LOADED, "readout: {adc_bits: 10}"),
        (
            FEEDBACK,
            replace(GROUNDED, sense="one"),
            "readout: {kind: driven, driven: rows, polarity: up, idle_ohm: 40, idle_volt: follows, "
            "idle_load_ohm: .inf, load_ohm: 4700}",
        ),
    ],
    ids=["mid-supply", "grounded mid-supply", "driven groups", "in turn", "bits", "feedback"],
)
def test_a_circuit_that_people_build_is_named_with_its_line(
    built: Any, stated: Any, line: str
) -> None:
    audited = audit(built, stated)
    assert audited.verdict.mark == "no"
    [finding] = [finding for finding in audited.advice if finding.room == "circuit"]
    assert finding.line == line


@pytest.mark.slow
def test_no_amplifier_is_advised_where_each_reading_would_be_a_cell() -> None:
    stated = TwoPointReadout(reference_ohm=4700.0, **CONVERTER)
    check = audit(FEEDBACK, stated).prepared.check
    assert check.mark == "no"
    assert not check.better


@pytest.mark.slow
def test_amplifiers_are_named_where_a_press_moves_its_own_readings_alone() -> None:
    built = VirtualGroundReadout(feedback_ohm=1000.0, drive_ohm=40.0, **CONVERTER)
    check = audit(built, replace(GROUNDED, load_ohm=1000.0)).prepared.check
    assert "virtual_ground" in check.better
