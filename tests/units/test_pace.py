"""The remaining time of a batch weighs estimators by their own speed."""

from types import SimpleNamespace
from typing import Any

import pytest
from promises import promise

from lampest.runs.batch import Pace


def pace(*frame_seconds: float) -> Pace:
    """Return the pace of cases of 100 frames, before the first."""
    cases: Any = [
        SimpleNamespace(name=f"{number}", cells=100, frames=100, frame_seconds=seconds)
        for number, seconds in enumerate(frame_seconds)
    ]
    return Pace.begun(cases, 0.0)


def test_before_the_first_frame_the_expected_time_is_left() -> None:
    assert pace(0.01, 0.05).left_s(1) == pytest.approx(6.0)
    assert pace(0.01, 0.05).left_s(2) == pytest.approx(3.0)


@promise("howto/batches: The remaining time weighs estimators by their own speed")
def test_a_fast_estimator_does_not_speak_for_a_slow_one() -> None:
    begun = pace(0.01, 0.05).after((10, 0), 5.0)
    assert begun.left_s(1) == pytest.approx(5.9), "the first frames end with the preparation"
    first = begun.after((60, 0), 6.0)  # 20 ms a frame, twice the expected time
    assert first.left_s(1) == pytest.approx(40 * 0.02 + 100 * 0.1)
    second = first.after((100, 10), 7.0).after((100, 20), 8.5)
    assert second.left_s(1) == pytest.approx(80 * 0.15)


def test_estimators_that_advance_together_share_the_time() -> None:
    begun = pace(0.01, 0.05).after((10, 10), 1.0)
    both = begun.after((20, 15), 2.0)  # 50 and 100 ms, in turn
    assert both.left_s(2) == pytest.approx(80 * 0.05 + 85 * 0.1)
    assert both.after((20, 15), 3.0) == both
