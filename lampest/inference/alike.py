"""Choice among panels that read alike, by an unloaded and a loaded frame together.

Where idle lines are held harder than the driven one, several panels give the readings of a frame
(`lampest.panel.readouts.branches`). A load changes some cells, and the others stand still: this
holds for the pair of panels that is meant. In any other pair nearly all cells change, because the
potential of a driven line is another one beyond its fold. With a Student-like density of changes,
a pair costs

    Σ ln(1 + (Δ ln r)²/(CHANGE² + σ²)),

σ² being the variance of Δ ln r by the readings' noise under this pair: 8 bits may leave a cell
unknown on one branch and known to a hundredth on another. Another pair is ruled out where it costs
more by CLEAR.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from lampest.inference.cells_fit import CellsFit, data_of_cells
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.posterior.reference import MAX_CELLS
from lampest.recording.readings import Readings

CHANGE = 0.03  # of ln r: cells that change by less stand still within the noise of exact fits
CLEAR = 10.0  # in the cost of a pair: odds of e^10, the more careful as changes share their noise
STILL = 2.0  # median change, over CHANGE and noise, in a pair of which most cells stand still
NOISE_RANGE = 3.0  # standard deviations of a reading: panels that fit to less are compared


@dataclass(frozen=True, eq=False)
class PanelChoice:
    """Panels of an unloaded and of a loaded frame, of all that give their readings.

    Attributes
    ----------
    resting, loaded : array, shape (rows, columns)
        Cells in ohm.
    other : array, shape (rows, columns), or None
        Cells of one of the two frames in the next best pair, ohm; None where no other pair is
        known.
    clear : bool
        Whether the next best pair is ruled out.
    """

    resting: Array
    loaded: Array
    other: Array | None
    clear: bool

    @classmethod
    def of(cls, scene: Scene, resting: Readings, loaded: Readings) -> Self | None:
        """Return the choice for two frames.

        A bound counts as a reading at its limit. The result is None where readings are missing, or
        no panel is found.
        """
        circuit = scene.circuit
        if not (circuit.several_panels and resting.seen.all() and loaded.seen.all()):
            return None
        tolerance = max(noise_share(resting), noise_share(loaded))
        unloaded = circuit.every_panel(resting.value, tolerance)
        of_load = circuit.every_panel(loaded.value, tolerance, unloaded)
        # Panels of a load are starts of the unloaded one that uniform panels may miss
        unloaded = circuit.every_panel(resting.value, tolerance, [*unloaded, *of_load])
        pairs = sorted(
            (
                _Pair(before, after, of_before + of_after)
                for before, of_before in _with_variances(scene, resting, unloaded)
                for after, of_after in _with_variances(scene, loaded, of_load)
            ),
            key=lambda pair: pair.cost,
        )
        if not pairs:
            return None
        best = pairs[0]
        # A pair that differs by less than noise is the same one.
        second = next((pair for pair in pairs if best.differs_from(pair)), None)
        if second is None:
            return cls(best.before, best.after, None, clear=best.mostly_still)
        frames = (change_cost(second.before, best.before), change_cost(second.after, best.after))
        other = second.before if frames[0] > frames[1] else second.after
        clear = second.cost - best.cost > CLEAR and best.mostly_still
        return cls(best.before, best.after, other, clear)

    @property
    def sentence(self) -> str:
        """The doubt that other cells are meant; '' where there is none."""
        if self.clear:
            return ""
        cure = "with a smaller drive_ohm they differ"
        if self.other is None:
            return (
                "between the unloaded and the loaded readings most cells have changed: "
                f"other cells may give these readings; {cure}"
            )
        chosen, other = (float(np.median(cells)) for cells in (self.resting, self.other))
        return (
            f"cells of about {chosen:.2g} ohm and "
            f"of about {other:.2g} ohm give these readings alike, and the former are taken: {cure}"
        )


@dataclass(frozen=True, eq=False)
class _Pair:
    """A panel of the unloaded and one of the loaded frame.

    Attributes
    ----------
    before, after : array, shape (rows, columns)
        Cells in ohm.
    variance : array, shape (rows, columns)
        Variance of the change of ln r by noise.
    """

    before: Array
    after: Array
    variance: Array

    @cached_property
    def cost(self) -> float:
        """Cost of the changes of the cells."""
        return change_cost(self.after, self.before, self.variance)

    @property
    def mostly_still(self) -> bool:
        """Whether most cells stand still within noise."""
        noise = np.sqrt(CHANGE**2 + self.variance)
        return bool(np.median(np.abs(np.log(self.after / self.before)) / noise) < STILL)

    def differs_from(self, pair: "_Pair") -> bool:
        """Return whether another pair has other cells beyond noise, which costs more than CLEAR."""
        frames = ((pair.before, self.before), (pair.after, self.after))
        return any(change_cost(*cells, self.variance) > CLEAR for cells in frames)


def _with_variances(
    scene: Scene, readings: Readings, panels: Sequence[Array]
) -> list[tuple[Array, Array]]:
    """Return panels with the variances of their ln r by the noise of readings.

    The variances are 0 where noise is unknown, or a panel is too large.
    """
    if readings.sigma is None or readings.value.size > MAX_CELLS:
        return [(cells, np.zeros(cells.shape)) for cells in panels]
    data = data_of_cells(scene, readings)
    fits = [CellsFit.at(scene, data, readings, cells) for cells in panels]
    return [(fit.cells, np.diag(fit.covariance).reshape(fit.cells.shape)) for fit in fits]


def change_cost(cells: Array, baseline: Array, variance: Array | float = 0.0) -> float:
    """Return Σ ln(1 + (Δ ln r)²/(CHANGE² + σ²)) of two panels.

    `variance` is σ² of the change by noise.
    """
    squares = np.log(cells / baseline) ** 2 / (CHANGE**2 + variance)
    return float(np.log1p(squares).sum())


def nearest_panel(panels: Sequence[Array], baseline: Array) -> Array:
    """Return the panel in which the fewest cells differ from the unloaded ones."""
    return min(panels, key=lambda cells: change_cost(cells, baseline))


def noise_share(readings: Readings) -> float:
    """Return the reach of readings' noise over their median; 0 where it is unknown."""
    if readings.sigma is None:
        return 0.0
    return NOISE_RANGE * float(np.median(readings.sigma) / np.median(readings.value))
