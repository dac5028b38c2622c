"""Times that cannot be right are named, beside the units of readings."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lampest import Recording
from lampest.estimate.prepared import Prepared


@pytest.mark.parametrize(
    ("step", "said"),
    [(0.0, "frames have the time of the frame before"), (50.0, "frames are 50 s apart: are times in s?"), (0.05, "")],
)
def test_equal_times_and_times_in_ms_are_named(disk: SimpleNamespace, step: float, said: str) -> None:
    small = Recording.load(disk.folder / "small.h5")
    timed = replace(small, time=step * np.arange(len(small.time)), simulation=None, acquisition=None)
    lines = Prepared(timed).warnings
    assert any(said in line for line in lines) if said else not any("time" in line for line in lines)
