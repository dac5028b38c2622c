"""Mouths of the study of attachments, whose films, rims and electronics are not the package's."""

import numpy as np
import pytest

from docs.studies.attachments import SLIDES_S, SLIDING, TOUCH_S, UNLOADED, recording, seen
from lampest.estimate.prepared import Prepared
from lampest.recording.recording import Recording
from lampest.report.detect.answer import LAMPREY, Detected
from lampest.report.detect.detection import Known, known_of, measured_frames


def detected(whole: Recording) -> Detected:
    """The answer to all frames."""
    watched = known_of(Prepared(whole))
    assert isinstance(watched, Known)
    return watched.answer(measured_frames(whole, watched, np.ones(len(whole.time), dtype=bool)))


def test_a_mouth_that_breathes_deeply_is_no_row_of_steps() -> None:
    """By 14 % of its suction, so that its breath changes the readings by more than half of the load."""
    assert seen("uneven mouth", 4.0, 501003).lamprey < 10


def test_an_outlier_in_two_frames_of_three_does_not_begin_a_window_anew() -> None:
    assert seen("mouth partly off", 4.0, 501001).lamprey < 8


def test_frames_after_a_full_window_are_judged_before_the_next_is_full() -> None:
    """The first 8 s leave a breath of 6 % at 0.7 Hz open."""
    whole, *_ = recording("mouth", 4.0, 501005)
    assert detected(whole).answer == LAMPREY


def test_a_cup_that_is_shaken_is_no_lamprey_in_any_frame() -> None:
    """Its first seconds look like breath."""
    assert np.isnan(seen("shaken cup", 4.0, 812005).lamprey)


@pytest.mark.parametrize("seed", range(1, 4))
def test_a_mouth_that_slides_is_one_attachment(seed: int) -> None:
    whole, made, _, _ = recording(SLIDING, 4.0, seed, attached_s=20.0)
    answer = detected(whole)
    (attachment,) = answer.attachments
    begin = whole.time[UNLOADED] + TOUCH_S
    assert answer.answer == LAMPREY and "pumping" not in answer.sentence
    assert attachment.moved_s and begin + SLIDES_S[0] < attachment.moved_s[-1] < begin + SLIDES_S[1] + 0.5
    assert abs(attachment.place[0] - made.centres_mm[0][0]) == pytest.approx(15, abs=1)


@pytest.mark.parametrize("curve", ["straight", "delayed"])
def test_bars_of_suction_and_breath_contain_films_that_no_one_measured(curve: str) -> None:
    found = [seen("mouth", 4.0, seed, attached_s=9.0, curve=curve) for seed in range(9000, 9004)]
    suction = np.array([(one.suction - one.true_suction) / one.suction_sd for one in found])
    depth = np.array([(one.seen_depth - one.depth) / one.depth_sd for one in found])
    assert np.abs(suction).max() < 2.3 and np.abs(depth).max() < 2.3
