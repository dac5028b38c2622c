"""The preparation of a recording."""

from pathlib import Path

import pytest

import lampest
from lampest.cost.terms import LogGradient, Misfit
from lampest.estimate import prepared as preparation
from lampest.estimate.estimator import Estimator
from lampest.estimate.prepared import Prepared
from lampest.estimate.sequence import reconstruct
from lampest.files.errors import InputError
from lampest.report.detect.detection import known_of

STEPS = ("cleaned_together", "scatter_seen", "with_still_cells", "warnings_of")


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The steps of a preparation, in the order in which they were taken."""
    taken: list[str] = []

    def counted(name: str) -> None:
        step = getattr(preparation, name)
        monkeypatch.setattr(preparation, name, lambda *given: (taken.append(name), step(*given))[1])

    for name in STEPS:
        counted(name)
    return taken


def test_estimates_detection_and_warnings_share_one_preparation(steps: list[str]) -> None:
    prepared = Prepared(lampest.Recording.load(Path("data/lamprey_35mm.h5")))
    for terms in ((Misfit(),), (Misfit(), LogGradient(weight=1.0))):
        found = reconstruct(prepared, Estimator(terms, "reduced"))
        assert found.checks == prepared.warnings and found.noise is prepared.noise
        assert found.model_check is prepared.check
    known_of(prepared)
    assert sorted(steps) == sorted(STEPS)


def test_what_is_no_recording_is_refused() -> None:
    with pytest.raises(InputError, match="recording must be a Recording"):
        Prepared.of("mine.h5")
