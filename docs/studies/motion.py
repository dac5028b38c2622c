"""Loads that move while a frame is scanned: unnamed in the scene, estimated, and specified.

Run it with: python -m docs.studies.motion [--recordings 8] [--seed 900] [MOTION]...

Each reading is taken at its own time, rows in turn, and a scan takes the whole time between frames.
The truth is that of the middle of the scan. Under `sways` and `stands` a scan takes no time.
"""

import argparse
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from docs.studies.effects import figures
from lampest import Panel, Recording, Scene, TwoPointReadout, two_point_resistance
from lampest.panel.panel import Array

SIDE = 8
UNLOADED = 5
FRAMES = 7
SERIES_OHM = 140.0
LSB_VOLT = 5 / 1024
LOADS = ("rock", "mouth", "rod", "hand")
SCENES: dict[str, Mapping[str, Any]] = {
    "unnamed": {},
    "estimated": {"motion": "estimated"},
    "number": {"motion": 1.0},
}


class Motion(NamedTuple):
    """Pitches per frame, share by which the load jitters, and share of the time of a scan."""

    speed: float = 0.0
    depth: float = 0.0
    scan: float = 1.0


MOTIONS = {
    "stands": Motion(scan=0.0),
    "sways by 10 %": Motion(depth=0.1, scan=0.0),
    "0.1 pitches a frame": Motion(speed=0.1),
    "0.3 pitches a frame": Motion(speed=0.3),
    "1 pitch a frame": Motion(speed=1.0),
    "jitters by 2 %": Motion(depth=0.02),
    "jitters by 10 %": Motion(depth=0.1),
}


def fall(kind: str, down: float, across: float) -> Array:
    """Fall of log r under a load at a place, (rows, columns)."""
    row, column = np.indices((SIDE, SIDE)) - (SIDE - 1) / 2
    row, column = row - down, column - across
    far = np.hypot(row, column)
    return {
        "rock": 2 * np.exp(-((far / 1.1) ** 2))
        + 0.8 * np.exp(-((np.hypot(row + 2, column - 1) / 0.8) ** 2)),
        "mouth": 1.6 * np.exp(-(((far - 1.9) / 0.6) ** 2)) - 0.25 * (far < 1.2),
        "rod": 1.2 / (1 + np.exp((far - 2.0) / 0.15)),
        "hand": np.exp(-((row / 3) ** 2) - ((column / 2.2) ** 2)),
    }[kind]


def recording(seed: int, kind: str, motion: Motion, keys: Mapping[str, Any]) -> Recording:
    """A moving load on films that scatter by a tenth.

    The readings are means of 20 readings of 10 bits of a divider across 1000 ohm.
    """
    rng = np.random.default_rng(seed)
    resting = 3000 * np.exp(0.1 * rng.standard_normal((SIDE, SIDE)))
    down, across = rng.uniform(-1, 1, 2)
    angle = rng.uniform(0, 2 * np.pi)
    phase = rng.uniform(0, 6)
    rate = 1.7 * rng.uniform(0.7, 1.3)
    strength = rng.uniform(0.7, 1.3)

    def cells(frame: float) -> Array:
        way = motion.speed * (frame - (FRAMES - 1) / 2)
        place = down + way * np.cos(angle), across + way * np.sin(angle)
        force = strength * (1 + motion.depth * np.sin(rate * frame + phase))
        return np.asarray(resting * np.exp(-force * fall(kind, *place)))

    truth = np.stack([*[resting] * UNLOADED, *map(cells, range(FRAMES))])
    exact = two_point_resistance(truth)
    size = SIDE * SIDE
    late = motion.scan * ((np.arange(size) + 0.5) / size - 0.5)
    for frame in range(FRAMES):
        scanned = two_point_resistance(np.stack([cells(frame + delay) for delay in late]))
        exact[UNLOADED + frame].flat = scanned.reshape(size, size).diagonal()
    volt = 5000 / (1000 + SERIES_OHM + exact)
    noise = 0.7 * rng.standard_normal((20, *volt.shape))
    codes = np.round(volt / LSB_VOLT + noise).clip(0, 1023).mean(axis=0)
    recorded = 1000 * (5 - codes * LSB_VOLT) / (codes * LSB_VOLT)
    readout = TwoPointReadout(readings=20, noise_lsb=0.7)
    scene = Scene(Panel(SIDE, SIDE), readout, SERIES_OHM, **keys)
    role = (np.arange(len(truth)) >= UNLOADED).astype(np.uint8)
    return Recording(scene, recorded, np.arange(len(truth)) / 4, role, truth_cell_resistance=truth)


def main() -> None:
    """Print a line for each motion and scene: means over the recordings."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("motions", nargs="*", default=list(MOTIONS))
    parser.add_argument("--recordings", type=int, default=8)
    parser.add_argument("--seed", type=int, default=900)
    given = parser.parse_args()
    print("| motion | scene | error, % | own | cells | changes |\n|---|---|---|---|---|---|")
    for name in given.motions:
        for scene, keys in SCENES.items():
            every = [
                figures(
                    recording(given.seed + at, LOADS[at % 4], MOTIONS[name], keys), advised=False
                )
                for at in range(given.recordings)
            ]
            error, own, _, cells, changes, _ = np.mean(every, axis=0)
            ratio = np.median(every, axis=0)[2]
            print(
                f"| {name} | {scene} | {error:.2f} | {own:.0f} × {ratio:.2f} | {cells:.0f} | "
                f"{changes:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
