"""Use of the methods by the paper's own criterion, the look of a map.

Size and alarm: docs/studies/mouths.md.

    lampest run configs/real_run.yaml
    python -m docs.studies.paper_ranking results/real_run

Look: correlation of the map as the paper draws it, clipped at ±100 %, with the truth drawn so;
median over loaded frames. The clean recordings and those of a panel like the paper's (real_*) have
a table each; those without a truth are left out.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lampest.panel.panel import Array
from lampest.report.strongest import percent_change
from lampest.runs.results import CaseResult, Results, read_results

MEASURED = "measured"


def likeness(change: Array, truth: Array) -> Array:
    """Correlation of clipped maps, frame by frame."""
    drawn, true = (np.clip(maps, -100, 100).reshape(len(maps), -1) for maps in (change, truth))
    return np.array(
        [
            np.corrcoef(record, truth_map)[0, 1]
            for record, truth_map in zip(drawn, true, strict=True)
        ]
    )


def looks(results: Results, recordings: Sequence[str]) -> dict[str, list[float]]:
    """Source → likeness of every frame of these recordings that is solved."""
    estimates: dict[str, list[float]] = {}
    for name in recordings:
        cases = results.of(name)
        truth = _true_change(cases[0])
        estimates.setdefault(MEASURED, []).extend(
            likeness(percent_change(cases[0].measured, cases[0].measured_baseline), truth)
        )
        for case in cases:
            good = case.solved
            estimates.setdefault(case.estimator, []).extend(
                likeness(case.relative_change[good], truth[good])
            )
    return estimates


def _true_change(case: CaseResult) -> Array:
    assert case.truth is not None and case.truth_baseline is not None
    return percent_change(case.truth, case.truth_baseline)


def main() -> None:
    """Print two tables a folder: clean recordings, and those of a panel like the paper's."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    for folder in parser.parse_args().folders:
        results = read_results(folder / "results.h5")
        judged = [name for name in results.recordings() if results.of(name)[0].truth is not None]
        for kind, real in (("clean", False), ("like the paper's panel", True)):
            recordings = [name for name in judged if name.startswith("real_") == real]
            print(f"\n{folder}, {kind}\n\n| | look |\n|---|---|")
            for source, likenesses in looks(results, recordings).items():
                print(f"| {source} | {np.median(likenesses):.2f} |")


if __name__ == "__main__":
    main()
