"""What can be tuned."""

from pathlib import Path

from lampest.runs.config import read_run
from lampest.studies.weights import why_not


def test_shipped_file_can_be_tuned() -> None:
    cases = read_run(Path(__file__).parents[2] / "configs" / "tune.yaml").cases
    assert len(cases) == 8
    assert all(case.estimator.automatic and why_not(case.estimator, 200) is None for case in cases)
