"""Verdicts on right circuits and on wrong ones, under loads of all sizes.

Run it with: python -m docs.studies.verdicts [--recordings 12] [--seed 1000] [--starters 0]

Right recordings are those of `docs.studies.wrong_readings`. Wrong ones are read by one of four
circuits with the same parts, and told as another one. Those of starters are right recordings by
each circuit of `lampest init` under each load; what is said of them is printed but for "yes".
"""

import argparse
from collections import Counter
from dataclasses import replace
from itertools import product

import numpy as np

from docs.studies.wrong_readings import Shown, drawn, of_load, with_starter
from lampest import GroundedReadout, LoadedColumnsReadout, Recording
from lampest.audit.advice import Audit
from lampest.inference.prepared import Prepared
from lampest.runs.starter import circuits

LOADS = ("palm", "feet", "sway", "places", "keys", "sweep")
OHM = {"drive_ohm": 50.0, "load_ohm": 1000.0}
CIRCUITS = {
    "one load": GroundedReadout(sense="one", **OHM),
    "loads stay": GroundedReadout(sense="all", **OHM),
    "columns driven": GroundedReadout(driven="columns", **OHM),
    "rows float": LoadedColumnsReadout(**OHM),
}


def read_by(plan: Shown, name: str) -> Shown:
    """Return a plan with one of the circuits, and its own converter."""
    converter = plan.scene.circuit
    keys = {key: getattr(converter, key) for key in ("adc_bits", "readings", "noise_lsb")}
    readout = replace(CIRCUITS[name], supply_volt=5.0, **keys)
    return replace(plan, scene=replace(plan.scene, readout=readout))


def told_wrong(plan: Shown, seed: int) -> Recording:
    """Return a recording by one circuit that its scene tells as another one."""
    pair = np.random.default_rng(seed).choice(list(CIRCUITS), 2, replace=False)
    told, true = (read_by(plan, name) for name in pair)
    return told.recording(told.volts(true.scene))


def of_starters(first: int) -> Counter[str]:
    """Return how many right recordings by circuits of `lampest init` have each verdict."""
    counts = Counter[str]()
    for number, (word, load) in enumerate(product(circuits(), LOADS)):
        made = with_starter(drawn(first + number, of_load(load)), word).recording()
        audit = Audit(Prepared(made))
        lines = [finding.line or finding.what for finding in audit.advice]
        counts[audit.verdict.mark] += 1
        counts["advised"] += bool(lines)
        if audit.verdict.mark != "yes" or lines:
            print(f"{word}, {load}, {first + number}: {audit.verdict.mark}, {lines}", flush=True)
    return counts


def main() -> None:
    """Print how many have each verdict, by load."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--starters", type=int, default=0, help="recordings of each circuit")
    options = parser.parse_args()
    for load in LOADS:
        right, wrong = Counter[str](), Counter[str]()
        for seed in range(options.seed, options.seed + options.recordings):
            plan = drawn(seed, of_load(load))
            right[Prepared(plan.recording()).check.mark] += 1
            wrong[Prepared(told_wrong(plan, seed)).check.mark] += 1
        print(f"{load:6} right {dict(right)}, wrong {dict(wrong)}", flush=True)
    for number in range(options.starters):
        print(f"starters: {dict(of_starters(options.seed + 1000 * number))}", flush=True)


if __name__ == "__main__":
    main()
