"""The smoother under real electronics, by an independent simulator.

The references are LSR-ΔCR, and the smoother after `--from-recording`.

Scenes are those of `docs.studies.mouth_scenes`, of eight kinds in turn: film uneven by 12 %, cells
that drift by 1 % a minute, channels of 3 ohm, a reference within 1 %, a ripple of 0.4 LSB along the
scan, one wild code in ten thousand. All recordings of a run have the same electronics. With --loads
each has so many loads, one after the other. Run it: python -m docs.studies.shared_errors
--recordings 16 --seed 5000 --calibrate 8
"""

import argparse
from dataclasses import replace

import numpy as np

from docs.studies import mouth_scenes
from docs.studies.limit import METHODS
from lampest import two_point_resistance
from lampest.apps.calibration.channels import calibrate_channels
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.panel.sizes import Systematic
from lampest.recording.recording import Recording

KINDS = (
    "uneven mouth",
    "two rods",
    "pressed mouth",
    "ring",
    "mouth partly off",
    "hand",
    "rock",
    "cup",
)
# EACH: frames of one load of several
RESTING = 3
FRAMES = 20
SIDE = 10
EACH = 8
SYSTEMATIC = Systematic(reference_tolerance=0.01, channel_spread_ohm=3.0)


def recording(seed: int, channels: Array, reference: float) -> Recording:
    """Three unloaded frames and twenty measured ones, a second apart, with their truth."""
    rng = np.random.default_rng(seed)
    panel = Panel(SIDE, SIDE)
    load = mouth_scenes.MAKERS[KINDS[seed % len(KINDS)]](rng, panel)
    film = replace(mouth_scenes.film(rng, "real"), scatter=0.12)
    time = np.arange(RESTING + FRAMES, dtype=float)
    on = int(rng.integers(RESTING + 1, RESTING + 6))
    off = len(time) if rng.random() < 0.5 else int(rng.integers(len(time) - 6, len(time)))
    courses = _courses(rng, time, on, off)
    return measured(rng, mouth_scenes.cells(rng, panel, load, film, courses), channels, reference)


def _courses(rng: np.random.Generator, time: Array, on: int, off: int) -> Array:
    """Return factors of contact and of suction that breathes, (frames, 2)."""
    breath = 1 + rng.uniform(0, 0.12) * np.sin(
        2 * np.pi * (rng.uniform(0.15, 0.45) * time + rng.random())
    )
    contact = breath * ((time >= on) & (time < off))
    return np.stack([contact, contact * np.clip((time - on + 0.2) / 2, 0, 1)], axis=1)


def in_turn(seed: int, channels: Array, reference: float, loads: int) -> Recording:
    """Return a recording with several loads of different kinds, each for five of EACH frames."""
    rng = np.random.default_rng(seed)
    panel = Panel(SIDE, SIDE)
    film = replace(mouth_scenes.film(rng, "real"), scatter=0.12)
    time = np.arange(RESTING + EACH * loads, dtype=float)
    cells = np.ones((len(time), *panel.shape))
    for number in range(loads):
        load = mouth_scenes.MAKERS[KINDS[(seed + number) % len(KINDS)]](rng, panel)
        on = RESTING + EACH * number + 2
        courses = _courses(rng, time, on, on + 5)
        alone = mouth_scenes.cells(np.random.default_rng([seed, 1]), panel, load, film, courses)
        cells = alone if number == 0 else cells * alone / alone[0]
    return measured(rng, cells, channels, reference)


def measured(
    rng: np.random.Generator, cells: Array, channels: Array, reference: float
) -> Recording:
    """Cells (frames, rows, columns) ohm that drift, as the board reads them."""
    time = np.arange(len(cells), dtype=float)
    panel = Panel(SIDE, SIDE)
    cells = cells * np.exp(0.01 / 60 * rng.standard_normal(panel.shape) * time[:, None, None])
    total = two_point_resistance(cells) + 140.0 + channels[:SIDE, None] + channels[SIDE:]
    volt = 1000 * (1 + reference) / (total + 1000 * (1 + reference))
    phase = rng.uniform(0, 2 * np.pi, len(time))
    ripple = 0.4 * np.sin(2 * np.pi * np.arange(SIDE) / SIDE + phase[:, None])[:, :, None]
    mean = mouth_scenes.sampled(rng, volt * 1023 + ripple)
    scene = Scene(panel, TwoPointReadout(noise_lsb=0.7), 140.0, systematic=SYSTEMATIC)
    role = (time >= RESTING).astype(np.uint8)
    return Recording(scene, 1000 * (1023 - mean) / mean, time, role, truth_cell_resistance=cells)


def measure(made: Recording, method: str) -> Array:
    """Return median errors of cells and changes, the rms error of changes, and both coverages.

    All are in percent.
    """
    results = reconstruct(made, Estimator(*METHODS[method]))
    assert made.truth_cell_resistance is not None and results.relative_change_lower is not None
    assert results.cell_resistance_lower is not None and results.cell_resistance_upper is not None
    cells = made.truth_cell_resistance[results.frame]
    resting = made.truth_cell_resistance[RESTING - 1]
    assert results.relative_change_upper is not None
    solved = results.solved
    change = 100 * (cells / resting - 1)
    error = np.log(results.cell_resistance / cells)[solved]
    of_change = (
        np.log(results.cell_resistance / results.baseline_resistance) - np.log(cells / resting)
    )[solved]
    inside = ((results.cell_resistance_lower <= cells) & (cells <= results.cell_resistance_upper))[
        solved
    ]
    cached = (
        (results.relative_change_lower <= change) & (change <= results.relative_change_upper)
    )[solved]
    sizes = np.median(np.abs(error)), np.median(np.abs(of_change)), np.sqrt(np.mean(of_change**2))
    return 100 * np.array([*sizes, inside.mean(), cached.mean()])


def study(count: int, seed: int, calibrate: int, loads: int) -> None:
    """Print both methods on `count` recordings, before and after a calibration of the scene.

    The calibration uses `calibrate` further recordings.
    """

    def made(number: int) -> Recording:
        return recording(number, *board) if loads == 1 else in_turn(number, *board, loads)

    rng = np.random.default_rng(seed)
    board = 3.0 * rng.standard_normal(2 * SIDE), float(rng.uniform(-0.01, 0.01))
    every = [made(seed + number) for number in range(count)]
    of_paper = np.stack([measure(record, "LSR-dCR") for record in every])

    def print_row(name: str, rows: Array) -> None:
        ratios = rows[:, :3] / of_paper[:, :3]
        shown = "; ".join(f"{np.median(ratio):.2f} / {ratio.max():.2f}" for ratio in ratios.T)
        print(
            f"{name:22} {rows.mean(axis=0).round(2)}; over LSR-dCR, median / worst: {shown}",
            flush=True,
        )

    print_row("LSR-dCR", of_paper)
    print_row("smoother", np.stack([measure(record, "smoother") for record in every]))
    if not calibrate:
        return
    results = calibrate_channels([made(seed + 10_000 + number) for number in range(calibrate)])
    off = (results.errors[1:] - board[0]).reshape(2, SIDE)
    left = np.sqrt(np.sum((off - off.mean(axis=1, keepdims=True)) ** 2) / (2 * SIDE - 2))
    print(
        f"{results.summary}; truly off by {left:.2f} ohm; the reference was off by "
        f"{100 * board[1]:+.2f} %"
    )
    again = [replace(record, scene=results.scene) for record in every]
    for method in ("LSR-dCR", "smoother"):
        print_row(f"{method}, calibrated", np.stack([measure(record, method) for record in again]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=16)
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--calibrate", type=int, default=8)
    parser.add_argument("--loads", type=int, default=1)
    arguments = parser.parse_args()
    study(arguments.recordings, arguments.seed, arguments.calibrate, arguments.loads)
