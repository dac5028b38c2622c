"""What recognition says of mouths and of what is none, over sizes, electronics and films, from scenes made elsewhere.

Run it with: python -m tests.studies.mouths --scenes 10 --seed 7 --sides 10 --films real other
"""

import argparse
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from time import process_time

import numpy as np

from lampest.loads.recognition.baseline import Baseline
from lampest.loads.recognition.candidates import KINDS
from lampest.loads.recognition.detector import Detector
from lampest.loads.recognition.frame import Direct
from lampest.loads.recognition.model_errors import ModelErrors
from lampest.loads.recognition.verdict import OR, Verdict
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from tests.studies.mouth_scenes import MAKERS, MOUTHS, cells, film, recorded

UNLOADED, ATTACHED = 3, 3.0  # unloaded frames; s after which a mouth is fully attached
ROUND = ("mouth", "uneven mouth", "pressed mouth", "mouth partly off", "cup", "ring", "rod")
BINS = np.array([0.0, 0.1, 0.5, 0.9, 1.0])


@dataclass(frozen=True, eq=False)
class Seen:
    """A frame: what it shows, what it is called, P(lamprey), the best fit's diameter with its σ, CPU time in ms."""

    kind: str
    side: int
    film: str
    time: float
    truth_mm: float
    label: str
    probability: float
    diameter: tuple[float, float]
    cost_ms: float


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
    return [Direct(*row, baseline, dry, at + 1.0) for *row, at in rows], time[UNLOADED:], made.diameters_mm


def seen(kind: str, side: int, film_kind: str, seed: int, count: int) -> list[Seen]:
    """All frames of one scene, in sequence."""
    frames, times, diameters = frames_of(kind, side, film_kind, seed, count)
    panel, found = Panel(side, side), []
    detector = Detector.of(panel, 0.6 * panel.pitch_mm, frames[0])
    for frame, at in zip(frames, times, strict=True):
        begin = process_time()
        detector, verdict = detector.push(frame)
        cost = 1e3 * (process_time() - begin)
        number = diameter_of(verdict)
        truth = diameters[0] if diameters else np.nan
        lamprey = verdict.probabilities[KINDS.index("lamprey")]
        found.append(Seen(kind, side, film_kind, at, truth, verdict.label, lamprey, number, cost))
    return found


def diameter_of(verdict: Verdict) -> tuple[float, float]:
    """(value, standard deviation) in mm of the most probable load; NaN where it has none."""
    fit = verdict.best
    names = [quantity.name for quantity in fit.candidate.quantities]
    if "diameter" not in names:
        return np.nan, np.nan
    values, slopes = fit.candidate.report(fit.parameters)
    place = names.index("diameter")
    return float(values[place]), float(np.sqrt(slopes[place] @ fit.covariance @ slopes[place]))


def holds(label: str, kind: str) -> bool:
    """Whether a label names a kind, alone, among others, or as one of several loads."""
    return kind in label.replace(" and ", OR).split(OR)


def report(found: Iterable[Seen]) -> None:
    """Print recall, confusion, false alarms, calibration, diameters, two mouths and times."""
    everything = list(found)
    kinds = [kind for kind in MAKERS if any(one.kind == kind for one in everything)]
    print(f"{'scene':17} frames holds lamprey  alone   within 5 s  called")
    false = others = 0
    for kind in kinds:
        own = [one for one in everything if one.kind == kind]
        settled = [one for one in own if one.time > ATTACHED] if kind in MOUTHS else own
        hold = np.mean([holds(one.label, "lamprey") for one in settled])
        alone = np.mean([set(one.label.split(" and ")) == {"lamprey"} for one in settled])
        if kind not in MOUTHS:
            false, others = false + round(alone * len(own)), others + len(own)
        frames = scene_frames(own)
        scenes = [own[first : first + frames] for first in range(0, len(own), frames)]
        told = np.mean([any(holds(one.label, "lamprey") for one in scene if one.time <= 5.5) for scene in scenes])
        labels = [one.label for one in settled]
        common = sorted(set(labels), key=labels.count, reverse=True)[:4]
        words = ", ".join(f"{label} {100 * labels.count(label) / len(labels):.0f} %" for label in common)
        print(f"{kind:17} {len(settled):6} {100 * hold:9.1f} % {100 * alone:8.1f} % {100 * told:8.1f} %   {words}")
    if others:
        print(f"\nfalse lamprey (called nothing else): {false} of {others} frames")
    calibration(everything)
    diameters(everything)
    two = [one for one in everything if one.kind == "two mouths" and one.time > ATTACHED]
    if two:
        print(
            f"two mouths told as two: {100 * np.mean([' and ' in one.label for one in two]):.0f} % of {len(two)} frames"
        )
    cost = np.array([one.cost_ms for one in everything])
    middle, far = np.percentile(cost, [50, 90])
    print(f"CPU time: median {middle:.1f} ms, 90 % below {far:.0f} ms, mean {cost.mean():.1f} ms")


def scene_frames(own: list[Seen]) -> int:
    """How many frames each scene has."""
    times = [one.time for one in own]
    return times.index(times[0], 1) if times.count(times[0]) > 1 else len(times)


def calibration(everything: list[Seen]) -> None:
    """Print how many frames with P(lamprey) in each bin show a mouth that sucks already."""
    print("\nP(lamprey)     frames  are mouths")
    told = [one for one in everything if one.kind not in MOUTHS or one.time > ATTACHED]
    probability = np.array([one.probability for one in told])
    truly = np.array([one.kind in MOUTHS for one in told])
    for low, high in pairwise(BINS):
        inside = (probability >= low) & ((probability < high) | (high == 1.0))
        if inside.any():
            print(f"{low:.1f} to {high:.1f} {inside.sum():10} {100 * truly[inside].mean():10.1f} %")


def diameters(everything: list[Seen]) -> None:
    """Print error and coverage of the diameter in settled frames of round loads."""
    print("\nshape             frames  median error  95th   within 95 %  median σ")
    for kind in ROUND:
        own = [one for one in everything if one.kind == kind and one.time > ATTACHED and np.isfinite(one.diameter[0])]
        if own:
            error = np.array([one.diameter[0] - one.truth_mm for one in own])
            sigma = np.array([one.diameter[1] for one in own])
            middle, far = np.percentile(np.abs(error), [50, 95])
            held = 100 * np.mean(np.abs(error) <= 1.96 * sigma)
            bias = np.median(error)
            print(
                f"{kind:17} {len(own):6} {middle:9.2f} mm {far:7.1f} {held:9.0f} % {np.median(sigma):9.2f} mm, "
                f"bias {bias:+.2f}"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=10, help="of every kind, side and film")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--frames", type=int, default=6, help="of a scene, over five seconds")
    parser.add_argument("--sides", type=int, nargs="+", default=[10])
    parser.add_argument("--films", nargs="+", default=["real", "other"], choices=["ideal", "real", "other"])
    parser.add_argument("--kinds", nargs="+", default=list(MAKERS), choices=list(MAKERS))
    given = parser.parse_args()
    plan = [
        (kind, side, film_kind, 1000 * given.seed + number)
        for number in range(given.scenes)
        for side in given.sides
        for film_kind in given.films
        for kind in given.kinds
    ]
    everything: list[Seen] = []
    with suppress(KeyboardInterrupt):  # what was seen until then is reported
        for kind, side, film_kind, seed in plan:
            everything += seen(kind, side, film_kind, seed, given.frames)
    report(everything)
