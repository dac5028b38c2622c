"""Choice among panels that read alike, by an unloaded and a loaded frame together.

Where idle lines hold the driven one harder than its driver does, several panels give the readings
of a frame (`lampest.panel.readouts.branches`). A load changes some cells, and the others stand
still: this holds for the pair of panels that is meant. In any other pair nearly all cells change,
because the potential of a driven line is another one beyond its fold. Pairs are compared by the
density of the loaded readings given the unloaded ones, with moved cells selected and the Jacobian
of the readings included (`FittedPair.density`). Another pair is ruled out where −2 ln density is
larger by CLEAR.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Self

import numpy as np

from lampest.inference.cells_fit import CellsFit, fitted
from lampest.inference.evidence import mostly_still
from lampest.inference.pair import FittedPair
from lampest.panel.panel import Array
from lampest.panel.scene import Scene
from lampest.recording.readings import Readings

CHANGE = 0.03  # of ln r: cells that change by less stand still within the noise of exact fits
CLEAR = 20.0  # of −2 ln density: odds of e^10, because linear theory is inexact near a fold
STILL = 2 * CHANGE  # median difference of ln r on a line of two panels that are different ones
SAME = 1e-2  # of r: fits that differ by less are one
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
        """Return the choice for two frames; None where one has bounds, or no panel is found."""
        circuit = scene.circuit
        if not (resting.plain.all() and loaded.plain.all()):
            return None
        if not circuit.several_panels(*resting.value.shape):
            return None
        tolerance = max(noise_share(resting), noise_share(loaded))
        unloaded = circuit.every_panel(resting.value, tolerance)
        of_load = circuit.every_panel(loaded.value, tolerance, unloaded)
        # Panels of a load are starts of the unloaded one that uniform panels may miss
        unloaded = circuit.every_panel(resting.value, tolerance, [*unloaded, *of_load])
        pairs = [
            FittedPair(frames)
            for frames in product(_fits(scene, resting, unloaded), _fits(scene, loaded, of_load))
        ]
        if not pairs:
            return None
        best = min(pairs, key=_cost)
        before, after = (fit.cells for fit in best.frames)
        still = mostly_still(best.moved)
        others = [pair for pair in pairs if _different(pair, best)]
        if not others:
            return cls(before, after, None, clear=still)
        second = min(others, key=_cost)
        other = next(
            there.cells
            for here, there in zip(best.frames, second.frames, strict=True)
            if _apart(here.cells, there.cells)
        )
        return cls(before, after, other, clear=still and _cost(second) - _cost(best) > CLEAR)

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


def _fits(scene: Scene, readings: Readings, panels: Sequence[Array]) -> list[CellsFit]:
    """Return the fits of a frame that begin at panels, those within noise if any is."""
    fits = list[CellsFit]()
    for cells in panels:
        fit = fitted(scene, readings, cells, patient=True)
        if fit is not None and not any(np.allclose(fit.cells, of.cells, SAME) for of in fits):
            fits.append(fit)
    return [fit for fit in fits if fit.within_noise] or fits


def _cost(pair: FittedPair) -> float:
    """Return −2 ln density of the loaded frame, and the misfit of both."""
    return pair.density + sum(fit.chi_square for fit in pair.frames)


def _different(pair: FittedPair, other: FittedPair) -> bool:
    """Return whether two pairs differ in either panel."""
    frames = zip(pair.frames, other.frames, strict=True)
    return any(_apart(here.cells, there.cells) for here, there in frames)


def _apart(cells: Array, others: Array) -> bool:
    """Return whether the cells of any line differ."""
    difference = np.abs(np.log(cells / others))
    return any(bool((np.median(difference, axis) > STILL).any()) for axis in (0, 1))


def change_cost(cells: Array, baseline: Array) -> float:
    """Return Σ ln(1 + (Δ ln r/CHANGE)²) of two panels."""
    return float(np.log1p((np.log(cells / baseline) / CHANGE) ** 2).sum())


def nearest_panel(panels: Sequence[Array], baseline: Array) -> Array:
    """Return the panel in which the fewest cells differ from the unloaded ones."""
    return min(panels, key=lambda cells: change_cost(cells, baseline))


def noise_share(readings: Readings) -> float:
    """Return the reach of readings' noise over their median; 0 where it is unknown."""
    if readings.sigma is None:
        return 0.0
    return NOISE_RANGE * float(np.median(readings.sigma) / np.median(readings.value))
