"""Frames of large panels in sequence: what each costs the processor, and where it ends.

    OMP_NUM_THREADS=1 python -m tests.studies.large --scene hand --weight 1e-3

Run it once with each version (PYTHONPATH) to compare them. Scenes differ in size, contrast, noise and load; LSR-∇CR.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from lampest import two_point_resistance
from lampest.cost.terms import Gradient, Misfit, Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.stream import Stream
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording

FRAMES = 4  # the first unloaded


def hand(generator: np.random.Generator) -> Array:
    """48 × 72, three discs at a fiftieth, which move."""
    cells = _even(generator, (48, 72), 20000, 0.1)
    row, column = np.mgrid[:48, :72]
    for frame in range(1, FRAMES):
        for at_row, at_column, radius in ((14 + frame, 20, 6), (30, 40 + 2 * frame, 9), (10, 60, 4)):
            cells[frame][(row - at_row) ** 2 + (column - at_column) ** 2 < radius**2] *= 0.02
    return cells


def holes(generator: np.random.Generator) -> Array:
    """64 × 64, uneven, one cell in fifty a thousandfold; a block and four rows pressed."""
    cells = _even(generator, (64, 64), 1500, 0.6)
    cells[:, generator.random((64, 64)) < 0.02] *= 1e3
    for frame in range(1, FRAMES):
        cells[frame, 10:30, 10 + 3 * frame : 18 + 3 * frame] *= 0.2
        cells[frame, 40:44] *= 0.5
    return cells


def rods(generator: np.random.Generator) -> Array:
    """64 × 64, three rods across each other at a two-hundredth."""
    cells = _even(generator, (64, 64), 50000, 0.2)
    row, column = np.mgrid[:64, :64]
    for frame in range(1, FRAMES):
        for angle in (0.3, 1.2, 2.4):
            far = (column - 32 - 4 * frame) * np.sin(angle) - (row - 28) * np.cos(angle)
            cells[frame] *= 1 - 0.995 * np.exp(-((far / 2) ** 2))
    return cells


def low(generator: np.random.Generator) -> Array:
    """56 × 60, one smooth load at a thirtieth on cells of 400 ohm."""
    cells = _even(generator, (56, 60), 400, 0.3)
    row, column = np.mgrid[:56, :60]
    for frame in range(1, FRAMES):
        cells[frame] /= 1 + 30 * np.exp(-((column - 20 - 5 * frame) ** 2 + (row - 30) ** 2) / 60.0)
    return cells


SCENES: dict[str, tuple[Callable[[np.random.Generator], Array], float]] = {
    "hand": (hand, 3.0),
    "holes": (holes, 1.0),
    "rods": (rods, 1.0),
    "low": (low, 2.0),
}


def _even(generator: np.random.Generator, shape: tuple[int, int], ohm: float, spread: float) -> Array:
    return np.repeat(ohm * np.exp(spread * generator.standard_normal((1, *shape))), FRAMES, axis=0)


def recording(name: str, seed: int) -> Recording:
    """A scene with its noise, in units of the readout's σ."""
    generator = np.random.default_rng(seed)
    make, noise = SCENES[name]
    cells, readout = make(generator), TwoPointReadout()
    exact = two_point_resistance(cells)
    read = exact + noise * readout.sigma(exact) * generator.standard_normal(exact.shape)
    kinds = np.array([0] + [1] * (FRAMES - 1), dtype=np.uint8)
    return Recording(Scene(Panel(*exact.shape[1:]), readout), read, np.arange(float(FRAMES)), kinds)


def main() -> None:
    """Print a line for every frame."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scene", choices=SCENES, default="hand")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--weight", type=float, default=1e-3)
    parser.add_argument("--weighting", choices=("plain", "noise"), default="plain")
    told = parser.parse_args()
    terms: tuple[Term, ...] = (Misfit(weighting=told.weighting), Gradient(weight=told.weight))
    estimator = Estimator(terms, formulation="reduced", error_bars=False)
    recorded = recording(told.scene, told.seed)
    readings = recorded.readings()
    stream = Stream.begin(estimator, recorded.scene, 1.0, readings[0])
    for frame in range(1, FRAMES):
        begun = time.process_time()
        stream, step = stream.push(readings[frame])
        spent = time.process_time() - begun
        found = step.solution
        print(
            f"{told.scene} {frame}: {spent:6.2f} s, cost {found.objective:.8g}, {found.iterations} iterations of the "
            f"best of {found.starts}, {found.status.value}",
            flush=True,
        )


if __name__ == "__main__":
    main()
