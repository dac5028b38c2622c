"""Errors of the cells at missing readings and next to them, and coverage of their intervals.

Run it with: python -m docs.studies.missing_readings --recordings 20 --seed 101
"""

import argparse
from dataclasses import replace

import numpy as np

from lampest.cost.terms import Gradient, Misfit, Term
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array, Panel
from lampest.panel.readouts import TwoPointReadout
from lampest.panel.scene import Scene
from lampest.recording.recording import MEASURED, Recording
from lampest.recording.shapes import OralDisc
from lampest.recording.simulation.simulation import Simulation, simulate

METHODS: dict[str, tuple[Term, ...]] = {
    "LSM": (Misfit(),),
    "LSR-gCR": (Misfit(), Gradient(weight="auto")),
}


def mouth(rng: np.random.Generator, seed: int) -> Recording:
    """Return three unloaded frames and three of a mouth, 6 × 6 to 14 × 14 cells.

    The readings are means of 20 conversions of 10 bits.
    """
    side = int(rng.integers(6, 15))
    place = rng.uniform(0.3, 0.7, 2) * (side - 1) * 10
    load = OralDisc(
        kind="oral_disc",
        centre_mm=(float(place[0]), float(place[1])),
        diameter_mm=float(rng.uniform(25, 40)),
        rim_width_mm=5.5,
        pressure_kpa=-10,
        rim_kpa=80,
    )
    scene = Scene(Panel(side, side, 10), TwoPointReadout(), 140.0)
    return simulate(Simulation(1, seed, scene, frames=3, loads=(load,)))


def study(count: int, seed: int) -> None:
    """Print error (median / 95th percentile, percent) and coverage of read and of missing cells."""
    for share in (0.0, 0.01, 0.05, 0.2):
        for name, terms in METHODS.items():
            rng = np.random.default_rng(seed)
            read: list[tuple[Array, Array]] = []
            blind: list[tuple[Array, Array]] = []
            for number in range(count):
                made = mouth(rng, seed + number)
                holes = (rng.random(made.recorded.shape) < share) & (made.role == MEASURED)[
                    :, None, None
                ]
                results = reconstruct(
                    replace(made, recorded=np.where(holes, np.nan, made.recorded)),
                    Estimator(terms, "reduced"),
                )
                lower = results.cell_resistance_lower
                upper = results.cell_resistance_upper
                assert (
                    made.truth_cell_resistance is not None
                    and lower is not None
                    and upper is not None
                )
                truth = made.truth_cell_resistance[results.frame]
                hole = holes[results.frame]
                error = 100 * np.abs(results.cell_resistance / truth - 1)
                held = (lower <= truth) & (truth <= upper)
                for parts, chosen in ((read, ~hole), (blind, hole)):
                    chosen &= results.solved[:, None, None]
                    parts.append((error[chosen], held[chosen].astype(float)))
            print(
                f"{100 * share:4.0f} % {name:8} read: {_text(read)}   missing: {_text(blind)}",
                flush=True,
            )


def _text(parts: list[tuple[Array, Array]]) -> str:
    error, held = (np.concatenate(part) for part in zip(*parts, strict=True))
    if not error.size:
        return "none"
    median, high = np.percentile(error, [50, 95])
    return f"{median:5.2f} / {high:6.1f} %, held {100 * held.mean():.1f} %"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=20)
    parser.add_argument("--seed", type=int, default=101)
    arguments = parser.parse_args()
    study(arguments.recordings, arguments.seed)
