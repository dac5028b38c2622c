"""What was seen of mouths and of what is none, as tables: recall, confusion, probabilities, diameters, times."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lampest.loads.recognition.candidates import UNKNOWN
from lampest.loads.recognition.verdict import OR
from tests.studies.mouth_scenes import MOUTHS

ATTACHED, WITHIN = 3.0, 5.5  # s after which a mouth is fully attached, and until which it must have been told
ROUND = ("mouth", "uneven mouth", "pressed mouth", "mouth partly off", "cup", "ring", "rod")
BINS = np.linspace(0, 1, 11)
NAMES = {"two mouths": "lamprey and lamprey", "two rods": "rod and rod"}  # what is no single load of its own name
ITSELF = ("nothing", "cup", "ring", "rod")


@dataclass(frozen=True)
class Seen:
    """A frame: what it shows, what it is called, P(lamprey), the best fit's diameter with its σ, CPU time."""

    kind: str
    side: int
    film: str
    seed: int
    time: float
    truth_mm: float
    label: str
    probability: float
    diameter_mm: float
    sigma_mm: float
    cost_ms: float


def holds(label: str, kind: str) -> bool:
    """Whether a label names a kind, alone, among others, or as one of several loads."""
    return kind in label.replace(" and ", OR).split(OR)


def report(everything: list[Seen]) -> None:
    """Print recall, confusion, false alarms, calibration, diameters, two mouths and times."""
    print(f"{'scene':17} frames holds lamprey  alone   within 5 s   itself alone  called")
    for kind in dict.fromkeys(one.kind for one in everything):
        confusion(kind, [one for one in everything if one.kind == kind])
    others = [one for one in everything if one.kind not in MOUTHS]
    mouths = [scene for scene in scenes(everything) if scene[0].kind in MOUTHS]
    told = sum(told_in_time(scene) for scene in mouths)
    false = sum(alone(one.label) for one in others)
    print(f"\nattachments told within 5 s: {told} of {len(mouths)}")
    print(f"false lamprey (called nothing else): {false} of {len(others)} frames")
    calibration(everything)
    diameters(everything)
    two = [one for one in everything if one.kind == "two mouths" and one.time > ATTACHED]
    for side in sorted({one.side for one in two}):
        own = [" and " in one.label for one in two if one.side == side]
        print(f"two mouths told as two, {side} x {side}: {100 * np.mean(own):.0f} % of {len(own)} frames")
    single = [" and " in one.label for one in everything if one.kind in ROUND and one.time > ATTACHED]
    if single:
        print(f"single loads called two: {sum(single)} of {len(single)} frames")
    cost = np.array([one.cost_ms for one in everything])
    middle, far = np.percentile(cost, [50, 90])
    print(f"CPU time: median {middle:.1f} ms, 90 % below {far:.0f} ms, mean {cost.mean():.1f} ms")


def confusion(kind: str, own: list[Seen]) -> None:
    """Print what all frames of a kind are called; of a mouth those in which it is attached."""
    settled = [one for one in own if one.time > ATTACHED] if kind in MOUTHS else own
    hold = np.mean([holds(one.label, "lamprey") for one in settled])
    sure = np.mean([alone(one.label) for one in settled])
    told = np.mean([told_in_time(scene) for scene in scenes(own)])
    labels = [one.label for one in settled]
    common = sorted(set(labels), key=labels.count, reverse=True)[:4]
    itself = np.mean([label == called(kind) for label in labels])
    words = ", ".join(f"{label} {100 * labels.count(label) / len(labels):.0f} %" for label in common)
    shares = f"{100 * hold:9.1f} % {100 * sure:8.1f} % {100 * told:8.1f} % {100 * itself:10.1f} %"
    print(f"{kind:17} {len(settled):6} {shares}   {words}")


def called(kind: str) -> str:
    """The label that says what a scene shows and nothing else."""
    if kind in NAMES:
        return NAMES[kind]
    return kind if kind in ITSELF else "lamprey" if kind in MOUTHS else UNKNOWN


def alone(label: str) -> bool:
    """Whether a label names a lamprey, or several, and nothing else."""
    return set(label.replace(" and ", OR).split(OR)) == {"lamprey"}


def told_in_time(scene: list[Seen]) -> bool:
    """Whether a lamprey was named in one of the first five seconds."""
    return any(holds(one.label, "lamprey") for one in scene if one.time <= WITHIN)


def scenes(everything: list[Seen]) -> list[list[Seen]]:
    """The frames scene by scene."""
    found: dict[tuple[str, int, str, int], list[Seen]] = {}
    for one in everything:
        found.setdefault((one.kind, one.side, one.film, one.seed), []).append(one)
    return list(found.values())


def calibration(everything: list[Seen]) -> None:
    """Print how many frames with P(lamprey) in each tenth show a mouth that sucks already.

    Then the same where mouths of all kinds together are as frequent as each other kind, which is what recognition
    takes for granted, in frames in which all that sucks does.
    """
    print("\nP(lamprey)     frames  are mouths    kinds alike")
    told = [one for one in everything if one.kind not in MOUTHS or one.time > ATTACHED]
    probability = np.array([one.probability for one in told])
    truly = np.array([one.kind in MOUTHS for one in told])
    kinds = ["mouth" if one.kind in MOUTHS else one.kind for one in told]
    late = np.array([one.time > ATTACHED for one in told])
    often = {kind: np.sum(late & (np.array(kinds) == kind)) for kind in set(kinds)}
    weight = late / np.maximum(1, [often[kind] for kind in kinds])
    for low, high in pairwise(BINS):
        inside = (probability >= low) & ((probability < high) | (high == 1.0))
        if inside.any():
            alike = np.sum((weight * truly)[inside]) / max(np.sum(weight[inside]), 1e-300)
            print(
                f"{low:.1f} to {high:.1f} {inside.sum():10} {100 * truly[inside].mean():10.1f} % {100 * alike:12.1f} %"
            )


def diameters(everything: list[Seen]) -> None:
    """Print error and coverage of the diameter in settled frames of round loads."""
    print("\nshape             frames  median error  95th   within 95 %  median σ")
    for kind in ROUND:
        own = [one for one in everything if one.kind == kind and one.time > ATTACHED and np.isfinite(one.diameter_mm)]
        if own:
            error = np.array([one.diameter_mm - one.truth_mm for one in own])
            sigma = np.array([one.sigma_mm for one in own])
            middle, far = np.percentile(np.abs(error), [50, 95])
            held = 100 * np.mean(np.abs(error) <= 1.96 * sigma)
            bias = np.median(error)
            print(
                f"{kind:17} {len(own):6} {middle:9.2f} mm {far:7.1f} {held:9.0f} % {np.median(sigma):9.2f} mm, "
                f"bias {bias:+.2f}"
            )
