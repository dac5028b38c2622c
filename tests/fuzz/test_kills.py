"""kill -9 at random moments: the run resumes, and its results are those of an undisturbed one, bit for bit."""

import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from fuzz.batches import Batch, batch, content, finished, kill, session, until

WHOM = ("command", "all", "worker")


def killed_again_and_again(tmp_path: Path, made: Batch, kills: int, seed: int) -> Counter[str]:
    """Kill as often, resume each time, and compare every folder that gets done; how often what happened."""
    rng, counts, folder = np.random.default_rng(seed), Counter[str](), 0
    begin = time.monotonic()
    made.finish(tmp_path / "undisturbed", 2)
    longest = time.monotonic() - begin
    undisturbed = content(tmp_path / "undisturbed" / "results.h5")
    while counts["kills"] < kills:
        out = tmp_path / f"out{folder}"
        before = finished(out)
        run = made.start(out, int(rng.integers(1, 3)))
        whom = WHOM[int(rng.integers(len(WHOM)))]
        time.sleep(float(rng.uniform(0.1 * longest, longest)))
        alive = run.poll() is None
        if alive:
            kill(run, whom, rng)
            counts.update({"kills": 1, whom: 1})
        _, said = run.communicate(timeout=300)
        assert "Traceback" not in said
        until(lambda leader=run.pid: not session(leader))
        assert finished(out) >= before
        if run.returncode == 0:
            assert content(out / "results.h5") == undisturbed
            folder, counts = folder + 1, counts + Counter(done=1)
    made.finish(tmp_path / f"out{folder}")
    assert content(tmp_path / f"out{folder}" / "results.h5") == undisturbed
    assert not list(tmp_path.rglob("*.part"))
    return counts


@pytest.mark.slow
def test_killed_runs_resume(tmp_path: Path) -> None:
    assert killed_again_and_again(tmp_path, batch(tmp_path, 2, (1e-4,)), 2, 1)["kills"] == 2


@pytest.mark.soak
def test_fifty_kills(tmp_path: Path) -> None:
    made = batch(tmp_path, 8, (1e-4, 1e-3, 1e-2))
    counts = killed_again_and_again(tmp_path, made, 50, 2)
    print(f"\n{made.cases} cases; {dict(counts)}; no result lost, none altered")
    assert counts["kills"] == 50
