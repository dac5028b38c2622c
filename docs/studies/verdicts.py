"""Verdicts on right circuits and on wrong ones, under loads of all sizes.

Run it with: python -m docs.studies.verdicts [--recordings 12] [--seed 1000]

Right recordings are those of `docs.studies.wrong_readings`. Wrong ones are read by one of four
circuits with the same parts, and told as another one.
"""

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np

from docs.studies.wrong_readings import Shown, drawn, of_load
from lampest import GroundedReadout, LoadedColumnsReadout, Recording
from lampest.inference.prepared import Prepared

LOADS = ("palm", "feet", "sway", "places", "keys", "sweep")
OHM = {"drive_ohm": 50.0, "load_ohm": 1000.0}
CIRCUITS = {
    "one load": GroundedReadout(sense="one", **OHM),
    "loads stay": GroundedReadout(sense="all", **OHM),
    "columns driven": GroundedReadout(driven="columns", **OHM),
    "rows float": LoadedColumnsReadout(**OHM),
}


def told_wrong(plan: Shown, seed: int) -> Recording:
    """Return a recording by one circuit that its scene tells as another one."""
    pair = np.random.default_rng(seed).choice(list(CIRCUITS), 2, replace=False)
    converter = plan.scene.circuit
    keys = {key: getattr(converter, key) for key in ("adc_bits", "readings", "noise_lsb")}
    told, true = (
        replace(plan.scene, readout=replace(CIRCUITS[name], supply_volt=5.0, **keys))
        for name in pair
    )
    plan = replace(plan, scene=told)
    return plan.recording(plan.volts(true))


def main() -> None:
    """Print how many have each verdict, by load."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1000)
    options = parser.parse_args()
    for load in LOADS:
        right, wrong = Counter[str](), Counter[str]()
        for seed in range(options.seed, options.seed + options.recordings):
            plan = drawn(seed, of_load(load))
            right[Prepared(plan.recording()).check.mark] += 1
            wrong[Prepared(told_wrong(plan, seed)).check.mark] += 1
        print(f"{load:6} right {dict(right)}, wrong {dict(wrong)}", flush=True)


if __name__ == "__main__":
    main()
