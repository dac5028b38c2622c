"""Blocks: frames of one stream that are solved together."""

import numpy as np
import pytest

import lampest
from docs.studies.blocks import jumping_between_rods, under_a_rod
from lampest.estimate.batch import leading_frames, push_block
from lampest.estimate.sequence import first_stream
from lampest.inference.prepared import Prepared
from lampest.recording.readings import Readings

SIDE = 6
PERIOD_S = 0.1
LOADS = 4
TERMS = (lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=1.0))
# Of ln r: solves end at steps below 1e-8.
SAME_ESTIMATE = 1e-6


@pytest.fixture(scope="module")
def jumping() -> tuple[lampest.Stream, Readings]:
    """The stream after its first frame, and the readings of the others."""
    recording = jumping_between_rods(SIDE, PERIOD_S)
    prepared = Prepared(recording)
    readings = prepared.noise.readings[recording.measured_frames()]
    estimator = lampest.Estimator(TERMS, "reduced")
    stream = first_stream(recording, prepared.noise.readings, estimator, prepared.noise)
    stream, _ = stream.push(readings[0])
    return stream, readings[1:]


def test_every_load_between_which_frames_jump_has_a_leader(
    jumping: tuple[lampest.Stream, Readings],
) -> None:
    _, readings = jumping
    leaders, nearest = leading_frames(readings)
    assert {leader % LOADS for leader in leaders} == set(range(LOADS))
    assert all(leader % LOADS == frame % LOADS for frame, leader in enumerate(nearest))


def test_near_copies_of_a_frame_have_one_leader() -> None:
    """Frames that differ by noise alone are solved together from the last estimate on."""
    recording = under_a_rod(SIDE, PERIOD_S)
    readings = Prepared(recording).noise.readings[recording.measured_frames()]
    leaders, _ = leading_frames(readings)
    assert leaders == [0]


def test_frames_of_a_block_are_those_that_are_pushed_alone(
    jumping: tuple[lampest.Stream, Readings],
) -> None:
    stream, readings = jumping
    alone = stream
    for frame, (_, step) in enumerate(push_block(stream, readings)):
        alone, single = alone.push(readings[frame])
        difference = np.log(step.cell_resistance / single.cell_resistance)
        assert np.abs(difference).max() < SAME_ESTIMATE
        assert step.bars is not None
        assert single.bars is not None
        np.testing.assert_allclose(
            step.bars.frame.deviation, single.bars.frame.deviation, rtol=SAME_ESTIMATE
        )


def test_followers_begin_near_their_estimates(jumping: tuple[lampest.Stream, Readings]) -> None:
    stream, readings = jumping
    leaders, _ = leading_frames(readings)
    iterations = np.array([step.solution.iterations for _, step in push_block(stream, readings)])
    leads = np.isin(np.arange(len(iterations)), leaders)
    assert np.median(iterations[~leads]) < np.median(iterations[leads])
