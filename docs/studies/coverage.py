"""Coverage of 95 % intervals on fresh scenes, and errors over standard deviations.

Run it with: python -m docs.studies.coverage --scenes 200 --seed 101
"""

import argparse
from typing import NamedTuple

import numpy as np

from lampest import two_point_resistance
from lampest.cost.terms import (
    CellResistance,
    Gradient,
    GradientOfRelativeChange,
    Misfit,
    RelativeChange,
)
from lampest.estimate.estimates import Estimates
from lampest.estimate.estimator import Estimator
from lampest.estimate.sequence import reconstruct
from lampest.panel.panel import Array, Panel
from lampest.panel.response import ratio_from_pressure
from lampest.panel.scene import Scene
from lampest.recording.recording import Recording
from lampest.recording.shapes import OralDisc

METHODS = {
    "LSM": (Misfit(),),
    "LSR-CR": (Misfit(), CellResistance(weight="auto")),
    "LSR-gCR": (Misfit(), Gradient(weight="auto")),
    "LSR-dCR": (Misfit(), RelativeChange(weight="auto")),
    "LSR-gdCR": (Misfit(), GradientOfRelativeChange(weight="auto")),
}


def mouth_cells(rng: np.random.Generator, side: int) -> Array:
    """The cells (2, side, side) ohm of a panel, unloaded and with an attached mouth."""
    panel = Panel(side, side)
    place = rng.uniform(0.2, 0.8, 2) * (side - 1) * 10
    load = OralDisc(
        kind="oral_disc",
        centre_mm=(float(place[0]), float(place[1])),
        diameter_mm=float(rng.uniform(20, 45)),
        rim_width_mm=float(rng.uniform(4, 7)),
        pressure_kpa=float(-rng.uniform(4, 20)),
        rim_kpa=float(rng.uniform(50, 110)),
    )
    resting = 3050 * np.exp(0.2 * rng.standard_normal(panel.shape))
    return np.stack([resting, resting * ratio_from_pressure(sum(load.mean_pressure(panel, 6.0)))])


def mouth(rng: np.random.Generator) -> tuple[Recording, Array]:
    """Return an unloaded frame, one with an attached mouth, and their true cells.

    The panel has 6 × 6 to 16 × 16 cells; the cells have the shape (2, rows, columns).
    """
    side = int(rng.integers(6, 17))
    noise = float(np.exp(rng.uniform(np.log(0.001), np.log(0.03))))
    panel = Panel(side, side)
    cells = mouth_cells(rng, side)
    exact = two_point_resistance(cells)
    measured = exact * (1 + noise * rng.standard_normal(exact.shape))
    role = np.array([0, 1], dtype=np.uint8)
    return Recording(Scene(panel), measured, np.arange(2.0), role, sigma=noise * exact), cells


class Errors(NamedTuple):
    """Errors of log r in a frame.

    every : of all cells. held, standard : of those away from bounds, whether the interval holds the
        truth, and the error over its standard deviation.
    """

    every: Array
    held: Array
    standard: Array


def errors_of(results: Estimates, truth: Array) -> Errors | None:
    """The errors of the first frame against the true cells; None where it has no error bars."""
    step = results.steps[0]
    if not step.solution.solved or step.bars is None:
        return None
    bars = step.bars.frame
    error = np.log(results.cell_resistance[0] / truth)
    free = ~(step.solution.at_lower[-1] | step.solution.open_cell[-1])
    held = (error <= bars.below) & (-error <= bars.above)
    return Errors(error, held[free].astype(float), (error / bars.deviation)[free])


def study(scenes: int, seed: int) -> None:
    """Print coverage and error over standard deviation of every method.

    Cells at bounds are left out.
    """
    rng = np.random.default_rng(seed)
    held: dict[str, list[Array]] = {name: [] for name in METHODS}
    standard: dict[str, list[Array]] = {name: [] for name in METHODS}
    for _ in range(scenes):
        recording, cells = mouth(rng)
        for name, terms in METHODS.items():
            results = reconstruct(recording, Estimator(terms, formulation="reduced"))
            errors = errors_of(results, cells[1])
            if errors is None:
                print(f"{name}: no error bars ({results.steps[0].solution.status.value})")
                continue
            held[name].append(errors.held)
            standard[name].append(errors.standard)
    for name in METHODS:
        inside = np.concatenate(held[name])
        size = np.concatenate(standard[name])
        print(
            f"{name}: {100 * inside.mean():.1f} % held, error/sd {np.sqrt(np.mean(size**2)):.2f}, "
            f"{inside.size} cells"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=101)
    arguments = parser.parse_args()
    study(arguments.scenes, arguments.seed)
