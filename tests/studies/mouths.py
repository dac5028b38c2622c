"""What recognition says of mouths and of what is none, over sizes, electronics and films, from scenes made elsewhere.

Run it with: python -m tests.studies.mouths --scenes 10 --seed 7 --sides 10 --films real other --out seen.csv
and print again what several runs found with: python -m tests.studies.mouths --read seen.csv other.csv
"""

import argparse
import csv
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from time import process_time

import numpy as np

from lampest.loads.recognition.baseline import Baseline
from lampest.loads.recognition.candidates import KINDS
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.frame import Direct
from lampest.loads.recognition.settings import ModelErrors
from lampest.loads.recognition.verdict import Verdict
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.report.detect.detection import QUANTITIES, numbers_of
from tests.studies.mouth_report import Seen, report
from tests.studies.mouth_scenes import MAKERS, cells, film, recorded

UNLOADED = 3  # frames


def frames_of(
    kind: str, side: int, film_kind: str, seed: int, count: int
) -> tuple[list[Direct], Array, tuple[float, ...]]:
    """(frames, their times, true diameters): touches at 0, presses after 0.5 s, sucks after 2.5 s, breathes."""
    rng = np.random.default_rng([seed, side, list(MAKERS).index(kind), len(film_kind)])
    panel = Panel(side, side)
    made, layer = MAKERS[kind](rng, panel), film(rng, film_kind)
    time = np.concatenate([np.arange(-UNLOADED, 0.0), 0.4 + np.linspace(0, 5, count)])
    breath = np.where(time < 0, 0, 1 + 0.1 * np.sin(2 * np.pi * 1.15 * time))
    courses = np.stack([np.clip(time / 0.5, 0, 1) * breath, np.clip((time - 0.5) / 2, 0, 1) * breath], axis=1)
    resistance = cells(rng, panel, made, layer, courses)
    measured, sigma = recorded(rng, resistance, film_kind != "ideal", time + UNLOADED)
    scene = Scene(panel, TwoPointReadout(), series_resistance_ohm=140.0)
    resting, noise = measured[:UNLOADED].mean(axis=0), sigma[:UNLOADED].mean(axis=0) / np.sqrt(UNLOADED)
    baseline, dry = Baseline.of(resting, noise, scene, ModelErrors()), np.zeros(panel.shape)
    rows = zip(measured[UNLOADED:], sigma[UNLOADED:], time[UNLOADED:], strict=True)
    frames = [Direct(one, error, baseline, dry, float(at) + 1.0) for one, error, at in rows]
    return frames, time[UNLOADED:], made.diameters_mm


def seen(kind: str, side: int, film_kind: str, seed: int, count: int) -> list[Seen]:
    """All frames of one scene, in sequence."""
    frames, times, diameters = frames_of(kind, side, film_kind, seed, count)
    panel, found = Panel(side, side), []
    detector = Detector.of(panel, 0.6 * panel.pitch_mm, frames[0])
    for frame, at in zip(frames, times, strict=True):
        begin = process_time()
        detector, verdict = detector.push(frame)
        cost = 1e3 * (process_time() - begin)
        truth = diameters[0] if diameters else np.nan
        lamprey = verdict.probabilities[KINDS.index("lamprey")]
        found.append(Seen(kind, side, film_kind, seed, at, truth, verdict.label, lamprey, *diameter_of(verdict), cost))
    return found


def diameter_of(verdict: Verdict) -> tuple[float, float]:
    """(value, standard deviation) in mm as `detect` reports it; NaN where the most probable load has none."""
    values, errors = numbers_of(verdict)
    place = [quantity.name for quantity in QUANTITIES].index("diameter")
    return float(values[place]), float(errors[place])


def read(path: Path) -> Iterator[Seen]:
    """What an earlier run has seen."""
    kinds = {field.name: field.type for field in fields(Seen)}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            yield Seen(**{name: kinds[name](text) for name, text in row.items()})  # type: ignore[operator]


def run(plan: Sequence[tuple[str, int, str, int]], count: int, out: Path | None) -> list[Seen]:
    """All scenes of a plan; with `out`, each is appended to a table as it is done."""
    everything: list[Seen] = []
    with suppress(KeyboardInterrupt):  # what was seen until then is reported
        for kind, side, film_kind, seed in plan:
            scene = seen(kind, side, film_kind, seed, count)
            everything += scene
            if out is not None:
                write(out, scene)
    return everything


def write(path: Path, scene: list[Seen]) -> None:
    """Append frames to a table."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        table = csv.writer(file)
        if new:
            table.writerow([field.name for field in fields(Seen)])
        table.writerows([getattr(one, field.name) for field in fields(Seen)] for one in scene)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=10, help="of every kind, side and film")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--frames", type=int, default=6, help="of a scene, over five seconds")
    parser.add_argument("--sides", type=int, nargs="+", default=[10])
    parser.add_argument("--films", nargs="+", default=["real", "other"], choices=["ideal", "real", "other"])
    parser.add_argument("--kinds", nargs="+", default=list(MAKERS), choices=list(MAKERS))
    parser.add_argument("--out", type=Path, help="a table of all frames, to which they are appended")
    parser.add_argument("--read", type=Path, nargs="+", help="such tables, to report instead of new scenes")
    given = parser.parse_args()
    plan = [
        (kind, side, film_kind, 1000 * given.seed + number)
        for number in range(given.scenes)
        for side in given.sides
        for film_kind in given.films
        for kind in given.kinds
    ]
    if given.read:
        report([one for path in given.read for one in read(path)])
    else:
        report(run(plan, given.frames, given.out))
