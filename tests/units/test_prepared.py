"""The preparation of a recording."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lampest
from lampest import Estimator, InputError, LogGradient, Misfit, ModelCheck, Recording
from lampest.estimate import prepared as preparation
from lampest.estimate.prepared import Prepared
from lampest.estimate.sequence import reconstruct
from lampest.report.detect.detection import known_of

STEPS = ("cleaned_together", "estimate_noise", "with_still_cells", "warnings_of")


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The steps of a preparation, in the order in which they were taken."""
    taken: list[str] = []

    def counted(name: str, step: Callable[..., Any], *given: Any) -> Any:
        taken.append(name)
        return step(*given)

    for name in STEPS:
        monkeypatch.setattr(preparation, name, partial(counted, name, getattr(preparation, name)))
    return taken


def test_estimates_detection_and_warnings_share_one_preparation(steps: list[str]) -> None:
    prepared = Prepared(lampest.Recording.load(Path("data/lamprey_35mm.h5")))
    for terms in ((Misfit(),), (Misfit(), LogGradient(weight=1.0))):
        found = reconstruct(prepared, Estimator(terms, "reduced"))
        assert found.checks == prepared.warnings and found.noise is prepared.noise
        assert found.model_check is prepared.check
    known_of(prepared)
    assert sorted(steps) == sorted(STEPS)


def test_a_check_that_explains_adds_the_numbers_that_no_frame_shows() -> None:
    recording = replace(lampest.Recording.load(Path("data/lamprey_35mm.h5")), raw_sums=None)
    silent = replace(recording, scene=replace(recording.scene, readout=None))
    for explains, taken in product((True, False, None), (recording, silent)):
        prepared = Prepared(taken)
        prepared.__dict__["_check"] = ModelCheck(explains, "as it stands")
        added = "; no frame shows the numbers" if explains and taken is recording else ""
        sentence = prepared.check.sentence
        assert sentence.startswith(f"as it stands{added}") and bool(added) == (sentence != "as it stands")


def test_what_is_no_recording_is_refused() -> None:
    with pytest.raises(InputError, match="recording must be a Recording"):
        Prepared.of("mine.h5")


@pytest.mark.parametrize(
    ("step", "said"),
    [(0.0, "frames have the time of the frame before"), (50.0, "frames are 50 s apart: are times in s?"), (0.05, "")],
)
def test_equal_times_and_times_in_ms_are_named(disk: SimpleNamespace, step: float, said: str) -> None:
    small = Recording.load(disk.folder / "small.h5")
    timed = replace(small, time=step * np.arange(len(small.time)), simulation=None, acquisition=None)
    lines = Prepared(timed).warnings
    assert any(said in line for line in lines) if said else not any("time" in line for line in lines)
