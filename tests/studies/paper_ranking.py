"""What methods are good for, as the paper asks: the look of a map, the size of a mouth, an alarm.

    lampest run configs/real_run.yaml; lampest detect results/real_run/results.h5
    python -m tests.studies.paper_ranking results/real_run

Look: correlation of the map as the paper draws it, clipped at ±100 %, with the truth drawn so; median over loaded
frames. Size: how far off the diameter of what is recognised is, and how often its 95 % interval holds it. Alarm: frames
of lampreys with "lamprey" in their label, and frames of everything else that are called "lamprey" alone.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

from lampest.panel.panel import Array
from lampest.report.plots.contours import percent_change
from lampest.runs.results import CaseResult, Results, read_results

DIAMETER_MM: Mapping[str, float] = {"rod": 40.0, "ring": 35.0, "cup": 35.0, "lamprey_35": 35.0, "lamprey_25": 25.0}
MEASURED, READINGS = "measured", "recording"


def likeness(change: Array, truth: Array) -> Array:
    """Correlation of clipped maps, frame by frame."""
    drawn, true = (np.clip(maps, -100, 100).reshape(len(maps), -1) for maps in (change, truth))
    return np.array([np.corrcoef(one, other)[0, 1] for one, other in zip(drawn, true, strict=True)])


def looks(results: Results) -> dict[str, list[float]]:
    """Source → likeness of every frame that is solved."""
    found: dict[str, list[float]] = {}
    for name in results.recordings():
        cases = results.of(name)
        truth = _true_change(cases[0])
        found.setdefault(MEASURED, []).extend(
            likeness(percent_change(cases[0].measured, cases[0].measured_baseline), truth)
        )
        for case in cases:
            good = case.solved
            found.setdefault(case.estimator, []).extend(likeness(case.relative_change[good], truth[good]))
    return found


def _true_change(case: CaseResult) -> Array:
    assert case.truth is not None and case.truth_baseline is not None
    return percent_change(case.truth, case.truth_baseline)


def sizes_and_alarms(file: Path) -> dict[str, dict[str, list[float]]]:
    """Source → errors of the diameter in mm, whether its interval holds it, whether the label is right."""
    found: dict[str, dict[str, list[float]]] = {}
    with h5py.File(file) as content:
        for recording, group in content["entry"].items():
            true = next(size for part, size in DIAMETER_MM.items() if part in recording)
            for source in group:
                own = found.setdefault(source, {"error": [], "held": [], "lamprey": [], "false": []})
                part = group[source]
                diameter, sd = part["diameter"][:], part["diameter_errors"][:]
                known = np.isfinite(diameter)
                own["error"] += list(np.abs(diameter[known] - true))
                own["held"] += list(np.abs(diameter[known] - true) <= 1.96 * sd[known])
                alone = [label.decode() == "lamprey" for label in part["label"][:]]
                named = ["lamprey" in label.decode() for label in part["label"][:]]
                if "lamprey" in recording:
                    own["lamprey"] += named
                else:
                    own["false"] += alone
    return found


def main() -> None:
    """One table for each folder of results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    for folder in parser.parse_args().folders:
        results = read_results(folder / "results.h5")
        seen = looks(results)
        detected = sizes_and_alarms(folder / "detections.h5")
        print(f"\n{folder}\n\n| | look | size: error [mm] | held [%] | named [%] | falsely [%] | ms |")
        print("|---|---|---|---|---|---|---|")
        times = {
            name: 1e3 * np.median([np.median(c.solve_time[c.solved]) for c in results.cases if c.estimator == name])
            for name in {case.estimator for case in results.cases}
        }
        for source in (MEASURED, *dict.fromkeys(case.estimator for case in results.cases)):
            own = detected.get(READINGS if source == MEASURED else source)
            look = f"{np.median(seen[source]):.2f}"
            if own is None:
                print(f"| {source} | {look} | | | | | |")
                continue
            numbers = (
                f"{np.median(own['error']):.1f} / {np.percentile(own['error'], 95):.0f}",
                f"{100 * np.mean(own['held']):.0f}",
                f"{100 * np.mean(own['lamprey']):.0f}",
                f"{100 * np.mean(own['false']):.0f}",
                f"{times[source]:.1f}" if source in times else "",
            )
            print(f"| {source} | {look} | {' | '.join(numbers)} |")


if __name__ == "__main__":
    main()
