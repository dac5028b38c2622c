"""Picture of docs/howto/adding/constraint.md: error bars without and with nine tied cells."""

from pathlib import Path

import casadi
import matplotlib.pyplot as plt
from matplotlib.patches import Rectangle

import lampest

PAGE = Path(__file__).parents[1] / "howto" / "adding"


def main() -> None:
    """Draw the picture beside the page."""
    recording = lampest.datasets.load("rod")
    terms = [lampest.Misfit(weighting="noise"), lampest.LogGradient(weight=1.0)]
    program = lampest.program(recording, terms, frames=[int(recording.measured_frames()[0])])
    plate = casadi.vec(program.cells()[0:3, 0:3]) / 1000
    solutions = {
        "free": program.solve(),
        "3 × 3 cells tied": program.subject_to("plate", plate[1:] - plate[0]).solve(),
    }
    maps = {
        name: 100 * (solution.cell_resistance_errors / solution.cell_resistance)[0]
        for name, solution in solutions.items()
    }
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
    largest = max(float(values.max()) for values in maps.values())
    for place, (name, values) in zip(axes, maps.items(), strict=True):
        image = place.imshow(values, vmin=0.0, vmax=largest, cmap="viridis")
        place.add_patch(Rectangle((-0.5, -0.5), 3, 3, fill=False, edgecolor="white", linewidth=2))
        place.set(title=name, xlabel="column", ylabel="row")
    figure.colorbar(image, ax=axes, label="standard deviation of ln r [%]")
    figure.savefig(PAGE / "constraint.png", dpi=110)


if __name__ == "__main__":
    main()
