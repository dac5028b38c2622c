"""kill -9 at random moments: the run resumes, and its results are those of an undisturbed one, bit for bit."""

from pathlib import Path

import pytest
from fuzz.batches import batch, killed_again_and_again


@pytest.mark.slow
def test_killed_runs_resume(tmp_path: Path) -> None:
    assert killed_again_and_again(tmp_path, batch(tmp_path, 2, (1e-4,)), 2, 1)["kills"] == 2


@pytest.mark.soak
def test_fifty_kills_lose_and_alter_no_result(tmp_path: Path) -> None:
    made = batch(tmp_path, 8, (1e-4, 1e-3, 1e-2))
    counts = killed_again_and_again(tmp_path, made, 50, 2)
    print(f"\n{made.cases} cases; {dict(counts)}; no result lost, none altered")
    assert counts["kills"] == 50
