"""Cost of a case apart from its solve.

Run it with: python -m docs.studies.many_cases --recordings 40 --estimators 50.

Processor time of one process, so that other work on the machine does not count: reading the run's
file, solving (what the estimator does, error bars left out), what follows from estimates, writing
each case and results.h5, and the same run once more, which finds every case done.
"""

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import lampest
from lampest.runs import batch
from lampest.runs.config import read_run
from lampest.runs.executors import local


def main() -> None:
    """Print milliseconds of processor time for each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=40)
    parser.add_argument("--estimators", type=int, default=50)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        path = written(Path(name), chosen.recordings, chosen.estimators)
        spent = Counter[str]()
        names = {"reconstruct": "solving", "case_result": "what follows", "write_results": "files"}
        parts = {name: timed(getattr(batch, name), what, spent) for name, what in names.items()}
        with mock.patch.multiple(batch, **parts):
            run = timed(read_run, "the run's file", spent)(path)
            timed(batch.run_batch, "all of it", spent)(
                run, Path(name) / "out", local(1, len(run.cases))
            )
        timed(batch.run_batch, "found done", spent)(
            run, Path(name) / "out", local(1, len(run.cases))
        )
        cases = len(run.cases)
    print(f"{cases} cases of 4 × 4 cells, 1 frame; ms of processor time for each")
    for what, seconds in spent.items():
        print(f"{what:>16} {1e3 * seconds / cases:7.2f}")
    beside = spent["the run's file"] + spent["all of it"] - spent["solving"] - spent["what follows"]
    print(f"{'beside both':>16} {1e3 * beside / cases:7.2f}")


def timed(function: Callable[..., Any], what: str, spent: Counter[str]) -> Callable[..., Any]:
    """The function with its processor time added to `spent`."""

    def call(*arguments: Any, **named: Any) -> Any:
        begin = time.thread_time()
        try:
            return function(*arguments, **named)
        finally:
            spent[what] += time.thread_time() - begin

    return call


def written(folder: Path, recordings: int, estimators: int) -> Path:
    """A run's file of so many tiny recordings with so many weights."""
    rng = np.random.default_rng(0)
    scene = lampest.Scene(
        lampest.Panel(4, 4), lampest.TwoPointReadout(noise_lsb=0.7), series_resistance_ohm=140.0
    )
    readout = scene.readout
    assert readout is not None
    for number in range(recordings):
        base = 1000 * np.exp(0.2 * rng.standard_normal((4, 4)))
        cells = np.stack([base, base * np.exp(0.3 * rng.standard_normal((4, 4)))])
        recorded = np.asarray(readout.to_recorded(readout.exact_reading(cells), scene))
        lampest.Recording(scene, recorded, np.arange(2.0), np.array([0, 1], dtype=np.uint8)).save(
            folder / f"r{number:04d}.h5"
        )
    lines = [
        f"  e{n:04d}: {{terms: {{misfit: {{}}, gradient: {{weight: "
        f"{10 ** (-5 + 4 * n / estimators):.6g}}}}}}}"
        for n in range(estimators)
    ]
    text = "\n".join(["schema: 1", "recordings: ['r*.h5']", "estimators:", *lines])
    (folder / "run.yaml").write_text(f"{text}\nformulation: reduced\nerror_bars: false\n")
    return folder / "run.yaml"


if __name__ == "__main__":
    main()
