"""Verdicts and advice of a set of recordings, and how they differ from those of another version.

    python -m docs.studies.verdicts results/verdicts.jsonl [--before OTHER.jsonl] [--right 60]

The file gets a line for each recording: right circuits of every kind with a mouth, wrong circuits,
and right ones drawn at random. A recording that the file has is not checked again. For another
version, run this script with its PYTHONPATH.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from docs.studies.coverage import mouth_cells
from docs.studies.model_check import sound, wrong
from docs.studies.readouts import CIRCUITS, measured
from lampest import Panel, Recording, Scene
from lampest.audit.advice import Audit
from lampest.inference.prepared import Prepared

COMPARED = ("mark", "better", "doubts", "advice")


def recordings(right: int) -> Iterator[tuple[str, Recording]]:
    """Yield recordings by name, `right` of them drawn at random."""
    for name, (readout, series) in CIRCUITS.items():
        for side, seed in ((8, 7001), (12, 7002)):
            rng = np.random.default_rng(seed)
            cells = mouth_cells(rng, side)
            scene = Scene(Panel(side, side), readout, series)
            yield f"circuit {name} {side} {seed}", measured(scene, cells, rng)
    for side, seed in ((6, 400), (6, 401), (10, 400), (10, 401), (16, 400)):
        for fault, recording in wrong(seed, side, 10):
            yield f"wrong {fault} {side} {seed}", recording
    for seed in range(90000, 90000 + right):
        drawn = sound(seed)
        if drawn is not None:
            yield f"right {seed} {drawn[0]}", drawn[1]


def verdict(recording: Recording) -> dict[str, Any]:
    """Return the verdict on a recording, its advice, and the processor seconds of both."""
    begin = time.process_time()
    audit = Audit(Prepared(recording))
    check = audit.prepared.check
    checked = time.process_time()
    advice = [finding.line for finding in audit.advice]
    return {
        "mark": check.mark,
        "better": check.better,
        "doubts": list(check.doubts),
        "advice": advice,
        "check_s": round(checked - begin, 3),
        "advice_s": round(time.process_time() - checked, 3),
    }


def read(path: Path) -> dict[str, dict[str, Any]]:
    """Return the lines of a file by the names of their recordings."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {entry["name"]: entry for entry in map(json.loads, lines)}


def main() -> None:
    """Write the verdicts that the file lacks, and print the differences to those before."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--right", type=int, default=30)
    given = parser.parse_args()
    given.file.parent.mkdir(parents=True, exist_ok=True)
    known = read(given.file)
    with given.file.open("a", encoding="utf-8") as out:
        for name, recording in recordings(given.right):
            if name not in known:
                out.write(json.dumps({"name": name} | verdict(recording)) + "\n")
                out.flush()
    after = read(given.file)
    before = after if given.before is None else read(given.before)
    shared = [name for name in after if name in before]
    for name in shared:
        for key in COMPARED:
            if after[name][key] != before[name][key]:
                print(f"{name}: {key} {before[name][key]} -> {after[name][key]}")
    for part in ("check_s", "advice_s"):
        first, last = (sum(file[name][part] for name in shared) for file in (before, after))
        print(f"{len(shared)} recordings, {part}: {first:.1f} -> {last:.1f}")


if __name__ == "__main__":
    main()
