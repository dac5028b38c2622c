"""Effects that other things imitate: the slope of a load, jitter, and errors of readings."""

from dataclasses import replace

import numpy as np
import pytest
from promises import promise

from docs.studies.effects import LOADS, ROWS, Row, figures, recording
from lampest import Systematic
from lampest.audit.advice import unnamed_effects
from lampest.audit.health import Health
from lampest.inference.effects.motion import (
    MotionEvidence,
    MotionSearch,
    moving_frames,
    share_of_motion,
)
from lampest.inference.evidence import usual_starts
from lampest.inference.prepared import Prepared
from lampest.panel.effects.converter_memory import KeptShare

SPREAD = "systematic.channel_spread_ohm"
SERIES = "systematic.series_tolerance_ohm"


def test_the_slope_of_a_palm_is_not_taken_for_a_resistance_in_series() -> None:
    """It was taken for 411 +- 6 ohm, where 20 were right."""
    row = ROWS["series +20 ohm"]
    noise = Prepared(recording(100, LOADS["palm"], row, row.estimated)).noise
    assert noise.estimated.get(SERIES, (0.0, 0.0))[0] < 80
    assert (SERIES in noise.estimated) != ("press a few cells" in noise.sentence)


@pytest.mark.long
@pytest.mark.parametrize("true_ohm", [2, 10])
def test_the_unloaded_panel_tells_the_spread_of_channels_under_a_palm(true_ohm: int) -> None:
    """The slope of the palm was taken for 75 ohm, whatever was right."""
    row = ROWS[f"channels of {true_ohm} ohm"]
    noise = Prepared(recording(100, LOADS["palm"], row, row.estimated)).noise
    spread, deviation = noise.estimated[SPREAD]
    assert abs(spread - true_ohm) < 2 * deviation and deviation < 0.8 * spread


def test_channels_are_told_beside_errors_of_each_reading() -> None:
    both = Systematic(channel_spread_ohm="estimated", reading_error="estimated")
    of_both = recording(100, LOADS["still"], Row(channel_ohm=10, static=0.01), {"systematic": both})
    noise = Prepared(of_both).noise
    spread, deviation = noise.estimated[SPREAD]
    size, size_deviation = noise.estimated["systematic.reading_error"]
    assert abs(spread - 10) < 2 * deviation
    assert abs(size - 0.01) < 2 * size_deviation


@pytest.mark.slow
@promise("howto/error_bars: With `motion`, bars also hold loads that jitter within a scan.")
@pytest.mark.parametrize("motion", ["estimated", 1.0])
def test_bars_hold_a_load_that_jitters_within_a_scan(motion: str | float) -> None:
    """With the steps between frames alone, 51 to 58 % of the changes were held."""
    jitter = recording(500, LOADS["jitter"], Row(), {"motion": motion})
    of_load = figures(jitter, advised=False)
    assert of_load.own > 85 and of_load.changes > 85
    assert 0.03 < Prepared(jitter).noise.motion.jitter < 0.12


@pytest.mark.slow
def test_bars_hold_a_load_whose_jitter_moves_most_cells() -> None:
    """No cells stood still without jitter, and 16 % were held."""
    jitter = recording(101, LOADS["jitter"], Row(), {"motion": 1.0})
    assert figures(jitter, advised=False).own > 85
    assert Health.of(jitter).well


@pytest.mark.slow
def test_a_load_that_jitters_is_advised_to_be_named() -> None:
    jitter = Prepared(recording(500, LOADS["jitter"], Row(), {}))
    assert "motion: estimated" in {finding.line for finding in unnamed_effects(jitter)}


@pytest.mark.long
@pytest.mark.parametrize(("seed", "advised"), [(500, True), (101, False)])
def test_jitter_that_moves_most_cells_is_estimated_and_not_advised(
    seed: int, advised: bool
) -> None:
    """A load on most cells, such as a hand, looks like one that jitters."""
    prepared = Prepared(recording(seed, LOADS["jitter"], Row(), {}))
    compared = prepared.recording, prepared.noise.readings
    assert share_of_motion(*compared, 1.0) is not None
    assert (share_of_motion(*compared, 1.0, may_jitter=False) is not None) == advised


def test_the_slope_of_the_evidence_of_motion_is_that_of_its_cost() -> None:
    prepared = Prepared(recording(500, LOADS["jitter"], Row(), {}))
    moving = moving_frames(prepared.recording, prepared.noise.readings, None, None)
    search = MotionSearch(moving, own=1e-4)
    middle = np.array([0.4, 2e-3, 1e-5])
    changes = [frame.changes_by(middle) for frame in moving]
    moved = [of_frame.selected(usual_starts(of_frame.change))[1] for of_frame in changes]

    def evidence(position: np.ndarray) -> MotionEvidence:
        return search.evidence(position, [each.changes_by(position) for each in moving], moved)

    for number, step in enumerate(1e-3 * middle):
        apart = np.eye(3)[number] * step
        rise = evidence(middle + apart).cost - evidence(middle - apart).cost
        assert rise / (2 * step) == pytest.approx(evidence(middle).gradient[number], rel=1e-3)
    assert (np.linalg.eigvalsh(evidence(middle).normal) > 0).all()


def test_a_search_for_motion_takes_few_steps_where_a_load_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With and without jitter, and from each of two starts: three evaluations at most."""
    prepared = Prepared(recording(500, LOADS["still"], Row(), {}))
    tried = []
    evaluate = MotionSearch.evidence

    def counted(self: MotionSearch, position: np.ndarray, *given: object) -> MotionEvidence:
        tried.append(tuple(position))
        return evaluate(self, position, *given)

    monkeypatch.setattr(MotionSearch, "evidence", counted)
    assert share_of_motion(prepared.recording, prepared.noise.readings).gain < 1
    assert len(tried) <= 12


def test_a_load_that_stands_does_not_jitter() -> None:
    standing = recording(500, LOADS["still"], Row(), {"motion": "estimated"})
    noise = Prepared(standing).noise
    assert noise.motion.jitter < 0.002
    known = Prepared(replace(standing, scene=replace(standing.scene, motion=1.0))).noise
    assert known.motion.jitter < 0.002


@pytest.mark.slow
def test_bars_carry_the_memory_that_a_palm_does_not_tell() -> None:
    row = ROWS["memory of 3 %"]
    palm = recording(102, LOADS["palm"], row, row.estimated)
    noise = Prepared(palm).noise
    share, deviation = noise.estimated["converter_memory"]
    assert share == 0 and deviation > 0.02
    assert figures(palm, advised=False).own > 90
    unaware = replace(palm, scene=replace(palm.scene, converter_memory=None))
    assert figures(unaware, advised=False).own < 88


def test_an_edge_that_looks_like_a_memory_is_within_its_deviation() -> None:
    """The edge of a rod gave 0.0385 +- 0.0027."""
    row = ROWS["memory of 3 %"]
    rod = Prepared(recording(100, LOADS["still"], row, row.estimated)).noise
    share, deviation = rod.estimated["converter_memory"]
    assert abs(share - 0.03) < 2 * deviation < 0.03
    assert rod.frame.memory == deviation


def test_a_load_that_jitters_tells_no_memory() -> None:
    """It was taken for a memory of 0.22 +- 0.01."""
    both = {"converter_memory": "estimated", "motion": "estimated"}
    noise = Prepared(recording(102, LOADS["jitter"], Row(), both)).noise
    assert "converter_memory" not in noise.estimated
    assert "record one that stands" in noise.sentence
    assert noise.frame.memory == KeptShare.prior == 0.03
